"""One heap for all threads of a program that runs for days."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

M_ARENA_MAX = -8
"""Of ``malloc.h`` of the GNU C library, mallopt(3)."""


def share_heap() -> None:
    """Let what one thread gives back be used by the others; to be called before there are any.

    The GNU C library has a heap for each thread.  Here samples go from thread to thread, and each heap would
    keep the holes that they leave: 40 MB after a minute at 1 kHz, and more by the hour.  Other systems are left
    alone.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
