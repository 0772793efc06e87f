"""What the shared view of a rack is told."""

from __future__ import annotations

from dataclasses import dataclass

from imumon.view.items import Event, ViewItem, ViewSetup


@dataclass(frozen=True, slots=True)
class OfUnit(ViewItem):
    """What is told of one unit; the title of the setup is its name."""

    setup: ViewSetup
    item: ViewItem

    @property
    def nbytes(self) -> int:
        """Bytes of the item."""
        return self.item.nbytes

    @property
    def rows(self) -> int:
        """Rows of the item."""
        return self.item.rows

    @property
    def lasting(self) -> str | None:
        """What the item replaces, of this unit."""
        key = self.item.lasting
        return None if key is None else f"{self.setup.title}: {key}"


@dataclass(frozen=True, slots=True)
class Overview(Event):
    """All units at a glance, as Markdown, and their names in order."""

    markdown: str
    units: tuple[str, ...]

    @property
    def lasting(self) -> str:
        """There is one page."""
        return "overview"
