"""Logs rows to the panels that draw their columns, with the axis that each needs and the cards of numbers."""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.view.axes import Axes
from imumon.view.cards import Cards, Reading, card
from imumon.view.extent import Extent
from imumon.view.items import ViewSetup
from imumon.view.layout import FIRST, Panel, Rows, log_markdown, tab_of
from imumon.view.shown import ShownPanels
from imumon.view.window import slow_window

LIVE_CARD_NS, RECORDED_CARD_NS = 500_000_000, 10_000_000_000
"""How often the cards are written: a person cannot read faster; in a recording each costs 2 kB."""


class PanelLog:
    """The panels that have had data, in the order in which they stand.

    Parameters
    ----------
    live : bool
        Whether a person is watching.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, axes: Axes, *, live: bool) -> None:
        self._rec, self._setup, self._axes, self._live = rec, setup, axes, live
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
            panel.declare(self._rec, live=self._live)

    def log(self, rows: Rows) -> set[str]:
        """Log rows; return the columns that panels draw."""
        claimed: set[str] = set()
        for panel in self._panels.drawing(rows):
            claimed.update(panel.columns)
            if self._panels.begins(panel, rows):
                panel.declare(self._rec, live=self._live)
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
            log_markdown(self._rec, card_path(place), [card(readings, values)], newest)

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
        extent = self._extents.setdefault(panel.key, Extent(self._window_s(panel)))
        ends = extent.ends(rows.clock, reach)
        if ends is not None:
            self._axes.set(panel.drawn, ends, rows.kept(np.array([len(reach.values) - 1])))

    def _window_s(self, panel: Panel) -> float | None:
        first = tab_of(panel.place) == FIRST
        shown = self._setup.window_s if first else slow_window(self._setup.window_s)
        return shown if self._live else None


def card_path(place: str) -> str:
    """Return the entity of a tab's card."""
    return f"/cards/{rr.escape_entity_path_part(place)}"
