"""Noise of a gyro axis from a recording: the likelihood of means of a second at rest.

The published model cannot learn δ¹ and δ²: their covariance with x is nought and stays so.  They are fitted
here instead: with φ = 0 model L is a local level, and δ¹ = √(walk Δt), R = white / Δt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.estimation.random_error.drift import (
    FLICKERS,
    FLOOR,
    STATES,
    TAUS_S,
    TO_INSTABILITY,
    WALKS,
    WIDTH,
    log_prior,
    predict,
    start,
    sums,
    update,
)
from imumon.estimation.random_error.parameters import GyroNoise
from imumon.estimation.random_error.slots import SlotGatherer, Slots

LEAST_SLOTS = 30
GRID = 10.0 ** np.arange(-11.0, 1.01, 0.05)
"""Walks that are tried, to the white noise's density, 1/s²."""
CHI_SQUARE_95 = 3.84
"""A deviance may exceed the least by this within 95 %."""


@dataclass(frozen=True, slots=True)
class LocalLevelFit:
    """White noise and random walk of a local level.

    Parameters
    ----------
    white : float
        Density of the white noise, (rad/s)² s; R of a sample is white / Δt.
    walk : float
        (rad/s)²/s; q of a sample is walk Δt.  0 when no walk fits best.
    walk_range : tuple of 2 float
        95 % limits of the walk; the lower one is 0 when the data do not show that there is one.
    slots : int
        Seconds at rest that were used.
    """

    white: float
    walk: float
    walk_range: tuple[float, float]
    slots: int

    @property
    def identified(self) -> bool:
        """Whether the data show a walk at all; a minute hardly ever does."""
        return self.walk_range[0] > 0.0

    def delta1(self, interval_s: float) -> float:
        """Return δ¹ of the published model at this sampling interval, with δ² = 0, rad/s."""
        return float(np.sqrt(self.walk * interval_s))

    def noise_variance(self, interval_s: float) -> float:
        """Return R of a sample, (rad/s)²."""
        return self.white / interval_s


def gather(
    time_ns: IntArray,
    reading: FloatArray,
    at_rest: npt.NDArray[np.bool_] | None = None,
    segment: IntArray | None = None,
) -> Slots:
    """Return the slots of a recording.

    Parameters
    ----------
    time_ns : array of int64, (n,)
    reading : array, (n,)
        rad/s; NaN where there is none.
    at_rest : array of bool, (n,), optional
        Default throughout.
    segment : array of int64, (n,), optional
        Default one.

    Raises
    ------
    ImumonError
        BAD_DATA when there are too few.
    """
    n = len(reading)
    rest = np.ones(n, np.bool_) if at_rest is None else at_rest
    number = np.zeros(n, np.int64) if segment is None else segment
    slots = SlotGatherer().process(time_ns, number, reading, rest)
    found = int(np.count_nonzero(slots.covered_s))
    if found < LEAST_SLOTS:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{found} s of readings at rest",
            f"noise can be fitted from {LEAST_SLOTS} s on; hours are better",
        )
    return slots


def fit_local_level(
    time_ns: IntArray,
    reading: FloatArray,
    at_rest: npt.NDArray[np.bool_] | None = None,
    segment: IntArray | None = None,
) -> LocalLevelFit:
    """Fit white noise and random walk by likelihood; parameters and errors are those of `gather`."""
    slots = gather(time_ns, reading, at_rest, segment)
    candidates = np.concatenate([[0.0], GRID])
    deviances, whites = np.empty(len(candidates)), np.empty(len(candidates))
    for i, walk in enumerate(candidates):
        deviances[i], whites[i] = local_level_deviance(slots, float(walk))
    best = int(np.argmin(deviances))
    inside = np.flatnonzero(deviances <= deviances[best] + CHI_SQUARE_95)
    walks = candidates * whites[best]
    limits = float(walks[inside[0]]), float(walks[inside[-1]])
    return LocalLevelFit(
        float(whites[best]), float(walks[best]), limits, int(np.count_nonzero(slots.covered_s))
    )


def local_level_deviance(slots: Slots, walk: float) -> tuple[float, float]:
    """Return -2 log likelihood of a walk (to the white noise's density), and that density at its best."""
    deviance, white = _local_level(slots.begins, slots.elapsed_s, slots.covered_s, slots.mean, walk)
    return float(deviance), float(white)


