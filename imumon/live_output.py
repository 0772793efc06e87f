"""What a wing may add to `imumon monitor`: an option that sends what is recorded elsewhere, too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from imumon.view.items import ViewItem, ViewSetup


class Running(Protocol):
    """An output while a command runs."""

    @property
    def publish(self) -> list[Callable[[ViewItem], None]]:
        """Where view items go."""

    @property
    def text(self) -> str:
        """What a status line says of it; empty when there is nothing to say."""

    @property
    def as_data(self) -> dict[str, object]:
        """What the command says with --json."""

    @property
    def rows(self) -> dict[str, str]:
        """What the summary says."""

    def announce(self, tell: Callable[[str, str], None]) -> None:
        """Say how it goes, when that changes."""

    def close(self) -> None:
        """Send what is left, and end."""


class LiveOutput(Protocol):
    """An option of `imumon monitor`."""

    name: str
    """Of the parameter that the option makes."""
    option: Any
    """Decorator of click that adds the option to a command."""

    def parse(self, given: Any) -> Sequence[Any]:
        """Return what the option asks for; raises BAD_CONFIG where it is wrong."""

    def start(self, parsed: Sequence[Any], setup: ViewSetup) -> Running:
        """Begin to send."""
