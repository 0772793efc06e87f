"""Is the signal quiet?  Means of neighbouring windows against the noise that the unit has at rest.

A slot of a quarter of a second has a mean and a variance of each axis.  Of a unit at rest the means are white
noise of variance v about a constant.  While v is known, windows of 1, 2, 4 ... 64 slots and those before them
may differ by no more than v and a permitted drift explain; while it is not, a trial of 16 slots finds it.  No
bias is needed: whether a steady mean is the bias or a turn is not decided here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray

AXES = 6
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
GYRO, ACCEL = slice(0, 3), slice(3, 6)
SLOT_S = 0.25
TRIAL = 16
"""Slots of a trial."""
LENGTHS = 2 ** np.arange(7)
RING = 160
"""Slots that are remembered: two of the longest windows, and more."""
CHI_SQUARE = 42.0
"""Three axes together: once in 2e8 for Gaussian noise of known variance."""
QUIET = np.repeat([3.5e-4, 5e-3], 3)
"""Standard deviation of a mean of a second or more that is never suspicious, rad/s (72 °/h) and m/s²
(0.03°)."""
VIBRATION = np.repeat([3.5e-2, 0.5], 3)
"""rad/s and m/s², rms within a slot: more is motion.  VQF's limits (Laidig and Seel 2023)."""
ROAD = np.array([2.5e-3, 0.021])
"""rad/s and m/s², rms of slot means: no sensor is noisier (0.1 °/s/√Hz and 1.5 mg/√Hz), a road is."""
VARIANCE_SIGMAS, VARIANCE_FACTOR = 6.0, 2.0
"""The variance of a slot's samples is beyond so many sigmas of a chi-square (Wilson and Hilferty), and
this factor."""
MEMORY_SLOTS = 1200.0
"""Over which the noise is averaged at rest: five minutes."""
COLOUR = 5.0
"""In a trial: largest variance of means of 4 and 8 slots over that of white noise."""
HALVES, HALVES_OFFSET = 5.0, 20.0
"""In a trial: largest noise of one half over the other, and what is added to it."""
BUMP = 20.0
"""In a trial: largest difference of a slot from its neighbours' mean, squared, over its variance."""
SLOWER = 16.0
"""In a trial: largest variance of slot means over that which their samples explain: more is slow motion."""
ANOTHER = 2.5
"""Factor of the variance from which on a trial has found another noise."""
SPIKE_SIGMAS = 8.0
"""A single sample so far from the mean at rest ends it."""
TINY = 1e-24
COARSEST_STEPS = (0.035, 0.16)
"""No gyro (rad/s) and no accelerometer (m/s²) reads in coarser steps: 2 °/s is what may shake at rest."""
DITHER = 2.0 * np.pi**2
"""Noise of variance v lets a mean err by exp(-DITHER v) half steps of the sensor, v in steps squared
(Widrow)."""


class Second(NamedTuple):
    """Means over about a second in which the unit was quiet."""

    end_s: float
    seconds: float
    """What its samples cover: the white noise is that of so long."""
    rate: FloatArray
    """rad/s, (3,)."""
    force: FloatArray
    """m/s², (3,); NaN without accelerometers."""
    degc: FloatArray
    """Temperature of each gyro, (3,); NaN without one."""
    heading: FloatArray = np.full(3, np.nan)
    """A vector that turns with the heading, (3,), by a magnetometer or the device; NaN without one."""


class Slot(NamedTuple):
    """One slot of samples of the six axes, (6,) each; NaN where an axis has none."""

    seconds: float
    samples: FloatArray
    mean: FloatArray
    variance: FloatArray
    """About the mean (n - 1)."""
    step: FloatArray
    """Step of the sensor, if its readings were mostly equal and some differed by one; else infinite."""