def fit_noise(
    time_ns: IntArray,
    reading: FloatArray,
    at_rest: npt.NDArray[np.bool_] | None = None,
    segment: IntArray | None = None,
) -> GyroNoise:
    """Fit white noise, flicker and random walk by likelihood; parameters and errors are those of `gather`.

    How much flicker is usual counts as well (`drift.log_prior`): a short recording says little.  A kind of
    drift without which all is as likely (within 95 %) is None; one is always kept.
    """
    slots = gather(time_ns, reading, at_rest, segment)
    flicker, walk = _climb(slots)
    full, white = _deviance(slots, flicker, walk)
    without = [_deviance(slots, 0.0, walk)[0], _deviance(slots, flicker, 0.0)[0]]
    # The walk is dropped first: flicker is what every gyro has.
    if walk > 0.0 and flicker > 0.0 and without[1] < full + CHI_SQUARE_95:
        walk, flicker = 0.0, _along(slots, flicker, 0.0, 0)
    elif walk > 0.0 and flicker > 0.0 and without[0] < full + CHI_SQUARE_95:
        flicker, walk = 0.0, _along(slots, 0.0, walk, 1)
    _, white = _deviance(slots, flicker, walk)
    return GyroNoise(
        angle_random_walk=float(np.sqrt(white)),
        bias_instability=float(np.sqrt(flicker * white)) * TO_INSTABILITY if flicker else None,
        rate_random_walk=float(np.sqrt(walk * white)) if walk else None,
    )


def _deviance(slots: Slots, flicker: float, walk: float) -> tuple[float, float]:
    """Return -2 log of likelihood and prior, and the density of the white noise at its best."""
    deviance, white = _flicker_level(
        slots.begins, slots.elapsed_s, slots.covered_s, slots.mean, np.array([flicker, walk, 0.0])
    )
    return float(deviance) - 2.0 * log_prior(flicker), float(white)


def _climb(slots: Slots) -> tuple[float, float]:
    """Return the most likely ratios: the best of the bank's, then each in turn on a finer grid."""
    pairs = [(f, w) for f in FLICKERS for w in WALKS if f or w]
    flicker, walk = min(pairs, key=lambda pair: _deviance(slots, *pair)[0])
    for _ in range(3):
        flicker = _along(slots, flicker, walk, 0) if flicker else 0.0
        walk = _along(slots, flicker, walk, 1) if walk else 0.0
    return flicker, walk


def _along(slots: Slots, flicker: float, walk: float, which: int) -> float:
    """Return the best value of one ratio, the other kept: three finer and finer steps."""
    pair = [flicker, walk]
    for step in (0.5, 0.2, 0.05):
        tried = pair[which] * 10.0 ** (step * np.arange(-3.0, 3.1))
        values = []
        for value in tried.tolist():
            pair[which] = value
            values.append(_deviance(slots, pair[0], pair[1])[0])
        pair[which] = float(tried[int(np.argmin(values))])
    return pair[which]


@njit(cache=True, nogil=True)
def _local_level(
    begins: npt.NDArray[np.bool_], elapsed: FloatArray, covered: FloatArray, mean: FloatArray, walk: float
) -> tuple[float, float]:
    x, p = 0.0, -1.0
    logs, squares, count = 0.0, 0.0, 0
    for k in range(mean.size):
        if begins[k]:
            p = -1.0
        if p >= 0.0:
            p += walk * elapsed[k]
        if covered[k] == 0.0:
            continue
        if p < 0.0:
            x, p = mean[k], 1.0 / covered[k]
            continue
        total = p + 1.0 / covered[k]
        residual = mean[k] - x
        logs += np.log(total)
        squares += residual * residual / total
        count += 1
        x += p / total * residual
        p *= 1.0 - p / total
    white = squares / count + FLOOR
    return count * np.log(white) + logs, white


@njit(cache=True, nogil=True)
def _flicker_level(
    begins: npt.NDArray[np.bool_],
    elapsed: FloatArray,
    covered: FloatArray,
    mean: FloatArray,
    ratio: FloatArray,
) -> tuple[float, float]:
    bank, column, decay = np.zeros((1, WIDTH)), np.empty(STATES), np.ones(STATES)
    ratios = ratio.reshape(1, 3)
    logs, squares, count = 0.0, 0.0, 0
    started = False
    for k in range(mean.size):
        started = started and not begins[k]
        if started:
            decay[1:] = np.exp(-elapsed[k] / TAUS_S)
            predict(bank[0], ratio, decay, elapsed[k])
        if covered[k] == 0.0:
            continue
        if not started:
            start(bank, ratios, mean[k], covered[k])
            started = True
            continue
        predicted, _ = sums(bank[0], column)
        total = update(bank[0], mean[k], covered[k], column)
        logs += np.log(total)
        squares += (mean[k] - predicted) ** 2 / total
        count += 1
    white = squares / count + FLOOR
    return count * np.log(white) + logs, white
