"""Rest without knowledge of the noise: 32 slots that look like noise about a constant.

White noise averages out over longer windows; hands, vehicles and anything else that moves do not.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import FloatArray
from imumon.estimation.rest.state import (
    AXES,
    GAIN,
    KNOWN,
    LEVELS,
    RING,
    SAMPLE_VAR,
    STEP,
    VARIANCE,
    State,
)
from imumon.estimation.rest.windows import CHI_SQUARE, COLOUR, QUIET, TINY

HALF = RING // 2
ALIKE = 2.5
LARGEST_SD = np.array([8.7e-3, 8.7e-3, 8.7e-3, 0.1, 0.1, 0.1])
"""No sensor has slot means noisier than this: 0.5 deg/s, 0.1 m/s²."""
STEADY = 4.0
"""Ratio of the variances in the two halves of a trial."""
LARGEST_RATIO = 20.0
"""A single second difference, squared, over the mean of them: more is a bump."""
NEIGHBOUR = math.sqrt(0.5)
"""Variance at a level of which nothing is known over that of half the windows: between white and flicker."""

# What a trial finds of an axis: variance of a mean of 1, 4, 8 slots; of a sample; what the step explains.
V1, V4, V8, WITHIN, FLOOR = range(5)


@njit(cache=True, nogil=True)
def present(ring: FloatArray, a: int) -> bool:
    """Tell whether axis a has been there in all slots of the ring."""
    finite = True
    for i in range(RING):
        finite = finite and math.isfinite(ring[a, i, 0])
    return finite


@njit(cache=True, nogil=True)
def mean_of(ring: FloatArray, a: int, begin: int, end: int) -> float:
    """Return the mean of slots begin to end."""
    total = 0.0
    for i in range(begin, end):
        total += ring[a, i, 0]
    return total / (end - begin)


@njit(cache=True, nogil=True)
def _second_differences(ring: FloatArray, a: int, width: int) -> float:
    """Return the variance of means of width slots from all their second differences."""
    total, count = 0.0, 0
    for begin in range(RING - 3 * width + 1):
        difference = 0.0
        for i in range(begin, begin + width):
            difference += ring[a, i, 0] - 2.0 * ring[a, i + width, 0] + ring[a, i + 2 * width, 0]
        total += difference * difference
        count += 1
    return total / (6.0 * count * width * width)


@njit(cache=True, nogil=True)
def _within(ring: FloatArray, a: int, begin: int, end: int) -> float:
    """Return the mean variance within slots, NaN when they hold single samples."""
    total, count = 0.0, 0
    for i in range(begin, end):
        if math.isfinite(ring[a, i, 1]):
            total += ring[a, i, 1]
            count += 1
    return total / count if count else np.nan


@njit(cache=True, nogil=True)
def _steady(ring: FloatArray, a: int, found: FloatArray, power: FloatArray) -> bool:
    """Add the second differences of both halves to power, (2, 2); tell whether none stands out."""
    mean, largest = 0.0, 0.0
    for i in range(RING - 2):
        h = ring[a, i, 0] - 2.0 * ring[a, i + 1, 0] + ring[a, i + 2, 0]
        scaled = h * h / (6.0 * (found[V1] + found[FLOOR] + TINY))
        power[0, 0 if i < HALF - 1 else 1] += scaled
        mean += scaled / (RING - 2)
        largest = max(largest, scaled)
    for half in range(2):
        within = _within(ring, a, half * HALF, (half + 1) * HALF)
        if math.isfinite(within):
            power[1, half] += (within + found[FLOOR]) / (found[WITHIN] + found[FLOOR] + TINY)
    return largest <= LARGEST_RATIO * max(mean, 1.0)


@njit(cache=True, nogil=True)
def _sensor_rests(ring: FloatArray, first: int, found: FloatArray, drift: FloatArray, seconds: float) -> bool:
    """Tell whether three axes are noise about a constant; seconds is the length of the ring."""
    slow_4, slow_8, white_4, white_8, moved = 0.0, 0.0, 0.0, 0.0, 0.0
    power = np.zeros((2, 2))
    for a in range(first, first + 3):
        if not math.isfinite(found[a, V1]):
            continue
        v1, quiet = found[a, V1] + found[a, FLOOR], QUIET[a] * QUIET[a]
        if v1 > LARGEST_SD[a] ** 2 or not _steady(ring, a, found[a], power):
            return False
        scale = 1.0 / max(v1, quiet)
        slow_4 += found[a, V4] * scale
        slow_8 += found[a, V8] * scale
        white_4 += max(v1 / 4.0, quiet) * scale
        white_8 += max(v1 / 8.0, quiet) * scale
        allowed = drift[a] * seconds / 2.0 + math.sqrt(12.0 * found[a, FLOOR])
        d = abs(mean_of(ring, a, HALF, RING) - mean_of(ring, a, 0, HALF)) - allowed
        if d > 0.0:
            moved += d * d / (2.0 * max(v1 / HALF, found[a, V8]) + TINY)
    if slow_4 > COLOUR * white_4 or slow_8 > COLOUR * white_8 or moved > CHI_SQUARE:
        return False
    for kind in range(2):
        low, high = min(power[kind, 0], power[kind, 1]), max(power[kind, 0], power[kind, 1])
        if high > STEADY * low + TINY:
            return False
    return True


@njit(cache=True, nogil=True)
def rests(state: State, ring: FloatArray, found: FloatArray, drift: FloatArray) -> bool:
    """Tell whether a ring, oldest slot first, shows a unit at rest; fill found, (6, 5)."""
    any_axis = False
    found[:] = np.nan
    for a in range(AXES):
        if present(ring, a):
            any_axis = True
            found[a, V1] = _second_differences(ring, a, 1)
            if found[a, V1] > LARGEST_SD[a] ** 2:
                return False
    if not any_axis:
        return False
    for a in range(AXES):
        if math.isfinite(found[a, V1]):
            within, step = _within(ring, a, 0, RING), state.axis[STEP, a]
            sample = max(found[a, V1], within) if math.isfinite(within) else found[a, V1]
            found[a, WITHIN] = sample
            found[a, V4] = _second_differences(ring, a, 4)
            found[a, V8] = _second_differences(ring, a, 8)
            found[a, FLOOR] = step * step / 12.0 if sample < 0.25 * step * step else 0.0
    seconds = state.durations.sum()
    return _sensor_rests(ring, 0, found, drift, seconds) and _sensor_rests(ring, 3, found, drift, seconds)


@njit(cache=True, nogil=True)
def _alike(state: State, a: int, found: FloatArray) -> bool:
    """Tell whether a trial found the noise that is known already, from more data."""
    before, now = state.level[0, VARIANCE, a], found[a, V1]
    within_before, within = state.axis[SAMPLE_VAR, a], found[a, WITHIN]
    same: bool = max(before, now) <= ALIKE * min(before, now) and within <= ALIKE * within_before
    return same


@njit(cache=True, nogil=True)
def adopt(state: State, found: FloatArray, only_unknown: bool) -> None:
    """Take the noise that a trial found as that of the unit at rest."""
    for a in range(AXES):
        if not math.isfinite(found[a, V1]) or (only_unknown and state.axis[KNOWN, a] > 0.0):
            continue
        if state.axis[KNOWN, a] > 0.0 and _alike(state, a, found):
            continue
        state.axis[KNOWN, a] = 1.0
        state.axis[SAMPLE_VAR, a] = found[a, WITHIN]
        v1 = found[a, V1]
        v4 = max(v1 / 4.0, found[a, V4])
        v8 = max(v1 / 8.0, found[a, V8])
        for j in range(LEVELS):
            state.level[j, GAIN, a] = 1.0 / (1.0 + max(32.0 / (1 << j), 3.0))
        state.level[0, VARIANCE, a] = v1
        state.level[1, VARIANCE, a] = max(v1 / 2.0, v4)
        state.level[2, VARIANCE, a] = v4
        state.level[3, VARIANCE, a] = v8
        for j in range(4, LEVELS):
            state.level[j, VARIANCE, a] = state.level[j - 1, VARIANCE, a] * NEIGHBOUR
