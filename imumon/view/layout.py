"""Panels as data: which columns make which entities, how they are drawn, and where they stand.

A panel is an entry in `imumon.view.panels.PANELS`; the logger and the blueprint know nothing else, so a panel
for another estimator is one more entry.  Exact SI values go to ``/samples/<panel>`` as float64; where a
person reads another unit (°/s, °, %) the converted values go to ``/view/<panel>`` beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import ColumnArray, FloatArray, IntArray
from imumon.charts import AXIS_COLORS, GREY, Color
from imumon.columns import KNOWN
from imumon.view.items import ViewSetup

SCENE, STRIPS, LINK = "scene", "strips", "link"
"""Places in the first tab; any other place is a tab of that name."""

ROOT_ATTITUDE = "/attitude"
BODY = f"{ROOT_ATTITUDE}/body"
ATTITUDE_STEP_NS = 20_000_000
"""The body is redrawn at the most 50 times a second; every quaternion is in ``/samples/attitude``."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of columns with their times; a timeline that the rows do not have is None."""

    columns: Mapping[str, ColumnArray]
    sample: IntArray | None
    device_ns: IntArray | None
    host_ns: IntArray | None

    @cached_property
    def indexes(self) -> list[rr.TimeColumn]:
        """The time columns of all rows, as Rerun wants them."""
        columns = []
        if self.sample is not None:
            columns.append(rr.TimeColumn("sample", sequence=self.sample))
        if self.device_ns is not None:
            columns.append(rr.TimeColumn("device_time", duration=self.device_ns.view("timedelta64[ns]")))
        if self.host_ns is not None:
            columns.append(rr.TimeColumn("host_time", timestamp=self.host_ns.view("datetime64[ns]")))
        return columns

    def kept(self, keep: npt.NDArray[np.bool_]) -> Rows:
        """Return the times of the rows to keep, without their columns."""
        times = (self.sample, self.device_ns, self.host_ns)
        return Rows({}, *[None if values is None else values[keep] for values in times])

    def thinned(self, step_ns: int) -> npt.NDArray[np.bool_]:
        """Return which rows are the first in a step of time, shape (n,): all when there is no clock."""
        clock = self.host_ns if self.device_ns is None else self.device_ns
        if clock is None:
            return np.ones(len(next(iter(self.columns.values()))), np.bool_)
        step = clock // step_ns
        return np.asarray(np.diff(step, prepend=step[:1] - 1) != 0)

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Return the named columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names]).astype(np.float64, copy=False)


@dataclass(frozen=True, slots=True)
class Window:
    """What the strips show of a timeline: the last seconds, or everything when there is no limit."""

    ranges: Sequence[rrb.VisibleTimeRange] | None
    axis: rrb.TimeAxis | None


TEMPORAL = ("device_time", "host_time")


def last_seconds(seconds: float) -> Window:
    """Return the window that follows the newest data, on whichever timeline is chosen."""
    start = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds)
    end = rrb.TimeRangeBoundary.cursor_relative()
    return Window(
        ranges=[rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in TEMPORAL],
        axis=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
    )


@dataclass(frozen=True, slots=True)
class Panel:
    """One view, and how its data gets there.

    Parameters
    ----------
    key : str
        Unique; the last part of the entity paths.
    place : str
        `SCENE`, `STRIPS`, `LINK`, or the name of a tab.
    columns : tuple of str
        All of these must be there, with a finite value somewhere, for the panel to appear.
    declare : callable
        Logs what does not change: names, colours, bodies.
    log : callable
        Logs rows.
    view : callable
        Makes the view for the blueprint.
    """

    key: str
    place: str
    columns: tuple[str, ...]
    declare: Callable[[rr.RecordingStream], None]
    log: Callable[[rr.RecordingStream, Rows], None]
    view: Callable[[ViewSetup, Window], Any]

    def fed_by(self, columns: Mapping[str, ColumnArray]) -> bool:
        """Tell whether all columns of the panel are among these."""
        return all(name in columns for name in self.columns)


UNIT_TEXT = {"rad/s": "rad/s", "m/s^2": "m/s²", "uT": "µT", "degC": "°C", "arbitrary": "a.u."}
"""Units as a person writes them, by the unit that pint reads."""
DEG = float(np.rad2deg(1.0))
FACTORS = {"": 1.0, "°": DEG, "°/s": DEG, "°/h": 3600.0 * DEG, "°C": 1.0, "°C/h": 3600.0, "µg": 1e6}
FACTORS |= {"1/s": 1.0, "%": 100.0}
"""Units that are drawn, and how many of each are one unit of the columns."""


