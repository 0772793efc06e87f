"""The arrangement of the viewer: exactly the panels that have data, nothing empty."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import rerun.blueprint as rrb

from .items import ViewSetup
from .lanes import LOG_TEXT
from .layout import FIRST, OTHER, SCENE, STRIPS, Strip, tab_of
from .panels import Panel, card_path
from .pictures import CHARTS
from .window import Window, series_view, slow_window

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

    panels: tuple[Panel, ...]  # those that have data
    charts: tuple[tuple[str, str, str], ...]  # those that have been drawn
    lanes: tuple[str, ...]  # entities of the lanes of states, from above
    log: bool  # whether there are log lines
    status: bool  # whether there is a status card
    full: bool  # whether as much has come as the slow tabs show

    def card(self, tab: str) -> Any:
        """Return the view of the numbers of a tab, of which the first has all; None where there are none."""
        strips = (panel for panel in self.panels if isinstance(panel, Strip) and panel.card)
        shown = any(tab in (FIRST, panel.place) for panel in strips)
        return rrb.TextDocumentView(origin=card_path(tab), name="Now") if shown else None


def blueprint(setup: ViewSetup, contents: Contents, timeline: str, *, live: bool) -> rrb.Blueprint:
    """Return the blueprint for what has come so far.

    It follows the last seconds of `timeline` where it is `live`; that of a recording shows everything.
    """
    window = Window(setup.window_s) if live else Window()
    slow = Window(slow_window(setup.window_s), contents.full) if live else Window()
    views: dict[str, list[Any]] = {SCENE: [], STRIPS: []}
    others: dict[tuple[str, str], list[Strip]] = {}
    for panel in contents.panels:
        if isinstance(panel, Strip) and panel.place == OTHER:
            group = panel.title.rpartition("/")[0], panel.unit_read(setup)
            others.setdefault(group, []).append(panel)
        else:
            shown = window if tab_of(panel.place) == FIRST else slow
            views.setdefault(panel.place, []).append(panel.view(setup, shown))
    for place, key, title in contents.charts:
        views.setdefault(place, []).append(rrb.Spatial2DView(origin=f"{CHARTS}/{key}", name=title))
    views[OTHER] = [_of_one_unit(*group, panels, setup, slow) for group, panels in others.items()]
    first = _first_tab(setup.first_tab if live else "Recording", views, window, contents)
    tabs = [_tab(place, views[place], contents) for place in views if tab_of(place) != FIRST and views[place]]
    return arranged(rrb.Tabs(first, *tabs), timeline)


def arranged(tabs: rrb.Tabs, timeline: str) -> rrb.Blueprint:
    """Return the blueprint that shows these tabs and nothing else, on this timeline.

    As it follows, a recording is opened at its end, where the charts are complete.
    """
    return rrb.Blueprint(
        tabs,
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _of_one_unit(stream: str, unit: str, panels: list[Strip], setup: ViewSetup, window: Window) -> Any:
    """Return the view of the columns of a stream in a unit that no panel draws."""
    first, *others = (panel.drawn for panel in panels)
    if not others:
        return panels[0].view(setup, window)
    title = ": ".join(filter(None, (stream, unit or "no unit")))
    return series_view(first, title, window, others, legend=True)


def _tab(name: str, views: list[Any], contents: Contents) -> Any:
    """Return a tab of its own: its numbers, series above each other, charts to their right.

    Beside many charts, or many strips, the numbers stand above the charts: series need the width for the
    numbers of their time axis.
    """
    charts = [view for view in views if isinstance(view, rrb.Spatial2DView)]
    series = [view for view in views if view not in charts]
    numbers = contents.card(name)
    if series and len(charts) > SIDE_CHARTS:
        side = _column([(1.0, numbers), (CHARTS_ROWS, rrb.Grid(*charts, grid_columns=2))])
        return _row([(2.4, _strips(series, MOST_NARROW)), (3.0, side)], name)
    if charts and len(series) > MOST_STRIPS:
        side = _column([(1.0, numbers), *((CHART_ROW, chart) for chart in charts)])
        return _row([(3.8, _strips(series, MOST_STRIPS)), (1.6, side)], name)
    drawn = rrb.Vertical(*charts) if series else rrb.Grid(*charts)
    parts = [(0.9, numbers), (2.2, _strips(series, MOST_STRIPS)), (2.0, drawn if charts else None)]
    return _row(parts, name)


def _row(parts: Sequence[tuple[float, Any]], name: str) -> Any:
    """Return parts beside each other, each with its share of the width; None is no part."""
    there = [(share, part) for share, part in parts if part is not None]
    shares = [share for share, _ in there]
    return rrb.Horizontal(*[part for _, part in there], column_shares=shares, name=name)


def _column(parts: Sequence[tuple[float, Any]]) -> Any:
    """Return parts above each other, each with its share of the height; None is no part, and without any."""
    there = [(share, part) for share, part in parts if part is not None]
    shares = [share for share, _ in there]
    return rrb.Vertical(*[part for _, part in there], row_shares=shares) if there else None


def _strips(views: list[Any], most: int) -> Any:
    """Return views of series, at the most so many above each other; None without any."""
    if len(views) <= most:
        return rrb.Vertical(*views) if views else None
    return rrb.Grid(*views, grid_columns=math.ceil(len(views) / most))


def _first_tab(name: str, views: dict[str, list[Any]], window: Window, contents: Contents) -> Any:
    """Return the first tab; if it is `TAB` points high lanes have what they need, the log the rest."""
    left = [*((1.9, view) for view in views[SCENE]), (2.9, contents.card(FIRST))]
    if contents.status:
        left.append((1.6, rrb.TextDocumentView(origin="/status", name="Status")))
    right: list[tuple[float, Any]] = []
    height = LANE * len(contents.lanes) + LANES_FRAME
    if contents.lanes:
        states = rrb.StateTimelineView(
            origin="/",
            contents=list(contents.lanes),
            name="States",
            time_ranges=window.ranges,
            time_view=window.axis,
        )
        right.append((height, states))
    if contents.log:
        right.append((max(LOG, TAB - height), rrb.TextDocumentView(origin=LOG_TEXT, name="Log")))
    is_short = window.seconds is not None and window.seconds <= SHORT_S
    strips = _strips(views[STRIPS], MOST_STRIPS if is_short else MOST_NARROW)
    return _row([(3.1, _column(left)), (5.2, strips), (2.7, _column(right))], name)
