"""What the measuring process and a publishing process say to each other over two pipes, pickled."""

from __future__ import annotations

from dataclasses import dataclass

from imumon.publishing.target import Target
from imumon.view.items import ViewSetup


@dataclass(frozen=True, slots=True)
class Begin:
    """The first frame; those that follow are lists of view items."""

    target: Target
    setup: ViewSetup


@dataclass(frozen=True, slots=True)
class Delivery:
    """How it goes, in a phrase; how many rows and events were taken so far, and how many did not leave."""

    text: str
    taken: int = 0
    failed: int = 0
    ready: bool = True
    """Whether the receiver can be reached, as far as is known."""
