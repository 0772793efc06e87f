"""The live view as the measuring process sees it: publish and go on."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from imumon.view.frames import Batch, ReplayRequest, Report, Start
from imumon.view.items import Drawing, Shown, ViewSetup, lasting_key, merge
from imumon.view.queue import DropOldestQueue
from imumon.view.viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode, quiet_environment

BATCH_S = 0.05
"""Batches are sent as they come, and so far apart: what comes faster, as in a replay, is joined."""
PROTOCOL = 5
"""Of pickle, which writes arrays as they are from here on."""
QUEUE_BYTES = 32 << 20
HISTORY_BYTES = 64 << 20
HISTORY_S = 120.0
BACKOFF_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
STEADY_S = 30.0
"""A view process that lived this long is started again without delay."""
STUCK_S = 30.0
"""A view process that does not take a frame in this time is killed and started again.  (A server whose
browser hangs stalls for 16 s and then goes on.)"""
LOOK_S = 0.5
"""How often it is looked whether it does."""
GOODBYE_S = 1.0


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


class ViewPublisher:
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
        self._start = Start(setup, mode, port, web_port, bind)
        self._queue: DropOldestQueue[Shown] = DropOldestQueue(QUEUE_BYTES)
        self._history = History(HISTORY_BYTES, HISTORY_S)
        self._number = 0
        self._sending_s = math.inf  # since when
        self._restarts = 0
        self._report = Report("view starts", False, port, web_port, "")
        self._request: ReplayRequest | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._supervisor = threading.Thread(target=self._supervise, name="view publisher", daemon=True)

    def start(self) -> ViewPublisher:
        """Start the view process and return at once."""
        self._supervisor.start()
        return self

    def publish(self, item: Shown) -> None:
        """Queue an item; takes microseconds, whatever state the view is in."""
        self._queue.put(item)

    @property
    def state(self) -> ViewState:
        """How the view is now."""
        report = self._report
        return ViewState(report.text, report.connected, self._queue.dropped, self._restarts)

    @property
    def url(self) -> str:
        """What to open: the page in a browser (web), the stream (native); empty until it is known."""
        return self._report.url

    def close(self, timeout_s: float = 1.5) -> None:
        """Send what is left and end the view process, within `timeout_s` whatever its state.

        The web viewer's servers end with it.  A native window stays open, so that one can go on looking.
        """
        deadline = time.monotonic() + timeout_s
        self._queue.close()
        self._supervisor.join(max(0.0, timeout_s - 0.3))
        process = self._process
        if process is not None and process.poll() is None:
            _kill(process)
        self._supervisor.join(max(0.1, deadline - time.monotonic()))

    def _supervise(self) -> None:
        """Keep a view process alive and supplied until closed."""
        failures = 0
        while True:
            started = time.monotonic()
            self._run_process()
            if self._queue.is_closed():
                return
            failures = 0 if time.monotonic() - started > STEADY_S else failures + 1
            self._restarts += 1
            self._wait(BACKOFF_S[min(failures, len(BACKOFF_S) - 1)])
            if self._queue.is_closed():
                return

    def _wait(self, pause_s: float) -> None:
        """Let time pass while the queue keeps emptying into the history."""
        end = time.monotonic() + pause_s
        while (left := end - time.monotonic()) > 0 and not self._queue.is_closed():
            self._next_batch(wait_s=left)

    def _run_process(self) -> None:
        """Run one view process from its start to its end."""
        stdin, to_process = Pipe(duplex=False)
        from_process, stdout = Pipe(duplex=False)
        with stdin, stdout:
            process = subprocess.Popen(
                [sys.executable, "-m", "imumon.view.child"],
                stdin=stdin.fileno(),
                stdout=stdout.fileno(),
                stderr=subprocess.DEVNULL,
                env=quiet_environment(),
                start_new_session=True,  # Ctrl-C is for the measuring process, which then closes this one
            )
        self._process = process
        self._request = None
        listener = threading.Thread(
            target=self._listen, args=[from_process, process], name="view reports", daemon=True
        )
        listener.start()
        try:
            with to_process:
                self._feed(process, to_process)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GOODBYE_S)
        finally:
            _kill(process)
            process.wait()
            listener.join()
            from_process.close()
        if not self._queue.is_closed():
            text = "view restarts" if self._report.port else self._report.text
            self._report = replace(self._report, text=text, connected=False)

    def _feed(self, process: subprocess.Popen[bytes], pipe: Connection) -> None:
        """Send frames until the process is gone or everything is sent and the queue closed."""
        sent = self._send(pipe, [pickle.dumps(self._start, PROTOCOL)])
        closing = False
        while sent and not closing and process.poll() is None:
            closing = self._queue.is_closed()
            frames = self._next_batch(wait_s=0.25)
            request, self._request = self._request, None
            if request is not None:
                again = Batch(self._number, self._history.after(request.after), request.request)
                frames = [pickle.dumps(again, PROTOCOL)]
            sent = self._send(pipe, frames)

    def _next_batch(self, wait_s: float) -> list[bytes]:
        """Return the frames of the next batch; none when nothing came."""
        items = merge(self._queue.take(BATCH_S, wait_s))
        if not items:
            return []
        self._number += 1
        return self._history.add(Batch(self._number, items), time.monotonic())

    def _send(self, pipe: Connection, frames: list[bytes]) -> bool:
        """Send frames; False when the process is gone, maybe since it was killed for taking nothing."""
        try:
            for frame in frames:
                self._sending_s = time.monotonic()
                pipe.send_bytes(frame)
        except OSError:
            return False
        finally:
            self._sending_s = math.inf
        return True

    def _listen(self, reports: Connection, process: subprocess.Popen[bytes]) -> None:
        """Take what the view process says until it ends; kill it when it does not take a frame."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                if not reports.poll(LOOK_S):
                    if time.monotonic() - self._sending_s > STUCK_S:
                        _kill(process)
                    continue
                message = reports.recv()
                if isinstance(message, ReplayRequest):
                    self._request = message
                else:
                    self._report = message
                    self._remember(message)

    def _remember(self, report: Report) -> None:
        """Start a later view process on the same ports, and do not open a second window."""
        start = self._start
        if report.port:
            self._start = replace(
                start,
                port=report.port,
                web_port=report.web_port or start.web_port,
                open_viewer=start.open_viewer and not report.connected,
            )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the view process and what it started for itself; a native viewer has a session of its own."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
