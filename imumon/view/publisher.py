"""The live view as the measuring process sees it: publish and go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from imumon.view.fed import FedProcess
from imumon.view.items import ViewItem, ViewSetup
from imumon.view.viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode


@dataclass(frozen=True, slots=True)
class Start:
    """The first message to a view process: what to show and where; then come lists of items."""

    setup: ViewSetup
    mode: Mode
    port: int
    """Of the native viewer, or of the page."""
    bind: str
    open_viewer: bool = True
    """Whether a native viewer is opened where none is open; False after a restart."""
    lasting: Sequence[ViewItem] = ()
    """States and charts that an earlier process has shown."""


@dataclass(frozen=True, slots=True)
class Report:
    """What a view process reports: a phrase; once it serves, what to open and the port of page or viewer.

    `dropped` and `restarts` are counted by who feeds it.
    """

    text: str
    url: str = ""
    port: int = 0
    dropped: int = 0
    restarts: int = 0

    def __str__(self) -> str:
        """Return one phrase, for the status line."""
        return f"{self.text}, {self.dropped} dropped" if self.dropped else self.text


class ViewPublisher(FedProcess):
    """Feeds a process that shows the live view; nothing that happens there delays the caller.

    Where another program has the port of the viewer or `web_port` of the page, the next free one is taken.
    The page is on the address `bind`.
    """

    def __init__(
        self,
        mode: Mode,
        setup: ViewSetup,
        *,
        port: int = VIEWER_PORT,
        web_port: int = WEB_PORT,
        bind: str = LOCALHOST,
        module: str = "imumon.view.child",
    ) -> None:
        super().__init__(module)
        self._start = Start(setup, mode, web_port if mode == "web" else port, bind)
        self._lasting: dict[str, ViewItem] = {}
        self._report = Report("view starts")

    @property
    def state(self) -> Report:
        """How the view is now."""
        return replace(self._report, dropped=self._queue.dropped, restarts=self._restarts)

    @property
    def url(self) -> str:
        """What to open: the page in a browser (web), the stream (native); empty until it is known."""
        return self._report.url

    def _first(self) -> Start:
        return replace(self._start, lasting=list(self._lasting.values()))

    def _handed(self, items: Sequence[ViewItem]) -> None:
        self._lasting |= {item.lasting: item for item in items if item.lasting is not None}

    def _received(self, report: Report) -> None:
        """Keep what a later view process needs: the same port, and no second window."""
        self._report = report
        if report.url:
            self._start = replace(self._start, open_viewer=False, port=report.port)

    def _gone(self) -> None:
        if not self._queue.closed.is_set():
            self._report = Report("view restarts" if self._report.url else self._report.text)
