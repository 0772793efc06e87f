"""Several sessions on one time axis: each quantity in a view of its own, each session in its own colour."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import IntArray, SampleBlock
from imumon.charts import BLUE, GREEN, ORANGE, RED, VIOLET, Color
from imumon.view.blueprint import arranged
from imumon.view.extent import Extent, entity
from imumon.view.items import Samples, Timebase, ViewSetup
from imumon.view.layout import FIRST, Rows, Strip, tab_of
from imumon.view.logger import RECORDED_STEP_NS
from imumon.view.panels import PANELS
from imumon.view.window import Window, series_view

COLORS: tuple[Color, ...] = (BLUE, ORANGE, GREEN, VIOLET, RED)
"""Of the sessions, in their order; with more they come again."""
COLUMNS = 3
"""Views beside each other in a tab: the three axes."""

NAMES_MARGIN = 0.3
"""Share of the time of all sessions that stays free behind it, for a legend of their names."""

Alignment = Literal["power-on", "host"]


@dataclass(slots=True)
class _Compared:
    """One line of a panel: what draws it of each session, and how far its axis reaches."""

    panel: Strip
    number: int
    drawn: list[Strip] = field(default_factory=list)
    extent: Extent = field(default_factory=Extent)
    ends: tuple[float, float] | None = None

    @property
    def title(self) -> str:
        name = self.panel.lines[self.number].name
        return self.panel.title if len(self.panel.lines) == 1 else f"{self.panel.title}: {name}"

    def of(self, session: str, color: Color) -> Strip:
        """Return the panel that draws this line of a session."""
        line = replace(self.panel.lines[self.number], name=session, color=color)
        key = f"{rr.escape_entity_path_part(session)}/{self.panel.key}/{self.number}"
        return replace(self.panel, key=key, lines=(line,), beside=None)


class Comparison:
    """Logs sessions, one after the other, to one recording stream.

    Parameters
    ----------
    setup : ViewSetup
        Title and units.
    align : "power-on" or "host"
        Whether each session begins at zero, or stands where the clock of its computer says.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, align: Alignment) -> None:
        self._rec, self._setup, self._align = rec, setup, align
        self._compared = {
            (panel.key, number): _Compared(panel, number)
            for panel in PANELS
            if isinstance(panel, Strip)
            for number in range(len(panel.lines))
        }
        self._sessions = 0
        self._blocks = 0
        self._span = [np.inf, -np.inf]
        rec.send_recording_name(setup.title)

    def session(self, name: str) -> Session:
        """Begin the next session; `name` is unlike those of the others."""
        self._sessions += 1
        return Session(self, name, COLORS[(self._sessions - 1) % len(COLORS)])

    def log(self, line: _Compared, panel: Strip, rows: Rows) -> None:
        """Log what a session has of a line."""
        if panel not in line.drawn:
            if not panel.says(rows):
                return
            line.drawn.append(panel)
            panel.declare(self._rec, live=False)
        panel.log(self._rec, rows)
        self._blocks += 1  # sessions overlap in time: the extent is told of a step for each block
        clock = np.array([self._blocks * 1_000_000_000])
        line.ends = line.extent.ends(clock, panel.reach(rows)) or line.ends

    def note(self, clock: IntArray) -> None:
        """Note how far time goes."""
        self._span = [min(self._span[0], int(clock[0])), max(self._span[1], int(clock[-1]))]

    @property
    def lines(self) -> list[_Compared]:
        """All lines, whether a session has them or not."""
        return list(self._compared.values())

    @property
    def aligned_at_power_on(self) -> bool:
        """Whether each session begins at zero."""
        return self._align == "power-on"

    def arrange(self) -> rrb.Blueprint | None:
        """Send the arrangement, once all is logged, and return it; None when there is nothing to see."""
        tabs: dict[str, list[Any]] = {}
        for line in self._compared.values():
            if line.drawn:
                place = line.panel.title if tab_of(line.panel.place) == FIRST else line.panel.place
                tabs.setdefault(place, []).append(self._view(line))
        if not tabs:
            return None
        grids = [rrb.Grid(*views, grid_columns=COLUMNS, name=name) for name, views in tabs.items()]
        timeline = "device_time" if self.aligned_at_power_on else "host_time"
        found = arranged(rrb.Tabs(*grids), timeline, play_state="paused")
        self._rec.send_blueprint(found)
        return found

    def _view(self, line: _Compared) -> Any:
        if line.ends is not None:  # at both ends of time: all of a recording is shown
            times = np.array(self._span, np.int64)
            rows = Rows({}, None, *((times, None) if self.aligned_at_power_on else (None, times)))
            rows.send(self._rec, entity(line.drawn[0].drawn), np.array([line.ends, line.ends]))
        view = line.drawn[0].view(self._setup, self._window)
        others = [f"{panel.drawn}/**" for panel in line.drawn[1:]]
        title = str(view.name).replace(line.panel.title, line.title)
        return series_view(line.drawn[0].drawn, title, self._window, line.panel.y_range, others, legend=True)

    @property
    def _window(self) -> Window:
        """The whole of time, and room for the names of the sessions."""
        first, last = self._span
        return Window(until_ns=round(last + NAMES_MARGIN * (last - first)))


class Session:
    """Logs the samples of one session, blocks in order."""

    def __init__(self, comparison: Comparison, name: str, color: Color) -> None:
        self._comparison = comparison
        self._timebase = Timebase()
        self._began_ns: int | None = None
        self._lines = [(line, line.of(name, color)) for line in comparison.lines]

    def log(self, block: SampleBlock) -> None:
        """Log samples: of each half second the extremes, so that spikes stay."""
        if not len(block):
            return
        rows = self._rows(self._timebase.samples(block))
        if rows.clock is None:
            return
        self._comparison.note(rows.clock)
        for line, panel in self._lines:
            if rows.columns.keys() >= set(panel.columns):
                self._comparison.log(line, panel, rows)

    def _rows(self, samples: Samples) -> Rows:
        if not self._comparison.aligned_at_power_on:
            return Rows(samples.block.columns, None, None, samples.host_ns, RECORDED_STEP_NS)
        device = samples.host_ns if samples.device_ns is None else samples.device_ns
        if device is None:
            return Rows(samples.block.columns, None, None, None, RECORDED_STEP_NS)
        if self._began_ns is None:
            self._began_ns = int(device[0])
        return Rows(samples.block.columns, None, device - self._began_ns, None, RECORDED_STEP_NS)
