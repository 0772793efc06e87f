"""What the commands that record a port share: settings, session, signals, log lines, single keys."""

import gc
import math
import os
import select
import signal
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from imumon.errors import ImumonError, Reason
from imumon.heap import prepare_heap
from imumon.recordings import lines

from .common import CLEAR_LINE, INTERRUPTED, is_terminal, log, note

if TYPE_CHECKING:
    from imumon.run.live import LiveSummary
    from imumon.run.setup import Setup
    from imumon.view.items import ViewItem

REFRESH_S = 0.25
"""How often a command looks after what it waits for."""


class Ending:
    """The end of a command: Ctrl-C and the like, or its time is over.

    `seconds` is how long the command runs, counted from `begin`; None: until a signal.
    """

    def __init__(self, seconds: float | None) -> None:
        self._seconds, self._deadline = seconds, math.inf
        self._signal = threading.Event()
        for number in ending_signals():
            signal.signal(number, lambda *_: self._signal.set())
        if INTERRUPTED.is_set():  # and a library has made nothing of it
            self._signal.set()
        # Whoever starts this command may hold signals back until it can heed them.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})

    def begin(self) -> None:
        """Let the time begin."""
        self._deadline = math.inf if self._seconds is None else time.monotonic() + self._seconds

    @property
    def is_requested(self) -> bool:
        """Whether a signal has requested the end."""
        return self._signal.is_set()

    def wait(self) -> bool:
        """Let a moment pass; return whether the command goes on."""
        left = self._deadline - time.monotonic()
        if left <= 0.0:
            return False
        return not self._signal.wait(min(REFRESH_S, left))


def serve(url: str) -> None:
    """Keep a page until Ctrl-C: its servers end with the command."""
    ending = Ending(None)  # before the note: who reads it may press Ctrl-C at once
    note(f"all is shown; {url} stays until Ctrl-C")
    while ending.wait():
        pass


class PortRun:
    """A port that is recorded, until its end is requested.

    `out` is the session folder; a new one in ./sessions when None.  `seconds` is how long to record.
    """

    def __init__(
        self,
        port: str,
        device: str,
        baud: int | None,
        setup: "Setup",
        out: Path | None,
        seconds: float | None,
        serial: str | None = None,
    ) -> None:
        from imumon.protocols.device import device_text, parse_device
        from imumon.recordings.folder import default_path
        from imumon.run.live import LiveRun  # here, as Ctrl-C while it loads shall leave no session behind

        prepare_heap()
        text, source = device_text(device)
        self._device, self._setup = parse_device(text, source), setup
        self._settings = self._device.port_settings(port, baud)
        self.lines, self.ending = Lines(), Ending(seconds)

        def new_run() -> LiveRun:
            folder = out or default_path(self._device.name, time.time_ns())
            return LiveRun(self._device, text, self._settings, setup, folder, self.lines.put, serial=serial)

        try:
            self.run = new_run()
        except ImumonError as error:
            if out is not None or error.reason is not Reason.EXISTS:
                raise
            self.run = new_run()  # another monitor has taken the name at the same moment
        self.run.open()
        self.ending.begin()

    def begin(self, publish: "Sequence[Callable[[ViewItem], None]]") -> None:
        """Begin to decode, once all is compiled."""
        from imumon.run.live import warm_up

        if not self.ending.is_requested:
            warm_up(self._device, self._setup)
        gc.freeze()  # a search through all that was loaded takes 0.1 s, in which nothing else runs
        self.run.begin(publish)

    def raise_problem(self, summary: "LiveSummary") -> None:
        """Raise what ended the run, or that nothing could be decoded."""
        from imumon.run.live import nothing_decoded

        problem = self.run.failure or nothing_decoded(self._settings, self._device, summary.counters)
        if problem is not None:
            raise problem


def ending_signals() -> list[signal.Signals]:
    """Return what ends a recording in order: Ctrl-C, kill, a terminal that was closed (not under nohup)."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    return numbers


class Lines(lines.Lines):
    """Log lines on their way from the threads of the run to standard error.

    Only the main thread writes there: a terminal that is stopped (Ctrl-S) or a pipe without a reader would
    block whoever does, and that must not be the recorder or the pipeline.
    """

    def write(self, before: str = "") -> None:
        """Write the lines that wait; `before` clears what stands in the terminal's line."""
        for _, level, text in self.take():
            note(control=before)
            log(level, text)


SCREEN_S = 1.0
"""How often a screen is drawn, s; it is some 2 kB."""


def watch(
    ending: Ending,
    lines: Lines,
    step: Callable[[], object],
    status: Callable[[], str],
    screen: Callable[[int, int], Sequence[str]] | None = None,
) -> None:
    """Wait for the end of a run, with a status line below the log lines on a terminal; call `step` meanwhile.

    A `screen`, lines by columns and rows, is drawn instead where there is one.
    """
    if screen is None:
        clear = CLEAR_LINE if is_terminal() else ""
        while ending.wait():
            step()
            lines.write(clear)
            if clear:
                note(status(), control=clear)
        note(control=clear)
        return
    from imumon.view.terminal import GIVEN_BACK, OWN_SCREEN, drawn

    drawn_s = -math.inf
    note(control=OWN_SCREEN)
    try:
        while ending.wait():
            step()
            if time.monotonic() - drawn_s >= SCREEN_S:
                drawn_s = time.monotonic()
                size = (0, 0)
                with suppress(OSError):  # it may be closed
                    size = os.get_terminal_size(sys.stderr.fileno())
                size = size if all(size) else (80, 24)
                note(control=drawn(screen(*size), *size))
    finally:
        note(control=GIVEN_BACK)


@contextmanager
def single_keys() -> Iterator[Callable[[], str] | None]:
    """Let keys come without Enter and unseen; yield what returns those since the last time.

    It is None without a terminal, and in the background.  Ctrl-C stays a signal; in the end the terminal is
    as it was.
    """
    terminal = sys.stdin.fileno() if sys.stdin.isatty() else -1
    in_front = terminal >= 0
    with suppress(OSError):  # there is no terminal, or one that controls no job
        in_front = os.tcgetpgrp(terminal) == os.getpgrp()
    if not in_front:
        yield None
        return

    def pressed() -> str:
        with suppress(OSError):  # in the background by now, or the terminal was closed
            if select.select([terminal], [], [], 0)[0]:
                return os.read(terminal, 100).decode(errors="replace")
        return ""

    # Else the system stops a command that is sent to the background and uses its terminal.
    usual = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGTTIN, signal.SIGTTOU)}
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal, termios.TCSANOW)
    try:
        yield pressed
    finally:
        with suppress(termios.error):  # the terminal was closed
            termios.tcsetattr(terminal, termios.TCSANOW, before)
        for number, handler in usual.items():
            signal.signal(number, handler)
