"""Draws charts as pictures: Rerun's own plots have time on their horizontal axis, and linear axes only."""

import io
import math
import threading
import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import rerun as rr

from imumon.charts import Chart
from imumon.harmless import for_plot

from .items import Drawing
from .rows import at_instants

CHARTS = "/charts"
PICTURE_SHARE = 0.03
"""Live, drawing charts takes so much of the time at the most."""
SIZE, DOTS_PER_INCH = (7.0, 5.6), 150
"""Inches, of all charts at all times: the viewer warns of a picture whose size changes.  Sharp in half of a
tab on a full HD screen, readable in a quarter."""
ROOM = {"left": 0.114, "right": 0.985, "bottom": 0.086}
"""Fixed: to fit them to the labels takes as long as all else."""
LEAST = 0.4
"""The axes reach at least so far to the right and up, however much stands there."""
NOTE_LETTERS, LETTERS = 69, 40
"""So many of a line of notes and of a headline fit at full size."""
TOP, NOTE, HEADLINE = 0.98, 0.032, 0.073
"""Where the axes end, and what a line of notes and a headline take of it."""
PAPER, FAINT = "#0d0d0d", "#3a3a3a"
STYLE: Any = [
    "dark_background",
    {
        "font.size": 10.0,
        "axes.edgecolor": "#808080",
        "legend.edgecolor": FAINT,
        "figure.facecolor": PAPER,
        "axes.facecolor": PAPER,
        "savefig.facecolor": PAPER,
    },
]
"""As the viewer's dark theme; on the light one it stands as a dark picture."""


class Painter:
    """Logs the latest of each chart as a picture: live in a thread, as one takes 0.1 s; else at the end."""

    def __init__(self, rec: rr.RecordingStream, *, live: bool) -> None:
        self._rec, self._live = rec, live
        self._waiting: dict[str, Drawing] = {}
        self._thread: threading.Thread | None = None
        self._next_s = -math.inf
        self.titles: dict[str, tuple[str, str, str]] = {}  # tab, key and title of every chart, by its key

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
        while self._waiting:
            self._draw(self._waiting.popitem()[1])

    def _draw(self, drawing: Drawing) -> None:
        """Log the picture of a chart, a PNG; a recording has it whatever moment is looked at."""
        began = time.thread_time()
        try:
            self._rec.send_columns(
                f"{CHARTS}/{drawing.chart.key}",
                indexes=at_instants(drawing.at).indexes if self._live else [],
                columns=rr.EncodedImage.columns(blob=[picture(drawing.chart)], media_type=["image/png"]),
            )
        finally:
            self._next_s = time.monotonic() + (time.thread_time() - began) / PICTURE_SHARE


def picture(chart: Chart) -> bytes:
    """Return the chart as a PNG; only its texts while it has no point to draw."""
    from matplotlib import style  # takes 0.3 s, and only a run with charts needs it

    with style.context(STYLE):
        figure = _figure()
        figure.clear()
        axes = figure.add_subplot()
        for curve in chart.curves:
            look: dict[str, Any] = {"lw": curve.width, "ls": "--" if curve.dashed else "-"}
            if curve.points:
                look = {"ls": "", "marker": "o", "ms": curve.width}
            name = for_plot(curve.name) if curve.listed else None
            axes.plot(curve.x, curve.y, color=[part / 255 for part in curve.color], label=name, **look)
        _frame(axes, chart)
        if not any(np.isfinite(curve.x * curve.y).any() for curve in chart.curves):
            axes.axis("off")
        out = io.BytesIO()
        figure.savefig(out, format="png", pil_kwargs={"compress_level": 3})
    return out.getvalue()


@cache
def _figure() -> Any:
    """Return the figure: each has pixels of 4 MB, which would wait for the garbage collector."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    return figure


def _frame(axes: Any, chart: Chart) -> None:
    from matplotlib.ticker import AutoMinorLocator, LogFormatter

    class Between(LogFormatter):  # numbers between the decades where there are few, without exponents
        def _num_to_string(self, x: float, *_: float) -> str:
            return f"{x:g}"

    for name, scale in (("x", chart.x), ("y", chart.y)):
        axis = getattr(axes, f"{name}axis")
        axis.set_label_text(for_plot(scale.label))
        if not scale.log:
            axis.set_minor_locator(AutoMinorLocator())
        elif any((np.asarray(getattr(curve, name)) > 0).any() for curve in chart.curves):
            axes.set(**{f"{name}scale": "log"})
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(Between(minor_thresholds=(2.0, 1.0)))
    axes.grid(which="major", color=FAINT, lw=0.8)
    axes.grid(which="minor", color=FAINT, lw=0.3)
    right = ROOM["right"]
    if any(curve.listed for curve in chart.curves):  # beside the axes: there it covers no data
        legend = axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.4, fontsize=9)
        width = legend.get_window_extent(axes.figure.canvas.get_renderer()).width
        right -= width / axes.figure.bbox.width
    top = TOP - NOTE * len(chart.notes) - (HEADLINE if chart.headline else 0.0)
    axes.figure.subplots_adjust(**ROOM | {"top": max(LEAST, top), "right": max(LEAST, right)})
    text = "\n".join(map(for_plot, chart.notes))
    axes.set_title(text, fontsize=_fitting(10.0, NOTE_LETTERS, chart.notes), loc="left", family="monospace")
    axes.figure.suptitle(for_plot(chart.headline), fontsize=_fitting(20.0, LETTERS, [chart.headline]))


def _fitting(points: float, letters: int, lines: Sequence[str]) -> float:
    """Return the size, points, at which the longest line fits, when so many letters fit at this one."""
    return points * letters / max([letters, *map(len, lines)])
