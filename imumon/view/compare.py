"""Several sessions on one time axis: each quantity in a view of its own, each session in its own colour."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import SampleBlock
from imumon.charts import BLUE, GREEN, ORANGE, RED, VIOLET, Color
from imumon.view.blueprint import arranged
from imumon.view.items import Timebase, Times, ViewSetup
from imumon.view.layout import FIRST, Strip, tab_of
from imumon.view.logger import RECORDED_STEP_NS
from imumon.view.panels import PANELS, draw
from imumon.view.rows import Rows
from imumon.view.window import Extents, Window, series_view

COLORS: tuple[Color, ...] = (BLUE, ORANGE, GREEN, VIOLET, RED)
"""Of the sessions, in their order; with more they come again."""
COLUMNS = 3
"""Views beside each other in a tab: the three axes."""

Alignment = Literal["power-on", "host"]


@dataclass(slots=True)
class _Quantity:
    """One line of a panel, a view of its own, and what draws it of each session."""

    panel: Strip
    number: int
    drawn: list[Strip] = field(default_factory=list)

    def of(self, session: str, color: Color) -> Strip:
        """Return the panel that draws this line of a session."""
        line = self.panel.lines[self.number]._replace(name=session, color=color)
        key = f"{rr.escape_entity_path_part(session)}/{self.panel.key}/{self.number}"
        return replace(self.panel, key=key, lines=(line,), beside=None)


class Comparison:
    """Logs sessions, one after the other, to one recording stream.

    With `align` each session begins at zero, or stands where the clock of its computer is.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, align: Alignment) -> None:
        self._rec, self._setup, self._align = rec, setup, align
        strips = [panel for panel in PANELS if isinstance(panel, Strip)]
        self._quantities = [_Quantity(panel, at) for panel in strips for at in range(len(panel.lines))]
        self._extents = Extents(rec, live=False)
        self._sessions = 0
        self._panels: list[Strip] = []
        """What draws the quantities of the present session."""
        rec.send_recording_name(setup.title)

    def begin(self, session: str) -> None:
        """Begin the next session, whose name is unlike those of the others."""
        color = COLORS[self._sessions % len(COLORS)]
        self._sessions += 1
        self._panels = [quantity.of(session, color) for quantity in self._quantities]
        self._timebase = Timebase()
        self._began_ns: int | None = None

    def log(self, block: SampleBlock) -> None:
        """Log samples of the session, in order: of each half second the extremes, so that spikes stay."""
        _, device_ns, host_ns = self._timebase.samples(block).times
        by_host = self._align == "host"
        clock = host_ns if by_host or device_ns is None else device_ns
        if clock is None or not len(clock):
            return
        if self._began_ns is None:
            self._began_ns = int(clock[0])
        times = Times(None, None, clock) if by_host else Times(None, clock - self._began_ns, None)
        rows = Rows(block.columns, times, RECORDED_STEP_NS)
        for quantity, panel in zip(self._quantities, self._panels, strict=True):
            begins = panel not in quantity.drawn
            if not rows.columns.keys() >= set(panel.columns) or (begins and not panel.has_values(rows)):
                continue
            if begins:
                quantity.drawn.append(panel)
            draw(self._rec, panel, rows, self._extents, begins=begins)

    def arrange(self) -> rrb.Blueprint | None:
        """Send the arrangement, once all is logged, and return it; None when there is nothing to see."""
        self._extents.finish()
        tabs: dict[str, list[Any]] = {}
        for quantity in self._quantities:
            if quantity.drawn:
                place = quantity.panel.place
                tab = quantity.panel.title if tab_of(place) == FIRST else place
                tabs.setdefault(tab, []).append(self._view(quantity))
        if not tabs:
            return None
        grids = [rrb.Grid(*views, grid_columns=COLUMNS, name=name) for name, views in tabs.items()]
        timeline = "device_time" if self._align == "power-on" else "host_time"
        found = arranged(rrb.Tabs(*grids), timeline)
        self._rec.send_blueprint(found)
        return found

    def _view(self, quantity: _Quantity) -> Any:
        panel, (first, *others) = quantity.panel, quantity.drawn
        title = str(first.view(self._setup, Window()).name)
        if len(panel.lines) > 1:
            title = title.replace(panel.title, f"{panel.title}: {panel.lines[quantity.number].name}")
        beside = [f"{other.drawn}/**" for other in others]
        return series_view(first.drawn, title, Window(), beside, legend=True)
