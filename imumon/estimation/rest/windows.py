"""A resting unit tested against the noise it had: means of neighbouring windows of 1, 2, 4 ... 128 slots.

The variance of a mean is learnt from second differences of three windows (a Hadamard variance), in which a
drift cancels; tested are first differences, in which it shows.  What a permitted drift or one step of the
sensor explains of a difference does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner, njit
from imumon.estimation.rest.state import (
    AXES,
    CAPACITY,
    DITHER,
    LEVELS,
    ROUNDED,
    SLOT_S,
    Slot,
    State,
    Windows,
    empty_slots,
)

CHI_SQUARE = 42.0
"""Three axes together: once in 2e8 for Gaussian noise of known variance."""
LONGEST_S = 20.0
"""Longer windows would only see drift."""
QUIET = np.array([3.5e-4, 3.5e-4, 3.5e-4, 4e-3, 4e-3, 4e-3])
"""Standard deviation of a mean below which no noise is suspicious, rad/s (72 deg/h) and m/s² (0.02 deg)."""
COLOUR = 5.0
"""Variance of the means of longer windows may be so many times that of white noise: a hand is slower."""
LEAST_GAIN, MOST_SURPRISE = 1.0 / 64.0, 4.0
TINY = 1e-24
SAMPLE_MEMORY = 1.0 / 64.0
QUIETER = 2.0
"""A variance over `SAMPLE_MEMORY` so many times smaller than that of before is no chance: three sigmas for
three samples in a slot.  Readings between two steps of the sensor toggle with the variance of a noise that
would hide the steps; where they stand still, they show how little of it there is."""
SPIKE_SIGMAS = 7.0
MEMORY_SLOTS = 32
"""Slots of the mean at rest."""
ROUNDING = 1e-9
"""Samples that differ by less than this share are equal: means of equal samples differ by rounding."""
MOST_WITHIN = np.array([3.5e-2, 3.5e-2, 3.5e-2, 0.5, 0.5, 0.5])
"""rad/s and m/s², rms: more vibration is motion.  2 °/s and 0.5 m/s² are the limits of VQF's rest detection
(Laidig and Seel 2023, restThGyr and restThAcc); an engine that idles stays at a third of them."""

SLOTS = 2 ** np.arange(LEVELS)


class Motion(NamedTuple):
    """The shortest windows that showed motion: their level and their seconds.

    sudden tells whether a sample or the vibration showed it as well; before is how many slots ago the latest
    window ended, and began, that was rest still; turning, that only the gyros' mean about the vertical showed
    it, and mean, what that was before, (6,), so many seconds ago, at degc °C.
    """

    level: int
    seconds: float
    sudden: bool
    before: tuple[int, int]
    turning: bool = False
    mean: FloatArray | None = None
    age_s: float = 0.0
    degc: float = np.nan


def seen(
    state: State, slots: Sequence[Slot], first: int, stop: int, drift: FloatArray
) -> tuple[int, Motion | None]:
    """Take slots until one shows motion, and learn the noise from those before it.

    Parameters
    ----------
    first, stop : int
        Which of the slots: the first, and the one that is taken no more.
    drift : array, (6,)
        Permitted, rad/s² and m/s³.

    Returns
    -------
    int
        How many were taken.
    Motion or None
        What the last of them shows.
    """
    state.make_room()
    stop = min(stop, first + CAPACITY - state.length)
    taken, level, sudden = _take(
        state.windows, state.length, state.quiet_from, slots, first, stop, drift, state.at_rest
    )
    state.length += taken
    if level < 0 and not sudden:
        return taken, None
    level = max(level, 0)
    return taken, Motion(level, state.span_s(2**level), sudden, (2 << level, 3 << level))


# What follows is compiled, for it runs with each slot.


@njit
def _take(
    windows: Windows,
    n: int,
    quiet_from: int,
    slots: Sequence[Slot],
    first: int,
    stop: int,
    drift: FloatArray,
    at_rest: bool,
) -> tuple[int, int, bool]:
    """Return how many slots were taken, and what the last shows, as `_shown` does."""
    for k in range(first, stop):
        level, sudden = _shown(windows, n + k - first, quiet_from, slots[k], drift, at_rest)
        if level >= 0 or sudden:
            return k - first + 1, level, sudden
    return stop - first, -1, False


@inner
def _shown(
    windows: Windows, n: int, quiet_from: int, slot: Slot, drift: FloatArray, at_rest: bool
) -> tuple[int, bool]:
    """Return the level of the shortest windows that show motion, -1 for none, and whether it is sudden."""
    _add(windows, n, slot)
    spike, present = False, False
    for j in range(AXES):
        present |= windows.known[j] and slot.samples[j] > 0
        spike |= slot.smallest[j] < windows.low[j] or slot.largest[j] > windows.high[j]
    if not present:
        return -1, False
    level = _compare(windows, n + 1, quiet_from, drift)
    sudden = (spike and at_rest) or _shaken(windows, slot)
    if at_rest and level < 0 and not sudden:
        _keep(windows, n + 1 - quiet_from, slot, drift)
    return level, sudden


@inner
def _add(windows: Windows, n: int, slot: Slot) -> None:
    """Add a slot to the n of the history, and see how fine the sensor's steps are."""
    windows.seconds[n + 1] = windows.seconds[n] + (slot.end_s - slot.start_s)
    for j in range(3):
        windows.reference[n, j] = slot.reference[j]
    windows.degc[n] = slot.degc if n == 0 or np.isfinite(slot.degc) else windows.degc[n - 1]
    for j in range(AXES):
        present = slot.samples[j] > 0.0
        windows.average[n, j], windows.within[n, j] = slot.average[j], slot.within[j]
        windows.jumps[n, j] = slot.jumps[j]
        windows.total[n + 1, j] = windows.total[n, j] + (
            slot.samples[j] * slot.average[j] if present else 0.0
        )
        windows.samples[n + 1, j] = windows.samples[n, j] + slot.samples[j]
        least = ROUNDING * (abs(slot.average[j]) + 1e-3)
        for step in (slot.largest[j] - slot.smallest[j], abs(slot.first[j] - windows.last[j])):
            if least < step < windows.step[j]:
                windows.step[j] = step
        if present:
            windows.last[j] = slot.last[j]


