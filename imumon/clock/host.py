"""Device time to host time: a line under the lower hull of arrival minus device time.

Delays are never negative, so the points (device time, arrival minus device time) lie above the line that
maps one clock to the other, and the quickest packets lie on it.  Of the lines below all points, the one that
minimises the summed distance to them has the slope of the edge of the lower convex hull under their mean
abscissa (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements",
INFOCOM 1999; Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002).
One edge is a poor judge when sampling and polling beat, as 10 ms samples and 16 ms polls do: the quickest
packets then come in steps of 2 ms, 40 s long at 50 ppm.  So the slope here is the chord of the hull across
the middle two thirds of the span: as accurate otherwise, and half the error in a beat.  The ends of the
hull, where a backlog or a stall bends it, have no say.  The line with that slope then touches the hull from
below.

A delay that all packets have in common cannot be seen: it is part of the offset.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.compiled import njit

BLOCK_NS = 30_000_000_000
"""The memory moves on in blocks of this length; each keeps its own hull, so that it can be forgotten."""
BLOCKS = 10
"""Blocks remembered, the current one among them: 4.5 to 5 min.

Longer averages more, shorter follows a warming crystal sooner.  The p99 error in simulated 16 ms bursts with
a memory of 2.5, 5 and 10 min is 0.09, 0.06 and 0.06 ms at a constant rate, 0.08, 0.18 and 0.74 ms when the
rate rises by 1 ppm a minute, and 0.15, 0.55 and 2.2 ms at 3 ppm a minute.
"""
VERTICES = 64
"""Hull vertices kept per block; a block of random delays has a dozen."""
STEP_NS = 50_000_000
"""An offset that changes by more than this is a step of a clock, not its drift..."""
STEP_AFTER_NS = 10_000_000_000
"""...upwards only when no packet has been quicker for this long, as packets may queue up."""
CRYSTAL_PPM = 500.0
"""No crystal is further off than this."""
PRIOR = 0.1
"""Drift expected before anything is seen (one sigma), as a part of the limit."""
MARGIN = 1 / 6
"""Part of the span at either end that the chord leaves out."""
TOUCH = 1 / 32
"""Uncertainty of a point of contact, as a part of the mean distance of the points from the line."""

STARTED, SEGMENT, X0, Y0, LAST_X, LAST_ARRIVAL, LAST_HOST, BLOCK, FAR_SINCE, SIZE, VERTEX, LEFT, RIGHT = (
    range(13)
)
COUNT, SUM_X, SUM_Y, SLOPE = range(4)
NOT_FAR = -1


class HostClock:
    """Host time of each sample, causal, in constant memory, whatever the division into blocks.

    Within a segment the line is fitted to the last 4.5 to 5 min; until the span tells the drift from the
    scatter of the delays, the drift is drawn towards zero.  Host time is never later than the arrival and
    never decreases, unless the arrival itself goes back, which then bounds it.  When the offset steps by more
    than 50 ms (the host clock was set) the fit starts anew: at once if the step is towards earlier arrivals,
    after 10 s if it is towards later ones.

    Parameters
    ----------
    drift_limit_ppm : float
        Largest drift of the device clock against the host clock; see `DeviceClock.drift_limit_ppm`.
    """

    def __init__(self, drift_limit_ppm: float = CRYSTAL_PPM) -> None:
        self._limit = drift_limit_ppm * 1e-6
        self._state: IntArray = np.zeros(13, np.int64)
        self._fit: FloatArray = np.zeros(4)
        self._hull: IntArray = np.zeros((BLOCKS * VERTICES, 2), np.int64)
        self._block_hulls: IntArray = np.zeros((BLOCKS, VERTICES, 2), np.int64)
        self._block_sizes: IntArray = np.zeros(BLOCKS, np.int64)
        self._block_sums: FloatArray = np.zeros((BLOCKS, 3))

    @property
    def offset_ns(self) -> int | None:
        """Host time minus device time at the latest sample; None before the first."""
        if not self._state[STARTED]:
            return None
        x = int(self._state[LAST_X])
        return int(self._state[Y0]) + int(_line(self._state, self._fit, self._hull, x))

    @property
    def drift_ppm(self) -> float:
        """Rate of the host clock against the device clock, minus one: positive when the device is slow."""
        return float(self._fit[SLOPE]) * 1e6

    @property
    def delay_ns(self) -> int | None:
        """Arrival minus host time of the latest sample: transport delay above the least; None at first."""
        if not self._state[STARTED]:
            return None
        return int(self._state[LAST_ARRIVAL] - self._state[LAST_HOST])

    def process(self, device_time_ns: IntArray, segment: IntArray, arrival_ns: IntArray) -> IntArray:
        """Return host time (n,) in ns for samples in order of arrival.

        Parameters
        ----------
        device_time_ns, segment : array, (n,)
            As `DeviceClock` gives them.
        arrival_ns : array, (n,)
            Unix time in ns; a row with `NO_INT` gets host time `NO_INT` and leaves the fit alone.
        """
        host_ns = np.empty(len(device_time_ns), np.int64)
        _fit_samples(
            device_time_ns,
            segment,
            arrival_ns,
            self._limit,
            self._state,
            self._fit,
            self._hull,
            self._block_hulls,
            self._block_sizes,
            self._block_sums,
            host_ns,
        )
        return host_ns


@njit
def _fit_samples(
    device: IntArray,
    segment: IntArray,
    arrival: IntArray,
    limit: float,
    state: IntArray,
    fit: FloatArray,
    hull: IntArray,
    block_hulls: IntArray,
    block_sizes: IntArray,
    block_sums: FloatArray,
    host: IntArray,
) -> None:
    for i in range(len(device)):
        if arrival[i] == NO_INT or device[i] == NO_INT:
            host[i] = NO_INT
            continue
        if _must_start(state, fit, hull, device[i], segment[i], arrival[i]):
            _start(state, fit, block_sizes, block_sums, device[i], segment[i], arrival[i])
        x = device[i] - state[X0]
        y = arrival[i] - device[i] - state[Y0]
        block = x // BLOCK_NS
        if block != state[BLOCK]:
            _forget(state, fit, hull, block_hulls, block_sizes, block_sums, block)
        row = block % BLOCKS
        block_sizes[row] = _push(block_hulls[row], block_sizes[row], x, y)
        state[SIZE] = _push(hull, state[SIZE], x, y)
        block_sums[row, COUNT] += 1.0
        block_sums[row, SUM_X] += x
        block_sums[row, SUM_Y] += y
        fit[COUNT] += 1.0
        fit[SUM_X] += x
        fit[SUM_Y] += y
        _support(state, fit, hull, limit)
        time = min(state[Y0] + _line(state, fit, hull, x) + device[i], arrival[i])
        # Should the arrival have gone back, then it is the bound that holds.
        time = min(max(time, state[LAST_HOST]), arrival[i])
        state[LAST_X] = x
        state[LAST_ARRIVAL] = arrival[i]
        state[LAST_HOST] = time
        host[i] = time


@njit
def _must_start(
    state: IntArray, fit: FloatArray, hull: IntArray, device: int, segment: int, arrival: int
) -> bool:
    """Tell whether the fit so far says nothing about this sample: another segment, or a clock was set."""
    x = device - state[X0]
    if not state[STARTED] or segment != state[SEGMENT]:
        return True
    above = arrival - device - state[Y0] - _line(state, fit, hull, x)
    if above < -STEP_NS:
        return True
    if above < STEP_NS:
        state[FAR_SINCE] = NOT_FAR
    elif state[FAR_SINCE] == NOT_FAR:
        state[FAR_SINCE] = x
    return bool(state[FAR_SINCE] != NOT_FAR and x - state[FAR_SINCE] > STEP_AFTER_NS)


@njit
def _start(
    state: IntArray,
    fit: FloatArray,
    block_sizes: IntArray,
    block_sums: FloatArray,
    device: int,
    segment: int,
    arrival: int,
) -> None:
    """Begin a fit with this sample as the origin; only the host time given out last is remembered."""
    if not state[STARTED]:
        state[LAST_HOST] = NO_INT
    state[STARTED] = 1
    state[SEGMENT] = segment
    state[X0] = device
    state[Y0] = arrival - device
    state[BLOCK] = 0
    state[FAR_SINCE] = NOT_FAR
    state[SIZE] = 0
    state[LEFT] = 0
    state[RIGHT] = 0
    # Fills, as an assignment to a slice takes a second more to compile.
    fit.fill(0.0)
    block_sizes.fill(0)
    block_sums.fill(0.0)


@njit
def _forget(
    state: IntArray,
    fit: FloatArray,
    hull: IntArray,
    block_hulls: IntArray,
    block_sizes: IntArray,
    block_sums: FloatArray,
    block: int,
) -> None:
    """Move on to `block`: drop the blocks that are too old, join the hulls of the others."""
    for new in range(max(state[BLOCK] + 1, block - BLOCKS + 1), block + 1):
        block_sizes[new % BLOCKS] = 0
        block_sums[new % BLOCKS].fill(0.0)
    state[BLOCK] = block
    state[SIZE] = 0
    state[LEFT] = 0
    state[RIGHT] = 0
    for k in range(SLOPE):
        fit[k] = 0.0
    for old in range(max(0, block - BLOCKS + 1), block):
        row = old % BLOCKS
        for k in range(block_sizes[row]):
            state[SIZE] = _push(hull, state[SIZE], block_hulls[row, k, 0], block_hulls[row, k, 1])
        for k in range(SLOPE):
            fit[k] += block_sums[row, k]


@njit
def _push(hull: IntArray, size: int, x: int, y: int) -> int:
    """Add a point at the right of a lower hull and return the new size (Andrew's monotone chain)."""
    if size and hull[size - 1, 0] == x:
        if y >= hull[size - 1, 1]:
            return size
        size -= 1
    while size > 1 and not _is_below(hull[size - 2], hull[size - 1], x, y):
        size -= 1
    if size == len(hull):
        # Only a curve that bends upwards for minutes gets here; every other vertex describes it too.
        for k in range(1, size // 2):
            hull[k, 0], hull[k, 1] = hull[2 * k, 0], hull[2 * k, 1]
        hull[size // 2, 0], hull[size // 2, 1] = hull[size - 1, 0], hull[size - 1, 1]
        size = size // 2 + 1
    hull[size, 0] = x
    hull[size, 1] = y
    return size + 1


@njit
def _is_below(a: IntArray, b: IntArray, x: int, y: int) -> bool:
    """Tell whether b lies below the line from a to (x, y).  Products in float64, as int64 would overflow."""
    return bool(float(b[1] - a[1]) * float(x - a[0]) < float(y - a[1]) * float(b[0] - a[0]))


@njit
def _slope(hull: IntArray, k: int) -> float:
    return float((hull[k + 1, 1] - hull[k, 1]) / (hull[k + 1, 0] - hull[k, 0]))


@njit
def _edge_at(hull: IntArray, last: int, k: int, x: float) -> int:
    """Return the edge over x, searching from k to the right; x only moves to the right, so this is quick."""
    k = min(k, last - 1)
    while k < last - 1 and hull[k + 1, 0] < x:
        k += 1
    return k


@njit
def _support(state: IntArray, fit: FloatArray, hull: IntArray, limit: float) -> None:
    """Choose the line: slope of the chord, drawn to zero while unsure, and the vertex it then touches."""
    last = state[SIZE] - 1
    if last == 0:
        state[VERTEX] = 0
        fit[SLOPE] = 0.0
        return
    span = float(hull[last, 0] - hull[0, 0])
    x_left, x_right = hull[0, 0] + MARGIN * span, hull[last, 0] - MARGIN * span
    state[LEFT] = _edge_at(hull, last, state[LEFT], x_left)
    state[RIGHT] = k = _edge_at(hull, last, state[RIGHT], x_right)
    y_left = hull[state[LEFT], 1] + _slope(hull, state[LEFT]) * (x_left - hull[state[LEFT], 0])
    y_right = hull[k, 1] + _slope(hull, k) * (x_right - hull[k, 0])
    chord = (y_right - y_left) / (x_right - x_left)
    distance = fit[SUM_Y] / fit[COUNT] - y_left - chord * (fit[SUM_X] / fit[COUNT] - x_left)
    # Least squares of the prior, 0 with sigma PRIOR * limit, and the chord, sigma TOUCH * distance / span.
    unsure = TOUCH * max(distance, 0.0) / (PRIOR * limit * span)
    slope = min(max(chord / (1.0 + unsure * unsure), -limit), limit)
    while k < last and _slope(hull, k) < slope:
        k += 1
    while k > 0 and _slope(hull, k - 1) > slope:
        k -= 1
    state[VERTEX] = k
    fit[SLOPE] = slope


@njit
def _line(state: IntArray, fit: FloatArray, hull: IntArray, x: int) -> int:
    """Return the line at x, relative to Y0, rounded down to ns."""
    vertex = hull[state[VERTEX]]
    return int(vertex[1] + math.floor(fit[SLOPE] * (x - vertex[0])))
