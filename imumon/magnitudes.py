"""What cannot be the unit that was declared: magnitudes and rates that no unit on earth has.

At rest gravity says so within percents; here it is what holds in any motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from imumon.blocks import NO_INT, IntArray, SampleBlock
from imumon.geodesy import STANDARD_GRAVITY

GRAVITIES = (0.3, 3.0)
"""Of the specific force, its median: what has less falls and what has more is thrown, neither for minutes."""
MINUTE_NS, MINUTES = 60_000_000_000, 3
"""So many in a row, the first of which may be cut short: rockets burn with three times gravity for a minute
or two, parabolas last half a minute."""
RATES_HZ = (0.1, 40e3)
"""Of samples: slower is no motion sensor, and the fastest that is sold has 32 kHz (ICM-42688)."""


def rate_doubts(rate_hz: float) -> list[str]:
    """Return the warning for a rate of samples, Hz, that no sensor has; none for NaN."""
    slowest, fastest = RATES_HZ
    text = (
        f"the rows come at {rate_hz:.3g} Hz, as those of no inertial sensor: is the unit of the time right?"
    )
    return [text] if rate_hz < slowest or rate_hz > fastest else []


def windows(time_ns: IntArray, segment: IntArray, length_ns: int) -> Iterator[tuple[tuple[int, int], slice]]:
    """Yield each window of device time that rows are in, as its segment and number, and its rows."""
    number = time_ns // length_ns
    edges = np.flatnonzero((np.diff(number) != 0) | (np.diff(segment) != 0)) + 1
    for begin, end in pairwise([0, *edges.tolist(), len(number)]):
        if end > begin:
            yield (int(segment[begin]), int(number[begin])), slice(begin, end)


class SpecificForce:
    """Judges the magnitude of the specific force minute by minute, whatever the division into blocks."""

    def __init__(self) -> None:
        self._minute = (NO_INT, NO_INT)
        """Segment, and number of the minute in device time."""
        self._sums = np.zeros(4)
        """Readings in it that are below `GRAVITIES`, above, and all; and the sum of those beyond, in g."""
        self._beyond = 0
        """Minutes in a row most of which was below, or above: negative where below."""
        self.found: str | None = None
        """The warning, once it is certain."""

    def look(self, block: SampleBlock) -> None:
        """Take samples, with what is left out of them missing, where they have a time."""
        accel = block.accel
        if self.found is not None or accel is None or "device_time_ns" not in block:
            return
        magnitude = np.sqrt(np.einsum("ij,ij->i", accel, accel)) / STANDARD_GRAVITY
        time_ns = block["device_time_ns"]
        there = np.isfinite(magnitude) & (time_ns != NO_INT)
        for minute, rows in windows(time_ns[there], block["segment"][there], MINUTE_NS):
            if minute != self._minute:
                self._end(minute)
            part = magnitude[there][rows]
            low, high = part < GRAVITIES[0], part > GRAVITIES[1]
            self._sums += [low.sum(), high.sum(), len(part), part[low | high].sum()]

    def _end(self, now: tuple[int, int]) -> None:
        """Classify the minute that has ended."""
        (low, high, every, total), (segment, minute) = self._sums.tolist(), self._minute
        way = -1 if 2 * low > every else 1 if 2 * high > every else 0
        self._beyond = way + (self._beyond if way * self._beyond > 0 else 0)
        if abs(self._beyond) >= MINUTES and self.found is None:
            what = f"the specific force is {total / (low + high):.2g} times gravity for minutes, which no "
            self.found = f"{what}vehicle on earth bears: is its unit right?"
        if now != (segment, minute + 1):
            self._beyond = 0
        self._minute, self._sums = now, np.zeros(4)
