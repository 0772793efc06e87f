"""Several sessions on one time axis: each quantity in a view of its own, each session in its own colour."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import SampleBlock
from imumon.charts import BLUE, GREEN, ORANGE, RED, VIOLET, Color
from imumon.errors import bad_data

from .blueprint import arranged
from .items import Timebase, Times, ViewSetup
from .layout import FIRST, Strip, tab_of
from .logger import RECORDED_STEP_NS
from .panels import PANELS, draw
from .rows import Rows
from .window import Extents, Window, series_view

COLORS: tuple[Color, ...] = (BLUE, ORANGE, GREEN, VIOLET, RED)
"""Of the sessions, in their order; with more they come again."""
COLUMNS = 3
"""Views beside each other in a tab: the three axes."""

Alignment = Literal["power-on", "host"]


def _quantities() -> Iterator[Strip]:
    """Yield a panel for each line of a panel: every quantity has a view of its own."""
    for panel in PANELS:
        if isinstance(panel, Strip):
            for number, line in enumerate(panel.lines):
                title = f"{panel.title}: {line.name}" if len(panel.lines) > 1 else panel.title
                yield replace(panel, key=f"{panel.key}/{number}", title=title, lines=(line,), beside=None)


class Comparison:
    """Logs sessions, one after the other, to one recording stream.

    With `align` each session begins at zero, or stands where the clock of its computer is.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, align: Alignment) -> None:
        self._rec, self._setup, self._align = rec, setup, align
        # What draws each quantity of the sessions that have it.
        self._drawn: dict[Strip, list[Strip]] = {quantity: [] for quantity in _quantities()}
        self._extents = Extents(rec, live=False)
        self._colors = cycle(COLORS)
        self._panels: list[Strip] = []  # what draws the quantities of the present session
        rec.send_recording_name(setup.title)

    def begin(self, session: str) -> None:
        """Begin the next session, whose name is unlike those of the others."""
        color, prefix = next(self._colors), rr.escape_entity_path_part(session)
        self._panels = [
            replace(one, key=f"{prefix}/{one.key}", lines=(one.lines[0]._replace(name=session, color=color),))
            for one in self._drawn
        ]
        self._timebase = Timebase()
        # First time of the present session; None while nothing of it is shown.
        self.began_ns: int | None = None

    def log(self, block: SampleBlock) -> None:
        """Log samples of the session, in order: of each half second the extremes, so that spikes stay."""
        _, device_ns, host_ns = self._timebase.samples(block).times
        by_host = self._align == "host"
        clock = host_ns if by_host or device_ns is None else device_ns
        if clock is None or not len(clock):
            return
        if self.began_ns is None:
            self.began_ns = int(clock[0])
        times = Times(None, None, clock) if by_host else Times(None, clock - self.began_ns, None)
        rows = Rows(block.columns, times, RECORDED_STEP_NS)
        for drawn, panel in zip(self._drawn.values(), self._panels, strict=True):
            begins = panel not in drawn
            if not rows.columns.keys() >= set(panel.columns) or (begins and not panel.has_values(rows)):
                continue
            if begins:
                drawn.append(panel)
            draw(self._rec, panel, rows, self._extents, begins=begins)

    def arrange(self) -> None:
        """Send the arrangement, once all is logged; raises BAD_DATA when there is nothing to see."""
        self._extents.finish()
        tabs: dict[str, list[Any]] = {}
        for panel, drawn in self._drawn.items():
            if drawn:
                tab = panel.title.partition(":")[0] if tab_of(panel.place) == FIRST else panel.place
                first, *others = [one.drawn for one in drawn]
                beside, title = [f"{other}/**" for other in others], panel.view(self._setup, Window()).name
                view = series_view(first, str(title), Window(), beside, legend=True)
                tabs.setdefault(tab, []).append(view)
        if not tabs:
            raise bad_data("the sessions have no samples that can be shown")
        grids = [rrb.Grid(*views, grid_columns=COLUMNS, name=name) for name, views in tabs.items()]
        timeline = "device_time" if self._align == "power-on" else "host_time"
        self._rec.send_blueprint(arranged(rrb.Tabs(*grids), timeline))
