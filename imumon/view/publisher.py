"""The live view as the measuring process sees it: publish and go on."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from .fed import BATCH_S, FedProcess
from .items import ViewItem, ViewSetup
from .viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode

WEB_BATCH_S, WEB_STEP_NS = 1.0, 20_000_000
"""A browser that joins late takes in what the server keeps, and hangs where that is much.  So a page gets
fewer, larger messages, and of 20 ms the extremes: at 1 kHz 13 min are kept instead of five."""


class Start(NamedTuple):
    """The first message to a view process: what to show and where; then come lists of items."""

    setup: ViewSetup
    mode: Mode
    port: int  # of the native viewer, or of the page
    bind: str
    open_viewer: bool = True  # whether a native viewer is opened where none is open; False after a restart
    lasting: Sequence[ViewItem] = ()  # states and charts so far


class Report(NamedTuple):
    """What a view process reports: a phrase; once it serves, what to open and the port of page or viewer."""

    text: str
    url: str = ""
    port: int = 0


class ViewPublisher(FedProcess):
    """Feeds a process that shows the live view; nothing that happens there delays the caller.

    Where another program has the `port` of the viewer, or of the page, the next free one is taken.  The page
    is on the address `bind`.
    """

    def __init__(
        self,
        mode: Mode,
        setup: ViewSetup,
        *,
        port: int | None = None,
        bind: str = LOCALHOST,
        module: str = "imumon.view.child",
    ) -> None:
        super().__init__(module, WEB_BATCH_S if mode == "web" else BATCH_S)
        setup = setup._replace(step_ns=WEB_STEP_NS * (mode == "web"))
        self._start = Start(setup, mode, port or (WEB_PORT if mode == "web" else VIEWER_PORT), bind)
        self._report = Report("view starts")
        self._announced = ""

    @property
    def text(self) -> str:
        """How the view is now, in one phrase."""
        return f"{self._report.text}, {self.dropped} dropped" if self.dropped else self._report.text

    @property
    def url(self) -> str:
        """What to open: the page in a browser (web), the stream (native); empty until it is known."""
        return self._report.url

    def announce(self, log: Callable[[str, str], None]) -> None:
        """Log where the view is, as soon as it is known and when it changes."""
        if self.url not in ("", self._announced):
            self._announced = self.url
            log("INFO", f"live view: {self.url}")

    def _first(self) -> Start:
        return self._start._replace(lasting=self._queue.lasting)

    def _received(self, report: Report) -> None:
        """Keep what a later view process needs: the same port, and no second window."""
        self._report = report
        if report.url:
            self._start = self._start._replace(open_viewer=False, port=report.port)

    def _gone(self) -> None:
        if not self._queue.closed.is_set():
            self._report = Report("view restarts" if self._report.url else self._report.text)
