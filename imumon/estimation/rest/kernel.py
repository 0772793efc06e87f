"""Sample by sample: gather slots, and at the end of each decide whether the unit is at rest."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.estimation.rest.state import (
    ANCHOR,
    ANCHOR_NS,
    ANCHOR_VAR,
    ANCHORED,
    AT_REST,
    AXES,
    CENTRE,
    COUNT,
    DOUBT_NS,
    HIGH,
    HOLD_NS,
    KNOWN,
    LAST,
    LAST_NS,
    LEVELS,
    LONG_HOLD_NS,
    LOW,
    MEAN_2,
    QUIET_SLOTS,
    REST_MEAN,
    RING,
    RING_COUNT,
    RUN_COUNT,
    RUN_SUM,
    SAMPLE_VAR,
    SEGMENT,
    SLOT_NS,
    SLOTS,
    SPIKE,
    SQUARES,
    STARTED,
    STEP,
    SUM,
    VARIANCE,
    State,
)
from imumon.estimation.rest.trial import adopt, mean_of, present, rests
from imumon.estimation.rest.windows import (
    MOST_SURPRISE,
    SPIKE_SIGMAS,
    TINY,
    add_slot,
    forget_windows,
    resolution,
    shaken,
)

SLOT_S = 0.125
GAP_S = 2.5
SETTLE_S = 1.0
SETTLE_SLOTS = 8
TRIAL_EVERY = 4
"""Slots between two trials, while there is need of one."""
HOLD_WINDOWS = 4.0
"""What showed only in windows of some length is watched for so many of them before it is rest again."""
MEMORY_SLOTS = 32.0
SAMPLE_MEMORY = 1.0 / 64.0
EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0

GYRO_DRIFT, ACCEL_DRIFT, G_SENSITIVITY, DOUBT_S, LARGEST_JUMP = range(5)


@njit(cache=True, nogil=True)
def detect(
    state: State,
    parameters: FloatArray,
    time_ns: IntArray,
    segment: IntArray,
    readings: FloatArray,
    at_rest: IntArray,
) -> None:
    """Decide for each row of readings, (n, 6), whether the unit is at rest there; fill at_rest, (n,)."""
    axis, integers = state.axis, state.integers
    slot, gap = int(SLOT_S * 1e9), int(GAP_S * 1e9)
    for i in range(len(time_ns)):
        now, any_value = time_ns[i], False
        for a in range(AXES):
            any_value = any_value or math.isfinite(readings[i, a])
        if now == NO_INT or not any_value:
            lasting = now != NO_INT and integers[STARTED] and now - integers[LAST_NS] <= gap
            at_rest[i] = integers[AT_REST] if lasting and segment[i] == integers[SEGMENT] else 0
            continue
        other = segment[i] != integers[SEGMENT]
        elapsed = now - integers[LAST_NS]
        if not integers[STARTED] or other or elapsed < 0 or elapsed > gap:
            _begin(state, now, segment[i], other)
        elif now - integers[SLOT_NS] >= slot:
            _end_slot(state, parameters, now)
            _next_slot(state, now)
        integers[LAST_NS] = now
        spike = False
        for a in range(AXES):
            x = readings[i, a]
            if math.isfinite(x):
                spike |= x < axis[a, LOW] or x > axis[a, HIGH]
                if axis[a, COUNT] == 0.0 and axis[a, CENTRE] == 0.0:
                    axis[a, CENTRE] = x
                deviation = x - axis[a, CENTRE]
                axis[a, SUM] += deviation
                axis[a, SQUARES] += deviation * deviation
                axis[a, COUNT] += 1.0
                step = abs(x - axis[a, LAST])
                if 0.0 < step < axis[a, STEP]:
                    axis[a, STEP] = step
                axis[a, LAST] = x
        if spike and integers[AT_REST]:
            integers[SPIKE] = 1
            _leave(state, 0, now, 0.0)
        at_rest[i] = integers[AT_REST]


@njit(cache=True, nogil=True)
def _begin(state: State, now: int, segment: int, other: bool) -> None:
    """Begin anew after a start, a gap or a restart: the noise survives all, the bias a gap only."""
    axis, integers = state.axis, state.integers
    if integers[AT_REST]:
        _leave(state, 0, integers[LAST_NS], 0.0)
    if other or now < integers[LAST_NS]:
        integers[ANCHORED] = integers[DOUBT_NS] = 0
    integers[STARTED] = 1
    integers[SEGMENT] = segment
    integers[RING_COUNT] = integers[SPIKE] = 0
    axis[:, LAST] = np.nan
    axis[:, CENTRE] = 0.0
    _watch(state, now, SETTLE_S)
    _next_slot(state, now)


@njit(cache=True, nogil=True)
def _next_slot(state: State, now: int) -> None:
    axis = state.axis
    for a in range(AXES):
        axis[a, CENTRE] += axis[a, SUM] / max(axis[a, COUNT], 1.0)
        axis[a, SUM] = axis[a, SQUARES] = axis[a, COUNT] = 0.0
    state.integers[SLOT_NS] = now


@njit(cache=True, nogil=True)
def _watch(state: State, now: int, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    state.integers[HOLD_NS] = now + int(max(seconds, SETTLE_S) * 1e9)
    state.integers[QUIET_SLOTS] = 0
    if seconds > SETTLE_S:
        state.integers[LONG_HOLD_NS] = state.integers[HOLD_NS]
    state.axis[:, RUN_SUM : RUN_COUNT + 1] = 0.0
    forget_windows(state)


@njit(cache=True, nogil=True)
def _leave(state: State, level: int, now: int, seconds: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    axis, integers = state.axis, state.integers
    for a in range(AXES):
        axis[a, ANCHOR] = axis[a, REST_MEAN]
        if level > 2 and math.isfinite(state.level[a, level, MEAN_2]):
            axis[a, ANCHOR] = state.level[a, level, MEAN_2]
        axis[a, ANCHOR_VAR] = state.level[a, min(level + 2, LEVELS - 1), VARIANCE]
        axis[a, LOW], axis[a, HIGH] = -np.inf, np.inf
    integers[AT_REST] = integers[RING_COUNT] = 0
    integers[ANCHORED] = 1
    integers[ANCHOR_NS] = now - int(HOLD_WINDOWS * seconds * 1e9)
    integers[DOUBT_NS] = 0


@njit(cache=True, nogil=True)
def _end_slot(state: State, parameters: FloatArray, now: int) -> None:
    """Test the slot that ends now against the noise at rest, and decide."""
    axis, integers = state.axis, state.integers
    sums, counts, variances = np.empty(AXES), np.empty(AXES), np.empty(AXES)
    drift = np.empty(AXES)
    drift[:3], drift[3:] = parameters[GYRO_DRIFT], parameters[ACCEL_DRIFT]
    known = False
    for a in range(AXES):
        n = axis[a, COUNT]
        counts[a], variances[a] = n, np.nan
        sums[a] = n * axis[a, CENTRE] + axis[a, SUM]
        if n > 1.0:
            variances[a] = max(axis[a, SQUARES] - axis[a, SUM] * axis[a, SUM] / n, 0.0) / (n - 1.0)
        if n > 0.0:
            axis[a, RUN_SUM] += sums[a] / n
            axis[a, RUN_COUNT] += 1.0
            known = known or axis[a, KNOWN] > 0.0
    seconds = 1e-9 * (now - integers[SLOT_NS])
    _to_ring(state, sums, counts, variances, seconds)
    if known:
        moved, moved_s = _moved(state, sums, counts, variances, seconds, drift)
        integers[SPIKE] = 0
        integers[QUIET_SLOTS] += 1
        if moved >= 0:
            if integers[AT_REST]:
                _leave(state, moved, now, moved_s)
            _watch(state, now, HOLD_WINDOWS * moved_s)
        elif integers[AT_REST]:
            _keep(state, variances, drift)
        elif now >= integers[HOLD_NS] and integers[QUIET_SLOTS] >= SETTLE_SLOTS:
            _return(state, parameters, now, drift)
    integers[SLOTS] += 1
    if integers[RING_COUNT] >= RING and now >= integers[LONG_HOLD_NS] and integers[SLOTS] % TRIAL_EVERY == 0:
        _try(state, parameters, now, drift)


@njit(cache=True, nogil=True)
def _to_ring(
    state: State, sums: FloatArray, counts: FloatArray, variances: FloatArray, seconds: float
) -> None:
    at = state.integers[RING_COUNT] % RING
    for a in range(AXES):
        state.ring[a, at, 0] = sums[a] / counts[a] if counts[a] > 0.0 else np.nan
        state.ring[a, at, 1] = variances[a]
    state.durations[at] = seconds
    # Counts on from RING, so that the place stays known and the number small.
    count = state.integers[RING_COUNT] + 1
    state.integers[RING_COUNT] = count if count < 2 * RING else RING


@njit(cache=True, nogil=True)
def _moved(
    state: State,
    sums: FloatArray,
    counts: FloatArray,
    variances: FloatArray,
    seconds: float,
    drift: FloatArray,
) -> tuple[int, float]:
    """Return level and seconds of the windows that show motion, (-1, 0) when none do."""
    moved, moved_s = add_slot(state, sums, counts, seconds, drift)
    if moved < 0 and (state.integers[SPIKE] or shaken(state, variances)):
        return 0, seconds
    return moved, moved_s


@njit(cache=True, nogil=True)
def _keep(state: State, variances: FloatArray, drift: FloatArray) -> None:
    """At rest still: follow the mean and the noise."""
    axis = state.axis
    for a in range(AXES):
        if axis[a, COUNT] == 0.0 or axis[a, KNOWN] == 0.0:
            continue
        mean = axis[a, CENTRE] + axis[a, SUM] / axis[a, COUNT]
        share = 1.0 / min(max(axis[a, RUN_COUNT], 1.0), MEMORY_SLOTS)
        axis[a, REST_MEAN] += share * (mean - axis[a, REST_MEAN])
        v = variances[a] if math.isfinite(variances[a]) else state.level[a, 0, VARIANCE]
        v = min(v, MOST_SURPRISE * axis[a, SAMPLE_VAR] + TINY)
        axis[a, SAMPLE_VAR] += SAMPLE_MEMORY * (v - axis[a, SAMPLE_VAR])
    _set_band(state, drift)


@njit(cache=True, nogil=True)
def _set_band(state: State, drift: FloatArray) -> None:
    """Set the band outside which a single sample is motion."""
    axis = state.axis
    for a in range(AXES):
        if axis[a, KNOWN] == 0.0:
            axis[a, LOW], axis[a, HIGH] = -np.inf, np.inf
            continue
        sd = math.sqrt(axis[a, SAMPLE_VAR] + state.level[a, 0, VARIANCE])
        width = SPIKE_SIGMAS * sd + 1.5 * resolution(axis, a) + drift[a] * MEMORY_SLOTS * SLOT_S
        axis[a, LOW], axis[a, HIGH] = axis[a, REST_MEAN] - width, axis[a, REST_MEAN] + width


@njit(cache=True, nogil=True)
def _enter(state: State, means: FloatArray, drift: FloatArray) -> None:
    for a in range(AXES):
        state.axis[a, REST_MEAN] = means[a]
    state.integers[AT_REST] = 1
    state.integers[DOUBT_NS] = 0
    _set_band(state, drift)


@njit(cache=True, nogil=True)
def _return(state: State, parameters: FloatArray, now: int, drift: FloatArray) -> None:
    """Quiet for long enough by the noise of the last rest: rest again, unless it still turns."""
    axis = state.axis
    means, counts = np.empty(AXES), np.empty(AXES)
    for a in range(AXES):
        counts[a] = axis[a, RUN_COUNT]
        means[a] = axis[a, RUN_SUM] / counts[a] if counts[a] > 0.0 else axis[a, REST_MEAN]
    if displacement(state, parameters, means, counts, now) <= 0.0:
        _enter(state, means, drift)


@njit(cache=True, nogil=True)
def displacement(
    state: State, parameters: FloatArray, means: FloatArray, counts: FloatArray, now: int
) -> float:
    """Return how far a gyro's mean is from that of the last rest, beyond what its bias can have done.

    means and numbers of slots, (6,); rad/s.
    """
    if not state.integers[ANCHORED]:
        return 0.0
    axis = state.axis
    force = 0.0
    for a in range(3, AXES):
        if axis[a, KNOWN] > 0.0 and counts[a] > 0.0:
            force += (means[a] - axis[a, ANCHOR]) ** 2
    elapsed = max(1e-9 * (now - state.integers[ANCHOR_NS]), 0.0)
    allowed = EARTH_TWICE + parameters[G_SENSITIVITY] * math.sqrt(force) + parameters[GYRO_DRIFT] * elapsed
    beyond = 0.0
    for a in range(3):
        if axis[a, KNOWN] > 0.0 and counts[a] > 0.0:
            variance = state.level[a, 0, VARIANCE] / min(counts[a], MEMORY_SLOTS) + axis[a, ANCHOR_VAR]
            noise = SIGMAS * math.sqrt(variance) + resolution(axis, a)
            beyond = max(beyond, abs(means[a] - axis[a, ANCHOR]) - allowed - noise)
    return beyond


@njit(cache=True, nogil=True)
def _try(state: State, parameters: FloatArray, now: int, drift: FloatArray) -> None:
    """Look for rest by another noise than that of the last, or of an axis of which nothing is known."""
    integers, unknown = state.integers, False
    for a in range(AXES):
        unknown = unknown or (state.axis[a, KNOWN] == 0.0 and present(state.ring, a))
    if integers[AT_REST] and not unknown:
        return
    at = integers[RING_COUNT] % RING
    ordered = np.empty_like(state.ring)
    for a in range(AXES):
        for i in range(RING):
            ordered[a, i] = state.ring[a, (at + i) % RING]
    found, means, counts = np.empty((AXES, 5)), np.empty(AXES), np.empty(AXES)
    if not rests(state, ordered, found, drift):
        integers[DOUBT_NS] = 0
        if integers[AT_REST]:
            _leave(state, 0, now, 0.0)
            _watch(state, now, SETTLE_S)
        return
    for a in range(AXES):
        means[a], counts[a] = mean_of(ordered, a, 0, RING), RING
        if not math.isfinite(means[a]):
            means[a], counts[a] = state.axis[a, REST_MEAN], 0.0
    if integers[AT_REST]:
        for a in range(AXES):
            if state.axis[a, KNOWN] == 0.0:
                state.axis[a, REST_MEAN] = means[a]
        adopt(state, found, True)
        return
    if integers[DOUBT_NS] == 0:
        integers[DOUBT_NS] = now
    beyond = displacement(state, parameters, means, counts, now)
    doubted = now - integers[DOUBT_NS] >= int(parameters[DOUBT_S] * 1e9)
    if beyond <= 0.0 or (doubted and beyond <= parameters[LARGEST_JUMP]):
        adopt(state, found, False)
        _enter(state, means, drift)
        _watch(state, now, 0.0)