@inner
def _compare(windows: Windows, n: int, quiet_from: int, drift: FloatArray) -> int:
    """Compare the windows that end now with the two before them, and learn from them."""
    found, levels = -1, 0
    while levels < LEVELS and (n - quiet_from) % (1 << levels) == 0:
        if windows.seconds[n] - windows.seconds[n - (1 << levels)] > LONGEST_S:
            break
        levels += 1
    for level in range(levels - 1, -1, -1):
        _fill_recent(windows, n, quiet_from, 1 << level)
        if _differ(windows, level, windows.seconds[n] - windows.seconds[n - (1 << level)], drift):
            found = level
        _learn(windows, level)
    return found


@inner(error_model="numpy")
def _fill_recent(windows: Windows, n: int, quiet_from: int, slots: int) -> None:
    """Write the means of the last three windows of so many slots, latest first; NaN where one is empty."""
    new = n
    for lag in range(3):
        old = max(new - slots, quiet_from)
        for j in range(AXES):
            total = windows.total[new, j] - windows.total[old, j]
            windows.recent[lag, j] = total / (windows.samples[new, j] - windows.samples[old, j])
        new = old


@inner
def _differ(windows: Windows, level: int, seconds: float, drift: FloatArray) -> bool:
    """Tell whether the latest window differs from one of the two before by more than noise, drift and step.

    Of the variance in the difference to the older one two parts of three are its: it is as old as it is rare.
    """
    for lag in (1, 2):
        for sensor in (0, 3):
            chi = 0.0
            for j in range(sensor, sensor + 3):
                change = abs(windows.recent[0, j] - windows.recent[lag, j])
                excess = change - lag * drift[j] * seconds - windows.resolution[j]
                if windows.known[j] and excess > 0.0:
                    chi += excess * excess / ((1.0 + lag) * (windows.variance[level, j] + TINY))
            if chi > CHI_SQUARE:
                return True
    return False


