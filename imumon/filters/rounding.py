"""What rounding to steps leaves of a signal with noise.

The mean of rounded samples errs by a periodic function of the signal; its amplitude for normal noise of
standard deviation s, with steps q, is q/pi exp(-2 pi² s²/q²): the first term of the Fourier series of the
sawtooth that rounding is, averaged over the noise (Widrow and Kollar, Quantization Noise, 2008, ch. 4).
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from imumon.blocks import FloatArray

FEW = 0.2  # distinct values, as a share of the samples, below which they lie on a grid
ON_GRID = 0.05  # share of a step within which a difference is a whole number of steps
ROUNDED = 1.0 / 12.0  # variance of what rounding adds, in steps squared
KEPT, BLOCK = 320, 64
"""Pieces of a channel that are evaluated, and samples of each: few, for its mean to be constant."""
FARTHEST = 6  # steps from the middle of a piece that are counted apart: for noise of 1.6 steps, four sigmas
TERMS = 60
"""Of the series that are summed: with noise of 0.02 steps, the least that is tried, the last is < 1e-14."""
RATIOS = np.geomspace(0.02, 1.6, 45)
"""Noise in steps that is tried, 10 % apart; above the last, rounding leaves all but 1e-22."""
PHASES = np.linspace(-0.5, 0.5, 21)  # means of a piece between two steps that are tried
LEAST_PROBABILITY = 1e-12  # of a step however far: a single outlier decides nothing


def mean_error(step: float, ratio: float) -> float:
    """Return by how much the mean of rounded samples errs at the most, for noise of `ratio` steps.

    By all `TERMS` of the series; without noise it is half a step, which they overshoot (Gibbs).
    """
    k = np.arange(1, TERMS + 1)
    sizes = np.exp(-2.0 * (np.pi * k * ratio) ** 2) / (np.pi * k)
    course = np.sin(2.0 * np.pi * np.outer(np.linspace(0.0, 0.5, 2 * TERMS), k)) @ (sizes * (-1.0) ** k)
    return step * min(float(np.abs(course).max()), 0.5)


def grid_step(distinct: FloatArray, samples: int) -> float:
    """Return the step of the grid that distinct values lie on, in the main; 0 when there is none."""
    if len(distinct) < 2 or len(distinct) > FEW * samples:
        return 0.0
    gaps = np.diff(distinct)  # the smallest are single steps; nine of ten must be whole ones
    # Rounded in a decimal text or by a factor, equal steps differ in their last digits.
    step = float(np.median(gaps[gaps <= 1.5 * np.quantile(gaps, 0.25)]))
    whole = np.abs(gaps / step - np.round(gaps / step)) < ON_GRID
    return step if whole.mean() > 0.9 else 0.0


class Digits(NamedTuple):
    """Step of a channel, in its unit, and its noise before rounding, in steps."""

    step: float
    ratio: float

    @property
    def error(self) -> float:
        """Part of the variance of a slow signal that rounding may add or take away.

        A slow signal of less than a step is passed on with a gain that differs from one by the slope of the
        error of the mean, 2 exp(-2 pi² ratio²); its variance by twice that.
        """
        return 4.0 * float(np.exp(-2.0 * (np.pi * self.ratio) ** 2))

    @property
    def share(self) -> float:
        """Part of the variance of a sample that is of rounding."""
        return ROUNDED / (ROUNDED + self.ratio**2)


def digits(values: FloatArray) -> Digits | None:
    """Return the digits of samples in order, (n,).

    None where none show: no grid, noise of more than 1.6 steps, a constant, or fewer than `BLOCK` samples.
    The noise is the likeliest by how often each step is read, each short piece with a mean of its own:
    between two steps readings toggle, in the middle of one they stand still, and both are the same noise.
    """
    pieces = len(values) // BLOCK
    if not pieces:
        return None
    chosen = np.unique(np.linspace(0, pieces - 1, min(pieces, KEPT)).astype(np.int64))
    parts = values[: pieces * BLOCK].reshape(pieces, BLOCK)[chosen]
    distinct = np.unique(parts)
    if len(distinct) == 1:  # a reading changes now and then, if ever
        changes = np.abs(np.diff(values))
        changes = changes[changes > 0.0]
        return Digits(float(changes.min()), float(RATIOS[0])) if len(changes) else None
    step = grid_step(distinct, parts.size)
    spread = np.sqrt(np.mean(np.diff(parts, axis=1) ** 2) / 2.0)
    if step == 0.0 or spread > RATIOS[-1] * step:
        return None
    middle = np.sort(parts, axis=1)[:, BLOCK // 2, None]  # one of the readings
    steps = np.clip(np.rint((parts - middle) / step), -FARTHEST, FARTHEST)
    counts = np.array([(steps == place).sum(axis=1) for place in range(-FARTHEST, FARTHEST + 1)])
    edges = np.concatenate([[-np.inf], np.arange(-FARTHEST, FARTHEST) + 0.5, [np.inf]])
    below = ndtr((edges - PHASES[:, None]) / RATIOS[:, None, None])
    likely = np.log(np.maximum(np.diff(below), LEAST_PROBABILITY)) @ counts  # (ratios, phases, pieces)
    best = likely.max(axis=1).sum(axis=1)
    return Digits(step, float(RATIOS[int(np.argmax(best))]))
