"""Times of the rows of a table from elsewhere: even ones, counts that wrap, segments."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.clock.rate import Intervals
from imumon.errors import ImumonError, Reason
from imumon.recordings.foreign import Part
from imumon.recordings.map import TableMap


@dataclass(slots=True)
class RowTimes:
    """Times of the rows so far: checks that they increase, counts segments, sums the span."""

    table: Path
    table_map: TableMap
    segment: int = 0
    span_ns: int = 0
    intervals: Intervals = field(default_factory=Intervals)
    last: tuple[int, int] | None = None
    """Time and line of the last row."""
    counted: int = 0
    """What its column of time says, and how often that has wrapped."""
    wraps: int = 0
    longest: tuple[int, int] = (0, 0)
    """The longest step forwards, and the line that it leads to."""

    def take(self, part: Part) -> tuple[IntArray, IntArray]:
        """Return the times of rows in ns, and their segments.

        Raises BAD_DATA at the first time that does not increase, unless it goes back and that begins a
        segment, and for times beyond 64 bits.
        """
        times = self._times(part)
        if not len(times):
            return times, times
        before = [] if self.last is None else [self.last]
        line = np.concatenate([np.array([number for _, number in before], np.int64), part.line])
        steps = np.diff(times, prepend=np.array([time for time, _ in before], np.int64))
        lines = line[1:]
        back = steps < 0
        wrong = np.flatnonzero((steps == 0) | (back & (not self._segments_allowed)))
        if len(wrong):
            at = int(wrong[0])
            self._refuse(int(times[len(times) - len(steps) + at]), int(steps[at]), line[at : at + 2])
        segments = self.segment + np.concatenate([np.zeros(1 - len(before), np.int64), np.cumsum(back)])
        self._note(steps, lines, back)
        self.intervals.add(times, segments)
        self.last = int(times[-1]), int(line[-1])
        self.segment = int(segments[-1])
        return times, segments

    def warnings(self) -> list[str]:
        """Return what cannot be known of these times, once all were taken."""
        time = self.table_map.time
        if time is None or time.wrap_ns is None:
            return []
        wrap, (longest_ns, line) = f"{float(time.wrap_ns) * 1e-9:g} s", self.longest
        return [
            f"{self.table}: time wraps every {wrap}, and how often it did in a gap cannot be known: one"
            f" of {wrap} or longer comes out short by whole wraps"
            + (f". The longest step is {longest_ns * 1e-9:g} s, to line {line}" if line else "")
        ]

    @property
    def _segments_allowed(self) -> bool:
        time = self.table_map.time
        return time is not None and time.backwards == "segment"

    def _times(self, part: Part) -> IntArray:
        time, counted = self.table_map.time, part.time_ns
        if time is None or counted is None:
            return _even_times(part.index, self.table_map.rate_hz)
        return counted if time.wrap_ns is None else self._unwrapped(counted, time.wrap_ns)

    def _unwrapped(self, counted: IntArray, wrap_ns: Fraction) -> IntArray:
        """Return the times of counts, each of which is behind the one before it by less than a wrap.

        The wraps are rounded to ns all together, so that nothing adds up.
        """
        if not len(counted):
            return counted
        before = counted[0] if self.last is None else self.counted
        wraps = self.wraps + np.cumsum(np.diff(counted, prepend=before) < 0)
        first, last = int(wraps[0]), int(wraps[-1])
        self.counted, self.wraps = int(counted[-1]), last
        if (last + 1) * wrap_ns >= 2**63:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{self.table}: its times wrap so often that they are beyond the 292 years of a time in ns",
                "check wraps_at and the unit of time in the map",
            )
        whole = np.array([round(number * wrap_ns) for number in range(first, last + 1)], np.int64)
        times: IntArray = counted + whole[wraps - first]
        return times

    def _note(self, steps: IntArray, lines: IntArray, back: BoolArray) -> None:
        """Keep what the report says of these steps."""
        if not len(steps):
            return
        self.span_ns += sum(steps[~back].tolist())
        at = int(steps.argmax())
        self.longest = max(self.longest, (int(steps[at]), int(lines[at])), key=lambda step: step[0])

    def _refuse(self, time_ns: int, step_ns: int, lines: IntArray) -> None:
        after, before = time_ns * 1e-9, (time_ns - step_ns) * 1e-9
        verb, hint = (
            "is before",
            "if the device or the log started anew there, add backwards: segment to time in the map;"
            " local time goes back where daylight saving ends: write UTC, or the zone (+01:00)",
        )
        if not step_ns:
            verb, hint = "is the same as", "if the rows are evenly spaced, give rate_hz: ... in place of time"
        raise ImumonError(
            Reason.BAD_DATA,
            f"{self.table}:{lines[1]}: time {after:.9f} s {verb} {before:.9f} s of line {lines[0]}",
            hint,
        )


def _even_times(index: IntArray, rate_hz: float | None) -> IntArray:
    """Return the times of rows at an even rate, each rounded by itself so that no error adds up.

    A row that was dropped keeps its time: the rows after it are where they would be with it.
    """
    if rate_hz is None:
        raise ValueError("a map without time has a rate")
    period_ns = 10**9 / Fraction(str(rate_hz))
    try:
        return np.array([round(row * period_ns) for row in index.tolist()], np.int64)
    except OverflowError:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"at rate_hz: {rate_hz:g} the table takes longer than the 292 years that a time in ns can tell",
            "give the rate of the rows in the map",
        ) from None
