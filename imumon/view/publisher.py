"""The live view as the measuring process sees it: publish and go on."""

from __future__ import annotations

import pickle
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.view.fed import PROTOCOL, FedProcess
from imumon.view.frames import Batch, Message, ReplayRequest, Report, Start
from imumon.view.items import Drawing, Shown, ViewSetup, lasting_key, merge
from imumon.view.viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode

HISTORY_BYTES = 64 << 20
HISTORY_S = 120.0


@dataclass(frozen=True, slots=True)
class ViewState:
    """How the live view is, for the status line."""

    text: str
    connected: bool
    dropped: int
    restarts: int

    def __str__(self) -> str:
        """Return one phrase."""
        return f"{self.text}, {self.dropped} dropped" if self.dropped else self.text


@dataclass(frozen=True, slots=True)
class Sent:
    """A batch as it was sent, when, and what of it does not age."""

    at_s: float
    number: int
    frame: bytes
    lasting: Mapping[str, Shown]


class History:
    """The latest batches, for a viewer that has not seen them, bounded in time and bytes.

    They are kept as they were sent: as arrays they are ten thousand small pieces a minute, which leave holes
    in the memory when they go.  States and the status card do not age: of those in batches that had to go,
    the latest of each stay.  Of a chart the latest is kept and no other.
    """

    def __init__(self, max_bytes: int, max_s: float) -> None:
        self._max_bytes, self._max_s = max_bytes, max_s
        self._sent: deque[Sent] = deque()
        self._bytes = 0
        self._lasting: dict[str, Shown] = {}
        self._charts: dict[str, Drawing] = {}

    def add(self, batch: Batch, now: float) -> list[bytes]:
        """Append a batch; forget the oldest ones when that is too much.  Return the frames to send."""
        charts = {item.chart.key: item for item in batch.items if isinstance(item, Drawing)}
        rest = [item for item in batch.items if not isinstance(item, Drawing)]
        self._charts |= charts
        frame = pickle.dumps(replace(batch, items=rest), PROTOCOL)
        lasting = {key: item for item in rest if (key := lasting_key(item)) is not None}
        self._sent.append(Sent(now, batch.number, frame, lasting))
        self._bytes += len(frame)
        while self._bytes > self._max_bytes or self._sent[0].at_s < now - self._max_s:
            old = self._sent.popleft()
            self._bytes -= len(old.frame)
            self._lasting |= old.lasting
        if not charts:
            return [frame]
        return [frame, pickle.dumps(replace(batch, items=list(charts.values())), PROTOCOL)]

    def after(self, number: int) -> list[Shown]:
        """Return all items of batches after this one, joined, the lasting ones of before first."""
        batches = (pickle.loads(sent.frame) for sent in self._sent if sent.number > number)
        items = [item for batch in batches for item in batch.items]
        return [*self._lasting.values(), *merge(items), *self._charts.values()]


class ViewPublisher(FedProcess):
    """Feeds a process that shows the live view; nothing that happens there delays the caller.

    Parameters
    ----------
    mode : "native" or "web"
        A native window, or a server that browsers open.
    setup : ViewSetup
        Title, recording, units, frame, window.
    port, web_port : int
        Ports to begin with; when another program has them, the next free ones are taken.
    bind : str
        Address that the web viewer's servers bind to.
    """

    def __init__(
        self,
        mode: Mode,
        setup: ViewSetup,
        *,
        port: int = VIEWER_PORT,
        web_port: int = WEB_PORT,
        bind: str = LOCALHOST,
    ) -> None:
        super().__init__("imumon.view.child")
        self._start = Start(setup, mode, port, web_port, bind)
        self._history = History(HISTORY_BYTES, HISTORY_S)
        self._number = 0
        self._report = Report("view starts", False, port, web_port, "")
        self._request: ReplayRequest | None = None

    def start(self) -> ViewPublisher:
        """Start the view process and return at once."""
        self._supervisor.start()
        return self

    @property
    def state(self) -> ViewState:
        """How the view is now."""
        report = self._report
        return ViewState(report.text, report.connected, self._queue.dropped, self._restarts)

    @property
    def url(self) -> str:
        """What to open: the page in a browser (web), the stream (native); empty until it is known."""
        return self._report.url

    def _first(self) -> Start:
        return self._start

    def _frames(self, items: Sequence[Shown]) -> list[bytes]:
        """Return the next batch, or all that the process asks for again."""
        frames: list[bytes] = []
        if items:
            self._number += 1
            frames = self._history.add(Batch(self._number, items), time.monotonic())
        request, self._request = self._request, None
        if request is not None:
            again = Batch(self._number, self._history.after(request.after), request.request)
            frames = [pickle.dumps(again, PROTOCOL)]
        return frames

    def _received(self, message: Message) -> None:
        """Start a later view process on the same ports, and do not open a second window."""
        if isinstance(message, ReplayRequest):
            self._request = message
            return
        start, self._report = self._start, message
        if message.port:
            self._start = replace(
                start,
                port=message.port,
                web_port=message.web_port or start.web_port,
                open_viewer=start.open_viewer and not message.connected,
            )

    def _gone(self) -> None:
        self._request = None
        if not self._queue.is_closed():
            text = "view restarts" if self._report.port else self._report.text
            self._report = replace(self._report, text=text, connected=False)
