"""Panels as data: which columns make which entities, how they are drawn, and where they stand.

A panel is an entry of `panels.yaml`; the logger and the blueprint know nothing else, so a panel for another
estimator is one more entry.  Values go to ``/samples/<panel>`` in the unit of their column, or to
``/view/<panel>`` in the unit that a person reads (°/s, °, %).
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import FloatArray
from imumon.charts import AXIS_COLORS, COLOR_NAMES, GREY, Color
from imumon.columns import KNOWN
from imumon.geodesy import quaternions

from .cards import DIGITS, Reading
from .items import ViewSetup
from .rows import Rows
from .window import RECENT_S, Window, declare_extent, entity, series_view

FIRST, OTHER = "Live", "Other"
"""The first tab, and that of the columns that no panel draws."""
SCENE, STRIPS = "scene", "strips"
"""Places in the first tab; any other place is a tab of that name."""

BAND_STEP_NS = 200_000_000
"""Estimates with a band are logged at the most five times a second; a replay gives every value."""
TWO_SIGMA = 4.0
"""Rerun draws a band of one square root of the variance on either side."""
BODY_STEP_NS = 20_000_000
"""The body is redrawn at the most 50 times a second."""
DEVICE = "/attitude"
"""Entity of the reference frame of the device."""
SPIKES_STAY = rr.components.AggregationPolicy.MinMax
"""Where several samples fall on one pixel their extremes are drawn: the mean would hide spikes and noise."""
LEAST_STEPS = 4.0
"""The axis spans at least so many steps of the last digit of a card."""
ROUNDING = 1e-6
"""And at least this share of the value: digits of a float32 end there."""


def tab_of(place: str) -> str:
    """Return the name of the tab in which a place is."""
    return FIRST if place in (SCENE, STRIPS) else place


DEG = float(np.rad2deg(1.0))
FACTORS = {"°": DEG, "°/s": DEG, "°/s²": DEG, "°/h": 3600.0 * DEG, "°C/h": 3600.0, "µrad": 1e6, "%": 100.0}
"""How many of a unit that is drawn are one unit of the columns, where that is not one."""
IN_DEGREES = {"rad": "°", "rad/s": "°/s", "rad/s^2": "°/s²"}
READ_AS = {**IN_DEGREES, "deg": "°", "m/s^2": "m/s²", "uT": "µT", "degC": "°C", "arbitrary": "a.u.", "1": ""}
"""The unit that a person reads for one of a column; others as they are."""


def read_as(setup: ViewSetup, column: str) -> tuple[str, float]:
    """Return the unit in which a person reads a column, empty without one, and how many of it are one."""
    known = KNOWN[column].unit if column in KNOWN else ""
    unit = setup.units.get(column, known)
    return READ_AS.get(unit, unit), DEG if unit in IN_DEGREES else 1.0


class Line(NamedTuple):
    """One line of a panel: its column, its name in the legend, its colour, the column of its sigma."""

    column: str
    name: str
    color: Color | None  # None: the viewer chooses one
    sd: str | None = None


@dataclass(frozen=True)
class Strip:
    """A panel that draws columns over time; `panels.yaml` explains the fields.

    The key, the last part of the entity paths, is unique.
    """

    key: str
    title: str
    lines: tuple[Line, ...]
    unit: str | None = None
    place: str = STRIPS
    look: Literal["lines", "steps", "points"] = "lines"
    beside: str | None = None
    limits: tuple[float, ...] = ()
    least: float = 0.0
    card: str = ""
    headline: bool = False
    silent: float | None = None
    without: str = ""

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that are drawn, and those of their sigmas: all must be there for a panel to appear."""
        return tuple(name for line in self.lines for name in (line.column, line.sd) if name is not None)

    def has_values(self, rows: Rows) -> bool:
        """Return whether each column has a value, one another than `silent`, and none is `without`."""
        if self.without in rows.columns:
            return False
        values = rows.matrix(self.columns)
        finite = np.isfinite(values)
        return bool(finite.any(axis=0).all() and (finite & (values != self.silent)).any())

    @property
    def drawn(self) -> str:
        """Entity of what is drawn."""
        return f"/samples/{self.key}" if self.unit is None else f"/view/{self.key}"

    def declare(self, rec: rr.RecordingStream) -> None:
        """Log what does not change: names, colours and styles."""
        names = [line.name for line in self.lines]
        colors = [line.color for line in self.lines if line.color is not None] or None
        look: Any = rr.SeriesPoints(names=names, colors=colors, marker_sizes=[2.0] * len(names))
        steps = rr.components.InterpolationMode.StepAfter
        if self.look != "points":
            look = rr.SeriesLines(
                names=names,
                colors=colors,
                widths=[1.6] * len(names),
                interpolation_mode=steps if self.look == "steps" else None,
                aggregation_policy=SPIKES_STAY,
            )
        rec.log(self.drawn, look, static=True)
        if self.limits:
            grey = rr.SeriesLines(names=["limit"] * 2, colors=[list(GREY)] * 2, widths=[1.0] * 2)
            rec.log(f"{self.drawn}/limits", grey, static=True)
        declare_extent(rec, self.drawn)

    def ends(self, rows: Rows) -> tuple[float, float] | None:
        """Return how far the vertical axis must reach over the last seconds, in the unit that is drawn.

        None without a value, and for the columns that no panel draws.
        """
        if self.place == OTHER:
            return None
        values = self._factor * rows.matrix([line.column for line in self.lines])
        half = np.zeros_like(values)
        for at, line in enumerate(self.lines):
            if line.sd is not None:
                half[:, at] = 2.0 * self._factor * rows.columns[line.sd]
        known = np.isfinite(values + half)
        if rows.clock is not None:
            known &= (rows.clock >= rows.clock[-1] - 1e9 * RECENT_S)[:, None]
        if not known.any():
            return None
        low, high = float((values - half)[known].min()), float((values + half)[known].max())
        digit = 10.0 ** -DIGITS[self.unit] if self.unit in DIGITS else 0.0
        span = max(self.least, LEAST_STEPS * digit, ROUNDING * max(abs(low), abs(high)))
        beyond = max(0.0, span - (high - low)) / 2
        return low - beyond, high + beyond

    def readings(self, setup: ViewSetup) -> list[Reading]:
        """Return what the card of its tab shows: a number for each line."""
        if not self.card:
            return []
        last = self.lines[-1]
        unit, factor = self.unit_read(setup), self._factor
        return [
            Reading(self.card, one.name, one.column, one.sd, unit, factor, self.headline and one is last)
            for one in self.lines
        ]

    def unit_read(self, setup: ViewSetup) -> str:
        """Return the unit that is drawn."""
        return read_as(setup, self.lines[0].column)[0] if self.unit is None else self.unit

    @property
    def _factor(self) -> float:
        return FACTORS.get(self.unit or "", 1.0)

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Log the values in the unit that is drawn."""
        values = self._factor * rows.matrix(self.columns)
        kept = rows.extremes(values)
        if self.look == "points" or self.place == OTHER:
            kept &= np.isfinite(values).any(axis=1)
        if not kept.any():
            return
        values, rows = values[kept], rows.kept(kept)
        rows.send(rec, self.drawn, values)
        if self.limits:
            ends = rows.kept(np.array([0, -1]))
            ends.send(rec, f"{self.drawn}/limits", np.array([self.limits, self.limits]))

    def view(self, setup: ViewSetup, window: Window) -> Any:
        """Return the view, its unit and the colours of its lines in the title: a legend would cover data."""
        unit = self.unit_read(setup)
        title = f"{self.title} [{unit}]" if unit else self.title
        if len(self.lines) > 1:
            title += ": " + ", ".join(
                f"{line.name} {COLOR_NAMES[line.color]}" for line in self.lines if line.color
            )
        beside = [self.beside] if self.beside else []
        ends = [entity(drawn.removesuffix("/**")) for drawn in (self.drawn, *beside)]
        return series_view(self.drawn, title, window, beside, ends)


@dataclass(frozen=True)
class Bands(Strip):
    """A panel that draws estimates inside their 2σ bands, in a `unit`."""

    def declare(self, rec: rr.RecordingStream) -> None:
        """Log names and colours; each band is an entity of its own."""
        for line in self.lines:
            color = None if line.color is None else [line.color]
            style = rr.Measurements.from_fields(names=[line.name], colors=color, widths=[1.6])
            rec.log(self._entity(line), style, static=True)
        declare_extent(rec, self.drawn)

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Log values and bands, five times a second."""
        due = rows.thinned(BAND_STEP_NS)
        for line in self.lines:
            value = self._factor * rows.columns[line.column]
            sd = np.zeros_like(value) if line.sd is None else self._factor * rows.columns[line.sd]
            keep = due & np.isfinite(value) & np.isfinite(sd)
            if keep.any():
                measured = rr.Measurements.columns(values=value[keep], variances=TWO_SIGMA * sd[keep] ** 2)
                rec.send_columns(self._entity(line), indexes=rows.kept(keep).indexes, columns=measured)

    def _entity(self, line: Line) -> str:  # its name may be that of a session, with spaces
        return f"{self.drawn}/{rr.escape_entity_path_part(line.name)}"


