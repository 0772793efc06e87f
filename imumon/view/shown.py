"""Which panels have had data, and what their cards show: the same for the viewer and for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from imumon.view.items import ViewSetup
from imumon.view.layout import SCENE, Panel, Rows
from imumon.view.panels import PANELS


class ShownPanels:
    """The panels that have had a value in each of their columns.

    Parameters
    ----------
    setup : ViewSetup
        Units.
    """

    def __init__(self, setup: ViewSetup) -> None:
        self.readings = {panel.key: panel.readings(setup) for panel in PANELS}
        """What the card shows of each panel, by its key."""
        self.begun: dict[str, Panel] = {}
        """Those that have had data, in the order in which they began."""
        self._drawing: dict[tuple[str, ...], tuple[Panel, ...]] = {}

    @property
    def in_order(self) -> tuple[Panel, ...]:
        """Those that have had data, in the order in which they stand."""
        return tuple(panel for panel in PANELS if panel.key in self.begun)

    def drawing(self, rows: Rows) -> Iterator[Panel]:
        """Yield the panels of which all columns are there, whether they have a value or not."""
        names = tuple(rows.columns)
        if names not in self._drawing:  # the columns of a stream hardly ever change
            there = set(names)
            self._drawing[names] = tuple(panel for panel in PANELS if there.issuperset(panel.columns))
        return iter(self._drawing[names])

    def begins(self, panel: Panel, rows: Rows) -> bool:
        """Take a new panel up when it has something to say; only one body can turn."""
        if panel.key in self.begun:
            return False
        if not panel.says(rows):
            return False
        if panel.place == SCENE and any(other.place == SCENE for other in self.begun.values()):
            return False
        self.begun[panel.key] = panel
        return True
