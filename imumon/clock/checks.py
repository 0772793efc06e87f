"""Rate and gaps of a stream; whether what dates its rows is true: counts that stand, a nominal rate."""

import math

import numpy as np

from imumon.blocks import NO_INT, IntArray, missing

from .device import RATE_STEADINESS, DatedBy

STANDS = 100
"""Packets in a row for which a count stays: a clock that ticks every 10 ms has 80 of a stream at 8 kHz."""
MEASURED_S = 10.0
"""Arrivals scatter by 0.1 s and more; over so long they give a rate to a few percent."""
SILENT_NS = 3_000_000_000
"""After a longer silence it is not known how many packets there would have been."""
SETTLE_NS = 1_000_000_000
"""What comes so soon after a silence, or first of all, may have been sent long before: it is not counted."""


class Repeats:
    """Compares the packet counter and the clock of each packet with those of the one before.

    A counter may stay while the clock goes on, or the clock while the counter does; where both are there and
    neither goes on, the packet has come twice.  What a device does not send is not looked for.
    """

    def __init__(self) -> None:
        self._last = np.full((2, 1), NO_INT)  # counter and clock of the last packet
        self._run = np.zeros(2, np.int64)  # packets in a row for which only this one has stayed by now
        self._stands_at: dict[int, int] = {}  # the count, of the first run of `STANDS` packets
        self._twice = self._rows = 0
        self._reported: set[str] = set()

    def add(self, counter: IntArray | None, ticks: IntArray | None, n: int) -> None:
        """Take rows that follow those of the last call, (n,) each, `NO_INT` where there is no count."""
        if not n:
            return
        none = missing(n, np.int64)
        counts = np.stack([none if count is None else count for count in (counter, ticks)])
        stays = (counts == np.hstack([self._last, counts[:, :-1]])) & (counts != NO_INT)
        self._last = counts[:, -1:]
        self._rows += n
        self._twice += int(stays.all(axis=0).sum())
        place, alone = np.arange(n), stays & ~stays[::-1]
        run = place - np.maximum.accumulate(np.where(alone, -1 - self._run[:, None], place), axis=1)
        self._run = run[:, -1]
        for which in np.flatnonzero((run >= STANDS).any(axis=1)).tolist():
            self._stands_at.setdefault(which, int(counts[which, np.argmax(run[which] >= STANDS)]))

    def notices(self, dated_by: DatedBy) -> list[str]:
        """Return, once each, what does not go on and what that means for the times of the rows."""
        one = "their rows have one time, and estimates leave out all but the first"
        texts = {}
        if 0 in self._stands_at:
            times = f", and {one}" if dated_by == "counter" else ""
            lost = f"it does not show packets that are lost{times}"
            texts["counter"] = f"the packet counter stands at {self._stands_at[0]}: {lost}"
        if 1 in self._stands_at:
            texts["clock"] = f"the device's clock stands at its count {self._stands_at[1]}: {one}"
        if self._twice:
            texts["twice"] = (
                f"{self._twice:,} of {self._rows:,} rows have the counter and the time of the one before, "
                "as of packets sent or recorded twice: they have its time, and estimates leave them out"
            )
        new = [text for what, text in texts.items() if what not in self._reported]
        self._reported.update(texts)
        return new


