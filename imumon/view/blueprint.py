"""The arrangement of the viewer: exactly the panels that have data, nothing empty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from imumon.view.chart import chart_view
from imumon.view.items import ViewSetup
from imumon.view.layout import LINK, OTHER, SCENE, STRIPS, Panel, Window, last_seconds, series_view

LOG_COLUMNS = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
_ENDLESS = rr.TimeRangeBoundary.infinite()
EVERYTHING = Window(None, rrb.TimeAxis(view_range=rr.TimeRange(start=_ENDLESS, end=_ENDLESS)))
"""Without the range of the axis the viewer shows a minute around the cursor."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What there is to see.

    Parameters
    ----------
    panels : tuple of Panel
        Those that have data.
    charts : tuple of (place, key, title)
        Those that have been drawn.
    lanes, log, status, others : bool
        Whether there are states, log lines, a status card, columns that no panel draws.
    """

    panels: tuple[Panel, ...]
    charts: tuple[tuple[str, str, str], ...]
    lanes: bool
    log: bool
    status: bool
    others: bool

    def __bool__(self) -> bool:
        """Tell whether there is anything besides charts."""
        return bool(self.panels) or self.lanes or self.log or self.status or self.others


def blueprint(setup: ViewSetup, contents: Contents, timeline: str, *, live: bool) -> rrb.Blueprint:
    """Return the blueprint for what has come so far.

    Parameters
    ----------
    timeline : str
        The one to follow.
    live : bool
        True to follow the last seconds, False for a recording: everything, with the time panel open.
    """
    window = last_seconds(setup.window_s) if live else EVERYTHING
    views: dict[str, list[Any]] = {SCENE: [], STRIPS: [], LINK: []}
    for panel in contents.panels:
        views.setdefault(panel.place, []).append(panel.view(setup, window))
    for place, key, title in contents.charts:
        views.setdefault(place, []).append(chart_view(key, title))
    if contents.others:
        views["Other"] = [series_view(OTHER, "Columns without a panel of their own", window)]
    first = _first_tab("Live" if live else "Recording", views, window, contents)
    tabs = [_tab(place, views[place]) for place in views if place not in (SCENE, STRIPS, LINK)]
    return rrb.Blueprint(
        rrb.Tabs(first, *tabs, active_tab=0),
        rrb.TimePanel(
            state="collapsed" if live else "expanded",
            timeline=timeline,
            play_state="following",  # a recording opens at its end, where the charts are complete
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _tab(name: str, views: list[Any]) -> Any:
    """Return a tab of its own: series above each other, charts to their right; charts alone side by side."""
    charts = [view for view in views if isinstance(view, rrb.Spatial2DView)]
    series = [view for view in views if view not in charts]
    if not series:
        return rrb.Horizontal(*charts, name=name)
    columns = [rrb.Vertical(*part) for part in (series, charts) if part]
    return rrb.Horizontal(*columns, name=name)


def _first_tab(name: str, views: dict[str, list[Any]], window: Window, contents: Contents) -> Any:
    left: list[tuple[float, Any]] = [(3.0, view) for view in views[SCENE]]
    if contents.status:
        left.append((2.2, rrb.TextDocumentView(origin="/status", name="Status")))
    right: list[tuple[float, Any]] = [(1.0, view) for view in views[LINK]]
    if contents.lanes:
        states = rrb.StateTimelineView(
            origin="/state", name="States", time_ranges=window.ranges, time_view=window.axis
        )
        right.append((1.6, states))
    if contents.log:
        right.append((1.6, rrb.TextLogView(origin="/log", name="Log", columns=LOG_COLUMNS)))
    middle = [(1.0, view) for view in views[STRIPS]]
    columns = [(share, part) for share, part in ((3.0, left), (4.6, middle), (3.2, right)) if part]
    return rrb.Horizontal(
        *[
            rrb.Vertical(*[view for _, view in part], row_shares=[share for share, _ in part])
            for _, part in columns
        ],
        column_shares=[share for share, _ in columns],
        name=name,
    )
