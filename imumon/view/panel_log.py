"""Logs rows to the panels that draw their columns, with axes and cards of numbers; other columns by unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from imumon.blocks import ColumnArray
from imumon.charts import AXIS_COLORS, BLUE, GREEN, RED
from imumon.view.cards import Cards, Reading, card
from imumon.view.items import ViewSetup
from imumon.view.layout import FIRST, SCENE, read_as, tab_of
from imumon.view.panels import PANELS, Panel
from imumon.view.rows import Rows, log_markdown
from imumon.view.window import Extents

LIVE_CARD_NS, RECORDED_CARD_NS = 500_000_000, 10_000_000_000
"""How often the cards are written: a person cannot read faster; in a recording each costs 2 kB."""

OTHER, CONVERTED = "/samples/other", "/view/other"
"""Entities of columns that are read in their own unit, and in another."""
PART_COLORS = {**AXIS_COLORS, "roll": RED, "pitch": GREEN, "yaw": BLUE}
"""Colour of a column by how its name ends."""


class ShownPanels:
    """The panels that have had a value in each column, and their numbers: for viewer and terminal."""

    def __init__(self, setup: ViewSetup) -> None:
        self.readings = {panel.key: panel.readings(setup) for panel in PANELS}
        """What the card shows of each panel, by its key."""
        self.begun: dict[str, Panel] = {}
        """Those that have had data, in the order in which they began."""
        self.cards = Cards()

    def take(self, rows: Rows) -> Iterator[tuple[Panel, bool]]:
        """Yield the panels that draw these rows, and whether they begin; only one body can turn."""
        for panel in drawing(rows):
            turns = panel.place == SCENE and any(other.place == SCENE for other in self.begun.values())
            begins = panel.key not in self.begun and not turns and panel.has_values(rows)
            if begins:
                self.begun[panel.key] = panel
            if panel.key in self.begun:
                self.cards.add(self.readings[panel.key], rows.columns)
                yield panel, begins


def drawing(rows: Rows) -> list[Panel]:
    """Return the panels of which all columns are there, whether they have a value or not."""
    return [panel for panel in PANELS if rows.columns.keys() >= set(panel.columns)]


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
        return tuple(panel for panel in PANELS if panel.key in self._panels.begun)

    def declare(self) -> None:
        """Log what does not change, for a new file."""
        for panel in self._panels.begun.values():
            panel.declare(self._rec)

    def log(self, rows: Rows) -> set[str]:
        """Log rows; return the columns that panels draw."""
        for panel, begins in self._panels.take(rows):
            if begins:
                panel.declare(self._rec)
            panel.log(self._rec, rows)
            ends = panel.ends(rows)
            if ends is not None:
                last = np.array([len(rows.columns[panel.columns[0]]) - 1])
                self._extents.set(panel.drawn, ends, rows.kept(last))
        return {name for panel in drawing(rows) for name in panel.columns}

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


class Others:
    """Logs float columns that no panel draws, each to an entity, once one of their values is not zero."""

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup) -> None:
        self._rec, self._setup = rec, setup
        self._names: set[str] = set()

    @property
    def views(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """A title and the entities of each view; that of one column names it."""
        found: dict[tuple[str, str], list[str]] = {}
        for name in sorted(self._names):
            found.setdefault((name.rpartition("/")[0], self._read_as(name)[0]), []).append(name)
        views = []
        for (stream, unit), names in found.items():
            title = f"{stream}: {unit or 'no unit'}" if stream else unit or "no unit"
            if len(names) == 1:
                title = f"{names[0]} [{unit}]" if unit else names[0]
            views.append((title, tuple(map(self._drawn, names))))
        return tuple(views)

    def declare(self) -> None:
        """Log what does not change, for a new file."""
        for name in self._names:
            self._declare(name)

    def log(self, name: str, values: ColumnArray, rows: Rows) -> None:
        """Log a column; its stream, if any, stands before its name and a slash."""
        numbers = np.asarray(values, np.float64)
        if name not in self._names:
            if not np.any(np.isfinite(numbers) & (numbers != 0.0)):
                return
            self._names.add(name)
            self._declare(name)
        kept = rows.extremes(numbers[:, np.newaxis]) & np.isfinite(numbers)
        if kept.any():
            _, factor = self._read_as(name)
            rows.kept(kept).send(self._rec, self._drawn(name), factor * numbers[kept])

    def _read_as(self, name: str) -> tuple[str, float]:
        return read_as(self._setup, name.replace("/", "_"))

    def _drawn(self, name: str) -> str:
        """Return the entity of a column, by whether it is drawn in its own unit."""
        return f"{OTHER if self._read_as(name)[1] == 1.0 else CONVERTED}/{name}"

    def _declare(self, name: str) -> None:
        color = PART_COLORS.get(name.rpartition("_")[2])
        look = rr.SeriesLines(names=[name], colors=None if color is None else [list(color)])
        self._rec.log(self._drawn(name), look, static=True)
