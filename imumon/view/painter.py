"""Logs charts as pictures; live they are drawn beside the samples."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

CHARTS = "/charts"


def log_picture(rec: rr.RecordingStream, key: str, blob: bytes, indexes: list[rr.TimeColumn]) -> None:
    """Log the picture of a chart, a PNG, at one moment; without `indexes` as the only one that there is."""
    image = rr.EncodedImage.columns(blob=[blob], media_type=["image/png"])
    rec.send_columns(f"{CHARTS}/{key}", indexes=indexes, columns=image)


def chart_view(key: str, title: str) -> Any:
    """Return the view of one chart."""
    return rrb.Spatial2DView(origin=f"{CHARTS}/{key}", name=title)


class Painter:
    """Draws live charts in a thread of its own: one takes 0.1 s or longer, in which samples go on.

    Parameters
    ----------
    share : float
        Of the time that drawing takes at the most.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._thread: threading.Thread | None = None
        self._next_s = -math.inf

    @property
    def is_free(self) -> bool:
        """Return whether the next one can be drawn now."""
        return time.monotonic() >= self._next_s

    def begin(self, draw: Callable[[], None]) -> None:
        """Draw, when it is free."""
        self._next_s = math.inf
        self._thread = threading.Thread(target=self._run, args=[draw], name="painter", daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Let what has begun be done."""
        if self._thread is not None:
            self._thread.join()

    def _run(self, draw: Callable[[], None]) -> None:
        began = time.thread_time()
        try:
            draw()
        finally:
            self._next_s = time.monotonic() + (time.thread_time() - began) / self._share