def unit_text(setup: ViewSetup, column: str) -> str:
    """Return the unit of a column as a person writes it; empty when it has none."""
    known = KNOWN[column].unit if column in KNOWN else ""
    unit = setup.units.get(column, known)
    return "" if unit == "1" else UNIT_TEXT.get(unit, unit)


def titled(name: str, unit: str) -> str:
    """Return a title with its unit in brackets."""
    return f"{name} [{unit}]" if unit else name


def strip(
    key: str,
    title: str,
    series: Mapping[str, str],
    *,
    colors: Sequence[Color] = tuple(AXIS_COLORS.values()),
    shown: str | None = None,
    place: str = STRIPS,
    steps: bool = False,
    y_range: tuple[float, float] | None = None,
    beside: str | None = None,
    limits: tuple[float, float] | None = None,
    sparse: bool = False,
) -> Panel:
    """Return a panel that draws columns over time.

    Parameters
    ----------
    series : mapping of str to str
        Column to name in the legend.
    shown : str, optional
        Draw the values in this unit of `FACTORS`, and keep the exact ones in ``/samples`` all the same.
    steps : bool
        Hold each value until the next instead of joining them by straight lines.
    y_range : (low, high), optional
        Fixed range of the y axis; it follows the data otherwise.
    beside : str, optional
        Entity of another panel, drawn in the same view.
    limits : (low, high), optional
        Two level lines, in the unit that is drawn.
    sparse : bool
        Most rows have no value: draw points, and log only rows that have one.
    """
    names = tuple(series)
    exact, drawn = f"/samples/{key}", f"/view/{key}" if shown else f"/samples/{key}"

    def declare(rec: rr.RecordingStream) -> None:
        style: Any = {
            "names": list(series.values()),
            "colors": [list(color) for color in colors[: len(names)]],
        }
        if sparse:
            look: Any = rr.SeriesPoints(**style, marker_sizes=[2.0] * len(names))
        else:
            mode = rr.components.InterpolationMode.StepAfter if steps else None
            look = rr.SeriesLines(**style, widths=[1.6] * len(names), interpolation_mode=mode)
        rec.log(drawn, look, static=True)
        if limits:
            grey = rr.SeriesLines(names=["limit"] * 2, colors=[list(GREY)] * 2, widths=[1.0] * 2)
            rec.log(f"{drawn}/limits", grey, static=True)

    def log(rec: rr.RecordingStream, rows: Rows) -> None:
        values = rows.matrix(names)
        if sparse:
            kept: Any = np.isfinite(values).any(axis=1)
            if not kept.any():
                return
            values, rows = values[kept], rows.kept(kept)
        indexes = rows.indexes
        rec.send_columns(exact, indexes=indexes, columns=rr.Scalars.columns(scalars=values))
        if shown:
            scaled = rr.Scalars.columns(scalars=values * FACTORS[shown])
            rec.send_columns(drawn, indexes=indexes, columns=scaled)
        if limits:
            ends = np.zeros(len(values), np.bool_)
            ends[[0, -1]] = True
            levels = np.tile(limits, (int(ends.sum()), 1))
            lines = rr.Scalars.columns(scalars=levels)
            rec.send_columns(f"{drawn}/limits", indexes=rows.kept(ends).indexes, columns=lines)

    def view(setup: ViewSetup, window: Window) -> Any:
        unit = shown or unit_text(setup, names[0])
        return series_view(drawn, titled(title, unit), window, y_range, beside)

    return Panel(key, place, names, declare, log, view)


def series_view(
    origin: str,
    name: str,
    window: Window,
    y_range: tuple[float, float] | None = None,
    beside: str | None = None,
) -> Any:
    """Return a view of series over time with the legend in its corner."""
    return rrb.TimeSeriesView(
        origin="/" if beside else origin,
        contents=[f"{origin}/**", *([beside] if beside else [])],
        name=name,
        time_ranges=window.ranges,
        axis_x=window.axis,
        axis_y=rrb.ScalarAxis(range=y_range) if y_range else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )


