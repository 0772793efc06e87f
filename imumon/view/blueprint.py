"""The arrangement of the viewer: exactly the panels that have data, nothing empty."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import rerun.blueprint as rrb

from imumon.view.items import ViewSetup
from imumon.view.lanes import LOG_TEXT
from imumon.view.layout import FIRST, SCENE, STRIPS, tab_of
from imumon.view.panel_log import card_path
from imumon.view.panels import Panel
from imumon.view.pictures import chart_view
from imumon.view.window import Window, series_view, slow_window

OTHER_TAB = "Other"
TAB, LANE, LANES_FRAME, LOG = 560.0, 40.0, 42.0, 150.0
"""Points: height of a tab in a browser of 1456 x 819; what a lane takes, title and times of all; what some
lines of the log need at least."""
MOST_STRIPS, MOST_NARROW = 3, 4
"""Above each other.  Rerun writes numbers at powers of ten, and only where these are 20 points apart: the
plots of four strips, 150 points high, would often have a single number.  Where two columns would be too
narrow for the numbers of the time axis, four stand above each other all the same."""
SHORT_S = 200.0
"""Two columns of the first tab have numbers on their time axes up to so long a window."""
SIDE_CHARTS = 2
"""So many charts stand above each other beside strips.  More get two columns and half of the tab: in a third
of its height the numbers of a chart cannot be read."""
CHART_ROW, CHARTS_ROWS = 2.4, 6.4
"""Height of a chart, and of two rows of them, where a card of one row has 1: which needs a hundred points."""


class Contents(NamedTuple):
    """What there is to see."""

    panels: tuple[Panel, ...]
    """Those that have data."""
    charts: tuple[tuple[str, str, str], ...]
    """Those that have been drawn."""
    lanes: tuple[str, ...]
    """Entities of the lanes of states, from above."""
    log: bool
    status: bool
    """Whether there are log lines, a status card."""
    others: tuple[tuple[str, tuple[str, ...]], ...]
    """Views of the columns that no panel draws."""
    cards: tuple[str, ...]
    """Tabs that have a card of numbers."""
    full: bool
    """Whether as much has come as the slow tabs show."""

    def __bool__(self) -> bool:
        """Return whether there is anything besides charts."""
        return bool(self.panels or self.lanes or self.others) or self.log or self.status


def blueprint(setup: ViewSetup, contents: Contents, timeline: str, *, live: bool) -> rrb.Blueprint:
    """Return the blueprint for what has come so far.

    It follows the last seconds of `timeline` where it is `live`; that of a recording shows everything.
    """
    window = Window(setup.window_s) if live else Window()
    slow = Window(slow_window(setup.window_s), contents.full) if live else Window()
    views: dict[str, list[Any]] = {SCENE: [], STRIPS: []}
    for panel in contents.panels:
        shown = window if tab_of(panel.place) == FIRST else slow
        views.setdefault(panel.place, []).append(panel.view(setup, shown))
    for place, key, title in contents.charts:
        views.setdefault(place, []).append(chart_view(key, title))
    views[OTHER_TAB] = [
        series_view(paths[0], title, slow, others=paths[1:], legend=len(paths) > 1)
        for title, paths in contents.others
    ]
    name = setup.first_tab if live else "Recording"
    first = _first_tab(name, views, window, contents)
    tabs = [_tab(place, views[place], contents) for place in views if tab_of(place) != FIRST and views[place]]
    return arranged(rrb.Tabs(first, *tabs), timeline)


def arranged(
    tabs: rrb.Tabs, timeline: str, play_state: Literal["following", "paused"] = "following"
) -> rrb.Blueprint:
    """Return the blueprint that shows these tabs and nothing else, on this timeline.

    One that follows opens a recording at its end, where the charts are complete.
    """
    return rrb.Blueprint(
        tabs,
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state=play_state),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _tab(name: str, views: list[Any], contents: Contents) -> Any:
    """Return a tab of its own: its numbers, series above each other, charts to their right.

    Beside many charts, or many strips, the numbers stand above the charts: series need the width for the
    numbers of their time axis.
    """
    charts = [view for view in views if isinstance(view, rrb.Spatial2DView)]
    series = [view for view in views if view not in charts]
    numbers = [rrb.TextDocumentView(origin=card_path(name), name="Now")] if name in contents.cards else []
    if series and len(charts) > SIDE_CHARTS:
        grid = rrb.Grid(*charts, grid_columns=2)
        rows = rrb.Vertical(*numbers, grid, row_shares=[1.0] * len(numbers) + [CHARTS_ROWS])
        return rrb.Horizontal(_strips(series, MOST_NARROW), rows, column_shares=[2.4, 3.0], name=name)
    if charts and len(series) > MOST_STRIPS:
        shares = [1.0] * len(numbers) + [CHART_ROW] * len(charts)
        rows = rrb.Vertical(*numbers, *charts, row_shares=shares)
        return rrb.Horizontal(_strips(series, MOST_STRIPS), rows, column_shares=[3.8, 1.6], name=name)
    parts: list[tuple[float, Any]] = [(0.9, view) for view in numbers]
    if series:
        parts.append((2.2, _strips(series, MOST_STRIPS)))
    if charts:
        parts.append((2.0, rrb.Vertical(*charts) if series else rrb.Grid(*charts)))
    shares = [share for share, _ in parts]
    return rrb.Horizontal(*[part for _, part in parts], column_shares=shares, name=name)


def _strips(views: list[Any], most: int) -> Any:
    """Return views of series, at the most so many above each other."""
    columns = math.ceil(len(views) / most)
    return rrb.Vertical(*views) if columns == 1 else rrb.Grid(*views, grid_columns=columns)


def _first_tab(name: str, views: dict[str, list[Any]], window: Window, contents: Contents) -> Any:
    """Return the first tab; if it is `TAB` points high lanes have what they need, the log the rest."""
    left: list[tuple[float, Any]] = [(1.9, view) for view in views[SCENE]]
    if FIRST in contents.cards:
        left.append((2.9, rrb.TextDocumentView(origin=card_path(FIRST), name="Now")))
    if contents.status:
        left.append((1.6, rrb.TextDocumentView(origin="/status", name="Status")))
    right: list[tuple[float, Any]] = []
    lanes = LANE * len(contents.lanes) + LANES_FRAME
    if contents.lanes:
        shown, axis = list(contents.lanes), window.axis
        states = rrb.StateTimelineView(
            origin="/", contents=shown, name="States", time_ranges=window.ranges, time_view=axis
        )
        right.append((lanes, states))
    if contents.log:
        right.append((max(LOG, TAB - lanes), rrb.TextDocumentView(origin=LOG_TEXT, name="Log")))
    is_short = window.seconds is not None and window.seconds <= SHORT_S
    most = MOST_STRIPS if is_short else MOST_NARROW
    middle = [(1.0, _strips(views[STRIPS], most))] if views[STRIPS] else []
    columns = [(share, part) for share, part in ((3.1, left), (5.2, middle), (2.7, right)) if part]
    stacked = [
        rrb.Vertical(*[view for _, view in part], row_shares=[share for share, _ in part])
        for _, part in columns
    ]
    return rrb.Horizontal(*stacked, column_shares=[share for share, _ in columns], name=name)