class NominalRate:
    """Compares the time that a nominal rate gives with the times of arrival.

    `rate_hz`: packets per second; None where nothing is dated by it.
    `given`: whether a person gave it for this stream, and not the device file for all.
    """

    def __init__(self, rate_hz: float | None, given: bool) -> None:
        self._rate_hz, self._given = rate_hz or math.nan, given
        self._last = np.zeros((0, 3), np.int64)  # time, segment, arrival of the last row, once there is one
        # Between the rows compared, by the rate and by the arrivals; the longest time without a read.
        self._device_s = self._arrived_s = self._latest_s = 0.0
        self._since_ns = 0  # arrival of the first row after the latest silence
        self._reported = False

    @property
    def measured_hz(self) -> float | None:
        """The rate by the times of arrival; None before there is enough of them."""
        if self._arrived_s < MEASURED_S:
            return None
        return self._rate_hz * self._device_s / self._arrived_s

    def add(self, time_ns: IntArray, segment: IntArray, arrival_ns: IntArray) -> None:
        """Take rows that were dated by the rate, (n,) each, behind those of the last call."""
        rows = np.column_stack([time_ns, segment, arrival_ns])[arrival_ns != NO_INT]
        if not len(rows):
            return
        if not len(self._last):
            self._since_ns = int(rows[0, 2])
        rows = np.vstack([self._last, rows])
        self._last = rows[-1:].copy()
        step, change, arrived = np.diff(rows, axis=0).T
        since = np.where(arrived >= SILENT_NS, rows[1:, 2], self._since_ns)
        since = np.maximum.accumulate(np.append(self._since_ns, since))
        self._since_ns = int(since[-1])
        lively = (arrived >= 0) & (arrived < SILENT_NS)
        near = lively & (change == 0) & (rows[:-1, 2] - since[:-1] > SETTLE_NS)
        self._latest_s = max(self._latest_s, float(arrived[lively].max(initial=0)) * 1e-9)
        self._device_s += float(step[near].sum()) * 1e-9
        self._arrived_s += float(arrived[near].sum()) * 1e-9

    def notices(self, ended: bool) -> list[str]:
        """Return, once, that the rate is contradicted, or at the end that it is only assumed."""
        measured = self.measured_hz
        if self._reported or (measured is None and (not ended or self._given)):
            return []
        text = f"and nothing shows whether they came at it, as {MEASURED_S:g} s of arrivals would"
        text += ": if they did not, decode or replay with --rate HZ, or set rate_hz in the device file"
        if measured is not None:
            # The packets at either end may have waited for as long as the longest time without a read.
            allowed_s = self._arrived_s / RATE_STEADINESS + 2.0 * self._latest_s
            if abs(self._device_s - self._arrived_s) <= allowed_s:
                return []
            found = f"{float(f'{measured:.3g}'):g}"
            advice = f"replay with --rate {found}, or set rate_hz: {found} in the device file"
            text = f"but they arrive at {found} Hz: {advice}"
        self._reported = True
        whose = "the given" if self._given else "the device file's nominal"
        spaced = f"no packet holds its measurement time: the rows are spaced at {whose} {self._rate_hz:g} Hz"
        return [f"{spaced}, {text}"]


SHORTEST_NS, LONGEST_NS = 1e3, 1e14
"""Intervals from 1 µs to a day; others are counted with the last."""
BINS_PER_DECADE = 100
GAP = 1.5
"""An interval longer than so many usual ones lacks a packet."""
LONG_GAP_NS, LONG_GAP = 1e9, 10.0
"""What is between the rows of an interval longer than both, of which the latter is in usual ones, is lost."""
FIRST = 1 << 14
"""Intervals of which it is found whether times are rounded."""
PARTS, SHORTEST_PART = 64, 3
"""Sums of intervals that are compared, and how many each has at least."""
ROUNDED, LOST = 0.05, 0.5
"""Of the variance that a sum of independent intervals has.  That of even rows differs by less than the
resolution over any length, a few percent of it; that of rows lost by chance has all of it."""
DIFFERS = 0.01
"""Less of a difference between the possible rates is not worth a refusal: it changes N by half of that."""

_EDGES = np.geomspace(SHORTEST_NS, LONGEST_NS, 11 * BINS_PER_DECADE + 1)


