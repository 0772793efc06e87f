"""Rate and gaps of a stream, from a histogram of its intervals: constant memory, whatever the blocks."""

from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, IntArray

SHORTEST_NS, LONGEST_NS = 1e3, 1e14
"""Intervals from 1 µs to a day; others are counted with the last."""
BINS_PER_DECADE = 100
GAP = 1.5
"""An interval longer than so many usual ones lacks a packet."""

_EDGES = np.geomspace(SHORTEST_NS, LONGEST_NS, 11 * BINS_PER_DECADE + 1)


class Intervals:
    """The intervals between the times of a stream within its segments."""

    def __init__(self) -> None:
        self._count = np.zeros(len(_EDGES) + 1, np.int64)
        self._sum = np.zeros(len(_EDGES) + 1)
        self._last: tuple[int, int] | None = None
        self.rows = 0
        self.backwards = 0
        """Steps back within a segment."""

    def add(self, time_ns: IntArray, segment: IntArray) -> None:
        """Count the intervals of rows that follow those of the last call."""
        self.rows += len(time_ns)
        known = time_ns != NO_INT
        time, label = time_ns[known], segment[known]
        if not len(time):
            return
        if self._last is not None:
            time = np.concatenate([[self._last[0]], time])
            label = np.concatenate([[self._last[1]], label])
        self._last = int(time[-1]), int(label[-1])
        step = np.diff(time)[np.diff(label) == 0]
        self.backwards += int((step < 0).sum())
        step = step[step > 0]
        which = np.searchsorted(_EDGES, step)
        # The sum first: who reads from another thread finds no number without it.
        self._sum += np.bincount(which, step, len(self._sum))
        self._count += np.bincount(which, minlength=len(self._count))

    @property
    def usual_ns(self) -> float | None:
        """Mean of the intervals about the median one; None before there are two times."""
        total = self._count.sum()
        if not total:
            return None
        median = int(np.searchsorted(np.cumsum(self._count), (total + 1) // 2))
        # A quarter of a decade to either side holds the jitter of a timer and no interval of two packets.
        near = slice(max(median - BINS_PER_DECADE // 8, 0), median + BINS_PER_DECADE // 8 + 1)
        return float(self._sum[near].sum() / self._count[near].sum())

    @property
    def rate_hz(self) -> float | None:
        """Rows per second where none is missing."""
        usual = self.usual_ns
        return None if usual is None else 1e9 / usual

    @property
    def gaps(self) -> int:
        """Intervals in which at least one row is missing."""
        usual = self.usual_ns
        if usual is None:
            return 0
        return int(self._count[int(np.searchsorted(_EDGES, GAP * usual)) + 1 :].sum())