class Attitude(NamedTuple):
    """A panel that turns a solid body by a quaternion w, x, y, z, or by roll, pitch and yaw."""

    key: str
    columns: tuple[str, ...]
    root: str = DEVICE  # entity of the reference frame that the body is drawn in
    title: str = "Attitude: body in the device's reference frame"
    axes: tuple[str, str, str] = ("X", "Y", "Z")  # names of the reference axes
    up: float | None = None  # which way the third axis points, 1 or -1; None: as the axes of the device do
    place: str = SCENE

    def has_values(self, rows: Rows) -> bool:
        """Return whether each column has a value."""
        return bool(np.isfinite(rows.matrix(self.columns)).any(axis=0).all())

    def declare(self, rec: rr.RecordingStream) -> None:
        """Log the housing with its connector and axes, and the reference axes."""
        axes, colors = np.eye(3), [list(color) for color in AXIS_COLORS.values()]
        housing = rr.Boxes3D(
            centers=[[0.0, 0.0, 0.0], [-0.62, 0.0, 0.0], [0.42, 0.0, 0.0]],
            half_sizes=[[0.5, 0.34, 0.13], [0.12, 0.12, 0.07], [0.05, 0.3, 0.135]],
            colors=[[95, 105, 125], [200, 165, 70], [230, 230, 235]],
            fill_mode="solid",
        )
        body_axes = rr.Arrows3D(
            origins=0.1 * axes, vectors=0.95 * axes, colors=colors, labels=list(AXIS_COLORS), radii=0.022
        )
        reference = rr.Arrows3D(
            vectors=1.5 * axes, colors=[list(GREY)], labels=list(self.axes), radii=0.008, show_labels=True
        )
        if self.up is not None:
            rec.log(self.root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rec.log(f"{self.drawn}/housing", housing, static=True)
        rec.log(f"{self.drawn}/axes", body_axes, static=True)
        rec.log(f"{self.root}/reference", reference, static=True)

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Turn the body."""
        values = rows.matrix(self.columns)
        keep: Any = np.isfinite(values).all(axis=1) & rows.thinned(BODY_STEP_NS)
        if keep.any():
            turned = rr.Transform3D.columns(quaternion=xyzw(values[keep]))
            rec.send_columns(self.drawn, indexes=rows.kept(keep).indexes, columns=turned)

    @property
    def drawn(self) -> str:
        """Entity of the body."""
        return f"{self.root}/body"

    def view(self, setup: ViewSetup, _: Window) -> Any:
        """Return the 3-D view, seen from above and ahead whichever way the reference frame has z."""
        up = self.up or (-1.0 if setup.z_down else 1.0)
        return rrb.Spatial3DView(
            origin=self.root,
            name=self.title,
            line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, color=[*GREY, 60]),
            eye_controls=rrb.EyeControls3D(
                position=[1.8, up * 1.7, up * 1.2], look_target=[0, 0, 0.08 * up], eye_up=[0, 0, up]
            ),
        )


def xyzw(values: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w, (n, 4), from w, x, y, z, or from roll, pitch, yaw in rad."""
    known = values if values.shape[1] == 4 else quaternions(values).T
    return np.ascontiguousarray(known[:, [1, 2, 3, 0]])
