"""A live view that is absent, stopped, killed or besieged: the recording must not notice."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from imumon.recordings.wire import (
    CDR,
    FIELDS,
    MAGIC,
    MESSAGE_OP,
    RECORD,
    WIRE_CHANNEL,
)
from tests.faults.killed import HELD_S, Line, Machine, allowed_s, end_in_order, wait_for_reader
from tests.faults.rows import Row
from tests.waiting import LIMIT_S

RATE_HZ = 100.0
POLL_S = 0.02
BROWSERS = 50
MOST_MB = 600.0
"""Of the monitor; 32 MB of them may wait for the view."""
READ = b"POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\nHost: 127.0.0.1\r\n"
READ += b"Content-Type: application/grpc-web+proto\r\nX-Grpc-Web: 1\r\nContent-Length: 5\r\n\r\n\0\0\0\0\0"


class Lag:
    """Watches a recording that grows, and how old the oldest byte is that it does not have yet."""

    def __init__(self, wire: Path, line: Line) -> None:
        self._file, self._line = wire.open("rb"), line
        self._at, self._kept = len(MAGIC), 0
        self.most_s = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Watch no more."""
        self._end.set()
        self._thread.join()
        self._file.close()

    def _run(self) -> None:
        while not self._end.wait(POLL_S):
            now, sent = time.monotonic(), len(self._line.times)
            self._look()
            first_lost = bisect_right(self._line.sent, self._kept, 0, sent)
            if first_lost < sent:
                self.most_s = max(self.most_s, now - self._line.times[first_lost])

    def _look(self) -> None:
        """Count the bytes of the records that are there by now."""
        self._file.seek(self._at)
        data, at = self._file.read(), 0
        while len(data) - at >= RECORD.size + FIELDS.size:
            opcode, length = RECORD.unpack_from(data, at)
            if at + RECORD.size + length > len(data):
                break
            if opcode == MESSAGE_OP and FIELDS.unpack_from(data, at + RECORD.size)[0] == WIRE_CHANNEL:
                self._kept += length - FIELDS.size - CDR.size
            at += RECORD.size + length
        self._at += at


@dataclass(slots=True)
class Scene:
    """A monitor with a web view, and what is done to it."""

    child: subprocess.Popen[str]
    sockets: list[socket.socket] = field(default_factory=list)

    def view(self) -> psutil.Process:
        """Return the view process."""
        every = psutil.Process(self.child.pid).children()
        return next(process for process in every if "imumon.view.child" in process.cmdline())

    def port(self) -> int:
        """Return the port of the page, through which the stream comes, too."""
        listening = [c.laddr for c in self.view().net_connections() if c.status == psutil.CONN_LISTEN]
        return next(address.port for address in listening if address.ip == "127.0.0.1")


def _stop(scene: Scene, seconds: float) -> None:
    scene.view().suspend()
    time.sleep(seconds)


def _kill(scene: Scene, seconds: float) -> None:
    scene.view().kill()
    time.sleep(seconds)


def _browsers(scene: Scene, seconds: float) -> None:
    """Let browsers come, read a little, and go; every fifth stays and reads nothing."""
    port = scene.port()
    for number in range(BROWSERS):
        browser = socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S)
        browser.sendall(READ)
        if number % 5:
            browser.recv(1000)
            browser.close()
        else:
            scene.sockets.append(browser)
        time.sleep(seconds / BROWSERS)


def _nothing(_: Scene, seconds: float) -> None:
    time.sleep(seconds)


STOPPED = "view process stopped, also at the end"
HARMS: dict[str, tuple[str, Callable[[Scene, float], None]]] = {
    "no view": ("none", _nothing),
    "no viewer looks": ("web", _nothing),
    STOPPED: ("web", _stop),
    "view process killed": ("web", _kill),
    f"{BROWSERS} browsers come and go, every fifth hangs": ("web", _browsers),
    "ports 9090 and 9876 taken": ("web", _nothing),
}


def harm(folder: Path, name: str, seconds: float, patience: float = 1.0) -> tuple[list[str], str]:
    """Run a monitor while something happens to its view; return what was not as promised, and the numbers.

    The end may take so many times as long as promised, on a machine that has other tests to run.
    """
    mode, action = HARMS[name]
    line = Line(RATE_HZ, seconds + LIMIT_S)
    arguments = ["monitor", line.path, "--device", "ax1", "--view", mode, "--out", str(folder), "--json"]
    program = [sys.executable, "-c", "from imumon.cli import main; main()", *arguments]
    taken = [socket.socket() for _ in range(2)] if name.startswith("ports") else []
    for port, one in zip((9090, 9876), taken, strict=False):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind(("127.0.0.1", port))
            one.listen()
        except OSError:
            pass  # another program has it, which is what this is about
    pipe = subprocess.PIPE
    with Machine() as machine, subprocess.Popen(program, stdout=pipe, stderr=pipe, text=True) as child:
        scene = Scene(child)
        try:
            assert child.stderr is not None
            wait_for_reader(child, folder / "wire.mcap")
            lag = Lag(folder / "wire.mcap", line)
            line.start()
            said = child.stderr.readline()
            while mode == "web" and "live view" not in said:
                said = child.stderr.readline()
            action(scene, seconds)
            memory = psutil.Process(child.pid).memory_info().rss / 1e6
            line.pause()
            lag.close()
            wrong, took_s = end_in_order(child, line, signal.SIGTERM, patience)
        finally:
            child.kill()
            line.close()
            for one in (*taken, *scene.sockets):
                one.close()
    if lag.most_s > allowed_s(machine.late_s):
        wrong.append(f"the recording was {lag.most_s:.2f} s behind")
    if memory > MOST_MB:
        wrong.append(f"{memory:.0f} MB")
    said = f"recording {lag.most_s:.2f} s behind at most, {HELD_S:g} s of work {machine.late_s:.2f} s late"
    return wrong, f"{said}, {memory:.0f} MB, exit after {took_s:.1f} s"


def attack_all(folder: Path, seconds: float, names: list[str] | None = None) -> Iterator[Row]:
    """Do each harm to a monitor's view."""
    for number, name in enumerate(names or HARMS):
        wrong, numbers = harm(folder / str(number), name, seconds)
        yield Row(f"{name}, for {seconds:g} s", 1, "; ".join([*wrong, numbers]), held=not wrong)
