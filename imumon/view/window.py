"""What the series of a tab show of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from imumon.view.extent import LATEST_S

SLOW_WINDOW_S = 600.0
"""The tabs behind the first show what is slow: the time since the start, then so many seconds at least."""
TEMPORAL = ("device_time", "host_time")
ENDLESS = rrb.TimeRangeBoundary.infinite()


@dataclass(frozen=True, slots=True)
class Window:
    """What the series of a tab show of a timeline, all the same."""

    seconds: float | None = None
    """Length; None for a whole recording."""
    full: bool = True
    """Whether so much has come; until then it begins where the data does."""
    margin_s: float = 0.0
    """What stays free on the right, for a legend, s."""
    until_ns: int | None = None
    """Where the axis of a whole recording ends; with the data without."""

    def looks(self, ends: Sequence[str]) -> dict[Any, Any]:
        """Return what is queried of the ends of axes: live the latest, which are of the whole window each."""
        if self.seconds is None:
            return {}
        start = rrb.TimeRangeBoundary.cursor_relative(seconds=-LATEST_S)
        end = rrb.TimeRangeBoundary.cursor_relative()
        ranges = [rrb.VisibleTimeRange(one, start=start, end=end) for one in TEMPORAL]
        return {one: [rrb.VisibleTimeRanges(ranges)] for one in ends}

    @property
    def ranges(self) -> list[rrb.VisibleTimeRange] | None:
        """What is queried, on whichever timeline is chosen."""
        if self.seconds is None:
            return None
        end = rrb.TimeRangeBoundary.cursor_relative()
        return [rrb.VisibleTimeRange(timeline, start=self._start, end=end) for timeline in TEMPORAL]

    @property
    def axis(self) -> rrb.TimeAxis:
        """What the axis shows; without it the viewer shows a minute around the cursor."""
        if self.seconds is None:
            until = ENDLESS if self.until_ns is None else rrb.TimeRangeBoundary.absolute(nanos=self.until_ns)
            return rrb.TimeAxis(view_range=rr.TimeRange(start=ENDLESS, end=until))
        end = rrb.TimeRangeBoundary.cursor_relative(seconds=self.margin_s)
        return rrb.TimeAxis(view_range=rr.TimeRange(start=self._start, end=end))

    @property
    def _start(self) -> rrb.TimeRangeBoundary:
        if not self.full or self.seconds is None:
            return ENDLESS
        return rrb.TimeRangeBoundary.cursor_relative(seconds=-self.seconds)


def series_view(
    origin: str,
    name: str,
    window: Window,
    y_range: tuple[float, float] | None = None,
    others: Sequence[str] = (),
    ends: Sequence[str] = (),
    *,
    legend: bool = False,
) -> Any:
    """Return a view of series over time, with other entities beside the first, and maybe a legend.

    A legend stands in the view, over data where there is no margin: better the title tells the colours.

    `ends` are entities that say how far the vertical axis reaches now.
    """
    return rrb.TimeSeriesView(
        origin="/" if others else origin,
        contents=[f"{origin}/**", *others],
        name=name,
        time_ranges=window.ranges,
        axis_x=window.axis,
        axis_y=rrb.ScalarAxis(range=y_range) if y_range else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop if legend else None, visible=legend),
        overrides=window.looks(ends),
    )


def slow_window(window_s: float) -> float:
    """Return the length of the slow tabs' window, by that of the first."""
    return max(SLOW_WINDOW_S, window_s)
