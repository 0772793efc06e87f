"""What a view of series shows: which time, and how far its vertical axis reaches.

Rerun's vertical axis follows the lines alone, so that a band is cut off, and it magnifies what is constant
until the rounding fills the panel.  An invisible line beside the drawn ones spans what has to be visible now.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from .rows import Rows

STEP_NS = 1_000_000_000
"""So often the ends are logged anew."""
RECENT_S = 10.0
"""They reach over the bands of so much time, which breathe with motion; wider ones of before are cut off."""


def entity(drawn: str) -> str:
    """Return the entity of the invisible line beside what is drawn."""
    return f"{drawn}/extent"


def declare_extent(rec: rr.RecordingStream, drawn: str) -> None:
    """Log that the line is invisible."""
    unseen = rr.SeriesLines(names=["", ""], colors=[[0, 0, 0, 0]] * 2, widths=[0.0, 0.0])
    rec.log(entity(drawn), unseen, static=True)


class Extents:
    """Logs the ends of axes: live once a second, a recording at its end.

    On the way they would cost a recording a fifth of its bytes.
    """

    def __init__(self, rec: rr.RecordingStream, *, live: bool) -> None:
        self._rec, self._live = rec, live
        self._ends: dict[str, tuple[float, float, int, Rows]] = {}
        self._second: int | None = None

    def set(self, drawn: str, ends: tuple[float, float], row: Rows) -> None:
        """Let the axis of what is drawn reach over these ends, from the time of a row on."""
        now = 0 if row.clock is None else int(row.clock[0])
        low, high, before, _ = self._ends.get(drawn, (*ends, now, row))
        if abs(now - before) > 1e9 * RECENT_S:  # or the clock has gone back
            low, high = ends
        self._ends[drawn] = min(low, ends[0]), max(high, ends[1]), now, row
        if self._live and now // STEP_NS != self._second:
            self._second = now // STEP_NS
            self.finish()

    def finish(self) -> None:
        """Log what was not logged."""
        for drawn, (low, high, _, row) in self._ends.items():
            row.send(self._rec, entity(drawn), np.array([[low, high]]))
        self._ends.clear()


SLOW_WINDOW_S = 600.0
"""The tabs behind the first show what is slow: the time since the start, then so many seconds at least."""
TEMPORAL = ("device_time", "host_time")
ENDLESS = rrb.TimeRangeBoundary.infinite()
NOW = rrb.TimeRangeBoundary.cursor_relative()


class Window(NamedTuple):
    """What the series of a tab show of a timeline, all the same."""

    seconds: float | None = None  # length; None for a whole recording
    full: bool = True  # whether so much has come; until then it begins where the data does

    def looks(self, ends: Sequence[str]) -> dict[Any, Any]:
        """Return what is queried of the ends of axes: live the latest."""
        if self.seconds is None:
            return {}
        latest = rrb.VisibleTimeRanges(_until_now(_back(RECENT_S)))
        return {one: [latest] for one in ends}

    @property
    def ranges(self) -> list[rrb.VisibleTimeRange] | None:
        """What is queried."""
        return None if self.seconds is None else _until_now(self._start)

    @property
    def axis(self) -> rrb.TimeAxis:
        """What the axis shows; without it the viewer shows a minute around the cursor."""
        end = ENDLESS if self.seconds is None else NOW
        return rrb.TimeAxis(view_range=rr.TimeRange(start=self._start, end=end))

    @property
    def _start(self) -> rrb.TimeRangeBoundary:
        if not self.full or self.seconds is None:
            return ENDLESS
        return _back(self.seconds)


def _back(seconds: float) -> rrb.TimeRangeBoundary:
    return rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)


def _until_now(start: rrb.TimeRangeBoundary) -> list[rrb.VisibleTimeRange]:
    return [rrb.VisibleTimeRange(timeline, start=start, end=NOW) for timeline in TEMPORAL]


def series_view(
    origin: str,
    name: str,
    window: Window,
    others: Sequence[str] = (),
    ends: Sequence[str] = (),
    *,
    legend: bool = False,
) -> Any:
    """Return a view of series over time, with other entities beside the first, and maybe a legend.

    A legend stands in the view, over data: better the title names the colours.

    `ends` are entities that state how far the vertical axis reaches now.
    """
    return rrb.TimeSeriesView(
        origin="/" if others else origin,
        contents=[f"{origin}/**", *others],
        name=name,
        time_ranges=window.ranges,
        axis_x=window.axis,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop if legend else None, visible=legend),
        overrides=window.looks(ends),
    )


def slow_window(window_s: float) -> float:
    """Return the length of the slow tabs' window, by that of the first."""
    return max(SLOW_WINDOW_S, window_s)