@dataclass(frozen=True, slots=True)
class Reference:
    """What a body is drawn in: its entity, the title of the view, names of the axes.

    `up` says which way the third axis points, 1 or -1; None: as the device's axes do.
    """

    root: str
    title: str
    axes: tuple[str, str, str]
    up: float | None = None


DEVICE = Reference(ROOT_ATTITUDE, "Attitude: body in the device's reference frame", ("X", "Y", "Z"))
EARTH = Reference(
    "/attitude_estimate", "Attitude by the estimator: the device sends none", ("east", "north", "up"), up=1.0
)


def attitude(
    key: str,
    columns: tuple[str, ...],
    quaternions: Callable[[FloatArray], FloatArray],
    reference: Reference = DEVICE,
) -> Panel:
    """Return a panel that turns a solid body; `quaternions` makes x, y, z, w of the columns, (n, 4)."""
    body = f"{reference.root}/body"

    def declare(rec: rr.RecordingStream) -> None:
        rec.log(f"/samples/{key}", rr.SeriesLines(names=list(columns)), static=True)
        draw_body(rec, body)
        draw_reference(rec, reference)

    def log(rec: rr.RecordingStream, rows: Rows) -> None:
        values = rows.matrix(columns)
        rec.send_columns(f"/samples/{key}", indexes=rows.indexes, columns=rr.Scalars.columns(scalars=values))
        keep: Any = np.isfinite(values).all(axis=1) & rows.thinned(ATTITUDE_STEP_NS)
        if keep.any():
            turned = rr.Transform3D.columns(quaternion=quaternions(values[keep]))
            rec.send_columns(body, indexes=rows.kept(keep).indexes, columns=turned)

    def view(setup: ViewSetup, window: Window) -> Any:  # noqa: ARG001 - a scene has no time axis
        up = reference.up or (-1.0 if setup.z_down else 1.0)
        return attitude_view(reference, up)

    return Panel(key, SCENE, columns, declare, log, view)


def draw_body(rec: rr.RecordingStream, body: str) -> None:
    """Log the housing with its connector, and its axes."""
    housing = rr.Boxes3D(
        centers=[[0.0, 0.0, 0.0], [-0.62, 0.0, 0.0], [0.42, 0.0, 0.0]],
        half_sizes=[[0.5, 0.34, 0.13], [0.12, 0.12, 0.07], [0.05, 0.3, 0.135]],
        colors=[[95, 105, 125], [200, 165, 70], [230, 230, 235]],
        fill_mode="solid",
    )
    rec.log(f"{body}/housing", housing, static=True)
    axes = np.eye(3)
    body_axes = rr.Arrows3D(
        origins=0.1 * axes,
        vectors=0.95 * axes,
        colors=[list(color) for color in AXIS_COLORS.values()],
        labels=["x", "y", "z"],
        radii=0.022,
    )
    rec.log(f"{body}/axes", body_axes, static=True)


def draw_reference(rec: rr.RecordingStream, reference: Reference) -> None:
    """Log the axes that the body turns in."""
    if reference.up is not None:
        rec.log(reference.root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    arrows = rr.Arrows3D(
        vectors=1.5 * np.eye(3),
        colors=[list(GREY)],
        labels=list(reference.axes),
        radii=0.008,
        show_labels=True,
    )
    rec.log(f"{reference.root}/reference", arrows, static=True)


def attitude_view(reference: Reference, up: float) -> Any:
    """Return the 3-D view, seen from above and ahead whichever way the third axis points."""
    return rrb.Spatial3DView(
        origin=reference.root,
        name=reference.title,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, color=[*GREY, 60]),
        eye_controls=rrb.EyeControls3D(
            position=[1.8, up * 1.7, up * 1.2], look_target=[0, 0, 0.08 * up], eye_up=[0, 0, up]
        ),
    )


def from_wxyz(values: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w from w, x, y, z, shape (n, 4)."""
    return np.ascontiguousarray(values[:, [1, 2, 3, 0]])


def from_euler(values: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w, (n, 4), from roll, pitch, yaw in rad (turns about z, then y, then x)."""
    cr, cp, cy = np.cos(values / 2).T
    sr, sp, sy = np.sin(values / 2).T
    return np.column_stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


OTHER = "/samples/other"
"""Float columns that no panel draws: one entity each, in a tab of their own."""
INTEGERS = "/samples/integers"
"""Integer columns (device time as sent, counters, status), exact, for those who read the recording."""
