"""A channel on an even grid of samples: gaps found, and the runs that a difference may span.

No sample is moved in time.  Between neighbours the time must be one interval, within `JITTER`; more is a gap
if it is a whole number of intervals, and the end of an island otherwise.  What is missing has the mean of its
neighbours, as many on either side as are missing; no difference crosses a gap that is longer than one part in
`PARTS` of its averaging time.  Nothing ever crosses the end of an island: a restart of the device, a gap of
unknown or great length.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.clock.checks import usual_interval_ns

from .covariance import TRUSTED_FREEDOM, Runs, covariances_of, freedom

JITTER = 0.35
"""Time between samples may be off by this part of the interval, or by the resolution of the times."""
PARTS = 4
"""A gap of a quarter of an averaging time, in the middle, changes its mean of a random walk by 0.4 % of the
variance: a quarter of the cube of its part."""
LONGEST_GAP = 200
"""A gap of more than one part in so many of the samples ends an island: no averaging time could bridge it."""
SHORTEST_ISLAND = 4
LONGEST_START_S = 1.0
"""The shortest averaging times are left out, up to this one, where a filter of the device has shaped them."""
LEAST_TIME = 4.0
"""Samples: a shorter correlation cannot be distinguished from white noise behind a filter."""
WALK = np.array([0.0, 0.0, 1.0, 0.0])
"""The noise that has the fewest degrees of freedom: a random walk of the rate."""


class EvenSeries(NamedTuple):
    """Samples on an even grid."""

    interval_s: float  # time from sample to sample
    values: FloatArray  # all islands one after the other, (n,); means of neighbours where one is missing
    islands: IntArray  # bounds of the islands in `values`, (k + 1,)
    gap_starts: IntArray
    gap_lengths: IntArray  # the missing samples, (g,)
    samples: int  # finite samples that there were
    jitter: float  # RMS deviation of the time between neighbours, as a part of the interval

    @property
    def used(self) -> int:
        """Samples that lie on the grid, without the missing ones."""
        return len(self.values) - int(self.gap_lengths.sum())

    @property
    def rate_hz(self) -> float:
        """Sample rate."""
        return 1.0 / self.interval_s

    @property
    def duration_s(self) -> float:
        """Length of the grid."""
        return len(self.values) * self.interval_s

    @property
    def there(self) -> BoolArray:
        """Which of the values are samples, (n,)."""
        n = len(self.values) + 1
        ends = np.bincount(self.gap_starts + self.gap_lengths, minlength=n)
        return np.asarray(np.cumsum(np.bincount(self.gap_starts, minlength=n) - ends)[:-1] == 0)

    def runs(self, m: int) -> tuple[IntArray, IntArray]:
        """Return starts and stops of the runs that differences of averaging factor m may span."""
        breaks = self.gap_lengths > m // PARTS
        edges = self.gap_starts[breaks]
        starts = np.concatenate([self.islands[:-1], edges + self.gap_lengths[breaks]])
        return np.sort(starts), np.sort(np.concatenate([edges, self.islands[1:]]))


def octaves(series: EvenSeries) -> IntArray:
    """Return the averaging factors 1, 2, 4, ... for which a run is long enough."""
    n = 0
    while np.subtract(*series.runs(1 << n)[::-1]).max(initial=0) >= 2 << n:
        n += 1
    return 1 << np.arange(n, dtype=np.int64)


class Division:
    """A record divided into runs, at each averaging factor; the same for all channels with the same gaps."""

    def __init__(self, series: EvenSeries) -> None:
        self.factors = octaves(series)
        self.runs, few = list[Runs](), list[bool]()
        for m in self.factors.tolist():
            starts, stops = series.runs(m)
            lengths, counts = np.unique((stops - starts)[stops - starts >= 2 * m], return_counts=True)
            self.runs.append(Runs(lengths.astype(np.float64), counts.astype(np.float64)))
            few.append(freedom("allan", m, self.runs[-1], WALK) < TRUSTED_FREEDOM)
        self.trusted = [*few, True].index(True)
        """How many of the averaging times can be trusted, from the shortest on."""
        first = math.log2(max(LONGEST_START_S / series.interval_s, LEAST_TIME))
        last = max(math.log2(self.factors[: self.trusted].max(initial=1)), first)
        self.times: list[float] = (2.0 ** np.arange(first, last + 1e-9)).tolist()
        """Correlation times that are tried, samples, in octaves: beyond a filter, to the longest of these."""
        known = dict(zip(self.times, covariances_of(self.factors, self.runs, self.times), strict=True))
        self.at = cache(lambda time: known.get(time) or covariances_of(self.factors, self.runs, [time])[0])
        """Return the covariances for a correlation time, samples."""


Grid = tuple[BoolArray, IntArray, EvenSeries]
"""Where samples lie on an even grid: which are kept, at which position; and a series without values."""


def even_channels(
    time_ns: IntArray, segment: IntArray, channels: Mapping[str, FloatArray], *, rounded: bool = False
) -> dict[str, EvenSeries]:
    """Put the finite values of each channel on an even grid; channels without two neighbours are left out.

    Device time, the count of its restarts, and channels are (n,), NaN where a channel has no sample: one that
    is slower than the packets has its own interval.  `rounded` times have a resolution near the interval.
    """
    grids: dict[bytes, Grid | None] = {}
    series = {}
    for name, values in channels.items():
        present = np.isfinite(values)
        key = np.packbits(present).tobytes()
        if key not in grids:
            grids[key] = _grid(time_ns[present], segment[present], rounded)
        if (grid := grids[key]) is not None:
            kept, position, bare = grid
            series[name] = bare._replace(values=_filled(values[present][kept], position, bare))
    return series


def _grid(time_ns: IntArray, segment: IntArray, rounded: bool) -> Grid | None:
    n, steps = len(time_ns), np.diff(time_ns)
    interval, resolution = usual_interval_ns(steps[(np.diff(segment) == 0) & (steps > 0)], rounded)
    if not interval > 0.0:
        return None
    steps = steps / interval
    tolerance = resolution / interval
    whole = np.where(np.abs(steps - 1.0) < tolerance, 1.0, np.rint(steps))
    even = (np.abs(steps - whole) <= max(JITTER, tolerance)) & (whole >= 1) & (whole - 1 <= n // LONGEST_GAP)
    even &= np.diff(segment) == 0
    together = steps[even & (whole == 1)]
    jitter = np.sqrt(np.mean((together - 1.0) ** 2)) if len(together) else 0.0
    island = np.cumsum(np.concatenate([[0], ~even]))
    kept = np.bincount(island)[island] >= SHORTEST_ISLAND
    if not kept.any():
        return None
    advance = np.concatenate([[1], np.where(even, whole, 1.0).astype(np.int64)])[kept]
    position = np.cumsum(advance) - 1
    islands = np.append(position[np.concatenate([[True], ~even])[kept]], position[-1] + 1)
    gaps = np.diff(position) - 1
    starts, lengths = position[:-1][gaps > 0] + 1, gaps[gaps > 0]
    return kept, position, EvenSeries(interval * 1e-9, np.empty(0), islands, starts, lengths, n, jitter)


def _filled(values: FloatArray, position: IntArray, bare: EvenSeries) -> FloatArray:
    """Return the samples at their positions, and between them the mean of their neighbours."""
    islands, starts, lengths = bare.islands, bare.gap_starts, bare.gap_lengths
    laid, there = np.zeros(islands[-1]), np.zeros(islands[-1], np.int64)
    laid[position], there[position] = values, 1
    island = np.searchsorted(islands, starts, side="right")
    low = np.maximum(starts - lengths, islands[island - 1])
    high = np.minimum(starts + 2 * lengths, islands[island])
    total, count = (np.concatenate([[0], np.cumsum(part)]) for part in (laid, there))
    laid[there == 0] = np.repeat((total[high] - total[low]) / (count[high] - count[low]), lengths)
    return laid
