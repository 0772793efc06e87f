"""Times of the rows of a table from elsewhere: even ones, counts that wrap, segments."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from imumon.blocks import IntArray
from imumon.clock.rate import Intervals
from imumon.errors import ImumonError, Reason
from imumon.recordings.foreign import Part
from imumon.recordings.map import TableMap


class RowTimes:
    """Times of the rows so far: checks that they increase, counts segments, sums the span."""

    def __init__(self, table: Path, table_map: TableMap) -> None:
        self._table, self._time, self._rate_hz = table, table_map.time, table_map.rate_hz
        self.segment = 0
        self.span_ns = 0
        self.intervals = Intervals()
        self._last: tuple[int, int] | None = None
        """Time and line of the last row."""
        self._counted = self._wraps = 0
        """What its column of time says, and how often that has wrapped."""

    def take(self, part: Part) -> tuple[IntArray, IntArray]:
        """Return the times of rows in ns, and their segments.

        Raises BAD_DATA at the first time that does not increase, unless it goes back and that begins a
        segment, and for times beyond 64 bits.
        """
        try:
            times = self._times(part)
        except OverflowError:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{self._table}: its times are beyond the 292 years that a time in ns can tell",
                "check rate_hz, or wraps_at and the unit of time, in the map",
            ) from None
        if not len(times):
            return times, times
        before_ns, before_line = self._last or (int(times[0]) - 1, 0)
        steps = np.diff(times, prepend=before_ns)
        back = steps < 0
        may_go_back = self._time is not None and self._time.backwards == "segment"
        wrong = np.flatnonzero((steps == 0) | (back & (not may_go_back)))
        if len(wrong):
            at = int(wrong[0])
            lines = np.append(before_line, part.line)[at : at + 2]
            raise self._error(int(times[at]), int(steps[at]), lines)
        segments = self.segment + np.cumsum(back)
        self.span_ns += sum(steps[~back].tolist()) - (self._last is None)
        self.intervals.add(times, segments)
        self._last = int(times[-1]), int(part.line[-1])
        self.segment = int(segments[-1])
        return times, segments

    def warnings(self) -> list[str]:
        """Return what cannot be known of these times."""
        if self._time is None or self._time.wrap_ns is None:
            return []
        wrap = f"{float(self._time.wrap_ns) * 1e-9:g} s"
        return [
            f"{self._table}: time wraps every {wrap}, and how often it did in a gap cannot be known: one"
            f" of {wrap} or longer comes out short by whole wraps"
        ]

    def _times(self, part: Part) -> IntArray:
        if part.time_ns is None:
            # Each is rounded by itself so that no error adds up; a row that was dropped keeps its time.
            period_ns = 10**9 / Fraction(str(self._rate_hz))
            return np.array([round(row * period_ns) for row in part.index.tolist()], np.int64)
        wrap_ns = None if self._time is None else self._time.wrap_ns
        if wrap_ns is None or not len(part.time_ns):
            return part.time_ns
        before = part.time_ns[0] if self._last is None else self._counted
        wraps = self._wraps + np.cumsum(np.diff(part.time_ns, prepend=before) < 0)
        first, last = int(wraps[0]), int(wraps[-1])
        self._counted, self._wraps = int(part.time_ns[-1]), last
        whole = np.array([round(number * wrap_ns) for number in range(first, last + 2)], np.int64)
        times: IntArray = part.time_ns + whole[wraps - first]
        return times

    def _error(self, time_ns: int, step_ns: int, lines: IntArray) -> ImumonError:
        after, before = time_ns * 1e-9, (time_ns - step_ns) * 1e-9
        verb, hint = (
            "is before",
            "if the device or the log started anew there, add backwards: segment to time in the map;"
            " local time goes back where daylight saving ends: write UTC, or the zone (+01:00)",
        )
        if not step_ns:
            verb, hint = "is the same as", "if the rows are evenly spaced, give rate_hz: ... in place of time"
        return ImumonError(
            Reason.BAD_DATA,
            f"{self._table}:{lines[1]}: time {after:.9f} s {verb} {before:.9f} s of line {lines[0]}",
            hint,
        )
