"""What the commands that record a port share: settings, session, signals, log lines."""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from imumon.cli.common import note, say
from imumon.errors import ImumonError, Reason

if TYPE_CHECKING:
    from imumon.protocols.device import DeviceFile
    from imumon.run.live import LiveRun
    from imumon.run.setup import Setup
    from imumon.transport.settings import PortSettings


def port_settings(port: str, device: DeviceFile, baud: int | None) -> PortSettings:
    """Return how a port is opened for a device, at its first baud rate unless another is given."""
    from imumon.transport.settings import PortSettings

    serial = device.serial
    rate = baud or serial.baudrates[0]
    return PortSettings(port, rate, serial.bytesize, serial.parity, serial.stopbits)


def new_run(
    device: DeviceFile,
    device_yaml: str,
    settings: PortSettings,
    setup: Setup,
    out: Path | None,
    lines: Lines,
) -> LiveRun:
    """Make the session; a default name that another monitor takes at the same moment is no obstacle."""
    from imumon.recordings.folder import default_path
    from imumon.run.live import LiveRun

    while True:
        folder = out or default_path(device.name, time.time_ns())
        try:
            return LiveRun(device, device_yaml, settings, setup, folder, lines.put)
        except ImumonError as error:
            if out is not None or error.reason is not Reason.EXISTS:
                raise


def heed_signals(ended: threading.Event) -> None:
    """Let Ctrl-C and the like set the event instead of ending the program at once."""
    for number in _ending_signals():
        signal.signal(number, lambda *_: ended.set())
    # Whoever starts this command may hold signals back until it can heed them.
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})


def _ending_signals() -> list[signal.Signals]:
    """Return what ends a recording in order: Ctrl-C, kill, a terminal that was closed (not under nohup)."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    return numbers


class Lines:
    """Log lines on their way from the threads of the run to standard error.

    Only the main thread writes there: a terminal that is stopped (Ctrl-S) or a pipe that nobody reads would
    block whoever does, and that must not be the recorder or the pipeline.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[str, str]] = SimpleQueue()

    def put(self, level: str, text: str) -> None:
        """Take a line; returns at once."""
        self._waiting.put((level, text))

    def write(self, before: str = "") -> None:
        """Write the lines that wait; `before` clears what stands in the terminal's line."""
        while True:
            try:
                level, text = self._waiting.get_nowait()
            except Empty:
                return
            note(before, newline=False)
            say(level, text)
