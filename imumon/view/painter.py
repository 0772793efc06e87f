"""Logs charts as pictures: live they are drawn beside the samples, of a recording at its end."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from imumon.view.items import Drawing
from imumon.view.pictures import picture
from imumon.view.rows import at_instants

CHARTS = "/charts"
PICTURE_SHARE = 0.03
"""Live, drawing charts takes so much of the time at the most."""


def chart_view(key: str, title: str) -> Any:
    """Return the view of one chart."""
    return rrb.Spatial2DView(origin=f"{CHARTS}/{key}", name=title)


class Painter:
    """Draws the latest of each chart: live in a thread, as one takes 0.1 s, in which samples go on."""

    def __init__(self, rec: rr.RecordingStream, *, live: bool) -> None:
        self._rec, self._live = rec, live
        self._waiting: dict[str, Drawing] = {}
        self._thread: threading.Thread | None = None
        self._next_s = -math.inf
        self.titles: dict[str, tuple[str, str, str]] = {}
        """Tab, key and title of every chart, by its key."""

    def add(self, drawing: Drawing) -> None:
        """Take a chart, which replaces the one before that was not drawn."""
        chart = drawing.chart
        self._waiting[chart.key] = drawing
        self.titles[chart.key] = chart.place, chart.key, chart.title

    def draw_next(self) -> None:
        """Begin to draw the one that waits longest, live and when it is time."""
        if self._live and self._waiting and time.monotonic() >= self._next_s:
            self._next_s = math.inf
            drawing = self._waiting.pop(next(iter(self._waiting)))
            self._thread = threading.Thread(target=self._draw, args=[drawing], name="painter", daemon=True)
            self._thread.start()

    def finish(self) -> None:
        """Draw all that wait."""
        if self._thread is not None:
            self._thread.join()
        for drawing in self._waiting.values():
            self._draw(drawing)
        self._waiting.clear()

    def _draw(self, drawing: Drawing) -> None:
        """Log the picture of a chart, a PNG; a recording has it whatever moment is looked at."""
        began = time.thread_time()
        try:
            image = rr.EncodedImage.columns(blob=[picture(drawing.chart)], media_type=["image/png"])
            indexes = at_instants(drawing.at).indexes if self._live else []
            self._rec.send_columns(f"{CHARTS}/{drawing.chart.key}", indexes=indexes, columns=image)
        finally:
            self._next_s = time.monotonic() + (time.thread_time() - began) / PICTURE_SHARE
