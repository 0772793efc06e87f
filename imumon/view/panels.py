"""The panels of the live view, as `panels.yaml` lists them, and what logs rows, axes and cards to them."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from pydantic import RootModel

from imumon.charts import AXIS_COLORS, BLUE, COLOR_NAMES, GREEN, RED
from imumon.config import load_yaml

from .cards import Cards, Reading, card
from .items import ViewSetup
from .layout import FIRST, OTHER, SCENE, Attitude, Bands, Line, Strip, read_as, tab_of
from .rows import Rows, log_markdown
from .window import Extents

Panel = Strip | Attitude

COLORS = AXIS_COLORS | {name: color for color, name in COLOR_NAMES.items()}
"""By their names in the file, where an axis stands for its colour."""
AXIS = "<axis>"


def _strips() -> Iterator[Strip]:
    """Yield the panels of the file, those of a key for each axis after each other."""
    entries = load_yaml(Path(__file__).with_suffix(".yaml"), RootModel[dict[str, Any]])
    for key, entry in entries.root.items():
        for axis in AXIS_COLORS if AXIS in key else ("",):
            yield _strip(key.replace(AXIS, axis), **json.loads(json.dumps(entry).replace(AXIS, axis)))


def _strip(
    key: str,
    lines: Mapping[str, str],
    *,
    band: bool = False,
    sd: str | None = None,
    limits: Sequence[float] = (),
    **fields: Any,
) -> Strip:
    drawn = tuple(
        _line(column.format(axis), shown.format(axis, axis), sd)
        for column, shown in lines.items()
        for axis in (AXIS_COLORS if "{}" in column else ("",))
    )
    return (Bands if band else Strip)(key, lines=drawn, limits=tuple(limits), **fields)


def _line(column: str, shown: str, sd: str | None) -> Line:
    color, _, name = shown.partition(" ")
    quantity, _, axis = column.rpartition("_")
    own = f"{quantity}_sd_{axis}" if axis in AXIS_COLORS else f"{column}_sd"
    return Line(column, name, COLORS[color], own if sd == "own" else sd)


PANELS: tuple[Panel, ...] = (
    Attitude("attitude", ("q_w", "q_x", "q_y", "q_z")),
    Attitude("attitude_from_angles", ("roll", "pitch", "yaw")),
    Attitude(
        "attitude_estimate",
        tuple(f"attitude_estimate_{part}" for part in "wxyz"),
        root="/attitude_estimate",
        title="Attitude by the estimator",
        axes=("east", "north", "up"),
        up=1.0,
    ),
    *_strips(),
)
"""All panels, in the order in which they stand.  The attitude that comes first turns the body."""

LIVE_CARD_NS, RECORDED_CARD_NS = 500_000_000, 10_000_000_000
"""How often the cards are written: a person cannot read faster; in a recording each costs 2 kB."""

PART_COLORS = {**AXIS_COLORS, "roll": RED, "pitch": GREEN, "yaw": BLUE}
"""Colour of a column by how its name ends."""


class ShownPanels:
    """The panels that have had a value in each column, and their numbers: for viewer and terminal."""

    def __init__(self, setup: ViewSetup) -> None:
        self._setup = setup
        self.begun: dict[str, Panel] = {}  # those that have had data, in the order in which they began
        self.readings: dict[str, Sequence[Reading]] = {}  # what the card shows of each
        self.cards = Cards()

    def take(self, rows: Rows) -> list[tuple[Panel, bool]]:
        """Return the panels that draw these rows, and whether they begin; only one body can turn."""
        found = []
        for panel in self._drawing(rows):
            turns = panel.place == SCENE and any(other.place == SCENE for other in self.begun.values())
            begins = panel.key not in self.begun and not turns and panel.has_values(rows)
            if begins:
                self.begun[panel.key] = panel
                self.readings[panel.key] = panel.readings(self._setup) if isinstance(panel, Strip) else ()
            if panel.key in self.begun:
                self.cards.add(self.readings[panel.key], rows.columns)
                found.append((panel, begins))
        return found

    def _drawing(self, rows: Rows) -> Iterator[Panel]:
        """Yield the panels of which all columns are there, and a strip for each other column of floats."""
        claimed: set[str] = set()
        for panel in PANELS:
            if rows.columns.keys() >= set(panel.columns):
                claimed.update(panel.columns)
                yield panel
        for column, values in rows.columns.items():
            if values.dtype == np.float64 and column not in claimed:
                name = f"{rows.stream}/{column.removeprefix(f'{rows.stream}_')}" if rows.stream else column
                unit, factor = read_as(self._setup, column)
                line = Line(column, name, PART_COLORS.get(name.rpartition("_")[2]))
                drawn = unit if factor != 1.0 else None
                yield Strip(f"other/{name}", name, (line,), drawn, OTHER, silent=0.0)


def draw(rec: rr.RecordingStream, panel: Panel, rows: Rows, extents: Extents, *, begins: bool) -> None:
    """Log rows to a panel, and how far its axis must reach."""
    if begins:
        panel.declare(rec)
    panel.log(rec, rows)
    if isinstance(panel, Strip) and (ends := panel.ends(rows)) is not None:
        last = np.array([len(rows.columns[panel.columns[0]]) - 1])
        extents.set(panel.drawn, ends, rows.kept(last))


class PanelLog(ShownPanels):
    """Logs the panels that have had data."""

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        super().__init__(setup)
        self._rec = rec
        self._step_ns = LIVE_CARD_NS if live else RECORDED_CARD_NS
        self._extents = Extents(rec, live=live)
        self.end_file = self._extents.finish  # logs how far the axes of a recording reach at its end
        self._written_ns = -self._step_ns  # so that the first comes at once

    @property
    def shown(self) -> tuple[Panel, ...]:
        """The panels that have data, in the order in which they stand."""
        others = (panel for panel in self.begun.values() if panel.place == OTHER)
        listed = (panel for panel in PANELS if panel.key in self.begun)
        return (*listed, *sorted(others, key=lambda panel: panel.key))

    def declare(self) -> None:
        """Log what does not change, for a new file."""
        for panel in self.begun.values():
            panel.declare(self._rec)

    def log(self, rows: Rows) -> None:
        """Log rows to the panels that draw them."""
        for panel, begins in self.take(rows):
            draw(self._rec, panel, rows, self._extents, begins=begins)

    def log_cards(self, newest: Rows) -> None:
        """Write the present values of every tab at the time of the newest row, when it is time."""
        now = 0 if newest.clock is None else int(newest.clock[0])
        if 0 <= now - self._written_ns < self._step_ns:
            return
        self._written_ns = now
        values, found = self.cards.take(), dict[str, list[Reading]]()
        for panel in self.shown:
            for place in {FIRST, tab_of(panel.place)}:  # the card of the first tab has all
                found.setdefault(place, []).extend(self.readings[panel.key])
        for place, readings in found.items():
            if readings:
                log_markdown(self._rec, card_path(place), [card(readings, values)], newest)


def card_path(place: str) -> str:
    """Return the entity of a tab's card."""
    return f"/cards/{rr.escape_entity_path_part(place)}"
