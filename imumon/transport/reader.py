"""The reader thread: read, stamp, hand on; watch for silence, reopen what was lost."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from imumon.blocks import IntArray
from imumon.errors import ImumonError

from .port import Port, open_port
from .ports import lost_error, silent_error
from .settings import PortSettings

ByteArray = npt.NDArray[np.uint8]

SILENT_AFTER_S = 1.0
REOPEN_S = 0.2
"""How often reopening is tried, for ever: a try takes a millisecond."""
STOP_S = 0.2
"""Longest wait for bytes; then it is looked whether the reader is to stop, or a silent port was replaced."""


class EventKind(Enum):
    """What happened to the port; the values are written into recordings and stay as they are."""

    OPENED = "opened"
    """The port was opened, for the first time or again; bytes before and after do not belong together."""
    SILENT = "silent"
    """The port is open, and no byte has come for a while."""
    RESUMED = "resumed"
    """Bytes come again after SILENT, on the same opening."""
    LOST = "lost"
    """The port failed; it is reopened as soon as it can be.  The gap lasts until the next OPENED."""
    UNAVAILABLE = "unavailable"
    """Reopening failed; reported again only when it fails for another reason."""
    SHARED = "shared"
    """Another program reads from the port as well, so bytes are missing."""
    CLOSED = "closed"
    """The reader was stopped; nothing follows."""
    MARK = "mark"
    """A person marked this moment; the details are the words."""
    START = "start"
    """A person began a part of the recording; the details are its name."""
    STOP = "stop"
    """A person ended that part."""


@dataclass(frozen=True)
class Bytes:
    """Bytes as they were read at once, and the Unix time (ns) right after the read."""

    data: bytes
    time_ns: int


@dataclass(frozen=True, eq=False)
class Reads:
    """Several reads one after the other, as a recording has them: faster to go through than each alone.

    For each, (n,): where it ends in the data, and the Unix time right after it.
    """

    data: ByteArray
    ends: IntArray
    arrivals_ns: IntArray

    @classmethod
    def of(cls, reads: Sequence[Bytes]) -> "Reads":
        """Return reads as one."""
        data = np.frombuffer(b"".join([read.data for read in reads]), np.uint8)
        ends = np.cumsum([len(read.data) for read in reads], dtype=np.int64)
        return cls(data, ends, np.array([read.time_ns for read in reads], np.int64))

    @property
    def lengths(self) -> IntArray:
        """Bytes of each read, (n,)."""
        return np.diff(self.ends, prepend=0)

    def __iter__(self) -> Iterator[Bytes]:
        start = 0
        for end, arrival_ns in zip(self.ends.tolist(), self.arrivals_ns.tolist(), strict=True):
            yield Bytes(self.data[start:end].tobytes(), arrival_ns)
            start = end


@dataclass(frozen=True)
class Event:
    """What happened to the port, when (Unix time, ns), and the details for a person."""

    kind: EventKind
    time_ns: int
    detail: str


Item = Bytes | Event
Sink = Callable[[Item], None]
"""Takes an item at once: `queue.SimpleQueue.put`, or a function that neither blocks nor raises."""


class Clock:
    """Unix time that never goes back: the time of day at the start plus a clock that only goes forwards.

    Steps of the computer's clock do not reach the stamps; its sleep does.
    """

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - steady_ns()

    def now_ns(self) -> int:
        """Return Unix time in ns."""
        return self._offset_ns + steady_ns()


def steady_ns() -> int:
    """Return the time of a clock that is never set, the same in all programs, ns."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class Reader:
    """Keeps a port open and hands every byte, with its time of arrival, to the sinks.

    A silent port is left open unless its device node vanished or was replaced: opening again toggles DTR,
    which resets some devices, and cannot help when the node is still the same.

    `settings`: the port.
    `sinks`: each gets every `Bytes` and `Event` in order, called from the reader thread.
    `silent_after_s`: time without bytes after which the port is called silent; set it for devices that send
        less often.
    """

    def __init__(self, settings: PortSettings, *sinks: Sink, silent_after_s: float = SILENT_AFTER_S) -> None:
        self.settings = settings
        self._sinks = sinks
        self._silent_after_s = silent_after_s
        self._clock = Clock()
        self.newest_ns = 0
        """Arrival of the newest bytes, Unix time; 0 before the first."""
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Open the port and start reading.

        Raises ImumonError when the port cannot be opened now: the name may be wrong, so it is not tried
        again.
        """
        port = open_port(self.settings)
        name = f"reader of {self.settings.url}"
        self._thread = threading.Thread(target=self._run, args=(port,), name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and close the port; returns when both are done, within 0.5 s."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self, port: Port | None) -> None:
        lost_ns: int | None = None
        try:
            while port is not None:
                with port:
                    self._report_opened(port, lost_ns)
                    failure = self._read_until_lost(port)
                if failure is None:
                    return
                lost_ns = self._clock.now_ns()
                self.report(EventKind.LOST, failure.seen, lost_ns)
                port = self._reopen()
        finally:
            self.report(EventKind.CLOSED, f"{self.settings.url} was closed")

    def _read_until_lost(self, port: Port) -> ImumonError | None:
        """Read until the port fails, and return why; None when the reader is stopped."""
        last_ns = self._clock.now_ns()
        silent = shared = False
        while not self._stopping.is_set():
            left_s = self._silent_after_s - (self._clock.now_ns() - last_ns) * 1e-9
            try:
                data = port.read(STOP_S if silent else min(STOP_S, max(left_s, 0.0)))
            except ImumonError as error:
                return error
            now_ns = self._clock.now_ns()
            quiet_s = (now_ns - last_ns) * 1e-9
            if data:
                if silent:
                    self.report(EventKind.RESUMED, f"bytes again after {quiet_s:.1f} s", now_ns)
                silent, last_ns = False, now_ns
                self._hand_on(Bytes(data, now_ns))
                self.newest_ns = now_ns
            elif quiet_s >= self._silent_after_s and not silent:
                silent = True
                self.report(EventKind.SILENT, silent_error(self.settings, quiet_s).seen, now_ns)
            if silent and (reason := port.gone()):
                return lost_error(self.settings, reason)
            if port.vanished_reads and not shared:
                shared = True
                self.report(EventKind.SHARED, "another program takes bytes from this port")
        return None

    def _reopen(self) -> Port | None:
        """Try to open until it works; return None when the reader is stopped meanwhile."""
        reported = ""
        while not self._stopping.wait(REOPEN_S):
            try:
                return open_port(self.settings)
            except ImumonError as error:
                if error.seen != reported:
                    reported = error.seen
                    self.report(EventKind.UNAVAILABLE, error.line)
        return None

    def _report_opened(self, port: Port, lost_ns: int | None) -> None:
        now_ns = self._clock.now_ns()
        gap = "" if lost_ns is None else f" again after {(now_ns - lost_ns) * 1e-9:.1f} s"
        self.report(EventKind.OPENED, f"{self.settings}{gap}; low latency: {port.low_latency}", now_ns)
        if port.shared_with:
            others = ", ".join(port.shared_with)
            self.report(
                EventKind.SHARED, f"also open in {others}: bytes that it reads are missing here", now_ns
            )

    def report(self, kind: EventKind, detail: str, time_ns: int | None = None) -> None:
        """Hand on an event of now, or of this Unix time (ns); may be called from any thread."""
        self._hand_on(Event(kind, self._clock.now_ns() if time_ns is None else time_ns, detail))

    def _hand_on(self, item: Item) -> None:
        for sink in self._sinks:
            sink(item)
