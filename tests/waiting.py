"""How tests wait: for what happens, and never for a time."""

from __future__ import annotations

import fcntl
import sys
import termios
import time
from collections.abc import Callable

LIMIT_S = 120.0
"""Nothing that a test waits for may take longer, on a machine however busy; a test as a whole has the timeout
in pyproject.toml."""
POLL_S = 0.005


def wait_until(condition: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
    """Wait until the condition holds; return whether it does."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(POLL_S)
    return True


def unread(slave: int) -> int:
    """Return how many bytes wait at the host's end of a pseudo-terminal."""
    return int.from_bytes(fcntl.ioctl(slave, termios.FIONREAD, bytes(4)), sys.byteorder)
