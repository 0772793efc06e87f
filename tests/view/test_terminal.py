"""The view in a terminal: what stands on a screen, and a real run in real terminals of two sizes."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from imumon.harmless import for_log
from imumon.protocols.device import load_device
from imumon.recordings.wire_reader import WireReader
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.reader import Event, EventKind
from imumon.view.items import Instant, Log, State, Timebase, ViewSetup
from imumon.view.terminal import TerminalView, drawn
from tests.cli.command import IMUMON
from tests.view.streams import block
from tests.waiting import LIMIT_S

SETUP = ViewSetup("bench", "bench")
CONTROL = re.compile(r"\x1b\[(\??)([\d;]*)([A-Za-z])")


class Glass:
    """A terminal that understands what `drawn` returns, and nothing else."""

    def __init__(self, columns: int, rows: int) -> None:
        self.lines = [" " * columns for _ in range(rows)]
        self.columns = columns
        self._row = self._column = 0

    def feed(self, text: str) -> None:
        at = 0
        for control in CONTROL.finditer(text):
            self._put(text[at : control.start()])
            at = control.end()
            _, given, what = control.groups()
            if what == "H":
                assert not given
                self._row = self._column = 0
            elif what == "K":
                self.lines[self._row] = self.lines[self._row][: self._column].ljust(self.columns)
            else:
                assert what in "hlm"
        self._put(text[at:])

    def _put(self, text: str) -> None:
        for number, part in enumerate(text.replace("\r", "").split("\n")):
            if number:
                self._row, self._column = self._row + 1, 0
            line = self.lines[self._row]
            end = self._column + len(part)
            assert end <= self.columns, part
            self.lines[self._row] = line[: self._column] + part + line[end:]
            self._column = end


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (200, 60), (20, 5), (1, 1)])
def test_whatever_the_size_the_screen_shows_what_the_lines_say(columns: int, rows: int) -> None:
    view, timebase = TerminalView(SETUP), Timebase()
    glass = Glass(columns, rows)
    for second in range(5):
        view.publish(timebase.samples(block(100 * second, 100)))
        view.publish(State(Instant(None, None, None), "port", "open"))
        view.publish(Log(Instant(None, None, None), f"line {second} \x1b[2J of a device", "WARN"))
        lines = view.lines(columns, rows, "open")
        glass.feed(drawn(lines, columns, rows))
        assert len(lines) <= rows
        for shown, line in zip(glass.lines, lines, strict=False):
            assert shown.rstrip() == for_log(line)[:columns].rstrip()
    if columns >= 80:
        text = "\n".join(glass.lines)
        assert "Port open" in text
        assert "angular rate" in text
        assert "WARN line 4" in text


@pytest.mark.parametrize(("columns", "rows"), [(38, 8), (50, 12)])
def test_in_a_small_window_there_are_numbers_with_names_and_units(columns: int, rows: int) -> None:
    view, timebase = TerminalView(SETUP), Timebase()
    view.publish(timebase.samples(block(0, 100)))
    for lane in ("port", "link", "data", "clock", "motion"):
        view.publish(State(Instant(None, None, None), lane, "a state of some length"))
    lines = view.lines(columns, rows, "open")
    numbers = [line for line in lines if re.fullmatch(r"\S.*[xyz]? +-?\d+\.\d+ °/s", line)]
    assert len(numbers) == 3


def _in_terminal(
    arguments: list[str], size: tuple[int, int], cwd: Path, keys: bytes, seen: Callable[[str], bool] | None
) -> tuple[int, str]:
    """Run a command in a terminal of so many columns and rows; return its exit code and what it wrote there.

    The keys are pressed once the port or a word on them is shown; when all is seen it is interrupted.
    """
    columns, rows = size
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    environment = os.environ | {"TERM": "xterm"}
    process = subprocess.Popen(
        [IMUMON, *arguments], stdin=theirs, stdout=theirs, stderr=theirs, cwd=cwd, env=environment
    )
    os.close(theirs)
    os.set_blocking(ours, False)
    parts: list[bytes] = []
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        try:
            part = os.read(ours, 65536)
        except BlockingIOError:
            part = b""
        except OSError:  # the other side is closed
            break
        parts.append(part)
        if keys and (b"Port open" in part or b"keys:" in part):
            os.write(ours, keys)
            keys = b""
        if not keys and seen is not None and seen(b"".join(parts).decode(errors="ignore")):
            process.send_signal(signal.SIGINT)
            seen = None
        if not part:
            if process.poll() is not None:
                break
            time.sleep(0.05)
    os.close(ours)
    return process.wait(LIMIT_S), b"".join(parts).decode()


SHOWN = ("Port open", "angular rate", "specific force", "temperature", "°/s", "packets")


@pytest.mark.long
def test_a_live_run_in_a_real_terminal(tmp_path: Path) -> None:
    columns, rows = 80, 24

    def all_is_seen(text: str) -> bool:
        recorded = b"".join(wire.read_bytes() for wire in tmp_path.glob("sessions/*/wire.mcap"))
        return b"part 1" in recorded and all(part in text for part in SHOWN)

    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        arguments = ["monitor", ahrs.port.path, "--device", "ax1", "--view", "terminal"]
        code, text = _in_terminal(arguments, (columns, rows), tmp_path, b"ms", all_is_seen)
    assert code == 0, text
    own = text[text.index("\x1b[?1049h") : text.index("\x1b[?1049l")]
    glass = Glass(columns, rows)
    glass.feed(own)
    shown = "\n".join(glass.lines)
    (wire,) = tmp_path.glob("sessions/*/wire.mcap")
    said = [item.detail for item in WireReader(wire) if isinstance(item, Event)]
    assert {"key m", "part 1"} <= set(said), "what the keys m and s do"
    for part in SHOWN:
        assert part in shown, shown
    assert "recorded" in text[text.index("\x1b[?1049l") :]


@pytest.mark.long
def test_keys_mark_without_a_view_too(tmp_path: Path) -> None:
    def is_marked(_: str) -> bool:
        return b"key m" in b"".join(wire.read_bytes() for wire in tmp_path.glob("sessions/*/wire.mcap"))

    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        arguments = ["monitor", ahrs.port.path, "--device", "ax1", "--view", "none"]
        code, text = _in_terminal(arguments, (80, 24), tmp_path, b"sm", is_marked)
    assert code == 0, text
    (wire,) = tmp_path.glob("sessions/*/wire.mcap")
    said = [(item.kind, item.detail) for item in WireReader(wire) if isinstance(item, Event)]
    assert said[1:3] == [(EventKind.START, "part 1"), (EventKind.MARK, "key m")]


def test_without_a_terminal_it_reports_that_and_records_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [IMUMON, "monitor", "/dev/null", "--device", "ax1", "--view", "terminal"],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "no terminal" in done.stderr
    assert not list(tmp_path.iterdir())


WATCHED = """
import signal, sys
from contextlib import suppress
from imumon.cli.live_run import Lines, watch

class Ending:
    left = [True, False]
    def wait(self):
        return self.left.pop(0)

signal.signal(signal.SIGHUP, signal.SIG_IGN)
with suppress(OSError):
    sys.stdin.readline()  # until the terminal is as it shall be
sizes = []
watch(Ending(), Lines(), lambda: None, str, lambda *size: sizes.append(size) or ["text"])
print(sizes)
"""


@pytest.mark.parametrize(
    ("size", "closed", "drawn_at"),
    [((30, 100), False, "(100, 30)"), ((0, 0), False, "80"), ((9, 9), True, "80")],
)
def test_a_terminal_without_a_size_or_that_was_closed_does_not_end_the_watch(
    size: tuple[int, int], closed: bool, drawn_at: str
) -> None:
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        [sys.executable, "-c", WATCHED],
        stdin=theirs, stdout=subprocess.PIPE, stderr=theirs, text=True, env=environment | {"TERM": "xterm"},
    )  # fmt: skip
    os.close(theirs)
    if closed:
        os.close(ours)
    else:
        os.write(ours, b"\n")
    out, _ = process.communicate(timeout=LIMIT_S)
    if not closed:
        os.close(ours)
    assert process.returncode == 0
    assert drawn_at in out
