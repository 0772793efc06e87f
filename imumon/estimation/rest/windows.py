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
    HALF_COUNT,
    HALF_SUM,
    KNOWN,
    LEARNT,
    LEVELS,
    MEAN_1,
    MEAN_2,
    SAMPLE_VAR,
    STEP,
    VARIANCE,
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
MOST_LEARNT, MOST_SURPRISE = 64.0, 4.0
SPIKE_SIGMAS = 7.0
TINY = 1e-24


@njit(cache=True, nogil=True)
def forget_windows(state: State) -> None:
    """Let no window begin before now."""
    level = state.level
    for a in range(AXES):
        for j in range(LEVELS):
            level[a, j, HALF_SUM] = level[a, j, HALF_COUNT] = 0.0
            level[a, j, MEAN_1] = level[a, j, MEAN_2] = np.nan
    state.waiting[:] = 0.0


@njit(cache=True, nogil=True)
def resolution(axis: FloatArray, a: int) -> float:
    """Return the step of axis a if its noise does not hide it, else 0."""
    step = axis[a, STEP]
    return step if axis[a, SAMPLE_VAR] < 0.25 * step * step else 0.0


@njit(cache=True, nogil=True)
def vibration_factor(count: float) -> float:
    """Return how many times its mean the variance of count samples may be (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * max(0.5 * (count - 1.0), 1.0))
    root = 1.0 - part + 6.0 * math.sqrt(part)
    return 2.0 * root * root * root


@njit(cache=True, nogil=True)
def shaken(state: State, slot_variance: FloatArray) -> bool:
    """Tell whether samples vary more within the slot just ended than they did at rest."""
    axis = state.axis
    for a in range(AXES):
        if axis[a, KNOWN] > 0.0 and axis[a, COUNT] >= 3.0:
            limit = axis[a, SAMPLE_VAR] * vibration_factor(axis[a, COUNT])
            if slot_variance[a] > limit + resolution(axis, a) ** 2:
                return True
    return False


@njit(cache=True, nogil=True)
def add_slot(
    state: State, sums: FloatArray, counts: FloatArray, seconds: float, drift: FloatArray
) -> tuple[int, float]:
    """Add a slot to all windows; return the longest level that moved, and its seconds, or (-1, 0).

    sums and counts, (6,), are overwritten.
    """
    waiting = state.waiting
    moved, moved_s = -1, 0.0
    for j in range(LEVELS):
        if seconds > LONGEST_S:
            break
        if _changed(state, j, sums, counts, seconds, drift):
            moved, moved_s = j, seconds
        _learn_and_shift(state, j, sums, counts)
        if waiting[j] == 0.0:
            waiting[j] = seconds
            for a in range(AXES):
                state.level[a, j, HALF_SUM] = sums[a]
                state.level[a, j, HALF_COUNT] = counts[a]
            break
        seconds += waiting[j]
        waiting[j] = 0.0
        for a in range(AXES):
            sums[a] += state.level[a, j, HALF_SUM]
            counts[a] += state.level[a, j, HALF_COUNT]
    return moved, moved_s


@njit(cache=True, nogil=True)
def _changed(
    state: State, j: int, sums: FloatArray, counts: FloatArray, seconds: float, drift: FloatArray
) -> bool:
    """Tell whether the means of gyros or of accelerometers differ from those one and two windows ago."""
    level, axis = state.level, state.axis
    for first in (0, 3):
        near, far = 0.0, 0.0
        for a in range(first, first + 3):
            if axis[a, KNOWN] == 0.0 or counts[a] == 0.0:
                continue
            mean, variance = sums[a] / counts[a], level[a, j, VARIANCE] + TINY
            allowed, step = drift[a] * seconds, resolution(axis, a)
            d = abs(mean - level[a, j, MEAN_1]) - allowed - step
            if d > 0.0:
                near += d * d / (2.0 * variance)
            d = abs(mean - level[a, j, MEAN_2]) - 2.0 * allowed - step
            if d > 0.0:
                far += d * d / (3.0 * variance)
        if near > CHI_SQUARE or far > CHI_SQUARE:
            return True
    return False


@njit(cache=True, nogil=True)
def _learn_and_shift(state: State, j: int, sums: FloatArray, counts: FloatArray) -> None:
    """Take the second difference as a measure of the variance; a single one cannot raise it much."""
    level = state.level
    for a in range(AXES):
        mean = sums[a] / counts[a] if counts[a] > 0.0 else np.nan
        if state.axis[a, KNOWN] > 0.0:
            second = mean - 2.0 * level[a, j, MEAN_1] + level[a, j, MEAN_2]
            if math.isfinite(second):
                old, learnt = level[a, j, VARIANCE], level[a, j, LEARNT]
                sample = min(second * second / 6.0, MOST_SURPRISE * old + TINY)
                white = level[a, 0, VARIANCE] / (1 << j)
                highest = COLOUR * max(white, QUIET[a] * QUIET[a])
                level[a, j, VARIANCE] = min(old + (sample - old) / (learnt + 1.0), highest)
                level[a, j, LEARNT] = min(learnt + 1.0, MOST_LEARNT)
        level[a, j, MEAN_2] = level[a, j, MEAN_1]
        level[a, j, MEAN_1] = mean
