"""Keeps the memory of programs that run for days: what is free goes back to the system."""

import ctypes

_LIBRARY = ctypes.CDLL(None)
_TRIM = getattr(_LIBRARY, "malloc_trim", None)
"""Of the GNU C library, malloc_trim(3); others do without."""
_OPTION = getattr(_LIBRARY, "mallopt", None)
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8
"""Names of options of mallopt(3)."""
LARGE_BYTES = 32 << 10
"""A batch for the view takes 45 kB at 1 kHz; what estimators work on takes less."""


def prepare_heap() -> None:
    """Give large pieces pages of their own, and all threads one heap; before there is a second thread.

    A heap keeps a page as long as a byte of it is in use.  Frames that wait for two minutes, columns of half
    a minute and pictures, in a heap for each thread, leave holes that no other thread fills.
    """
    if _OPTION is not None:
        _OPTION(_MMAP_THRESHOLD, LARGE_BYTES)
        _OPTION(_ARENA_MAX, 1)


def trim_heap() -> None:
    """Give back the pages that are free between others; takes 1 to 5 ms for 200 MB.

    The C library gives back no more than the end of each heap.  Samples that are held for half a minute leave
    holes before it, more by the hour.
    """
    if _TRIM is not None:
        _TRIM(0)
