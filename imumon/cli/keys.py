"""Single keys that a person presses while a command runs."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Keys:
    """Reads keys as they are pressed, without waiting; none where standard input is no terminal."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def pressed(self) -> str:
        """Return the keys since the last time."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0)[0]:
            return ""
        return os.read(self._descriptor, 100).decode(errors="replace")


@contextmanager
def single_keys() -> Iterator[Keys]:
    """Let keys come without Enter and unseen, and give the terminal back as it was; Ctrl-C stays a signal."""
    descriptor = sys.stdin.fileno() if sys.stdin.isatty() else None
    before: list[Any] | None = None
    if descriptor is not None and sys.platform != "win32":
        import termios
        import tty

        before = termios.tcgetattr(descriptor)
        tty.setcbreak(descriptor, termios.TCSANOW)
    try:
        yield Keys(descriptor if before is not None else None)
    finally:
        if descriptor is not None and before is not None:
            termios.tcsetattr(descriptor, termios.TCSANOW, before)
