"""Draws charts in a 2-D view: Rerun's own plots have time on their horizontal axis, and linear axes only."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import FloatArray
from imumon.charts import GREY, Axis, Chart, Curve

CHARTS = "/charts"
WIDTH, HEIGHT = 1.6, 1.0
"""The plotting area in scene units; the vertical axis of a 2-D view points down."""
MARGIN = (0.20, 0.12, 0.06, 0.22)
"""Room for labels left, above, right, below."""
TICKS = 6
"""At the most about so many on an axis."""
EMPTY = (0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Scale:
    """Maps one axis to 0..1 between its limits, which are logarithms where the axis is logarithmic."""

    log: bool
    low: float
    high: float

    def place(self, values: FloatArray) -> FloatArray:
        """Return where values stand, shape (n,); NaN where a logarithm has none."""
        return (_transformed(values, self.log) - self.low) / (self.high - self.low)

    def ticks(self) -> list[tuple[float, str]]:
        """Return place and text of the marks on the axis."""
        step = _step(self.high - self.low)
        if self.log:
            step = max(1.0, float(np.ceil(step)))
        first = np.ceil(self.low / step - 1e-9)
        marks = (first + np.arange(0, (self.high - self.low) / step + 1)) * step
        inside = marks[(marks >= self.low - 1e-9 * step) & (marks <= self.high + 1e-9 * step)]
        return [
            ((mark - self.low) / (self.high - self.low), f"{10.0**mark:g}" if self.log else f"{mark:.6g}")
            for mark in inside + 0.0
        ]


def scale(axis: Axis, values: FloatArray) -> Scale:
    """Return the scale on which all of the values can be seen: whole decades, or 5 % more than the range."""
    usable = _transformed(values, axis.log)
    usable = usable[np.isfinite(usable)]
    low, high = (float(usable.min()), float(usable.max())) if len(usable) else EMPTY
    if axis.log:
        low, high = float(np.floor(low + 1e-9)), float(np.ceil(high - 1e-9))
        return Scale(True, low, max(high, low + 1.0))
    room = 0.05 * (high - low) or max(abs(high), 1.0) * 1e-3
    return Scale(False, low - room, high + room)


def declare_chart(rec: rr.RecordingStream, chart: Chart) -> None:
    """Log how a chart looks: what does not change while its curves do."""
    root = f"{CHARTS}/{chart.key}"
    grid = rr.LineStrips2D.from_fields(colors=[[*GREY, 90]], radii=rr.Radius.ui_points(0.5))
    rec.log(f"{root}/grid", grid, static=True)
    marks = rr.Points2D.from_fields(
        colors=[[*GREY, 255]], radii=rr.Radius.ui_points(0.0), show_labels=True, draw_order=40.0
    )
    rec.log(f"{root}/marks", marks, static=True)
    for curve in chart.curves:
        radius, colors = rr.Radius.ui_points(curve.width / 2), [list(curve.color)]
        kind = rr.Points2D if curve.points else rr.LineStrips2D
        look = kind.from_fields(colors=colors, radii=radius, draw_order=50.0)
        rec.log(_path(root, curve), look, static=True)
        # The legend: a line of text in the curve's colour needs an entity of its own.
        if curve.listed:
            rec.log(_path(f"{root}/legend", curve), _legend(chart, curve), static=True)


def log_chart(rec: rr.RecordingStream, chart: Chart, indexes: list[rr.TimeColumn]) -> None:
    """Log a chart at one moment; `indexes` has one row."""
    x = scale(chart.x, _all([curve.x for curve in chart.curves]))
    y = scale(chart.y, _all([curve.y for curve in chart.curves]))
    root = f"{CHARTS}/{chart.key}"
    _log_frame(rec, root, chart, x, y, indexes)
    for curve in chart.curves:
        places = np.column_stack([x.place(curve.x) * WIDTH, -y.place(curve.y) * HEIGHT])
        if curve.points:
            parts: Any = places[np.isfinite(places).all(axis=1)]
            drawn = rr.Points2D.columns(positions=parts)
        else:
            parts = _strips(places)
            drawn = rr.LineStrips2D.columns(strips=parts)
        rec.send_columns(_path(root, curve), indexes=indexes, columns=drawn.partition([len(parts)]))


def chart_view(key: str, title: str) -> Any:
    """Return the view of one chart."""
    left, above, right, below = MARGIN
    return rrb.Spatial2DView(
        origin=f"{CHARTS}/{key}",
        name=title,
        visual_bounds=rrb.VisualBounds2D(x_range=(-left, WIDTH + right), y_range=(-HEIGHT - above, below)),
    )


def _log_frame(
    rec: rr.RecordingStream, root: str, chart: Chart, x: Scale, y: Scale, indexes: list[rr.TimeColumn]
) -> None:
    """Log grid, marks and the labels of the axes."""
    box = [[0.0, 0.0], [WIDTH, 0.0], [WIDTH, -HEIGHT], [0.0, -HEIGHT], [0.0, 0.0]]
    strips = [np.array(box)]
    places, texts = [[WIDTH / 2, 0.14], [0.0, -HEIGHT - 0.07]], [chart.x.label, chart.y.label]
    for at, text in x.ticks():
        strips.append(np.array([[at * WIDTH, 0.0], [at * WIDTH, -HEIGHT]]))
        places.append([at * WIDTH, 0.05])
        texts.append(text)
    for at, text in y.ticks():
        strips.append(np.array([[0.0, -at * HEIGHT], [WIDTH, -at * HEIGHT]]))
        places.append([-0.1, -at * HEIGHT - 0.02])
        texts.append(text)
    grid = rr.LineStrips2D.columns(strips=strips)
    rec.send_columns(f"{root}/grid", indexes=indexes, columns=grid.partition([len(strips)]))
    marks = rr.Points2D.columns(positions=places, labels=texts)
    rec.send_columns(f"{root}/marks", indexes=indexes, columns=marks.partition([len(places)]))


def _path(root: str, curve: Curve) -> str:
    return f"{root}/{rr.escape_entity_path_part(curve.name)}"


def _legend(chart: Chart, curve: Curve) -> rr.Points2D:
    row = [other.name for other in chart.curves if other.listed].index(curve.name)
    return rr.Points2D(
        [[WIDTH - 0.15, -HEIGHT + 0.06 + 0.07 * row]],
        labels=[curve.name],
        colors=[list(curve.color)],
        radii=rr.Radius.ui_points(3.0),
        show_labels=True,
        draw_order=60.0,
    )


def _strips(places: FloatArray) -> list[FloatArray]:
    """Cut a line where it has no value; what remains of one point is no line."""
    gaps = np.flatnonzero(~np.isfinite(places).all(axis=1))
    edges = np.concatenate([[-1], gaps, [len(places)]])
    parts = [places[before + 1 : gap] for before, gap in pairwise(edges.tolist())]
    return [part for part in parts if len(part) > 1]


def _transformed(values: FloatArray, log: bool) -> FloatArray:
    if not log:
        return np.asarray(values, np.float64)
    return np.log10(values, out=np.full(len(values), np.nan), where=np.asarray(values) > 0)


def _step(span: float) -> float:
    """Return the distance of marks: 1, 2 or 5 times a power of ten, `TICKS` of them or fewer."""
    rough = span / TICKS
    power = 10.0 ** np.floor(np.log10(rough))
    return float(next((m * power for m in (1.0, 2.0, 5.0) if m * power >= rough), 10.0 * power))


def _all(parts: list[FloatArray]) -> FloatArray:
    return np.concatenate(parts) if parts else np.empty(0)