@inner
def _learn(windows: Windows, level: int) -> None:
    """Take the second difference as a measure of the variance; a single one cannot raise it much."""
    for j in range(AXES):
        second = windows.recent[0, j] - 2.0 * windows.recent[1, j] + windows.recent[2, j]
        if not (windows.known[j] and np.isfinite(second)):
            continue
        old, gain = windows.variance[level, j], windows.gain[level, j]
        sample = min(second * second / 6.0, MOST_SURPRISE * old + TINY)
        highest = COLOUR * max(windows.variance[0, j] / (1 << level), QUIET[j] ** 2)
        windows.variance[level, j] = min(old + gain * (sample - old), highest)
        if gain > LEAST_GAIN:
            windows.gain[level, j] = gain / (1.0 + gain)


@inner
def vibration_factor(count: float) -> float:
    """Return how many times its mean the variance of count samples may be (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * max(0.5 * (count - 1.0), 1.0))
    return 2.0 * (1.0 - part + 6.0 * np.sqrt(part)) ** 3  # type: ignore[no-any-return]


@inner
def _shaken(windows: Windows, slot: Slot) -> bool:
    """Tell whether samples vary more within the slot than they did at rest."""
    for j in range(AXES):
        within = slot.within[j]
        # A trial may have found a gyro whose white noise alone is more.
        if within > max(MOST_WITHIN[j] ** 2, 2.0 * windows.sample_variance[j]):
            return True
        if windows.known[j] and slot.samples[j] >= 3 and within > 2.0 * windows.sample_variance[j]:
            limit = windows.sample_variance[j] * vibration_factor(slot.samples[j])
            if within > limit + windows.resolution[j] ** 2:
                return True
    return False


@inner
def _keep(windows: Windows, quiet: int, slot: Slot, drift: FloatArray) -> None:
    """At rest still: follow the mean and the noise, and set the band outside which a sample is motion."""
    share = 1.0 / min(quiet, MEMORY_SLOTS)
    for j in range(AXES):
        if not windows.known[j]:
            continue
        known = windows.sample_variance[j]
        if slot.samples[j] > 0.0:
            windows.rest_mean[j] += share * (slot.average[j] - windows.rest_mean[j])
            within = slot.within[j] if np.isfinite(slot.within[j]) else windows.variance[0, j]
            # Readings that hardly ever change hide noise that rounding leaves of: a change is no surprise.
            usual = max(known, ROUNDED * windows.step[j] * windows.step[j]) + TINY
            known += SAMPLE_MEMORY * (min(within, MOST_SURPRISE * usual) - known)
            windows.sample_variance[j] = known
            windows.quietest[j] = min(windows.quietest[j], QUIETER * known)
        _set_band(windows, j, drift[j])


@inner
def _set_band(windows: Windows, j: int, drift: float) -> None:
    step = windows.step[j]
    noise = min(windows.sample_variance[j], windows.quietest[j]) / (step * step + TINY)
    windows.resolution[j] = step * np.exp(-DITHER * max(noise - ROUNDED, 0.0))
    sd = np.sqrt(windows.sample_variance[j] + windows.variance[0, j])
    width = SPIKE_SIGMAS * sd + 1.5 * windows.resolution[j] + drift * MEMORY_SLOTS * SLOT_S
    windows.low[j], windows.high[j] = windows.rest_mean[j] - width, windows.rest_mean[j] + width


@njit
def set_band(windows: Windows, drift: FloatArray) -> None:
    """Set the band outside which a single sample is motion, and what is left of the sensor's steps."""
    for j in range(AXES):
        windows.low[j], windows.high[j] = -np.inf, np.inf
        if windows.known[j]:
            _set_band(windows, j, drift[j])


def compile_kernels() -> None:
    """Compile what runs with each slot, or load it."""
    state = State()
    seen(state, empty_slots(1), 0, 1, np.zeros(AXES))
    set_band(state.windows, np.zeros(AXES))