def usual_interval_ns(steps: IntArray, rounded: bool = False) -> tuple[float, float]:
    """Return the usual one of intervals (n,) > 0, and the resolution of their times where they differ by it.

    It is the mean of those within 50 % of their median.  Where times are `rounded`, and the median is their
    resolution or twice it, it is that of all within the resolution, unless rows are lost; NaN where that
    cannot be distinguished, 0 without intervals.
    """
    if not len(steps):
        return 0.0, 0.0
    median = np.partition(steps, (len(steps) - 1) // 2)[(len(steps) - 1) // 2]
    away = np.abs(steps - median)
    usual = float(steps[away < 0.5 * median].mean())
    if not rounded:
        return usual, 0.0
    resolution = float(np.gcd.reduce(steps))
    near = steps[away <= resolution] / resolution
    if median > 2 * resolution or near.min() == near.max():
        return usual, 0.0
    mean, length = float(near.mean()), len(near) // PARTS
    scatter = near[: PARTS * length].reshape(PARTS, length).sum(axis=1).var()
    chance = length * near.var()
    # Two even rows are at least 2 mean - 1 apart.
    if 2.0 * mean - 1.0 >= near.max() or (length >= SHORTEST_PART and scatter < ROUNDED * chance):
        return mean * resolution, resolution
    is_lost = length >= SHORTEST_PART and scatter > LOST * chance
    differs = abs(mean * resolution / usual - 1.0) > DIFFERS
    return math.nan if differs and not is_lost else usual, 0.0


class Intervals:
    """The intervals between the times of a stream within its segments; `rounded` are those of tables."""

    def __init__(self, rounded: bool = False) -> None:
        self._count = np.zeros(len(_EDGES) + 1, np.int64)
        self._sum = np.zeros(len(_EDGES) + 1)
        self._first, self._most = np.zeros(0, np.int64), FIRST if rounded else 0
        self._last = np.zeros((0, 2), np.int64)  # time and segment of the last row
        self.rows = 0
        self.backwards = 0
        """Steps back within a segment."""

    def add(self, time_ns: IntArray, segment: IntArray) -> None:
        """Count the intervals of rows that follow those of the last call."""
        self.rows += len(time_ns)
        rows = np.vstack([self._last, np.column_stack([time_ns, segment])[time_ns != NO_INT]])
        self._last = rows[-1:].copy()
        step, change = np.diff(rows, axis=0).T
        step = step[change == 0]
        self.backwards += int((step < 0).sum())
        step = step[step > 0]
        if len(self._first) < self._most:
            self._first = np.append(self._first, step)[: self._most]
        which = np.searchsorted(_EDGES, step)
        self._sum += np.bincount(which, step, len(self._sum))
        self._count += np.bincount(which, minlength=len(self._count))

    @property
    def usual_ns(self) -> float | None:
        """Mean of the intervals about the median one; None before there are two times."""
        total = self._count.sum()
        if not total:
            return None
        median = np.searchsorted(np.cumsum(self._count), (total + 1) // 2)
        # A quarter of a decade to either side holds the jitter of a timer and no interval of two packets.
        near = slice(max(median - BINS_PER_DECADE // 8, 0), median + BINS_PER_DECADE // 8 + 1)
        return float(self._sum[near].sum() / self._count[near].sum())

    @property
    def rate_hz(self) -> float | None:
        """Rows per second where none is missing; None where it is not known."""
        usual = usual_interval_ns(self._first, rounded=True)[0] if self._most else self.usual_ns
        return 1e9 / usual if usual and not math.isnan(usual) else None

    @property
    def gaps(self) -> int:
        """Intervals in which at least one row is missing."""
        usual = self.usual_ns or math.inf
        return int(self._count[np.searchsorted(_EDGES, GAP * usual) + 1 :].sum())

    @property
    def covered_s(self) -> float:
        """Sum of the intervals without long gaps."""
        longest = max(LONG_GAP_NS, LONG_GAP * (self.usual_ns or 0.0))
        return float(self._sum[: np.searchsorted(_EDGES, longest) + 1].sum()) * 1e-9
