"""Whether the device's own counts go on: a counter or a clock that stands, packets that come twice."""

from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, BoolArray, IntArray
from imumon.clock.device import DatedBy

STANDS = 100
"""Packets in a row for which a count stays: a clock that ticks every 10 ms has 80 of a stream at 8 kHz."""


class Repeats:
    """Compares the packet counter and the clock of each packet with those of the one before.

    A counter may stay while the clock goes on, or the clock while the counter does; where both are there and
    neither goes on, the packet has come twice.  What a device does not send is not looked for.
    """

    def __init__(self) -> None:
        self._last = (NO_INT, NO_INT)
        self._run = {"counter": 0, "clock": 0}
        """Packets in a row for which each has stayed by now."""
        self._stands_at: dict[str, int] = {}
        """The count, of the first run of `STANDS` packets."""
        self._twice = self._rows = 0
        self._reported: set[str] = set()

    def add(self, counter: IntArray | None, ticks: IntArray | None, n: int) -> None:
        """Take rows that follow those of the last call, (n,) each, `NO_INT` where there is no count."""
        if not n:
            return
        none = np.full(n, NO_INT)
        counter, ticks = none if counter is None else counter, none if ticks is None else ticks
        counted, timed = (
            _stays(count, last) for count, last in zip((counter, ticks), self._last, strict=True)
        )
        self._last = int(counter[-1]), int(ticks[-1])
        self._rows += n
        self._twice += int((counted & timed).sum())
        self._follow("counter", counted & ~timed, counter)
        self._follow("clock", timed & ~counted, ticks)

    def _follow(self, which: str, stays: BoolArray, count: IntArray) -> None:
        place = np.arange(len(stays))
        run = place - np.maximum.accumulate(np.where(stays, -1 - self._run[which], place))
        self._run[which] = int(run[-1])
        if which not in self._stands_at and (run >= STANDS).any():
            self._stands_at[which] = int(count[np.argmax(run >= STANDS)])

    def notices(self, dated_by: DatedBy) -> list[str]:
        """Return, once each, what does not go on and what that means for the times of the rows."""
        one = "their rows have one time, and estimates leave out all but the first"
        lost = "it does not show packets that are lost"
        texts = {}
        if "counter" in self._stands_at:
            times = f", and {one}" if dated_by == "counter" else ""
            texts["counter"] = f"the packet counter stands at {self._stands_at['counter']}: {lost}{times}"
        if "clock" in self._stands_at:
            texts["clock"] = f"the device's clock stands at its count {self._stands_at['clock']}: {one}"
        if self._twice:
            texts["twice"] = (
                f"{self._twice:,} of {self._rows:,} rows have the counter and the time of the one before, "
                "as of packets sent or recorded twice: they have its time, and estimates leave them out"
            )
        new = [text for what, text in texts.items() if what not in self._reported]
        self._reported.update(texts)
        return new


def _stays(count: IntArray, last: int) -> BoolArray:
    """Return which counts are those of the packet before."""
    return np.asarray((count == np.concatenate([[last], count[:-1]])) & (count != NO_INT))
