"""Logs rows to the panels that draw their columns, with axes and cards of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from imumon.charts import AXIS_COLORS, BLUE, GREEN, RED
from imumon.view.cards import Cards, Reading, card
from imumon.view.items import ViewSetup
from imumon.view.layout import FIRST, OTHER, SCENE, Line, Strip, read_as, tab_of
from imumon.view.panels import PANELS, Panel
from imumon.view.rows import Rows, log_markdown
from imumon.view.window import Extents

LIVE_CARD_NS, RECORDED_CARD_NS = 500_000_000, 10_000_000_000
"""How often the cards are written: a person cannot read faster; in a recording each costs 2 kB."""

PART_COLORS = {**AXIS_COLORS, "roll": RED, "pitch": GREEN, "yaw": BLUE}
"""Colour of a column by how its name ends."""


class ShownPanels:
    """The panels that have had a value in each column, and their numbers: for viewer and terminal."""

    def __init__(self, setup: ViewSetup) -> None:
        self._setup = setup
        self.begun: dict[str, Panel] = {}
        """Those that have had data, in the order in which they began."""
        self.readings: dict[str, Sequence[Reading]] = {}
        """What the card shows of each."""
        self.cards = Cards()
        self._others: dict[tuple[str, str], Strip] = {}

    def take(self, rows: Rows) -> Iterator[tuple[Panel, bool]]:
        """Yield the panels that draw these rows, and whether they begin; only one body can turn."""
        for panel in self._drawing(rows):
            turns = panel.place == SCENE and any(other.place == SCENE for other in self.begun.values())
            begins = panel.key not in self.begun and not turns and panel.has_values(rows)
            if begins:
                self.begun[panel.key], self.readings[panel.key] = panel, panel.readings(self._setup)
            if panel.key in self.begun:
                self.cards.add(self.readings[panel.key], rows.columns)
                yield panel, begins

    def _drawing(self, rows: Rows) -> Iterator[Panel]:
        """Yield the panels of which all columns are there, and a strip for each other column of floats."""
        claimed: set[str] = set()
        for panel in PANELS:
            if rows.columns.keys() >= set(panel.columns):
                claimed.update(panel.columns)
                yield panel
        for column, values in rows.columns.items():
            if values.dtype == np.float64 and column not in claimed:
                key = rows.stream, column
                if key not in self._others:
                    self._others[key] = self._other(*key)
                yield self._others[key]

    def _other(self, stream: str, column: str) -> Strip:
        """Return the strip of a column that no panel draws, in the unit that a person reads."""
        name = f"{stream}/{column.removeprefix(f'{stream}_')}" if stream else column
        unit, factor = read_as(self._setup, column)
        line = Line(column, name, PART_COLORS.get(name.rpartition("_")[2]))
        return Strip(f"other/{name}", name, (line,), unit if factor != 1.0 else None, OTHER, silent=0.0)


class PanelLog:
    """Logs the panels that have had data."""

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        self._rec = rec
        self._step_ns = LIVE_CARD_NS if live else RECORDED_CARD_NS
        self._panels = ShownPanels(setup)
        self._extents = Extents(rec, live=live)
        self._written_ns: int | None = None

    @property
    def shown(self) -> tuple[Panel, ...]:
        """The panels that have data, in the order in which they stand."""
        begun = self._panels.begun.values()
        others = sorted((panel for panel in begun if panel.place == OTHER), key=lambda panel: panel.key)
        return (*(panel for panel in PANELS if panel.key in self._panels.begun), *others)

    def declare(self) -> None:
        """Log what does not change, for a new file."""
        for panel in self._panels.begun.values():
            panel.declare(self._rec)

    def log(self, rows: Rows) -> None:
        """Log rows to the panels that draw them."""
        for panel, begins in self._panels.take(rows):
            if begins:
                panel.declare(self._rec)
            panel.log(self._rec, rows)
            ends = panel.ends(rows)
            if ends is not None:
                last = np.array([len(rows.columns[panel.columns[0]]) - 1])
                self._extents.set(panel.drawn, ends, rows.kept(last))

    def log_cards(self, newest: Rows) -> None:
        """Write the present values of every tab at the time of the newest row, when it is time."""
        now = 0 if newest.clock is None else int(newest.clock[0])
        if self._written_ns is not None and 0 <= now - self._written_ns < self._step_ns:
            return
        self._written_ns = now
        values = self._panels.cards.take()
        for place, readings in self.readings().items():
            log_markdown(self._rec, card_path(place), [card(readings, values)], newest)

    def readings(self) -> dict[str, list[Reading]]:
        """Return what the card of each tab shows: that of the first tab everything."""
        found: dict[str, list[Reading]] = {}
        for panel in self.shown:
            if readings := self._panels.readings[panel.key]:
                for place in dict.fromkeys((FIRST, tab_of(panel.place))):
                    found.setdefault(place, []).extend(readings)
        return found

    def end_file(self) -> None:
        """Log how far the axes of a recording reach at its end."""
        self._extents.finish()


def card_path(place: str) -> str:
    """Return the entity of a tab's card."""
    return f"/cards/{rr.escape_entity_path_part(place)}"
