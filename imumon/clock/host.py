"""Device time to host time: a line under the lower hull of arrival minus device time.

Delays are never negative, so the points (device time, arrival minus device time) lie above the line that
maps one clock to the other, and the quickest packets lie on it.  Of the lines below all points, the one that
minimises the summed distance to them has the slope of the edge of the lower convex hull under their mean
abscissa (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements",
INFOCOM 1999; Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002).
One edge is a poor measure when sampling and polling beat, as 10 ms samples and 16 ms polls do: the quickest
packets then come in steps of 2 ms, 40 s long at 50 ppm.  So the slope here is the chord of the hull across
the middle two thirds of the span: as accurate otherwise, and half the error in a beat.  The ends of the
hull, where a backlog or a stall bends it, do not count.  The line with that slope then touches the hull from
below.

A delay that all packets have in common cannot be determined: it is part of the offset.
"""

import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import NO_INT, IntArray
from imumon.compiled import inner, njit, record, records

BLOCK_NS = 30_000_000_000
"""The memory moves on in blocks of this length; each keeps its own hull, so that it can be forgotten."""
BLOCKS = 10
"""Blocks remembered, the current one among them: 4.5 to 5 min.

The p99 error in simulated 16 ms bursts with a memory of 2.5, 5 and 10 min is 0.09, 0.06 and 0.06 ms at a
constant rate, and 0.08, 0.18 and 0.74 ms when the rate rises by 1 ppm a minute.
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
"""Drift expected before anything is measured (one sigma), as a part of the limit."""
MARGIN = 1 / 6
"""Part of the span at either end that the chord leaves out."""
TOUCH = 1 / 32
"""Uncertainty of a point of contact, as a part of the mean distance of the points from the line."""
POLL_NS = 16_000_000
"""The slowest that adapters poll.  In a beat with the samples the quickest packets come in steps of no more,
and of no more than samples are apart; scatter does not show them."""

NOT_FAR = -1
NO_SEGMENT = -1


class _Block:
    """Hull and sums of samples, those of one block; x and y are relative to the origin of the fit."""

    corners: int
    hull: IntArray
    count: float
    sum_x: float
    sum_y: float


class _Fit(_Block):
    """The line, and the hull and sums of all blocks that are remembered."""

    segment: int
    x0: int
    y0: int
    last_arrival: int
    last_host: int
    block: int
    far_since: int
    vertex: int
    slope: float
    slope_sd: float


class HostClock:
    """Host time of each sample, causal, in constant memory, whatever the division into blocks.

    Within a segment the line is fitted to the last 4.5 to 5 min; until the span separates the drift from the
    scatter of the delays, the drift is drawn towards zero.  Host time is never later than the arrival and
    never decreases, unless the arrival itself goes back, which then bounds it.  When the offset steps by more
    than 50 ms (the host clock was set) the fit starts anew: at once if the step is towards earlier arrivals,
    after 10 s if it is towards later ones.

    `drift_limit_ppm`: largest drift of the device clock against the host clock; see
    `DeviceClock.drift_limit_ppm`.
    """

    def __init__(self, drift_limit_ppm: float = CRYSTAL_PPM) -> None:
        self._limit = drift_limit_ppm * 1e-6
        self._fit = record(_Fit, hull=(BLOCKS * VERTICES, 2))
        self._fit.segment = NO_SEGMENT
        self._fit.last_host = NO_INT
        self._blocks = records(_Block, BLOCKS, hull=(VERTICES, 2))

    @property
    def drift_ppm(self) -> float:
        """Rate of the host clock against the device clock, minus one: positive when the device is slow."""
        return float(self._fit.slope) * 1e6

    @property
    def drift_sd_ppm(self) -> float:
        """Standard deviation of `drift_ppm`; NaN while it is a bound, or no better known than before."""
        sd = float(self._fit.slope_sd)
        return sd * 1e6 if 0.0 < sd < PRIOR * self._limit else math.nan

    @property
    def delay_ns(self) -> int | None:
        """Arrival minus host time of the latest sample: transport delay above the least; None at first."""
        if self._fit.segment == NO_SEGMENT:
            return None
        return int(self._fit.last_arrival - self._fit.last_host)

    def process(self, device_time_ns: IntArray, segment: IntArray, arrival_ns: IntArray) -> IntArray:
        """Return host time (n,) in ns for samples in order of arrival.

        `device_time_ns`, `segment` (n,): as `DeviceClock` gives them.
        `arrival_ns` (n,): Unix time in ns; a row with `NO_INT` gets host time `NO_INT` and leaves the fit
            alone.
        """
        host_ns = np.empty(len(device_time_ns), np.int64)
        _fit_samples(device_time_ns, segment, arrival_ns, self._limit, self._fit, self._blocks, host_ns)
        return host_ns


@njit
def _fit_samples(
    device: IntArray,
    segment: IntArray,
    arrival: IntArray,
    limit: float,
    fit: _Fit,
    blocks: Sequence[_Block],
    host: IntArray,
) -> None:
    for i in range(len(device)):
        if arrival[i] == NO_INT or device[i] == NO_INT:
            host[i] = NO_INT
            continue
        if _must_start(fit, device[i], segment[i], arrival[i]):
            _start(fit, blocks, device[i], segment[i], arrival[i])
        x = device[i] - fit.x0
        y = arrival[i] - device[i] - fit.y0
        if x // BLOCK_NS != fit.block:
            _forget(fit, blocks, x // BLOCK_NS)
        block = blocks[fit.block % BLOCKS]
        block.corners = _push(block.hull, block.corners, x, y)
        fit.corners = _push(fit.hull, fit.corners, x, y)
        _add(block, 1.0, x, y)
        _add(fit, 1.0, x, y)
        _support(fit, limit)
        time = min(fit.y0 + _line(fit, x) + device[i], arrival[i])
        # Should the arrival have gone back, then it is the bound that holds.
        time = min(max(time, fit.last_host), arrival[i])
        fit.last_arrival = arrival[i]
        fit.last_host = time
        host[i] = time


@inner
def _add(sums: _Block, count: float, x: float, y: float) -> None:
    sums.count += count
    sums.sum_x += x
    sums.sum_y += y


@inner
def _must_start(fit: _Fit, device: int, segment: int, arrival: int) -> bool:
    """Return whether the fit so far does not apply to this sample: another segment, or a clock was set."""
    x = device - fit.x0
    if segment != fit.segment:
        return True
    above = arrival - device - fit.y0 - _line(fit, x)
    if above < -STEP_NS:
        return True
    if above < STEP_NS:
        fit.far_since = NOT_FAR
    elif fit.far_since == NOT_FAR:
        fit.far_since = x
    return bool(fit.far_since != NOT_FAR and x - fit.far_since > STEP_AFTER_NS)


@inner
def _start(fit: _Fit, blocks: Sequence[_Block], device: int, segment: int, arrival: int) -> None:
    """Begin a fit with this sample as the origin; only the host time given out last is remembered."""
    fit.segment = segment
    fit.x0 = device
    fit.y0 = arrival - device
    fit.block = 0
    fit.far_since = NOT_FAR
    fit.slope = 0.0
    fit.slope_sd = math.inf
    _empty(fit)
    for block in blocks:
        _empty(block)


@inner
def _empty(sums: _Block) -> None:
    sums.corners = 0
    sums.count = sums.sum_x = sums.sum_y = 0.0


@inner
def _forget(fit: _Fit, blocks: Sequence[_Block], number: int) -> None:
    """Move on to the block `number`: drop the blocks that are too old, join the hulls of the others."""
    for new in range(max(fit.block + 1, number - BLOCKS + 1), number + 1):
        _empty(blocks[new % BLOCKS])
    fit.block = number
    _empty(fit)
    for old in range(max(0, number - BLOCKS + 1), number):
        block = blocks[old % BLOCKS]
        for k in range(block.corners):
            fit.corners = _push(fit.hull, fit.corners, block.hull[k, 0], block.hull[k, 1])
        _add(fit, block.count, block.sum_x, block.sum_y)


@inner
def _push(hull: IntArray, size: int, x: int, y: int) -> int:
    """Add a point at the right of a lower hull and return the new size (Andrew's monotone chain)."""
    if size and hull[size - 1, 0] == x:
        if y >= hull[size - 1, 1]:
            return size
        size -= 1
    while size > 1:
        a, b = hull[size - 2], hull[size - 1]
        # Whether b lies below the line from a to (x, y); products in float64, as int64 would overflow.
        if float(b[1] - a[1]) * float(x - a[0]) < float(y - a[1]) * float(b[0] - a[0]):
            break
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


@inner
def _slope(hull: IntArray, k: int) -> float:
    return float((hull[k + 1, 1] - hull[k, 1]) / (hull[k + 1, 0] - hull[k, 0]))


@inner
def _edge_at(hull: IntArray, last: int, x: float) -> int:
    """Return the edge of a hull, of `last`, over an abscissa."""
    edge = 0
    while edge < last - 1 and hull[edge + 1, 0] < x:
        edge += 1
    return edge


@inner
def _support(fit: _Fit, limit: float) -> None:
    """Choose the line: slope of the chord, drawn to zero while unsure, and the vertex it then touches."""
    hull, last = fit.hull, fit.corners - 1
    if last == 0:
        fit.vertex = 0
        fit.slope = 0.0
        return
    span = float(hull[last, 0] - hull[0, 0])
    x_left, x_right = hull[0, 0] + MARGIN * span, hull[last, 0] - MARGIN * span
    left, k = _edge_at(hull, last, x_left), _edge_at(hull, last, x_right)
    y_left = hull[left, 1] + _slope(hull, left) * (x_left - hull[left, 0])
    y_right = hull[k, 1] + _slope(hull, k) * (x_right - hull[k, 0])
    chord = (y_right - y_left) / (x_right - x_left)
    distance = fit.sum_y / fit.count - y_left - chord * (fit.sum_x / fit.count - x_left)
    # Least squares of the prior, 0 with sigma PRIOR * limit, and the chord, sigma TOUCH * distance / span.
    unsure = TOUCH * max(distance, 0.0) / (PRIOR * limit * span)
    slope = chord / (1.0 + unsure * unsure)
    of_touch = PRIOR * limit * unsure / math.sqrt(1.0 + unsure * unsure)
    of_step = min(span / fit.count, POLL_NS) / (math.sqrt(12.0) * span)
    fit.slope_sd = math.hypot(of_touch, of_step)
    if abs(slope) > limit:
        slope, fit.slope_sd = math.copysign(limit, slope), math.inf
    while k < last and _slope(hull, k) < slope:
        k += 1
    while k > 0 and _slope(hull, k - 1) > slope:
        k -= 1
    fit.vertex = k
    fit.slope = slope


@inner
def _line(fit: _Fit, x: int) -> int:
    """Return the line at x, relative to y0, rounded down to ns."""
    vertex = fit.hull[fit.vertex]
    return int(vertex[1] + math.floor(fit.slope * (x - vertex[0])))
