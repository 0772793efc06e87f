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
    COUNTS,
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
    MEANS,
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
    SUMS,
    VARIANCE,
    VARIANCES,
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
BAND_EVERY = 4
SAMPLE_MEMORY = 1.0 / 64.0
EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0
ROUNDING = 1e-9
"""Samples that differ by less than this share are equal: means of equal samples differ by rounding."""

G_SENSITIVITY, DOUBT_S, LARGEST_JUMP, DRIFT = range(4)
# From DRIFT on, the drift of each axis.


@njit(cache=True, nogil=True)
def detect(
    state: State,
    parameters: FloatArray,
    time_ns: IntArray,
    segment: IntArray,
    readings: FloatArray,
    at_rest: IntArray,
) -> None:
    """Decide for each row of readings, (6, n), whether the unit is at rest there; fill at_rest, (n,)."""
    axis, integers = state.axis, state.integers
    slot, gap = int(SLOT_S * 1e9), int(GAP_S * 1e9)
    for i in range(len(time_ns)):
        now, any_value = time_ns[i], False
        for a in range(AXES):
            any_value = any_value or math.isfinite(readings[a, i])
        if now == NO_INT or not any_value:
            lasting = now != NO_INT and integers[STARTED] and now - integers[LAST_NS] <= gap
            at_rest[i] = integers[AT_REST] if lasting and segment[i] == integers[SEGMENT] else 0
            continue
        other = segment[i] != integers[SEGMENT]
        elapsed = now - integers[LAST_NS]
        if not integers[STARTED] or other or elapsed < 0 or elapsed > gap:
            _begin(state, now, segment[i], other)
            for a in range(AXES):
                axis[CENTRE, a] = readings[a, i] if math.isfinite(readings[a, i]) else axis[CENTRE, a]
        elif now - integers[SLOT_NS] >= slot:
            _end_slot(state, parameters, now)
            _next_slot(state, now)
        integers[LAST_NS] = now
        spike = False
        for a in range(AXES):
            x = readings[a, i]
            if math.isfinite(x):
                spike |= (x < axis[LOW, a]) | (x > axis[HIGH, a])
                deviation = x - axis[CENTRE, a]
                axis[SUM, a] += deviation
                axis[SQUARES, a] += deviation * deviation
                axis[COUNT, a] += 1.0
                step = abs(x - axis[LAST, a])
                least = ROUNDING * (abs(x) + 1e-3)
                axis[STEP, a] = step if least < step < axis[STEP, a] else axis[STEP, a]
                axis[LAST, a] = x
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
    integers[LONG_HOLD_NS] = now
    axis[LAST] = np.nan
    _watch(state, now, SETTLE_S)
    _next_slot(state, now)


@njit(cache=True, nogil=True)
def _next_slot(state: State, now: int) -> None:
    axis = state.axis
    for a in range(AXES):
        axis[CENTRE, a] += axis[SUM, a] / max(axis[COUNT, a], 1.0)
        axis[SUM, a] = axis[SQUARES, a] = axis[COUNT, a] = 0.0
    state.integers[SLOT_NS] = now


