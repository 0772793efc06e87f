"""Logs rows to the panels that draw their columns, with the axis that each needs and the cards of numbers."""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.view.cards import Cards, Reading, card
from imumon.view.extent import FEW_MARKS, FEWEST_MARKS, Extent, entity
from imumon.view.items import ViewSetup
from imumon.view.layout import FIRST, LINK, Panel, Rows, tab_of
from imumon.view.shown import ShownPanels

HIGH_STRIPS = 2
"""With more in a tab each is too low for numbers at all marks of its axis."""
LIVE_CARD_NS, RECORDED_CARD_NS = 500_000_000, 10_000_000_000
"""How often the cards are written: a person cannot read faster; in a recording each costs 2 kB."""


class PanelLog:
    """The panels that have had data, in the order in which they stand.

    Parameters
    ----------
    rec : RecordingStream
    setup : ViewSetup
    live : bool
        Whether a person is watching.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        self._rec = rec
        self._step_ns = LIVE_CARD_NS if live else RECORDED_CARD_NS
        self._panels = ShownPanels(setup)
        self._extents: dict[str, Extent] = {}
        self._cards = Cards()
        self._written_ns: int | None = None

    @property
    def shown(self) -> tuple[Panel, ...]:
        """The panels that have data."""
        return self._panels.in_order

    def declare(self) -> None:
        """Log what does not change, for a new reader."""
        for panel in self._panels.begun.values():
            panel.declare(self._rec)

    def log(self, rows: Rows) -> set[str]:
        """Log rows; return the columns that panels draw."""
        claimed: set[str] = set()
        for panel in self._panels.drawing(rows):
            claimed.update(panel.columns)
            if self._panels.begins(panel, rows):
                panel.declare(self._rec)
            if panel.key in self._panels.begun:
                panel.log(self._rec, rows)
                self._log_extent(panel, rows)
                self._cards.add(self._panels.readings[panel.key], rows.columns)
        return claimed

    def log_cards(self, newest: Rows) -> None:
        """Write the present values of every tab at the time of the newest row, when it is time."""
        clock = newest.clock
        now = 0 if clock is None else int(clock[0])
        if self._written_ns is not None and 0 <= now - self._written_ns < self._step_ns:
            return
        self._written_ns = now
        values = self._cards.take()
        for place, readings in self.readings().items():
            text = rr.TextDocument.columns(text=[card(readings, values)], media_type=["text/markdown"])
            self._rec.send_columns(card_path(place), indexes=newest.indexes, columns=text)

    def readings(self) -> dict[str, list[Reading]]:
        """Return what the card of each tab shows: that of the first tab everything."""
        found: dict[str, list[Reading]] = {}
        for panel in self.shown:
            readings = self._panels.readings[panel.key]
            for place in dict.fromkeys((FIRST, tab_of(panel.place))):
                if readings:
                    found.setdefault(place, []).extend(readings)
        return found

    def _log_extent(self, panel: Panel, rows: Rows) -> None:
        reach = panel.reach(rows)
        if reach is None:
            return
        neighbours = sum(other.place == panel.place for other in self._panels.begun.values())
        known = self._extents.setdefault(panel.key, Extent())
        crowded = FEW_MARKS if neighbours > HIGH_STRIPS else None
        ends = known.ends(rows.clock, reach, FEWEST_MARKS if panel.place == LINK else crowded)
        if ends is not None:
            indexes = rows.kept(np.array([len(reach.values) - 1])).indexes
            scalars = rr.Scalars.columns(scalars=np.array([ends]))
            self._rec.send_columns(entity(panel.drawn), indexes=indexes, columns=scalars)


def card_path(place: str) -> str:
    """Return the entity of a tab's card."""
    return f"/cards/{rr.escape_entity_path_part(place)}"
