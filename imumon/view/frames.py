"""What the measuring process and the view process say to each other over two pipes, pickled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imumon.view.items import Shown, ViewSetup
from imumon.view.viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode


@dataclass(frozen=True, slots=True)
class Start:
    """The first frame: what to show and where."""

    setup: ViewSetup
    mode: Mode
    port: int = VIEWER_PORT
    web_port: int = WEB_PORT
    bind: str = LOCALHOST
    open_viewer: bool = True
    """Whether a native viewer may be started; False after a restart, so that a viewer that the user closed
    stays closed."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Items, numbered by the batch that they came in; the answer to a `ReplayRequest` bears its number."""

    number: int
    items: Sequence[Shown]
    answers: int | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """What the view process says of itself."""

    text: str
    """One phrase for the status line."""
    connected: bool
    """Whether the items reach a viewer, or a server that viewers can open."""
    port: int
    web_port: int
    """Ports in use."""
    url: str
    """What to open in a browser, or where the stream is."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Please send all batches after `after` again, as one that answers `request`."""

    request: int
    after: int


Message = Report | ReplayRequest
"""What the view process sends."""