@njit(cache=True, nogil=True)
def _watch(state: State, now: int, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    state.integers[HOLD_NS] = now + int(max(seconds, SETTLE_S) * 1e9)
    forget_windows(state, state.integers[QUIET_SLOTS])
    state.integers[QUIET_SLOTS] = 0
    if seconds > SETTLE_S:
        state.integers[LONG_HOLD_NS] = state.integers[HOLD_NS]
    for a in range(AXES):
        state.axis[RUN_SUM, a] = state.axis[RUN_COUNT, a] = 0.0


@njit(cache=True, nogil=True)
def _leave(state: State, level: int, now: int, seconds: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    axis, integers = state.axis, state.integers
    for a in range(AXES):
        axis[ANCHOR, a] = axis[REST_MEAN, a]
        if level > 2 and math.isfinite(state.level[level, MEAN_2, a]):
            axis[ANCHOR, a] = state.level[level, MEAN_2, a]
        axis[ANCHOR_VAR, a] = state.level[min(level + 2, LEVELS - 1), VARIANCE, a]
        axis[LOW, a], axis[HIGH, a] = -np.inf, np.inf
    integers[AT_REST] = integers[RING_COUNT] = 0
    integers[ANCHORED] = 1
    integers[ANCHOR_NS] = now - int(HOLD_WINDOWS * seconds * 1e9)
    integers[DOUBT_NS] = 0


@njit(cache=True, nogil=True)
def _end_slot(state: State, parameters: FloatArray, now: int) -> None:
    """Test the slot that ends now against the noise at rest, and decide."""
    axis, integers = state.axis, state.integers
    slot, drift = state.slot, parameters[DRIFT:]
    known, last, share, share_within = False, 0.0, np.nan, np.nan
    for a in range(AXES):
        n = axis[COUNT, a]
        if n != last:
            last = n
            share = 1.0 / n if n > 0.0 else np.nan
            share_within = 1.0 / (n - 1.0) if n > 1.0 else np.nan
        slot[COUNTS, a], slot[MEANS, a] = n, axis[CENTRE, a] + axis[SUM, a] * share
        slot[SUMS, a] = n * axis[CENTRE, a] + axis[SUM, a]
        within = axis[SQUARES, a] - axis[SUM, a] * axis[SUM, a] * share
        slot[VARIANCES, a] = max(within, 0.0) * share_within
        if n > 0.0:
            axis[RUN_SUM, a] += slot[MEANS, a]
            axis[RUN_COUNT, a] += 1.0
            known = known or axis[KNOWN, a] > 0.0
    seconds = 1e-9 * (now - integers[SLOT_NS])
    _to_ring(state, seconds)
    if known:
        moved, moved_s = _moved(state, seconds, drift)
        integers[SPIKE] = 0
        integers[QUIET_SLOTS] += 1
        if moved >= 0:
            if integers[AT_REST]:
                _leave(state, moved, now, moved_s)
            _watch(state, now, HOLD_WINDOWS * moved_s)
        elif integers[AT_REST]:
            _keep(state, drift)
        elif now >= integers[HOLD_NS] and integers[QUIET_SLOTS] >= SETTLE_SLOTS:
            _return(state, parameters, now, drift)
    integers[SLOTS] += 1
    if integers[RING_COUNT] >= RING and now >= integers[LONG_HOLD_NS] and integers[SLOTS] % TRIAL_EVERY == 0:
        _try(state, parameters, now, drift)


@njit(cache=True, nogil=True)
def _to_ring(state: State, seconds: float) -> None:
    at = state.integers[RING_COUNT] % RING
    for a in range(AXES):
        state.ring[a, at, 0] = state.slot[MEANS, a]
        state.ring[a, at, 1] = state.slot[VARIANCES, a]
    state.durations[at] = seconds
    # Counts on from RING, so that the place stays known and the number small.
    count = state.integers[RING_COUNT] + 1
    state.integers[RING_COUNT] = count if count < 2 * RING else RING


@njit(cache=True, nogil=True)
def _moved(state: State, seconds: float, drift: FloatArray) -> tuple[int, float]:
    """Return level and seconds of the windows that show motion, (-1, 0) when none do."""
    moved, moved_s = add_slot(state, seconds, drift)
    if moved < 0 and (state.integers[SPIKE] or shaken(state)):
        return 0, seconds
    return moved, moved_s


@njit(cache=True, nogil=True)
def _keep(state: State, drift: FloatArray) -> None:
    """At rest still: follow the mean and the noise."""
    axis, slot = state.axis, state.slot
    for a in range(AXES):
        if axis[COUNT, a] == 0.0 or axis[KNOWN, a] == 0.0:
            continue
        count = axis[RUN_COUNT, a]
        share = 1.0 / MEMORY_SLOTS if count >= MEMORY_SLOTS else 1.0 / max(count, 1.0)
        axis[REST_MEAN, a] += share * (axis[CENTRE, a] + axis[SUM, a] / axis[COUNT, a] - axis[REST_MEAN, a])
        v = slot[VARIANCES, a]
        v = v if math.isfinite(v) else state.level[0, VARIANCE, a]
        v = min(v, MOST_SURPRISE * axis[SAMPLE_VAR, a] + TINY)
        axis[SAMPLE_VAR, a] += SAMPLE_MEMORY * (v - axis[SAMPLE_VAR, a])
    if state.integers[SLOTS] % BAND_EVERY == 0:
        _set_band(state, drift)


@njit(cache=True, nogil=True)
def _set_band(state: State, drift: FloatArray) -> None:
    """Set the band outside which a single sample is motion."""
    axis = state.axis
    for a in range(AXES):
        if axis[KNOWN, a] == 0.0:
            axis[LOW, a], axis[HIGH, a] = -np.inf, np.inf
            continue
        sd = math.sqrt(axis[SAMPLE_VAR, a] + state.level[0, VARIANCE, a])
        width = SPIKE_SIGMAS * sd + 1.5 * resolution(axis, a) + drift[a] * MEMORY_SLOTS * SLOT_S
        axis[LOW, a], axis[HIGH, a] = axis[REST_MEAN, a] - width, axis[REST_MEAN, a] + width


@njit(cache=True, nogil=True)
def _enter(state: State, means: FloatArray, drift: FloatArray) -> None:
    for a in range(AXES):
        state.axis[REST_MEAN, a] = means[a]
    state.integers[AT_REST] = 1
    state.integers[DOUBT_NS] = 0
    _set_band(state, drift)


@njit(cache=True, nogil=True)
def _return(state: State, parameters: FloatArray, now: int, drift: FloatArray) -> None:
    """Quiet for long enough by the noise of the last rest: rest again, unless it still turns."""
    axis = state.axis
    means, counts = np.empty(AXES), np.empty(AXES)
    for a in range(AXES):
        counts[a] = axis[RUN_COUNT, a]
        means[a] = axis[RUN_SUM, a] / counts[a] if counts[a] > 0.0 else axis[REST_MEAN, a]
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
        if axis[KNOWN, a] > 0.0 and counts[a] > 0.0:
            force += (means[a] - axis[ANCHOR, a]) ** 2
    elapsed = max(1e-9 * (now - state.integers[ANCHOR_NS]), 0.0)
    allowed = EARTH_TWICE + parameters[G_SENSITIVITY] * math.sqrt(force) + parameters[DRIFT] * elapsed
    beyond = 0.0
    for a in range(3):
        if axis[KNOWN, a] > 0.0 and counts[a] > 0.0:
            variance = state.level[0, VARIANCE, a] / min(counts[a], MEMORY_SLOTS) + axis[ANCHOR_VAR, a]
            noise = SIGMAS * math.sqrt(variance) + resolution(axis, a)
            beyond = max(beyond, abs(means[a] - axis[ANCHOR, a]) - allowed - noise)
    return beyond


@njit(cache=True, nogil=True)
def _try(state: State, parameters: FloatArray, now: int, drift: FloatArray) -> None:
    """Look for rest by another noise than that of the last, or of an axis of which nothing is known."""
    integers, unknown = state.integers, False
    for a in range(AXES):
        unknown = unknown or (state.axis[KNOWN, a] == 0.0 and present(state.ring, a))
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
            means[a], counts[a] = state.axis[REST_MEAN, a], 0.0
    if integers[AT_REST]:
        for a in range(AXES):
            if state.axis[KNOWN, a] == 0.0:
                state.axis[REST_MEAN, a] = means[a]
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
