"""A resting unit tested against the noise it had: means of neighbouring windows of 1, 2, 4 ... 128 slots.

The variance of a mean is learnt from second differences of three windows (a Hadamard variance), in which a
drift cancels; tested are first differences, in which it shows.  What a permitted drift or one step of the
sensor explains of a difference does not count.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import FloatArray
from imumon.estimation.rest.state import (
    AXES,
    COUNT,
    COUNTS,
    GAIN,
    HALF_COUNT,
    HALF_SUM,
    KNOWN,
    LEVELS,
    MEAN_1,
    MEAN_2,
    MEANS,
    SAMPLE_VAR,
    STEP,
    SUMS,
    VARIANCE,
    VARIANCES,
    State,
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
SPIKE_SIGMAS = 7.0
TINY = 1e-24


@njit(cache=True, nogil=True)
def forget_windows(state: State, slots: int) -> None:
    """Let no window begin before now; slots is the number added since this was called before."""
    level = state.level
    for j in range(LEVELS):
        if (1 << j) > slots:
            break
        state.waiting[j] = 0.0
        for a in range(AXES):
            level[j, HALF_SUM, a] = level[j, HALF_COUNT, a] = 0.0
            level[j, MEAN_1, a] = level[j, MEAN_2, a] = np.nan


@njit(cache=True, nogil=True)
def resolution(axis: FloatArray, a: int) -> float:
    """Return the step of axis a if its noise does not hide it, else 0."""
    step = axis[STEP, a]
    return step if axis[SAMPLE_VAR, a] < 0.25 * step * step else 0.0


@njit(cache=True, nogil=True)
def vibration_factor(count: float) -> float:
    """Return how many times its mean the variance of count samples may be (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * max(0.5 * (count - 1.0), 1.0))
    root = 1.0 - part + 6.0 * math.sqrt(part)
    return 2.0 * root * root * root


@njit(cache=True, nogil=True)
def shaken(state: State) -> bool:
    """Tell whether samples vary more within the slot just ended than they did at rest."""
    axis = state.axis
    for a in range(AXES):
        variance, usual = state.slot[VARIANCES, a], axis[SAMPLE_VAR, a]
        # The factor is 2 at least: most slots need no more than this.
        if variance > 2.0 * usual and axis[KNOWN, a] > 0.0 and axis[COUNT, a] >= 3.0:
            step = resolution(axis, a)
            if variance > usual * vibration_factor(axis[COUNT, a]) + step * step:
                return True
    return False


@njit(cache=True, nogil=True)
def add_slot(state: State, seconds: float, drift: FloatArray) -> tuple[int, float]:
    """Add the slot to all windows; return the longest level that moved, and its seconds, or (-1, 0).

    Sums, counts and means of the slot are overwritten by those of longer windows.
    """
    waiting, slot, level = state.waiting, state.slot, state.level
    moved, moved_s = -1, 0.0
    for j in range(LEVELS):
        if seconds > LONGEST_S:
            break
        if _changed(state, j, seconds, drift):
            moved, moved_s = j, seconds
        _learn_and_shift(state, j)
        if waiting[j] == 0.0:
            waiting[j] = seconds
            for a in range(AXES):
                level[j, HALF_SUM, a] = slot[SUMS, a]
                level[j, HALF_COUNT, a] = slot[COUNTS, a]
            break
        seconds += waiting[j]
        waiting[j] = 0.0
        count, share = 0.0, np.nan
        for a in range(AXES):
            slot[SUMS, a] += level[j, HALF_SUM, a]
            slot[COUNTS, a] += level[j, HALF_COUNT, a]
            if slot[COUNTS, a] != count:
                count = slot[COUNTS, a]
                share = 1.0 / count if count > 0.0 else np.nan
            slot[MEANS, a] = slot[SUMS, a] * share
    return moved, moved_s


@njit(cache=True, nogil=True)
def _changed(state: State, j: int, seconds: float, drift: FloatArray) -> bool:
    """Tell whether the means of gyros or of accelerometers differ from those one and two windows ago."""
    level, slot = state.level, state.slot
    suspect = False
    for a in range(AXES):
        # A sum of three over the limit has a term over a third of it.
        unlikely = (CHI_SQUARE / 3.0) * (level[j, VARIANCE, a] + TINY)
        near = abs(slot[MEANS, a] - level[j, MEAN_1, a]) - drift[a] * seconds
        far = abs(slot[MEANS, a] - level[j, MEAN_2, a]) - 2.0 * drift[a] * seconds
        suspect |= (near > 0.0) & (near * near > 2.0 * unlikely)
        suspect |= (far > 0.0) & (far * far > 3.0 * unlikely)
    return suspect and _improbable(state, j, seconds, drift)


@njit(cache=True, nogil=True)
def _improbable(state: State, j: int, seconds: float, drift: FloatArray) -> bool:
    """Sum the differences of each sensor's axes, less what drift and step explain."""
    level, axis, slot = state.level, state.axis, state.slot
    for first in (0, 3):
        near, far = 0.0, 0.0
        for a in range(first, first + 3):
            if axis[KNOWN, a] == 0.0:
                continue
            allowed, step = drift[a] * seconds, resolution(axis, a)
            variance = level[j, VARIANCE, a] + TINY
            d = abs(slot[MEANS, a] - level[j, MEAN_1, a]) - allowed - step
            e = abs(slot[MEANS, a] - level[j, MEAN_2, a]) - 2.0 * allowed - step
            # Means that are missing count for nothing.
            near += d * d / (2.0 * variance) if d > 0.0 else 0.0
            far += e * e / (3.0 * variance) if e > 0.0 else 0.0
        if near > CHI_SQUARE or far > CHI_SQUARE:
            return True
    return False


@njit(cache=True, nogil=True)
def _learn_and_shift(state: State, j: int) -> None:
    """Take the second difference as a measure of the variance; a single one cannot raise it much."""
    level, axis, slot = state.level, state.axis, state.slot
    white = 1.0 / (1 << j)
    for a in range(AXES):
        second = slot[MEANS, a] - 2.0 * level[j, MEAN_1, a] + level[j, MEAN_2, a]
        if axis[KNOWN, a] > 0.0 and math.isfinite(second):
            old, gain = level[j, VARIANCE, a], level[j, GAIN, a]
            sample = min(second * second * (1.0 / 6.0), MOST_SURPRISE * old + TINY)
            highest = COLOUR * max(white * level[0, VARIANCE, a], QUIET[a] * QUIET[a])
            level[j, VARIANCE, a] = min(old + (sample - old) * gain, highest)
            if gain > LEAST_GAIN:
                level[j, GAIN, a] = gain / (1.0 + gain)
        level[j, MEAN_2, a] = level[j, MEAN_1, a]
        level[j, MEAN_1, a] = slot[MEANS, a]
