"""Where the live stream goes: into a native viewer that listens, or out of a server that browsers open."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from enum import Enum, auto
from typing import TYPE_CHECKING

from imumon.view.frames import Report, Start
from imumon.view.gate import Gate, hidden_address
from imumon.view.viewer import (
    LOCALHOST,
    SERVER_MEMORY,
    Answer,
    free_port,
    listen,
    probe,
    proxy_url,
    start_viewer,
)
from imumon.view.web import WebServer

if TYPE_CHECKING:
    import rerun as rr

FLUSH_S = 0.5
MISSES = 2
"""Probes without an answer before the viewer counts as hung."""

Tell = Callable[[Report], None]


class Change(Enum):
    """What became of the reader since it was last looked after."""

    NEW = auto()
    """A reader that has seen nothing yet."""
    RESUMED = auto()
    """The same reader goes on after a pause."""


class _Phase(Enum):
    WAITING = auto()
    CONNECTED = auto()
    PAUSED = auto()


class NativeLink:
    """A native viewer on this machine; it may be closed, hang, or come back at any time.

    Connecting to a port where nobody listens costs 5 s and loses everything afterwards, and a sink whose
    viewer hangs blocks in the end, so the port is asked before every step and nothing is logged meanwhile.

    Parameters
    ----------
    start : Start
        Port, and whether a viewer may be opened.
    tell : callable
        Takes a `Report` at every look.
    """

    def __init__(self, start: Start, tell: Tell) -> None:
        self._tell = tell
        self._port = start.port
        self._viewer: subprocess.Popen[bytes] | None = None
        self._phase = _Phase.WAITING
        self._misses = 0
        self._has_connected = not start.open_viewer
        answer = probe(start.port)
        if start.open_viewer and answer in (Answer.OTHER, Answer.SILENT):
            self._port = free_port(start.port + 1)
        if start.open_viewer and answer is not Answer.RERUN:
            self._viewer = start_viewer(self._port, "--expect-data-soon")

    @property
    def connected(self) -> bool:
        """Whether what is logged now reaches the viewer."""
        return self._phase is _Phase.CONNECTED

    def poll(self, rec: rr.RecordingStream) -> Change | None:
        """Look after the connection and say what has changed."""
        answer = probe(self._port)
        change = None
        if answer is Answer.RERUN:
            self._misses = 0
            change = self._connect(rec) if self._phase is _Phase.WAITING else self._check(rec)
        elif answer is Answer.SILENT:
            self._misses += 1
            if self._misses >= MISSES and self.connected:
                self._phase = _Phase.PAUSED
        else:
            self._phase = _Phase.WAITING
        self._tell(Report(self._text(answer), self.connected, self._port, 0, proxy_url(self._port)))
        return change

    def _connect(self, rec: rr.RecordingStream) -> Change:
        rec.connect_grpc(proxy_url(self._port))
        self._phase = _Phase.CONNECTED
        self._has_connected = True
        return Change.NEW

    def _check(self, rec: rr.RecordingStream) -> Change | None:
        """Find out whether the connection still carries; the viewer may be another one by now."""
        try:
            rec.flush(timeout_sec=FLUSH_S)
        except RuntimeError as error:  # rerun has no exceptions of its own
            if "severed" in str(error):
                return self._connect(rec)
            self._phase = _Phase.PAUSED
            return None
        paused = self._phase is _Phase.PAUSED
        self._phase = _Phase.CONNECTED
        return Change.RESUMED if paused else None

    def _text(self, answer: Answer) -> str:
        if self.connected:
            return "viewer connected"
        if self._phase is _Phase.PAUSED or answer is Answer.SILENT:
            return "viewer does not respond"
        code = self._viewer.poll() if self._viewer else None
        if code:  # one without a display may have answered a moment before
            return f"the viewer could not start or go on (exit code {code}); try --view web"
        if self._has_connected or code == 0:
            return f"viewer closed; `rerun --bind {LOCALHOST} --port {self._port}` brings it back"
        return "viewer starts"


class WebLink:
    """A server on this machine that viewers in a browser come to and leave.

    Parameters
    ----------
    start : Start
        Ports, and the address that the page is on; ports in use are passed over.
    tell : callable
        Takes a `Report` when the servers are up.
    """

    connected = True

    def __init__(self, start: Start, tell: Tell) -> None:
        self._tell = tell
        self._door = listen(start.port)
        device = start.setup.properties.get("device", "")
        title = " - ".join(filter(None, (device, start.setup.title, "imumon")))
        self._behind = hidden_address()
        self._web = WebServer(listen(start.web_port, start.bind), self._behind, title)
        self._serving = False
        self._gate: Gate | None = None

    def poll(self, rec: rr.RecordingStream) -> Change | None:
        """Start serving, the first time."""
        if self._serving:
            return None
        self._serving = True
        import rerun as rr  # takes 0.4 s, in which a native viewer comes up: see Child

        rec.set_sinks(rr.GrpcServerSink(*self._behind, server_memory_limit=SERVER_MEMORY, newest_first=True))
        port = self._door.getsockname()[1]
        self._gate = Gate(self._door, self._behind)
        self._tell(Report("serving the web viewer", True, port, self._web.port, self._web.url))
        return Change.NEW