@dataclass(slots=True, eq=False)
class State:
    """The latest slots, and the noise at rest."""

    total: FloatArray = field(default_factory=lambda: np.zeros((RING, AXES)))
    """Sum of the means up to each slot."""
    mean: FloatArray = field(default_factory=lambda: np.zeros((RING, AXES)))
    within: FloatArray = field(default_factory=lambda: np.full((RING, AXES), np.nan))
    slots: int = 0
    """Since the start."""
    begun: int = 0
    """How many there were when it began anew."""
    run: int = 0
    """Quiet slots in a row; 0 while it moves, or nothing is known."""
    unquiet: int = 0
    """Slots that were not, since the last rest of a trial's length."""
    known: bool = False
    noise: FloatArray = field(default_factory=lambda: np.zeros(AXES))
    """Variance of the mean of a slot at rest, (6,)."""
    sample_noise: FloatArray = field(default_factory=lambda: np.zeros(AXES))
    """Variance of its samples at rest, (6,)."""
    learned: float = 0.0
    disturbed: bool = False
    """Whether a single sample of the present slot was outside `band`."""
    another: bool = False
    """Whether a trial has found another noise with this slot."""
    present: BoolArray = field(default_factory=lambda: np.zeros(AXES, np.bool_))
    """Axes that have readings, (6,)."""
    absent: int = 0
    """Slots for which one of them had none."""
    step: FloatArray = field(default_factory=lambda: np.repeat(np.inf, AXES))
    """Step of the sensor, (6,); infinite while it is not known."""
    seconds: float = SLOT_S

    def means(self, count: int) -> FloatArray:
        """Return the means of the latest slots, oldest first, (count, 6)."""
        return self.mean[np.arange(self.slots - count, self.slots) % RING]

    @property
    def rounding(self) -> FloatArray:
        """Variance that rounding gives a mean which the noise does not reach, (6,)."""
        found: FloatArray = np.where(np.isfinite(self.step), self.step, 0.0) ** 2 / 12.0
        return found

    @property
    def rounding_error(self) -> FloatArray:
        """Largest error of a mean by rounding to steps of the sensor, (6,)."""
        step = np.where(np.isfinite(self.step), self.step, 0.0)
        noise = np.maximum(self.sample_noise / (step * step + TINY) - 1.0 / 12.0, 0.0)
        return np.asarray(0.5 * step * np.exp(-DITHER * noise))

    @property
    def band(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest reading of a unit at rest, (6,) each; infinite while it is not."""
        width = np.where(self.present, SPIKE_SIGMAS * np.sqrt(self.sample_noise + self.noise), np.inf)
        width = width + 4.0 * QUIET + np.where(np.isfinite(self.step), 1.5 * self.step, 0.0)
        centre = self.means(4).mean(0)
        return centre - width, centre + width


def begin(state: State) -> None:
    """Begin anew, after a gap or a restart: the noise is what it was."""
    state.begun, state.run, state.unquiet = state.slots, 0, 0


def step(state: State, slot: Slot, drift: FloatArray, at_rest: bool | None = None) -> int:
    """Take a slot; return how many have been quiet in a row.

    Parameters
    ----------
    drift : array (6,)
        Permitted at rest, rad/s² and m/s³.
    at_rest : bool or None
        Whether the unit was at rest, where another detector decides; only the noise is learned then.
    """
    mean = _completed(state, slot)
    j = state.slots % RING
    state.total[j], state.mean[j], state.within[j] = state.total[j - 1] + mean, mean, slot.variance
    state.slots += 1
    state.seconds, state.another = slot.seconds, False
    if at_rest is not None:
        _learn_at_given_rest(state, slot, at_rest)
        return state.run
    first_step = bool((np.isfinite(slot.step) & ~np.isfinite(state.step)).any())
    state.disturbed &= not first_step  # the first step of a coarse sensor is outside a band that knew none
    state.step = np.minimum(state.step, slot.step)
    if state.known:
        state.run += 1
        if _moves(state, slot, drift) or state.disturbed:
            state.run, state.unquiet = 0, state.unquiet + 1
        else:
            _learn(state, slot)
    state.disturbed = False
    needed = not state.known or (state.unquiet >= 4 and state.run < TRIAL)
    if needed and state.slots - state.begun >= TRIAL and state.slots % 4 == 0:
        _try(state, slot)
    return state.run


def _completed(state: State, slot: Slot) -> FloatArray:
    """Return the means, with the last one of an axis that pauses, and 0 of one that is absent; note which
    are there."""
    there = np.isfinite(slot.mean)
    if (there > state.present).any():
        state.known, state.present = False, state.present | there
        begin(state)
    state.absent = state.absent + 1 if (there < state.present).any() else 0
    if state.absent > TRIAL:
        state.known, state.present, state.absent = False, there, 0
        begin(state)
    return np.where(there, slot.mean, np.where(state.present, state.mean[(state.slots - 1) % RING], 0.0))


def _moves(state: State, slot: Slot, drift: FloatArray) -> bool:
    """Return whether windows, or the samples of the slot, differ by more than noise and drift."""
    lengths = LENGTHS[state.run >= 2 * LENGTHS]
    if len(lengths):
        j, width = state.slots - 1, lengths[:, np.newaxis]
        now, then, before = (
            state.total[j % RING],
            state.total[(j - lengths) % RING],
            state.total[(j - 2 * lengths) % RING],
        )
        excess = np.maximum(np.abs(now - 2.0 * then + before) / width - drift * state.seconds * width, 0.0)
        # A shorter window has a smaller floor: a disturbance has had less time to act.
        floor = QUIET**2 / np.maximum(1.0, 4.0 / width) + state.rounding
        square = excess**2 / (2.0 * np.maximum(state.noise / width, floor))
        if (square.reshape(-1, 2, 3).sum(2) > CHI_SQUARE).any():
            return True
    return bool((slot.variance > _largest_variance(state, slot.samples)).any())


def _largest_variance(state: State, count: FloatArray) -> FloatArray:
    """Return the largest variance of so many samples at rest, (6,); infinite of fewer than three."""
    k = 2.0 / (9.0 * np.maximum(0.5 * (count - 1.0), 1.0))
    factor = VARIANCE_FACTOR * (1.0 - k + VARIANCE_SIGMAS * np.sqrt(k)) ** 3
    limit = np.maximum(factor * state.sample_noise, 1e-12) + 12.0 * state.rounding
    return np.where(count >= 3.0, limit, np.inf)


def _learn(state: State, slot: Slot) -> None:
    """Learn the noise from second differences, in which a drift cancels."""
    if state.run < 3:
        return
    first, second, third = state.means(3)
    gain = max(1.0 / MEMORY_SLOTS, 1.0 / (state.learned + 1.0))
    state.learned += 1.0
    square = (third - 2.0 * second + first) ** 2 / 6.0
    state.noise = state.noise + gain * (np.minimum(square, 9.0 * state.noise) - state.noise)
    enough = slot.samples >= 3.0
    if enough.any():
        within = np.where(enough, np.minimum(slot.variance, 4.0 * state.sample_noise), state.sample_noise)
        state.sample_noise = state.sample_noise + gain * (within - state.sample_noise)
    if state.run >= TRIAL:
        state.unquiet = 0


def _learn_at_given_rest(state: State, slot: Slot, at_rest: bool) -> None:
    """Count slots at rest, and learn their noise, once there are enough of them."""
    state.run = state.run + 1 if at_rest else 0
    if state.run >= TRIAL and not state.known:
        state.known, state.learned = True, TRIAL - 2.0
        state.noise = noise_of(state.means(TRIAL))
        state.sample_noise = state.noise * slot.samples
    elif at_rest:
        _learn(state, slot)


def noise_of(mean: FloatArray) -> FloatArray:
    """Return the variance of slot means by their second differences, (6,)."""
    return np.asarray(np.maximum((np.diff(mean, 2, axis=0) ** 2).mean(0) / 6.0, TINY))


def _try(state: State, slot: Slot) -> None:
    """Take the noise of the last slots, if they look like a constant with noise, and like another one."""
    found = trial(
        state.means(TRIAL),
        state.within[np.arange(state.slots - TRIAL, state.slots) % RING],
        slot.samples,
        state,
    )
    if found is None:
        return
    noise, within = found
    other = (noise > ANOTHER * state.noise + state.rounding) | (
        within > ANOTHER * state.sample_noise + state.rounding
    )
    if state.known and not other.any():
        return
    state.another, state.known = True, True
    state.noise, state.sample_noise = noise, within
    state.learned, state.run, state.unquiet = TRIAL - 2.0, TRIAL, 0


def trial(
    mean: FloatArray, within: FloatArray, count: FloatArray, state: State
) -> tuple[FloatArray, FloatArray] | None:
    """Return the variance of slot means and of samples, (6,) each; None of what moves.

    Parameters
    ----------
    mean, within : array (16, 6)
        Means of slots, and variances of their samples.
    """
    second, noise = np.diff(mean, 2, axis=0), noise_of(mean)
    enough = np.isfinite(within).all(0) & (count >= 3.0)
    samples = np.where(enough, np.where(enough, within, 0.0).mean(0), noise * count)
    quiet2 = (np.minimum(QUIET**2, 9.0 * state.noise) if state.known else QUIET**2) + state.rounding
    floor = np.maximum(noise, quiet2)
    if _is_road(mean, noise, samples, count):
        return None
    for length in (4, 8):  # noise averages out
        means = mean.reshape(-1, length, AXES).mean(1)
        ratio = means.var(0, ddof=1) / np.maximum(noise / length, quiet2)
        if (ratio.reshape(2, 3).mean(1) > COLOUR).any() or (ratio > 2.0 * COLOUR).any():
            return None
    if (enough & (noise * count > SLOWER * samples) & (noise > quiet2)).any():
        return None  # a hand is slow within a slot and fast between slots
    halves = np.stack([(second[:7] ** 2).sum(0), (second[7:] ** 2).sum(0)]) / floor
    by_sensor = halves.reshape(2, 2, 3).sum(2)
    if (by_sensor.max(0) > HALVES * by_sensor.min(0) + HALVES_OFFSET).any():
        return None
    if (second**2 / 6.0 > BUMP * floor).any():
        return None
    return noise, samples


def _is_road(mean: FloatArray, noise: FloatArray, samples: FloatArray, count: FloatArray) -> bool:
    """Return whether it shakes more than any sensor's noise does."""
    white = noise * count < 1.5 * samples
    loud = np.maximum(mean.var(0), noise).reshape(2, 3).mean(1) > ROAD**2
    loud &= count.reshape(2, 3).max(1) >= 3.0  # single samples are as loud as they are
    shakes = samples > VIBRATION**2
    if loud[1] or shakes[ACCEL].any():
        return True
    return bool((loud[0] and not white[GYRO].all()) or (shakes & ~white)[GYRO].any())
