"""Single keys that a person presses while a command runs."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


class Keys:
    """Reads keys as they are pressed, without waiting; none where standard input is no terminal."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    @property
    def possible(self) -> bool:
        """Whether keys can come now; the system stops who reads a terminal from the background."""
        if self._descriptor is None:
            return False
        try:
            return os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:  # a terminal that controls no job
            return True

    def pressed(self) -> str:
        """Return the keys since the last time."""
        if self._descriptor is None or not self.possible:
            return ""
        try:
            if not select.select([self._descriptor], [], [], 0)[0]:
                return ""
            pressed = os.read(self._descriptor, 100)
        except OSError:
            pressed = b""
        if not pressed:  # the terminal was closed
            self._descriptor = None
        return pressed.decode(errors="replace")


@contextmanager
def single_keys() -> Iterator[Keys]:
    """Let keys come without Enter and unseen, and give the terminal back as it was; Ctrl-C stays a signal.

    None come to a command in the background.
    """
    keys = Keys(sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None)
    if not keys.possible or sys.platform == "win32":
        yield Keys(None)
        return
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin, termios.TCSANOW)
    try:
        yield keys
    finally:
        # The system would stop a command in the background that sets the terminal.
        held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU})
        with suppress(OSError, termios.error):  # the terminal was closed
            termios.tcsetattr(sys.stdin, termios.TCSANOW, before)
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
