"""Panels as data: which columns make which entities, how they are drawn, and where they stand.

A panel is an entry in `imumon.view.panels.PANELS`; the logger and the blueprint know nothing else, so a panel
for another estimator is one more entry.  Exact SI values go to ``/samples/<panel>`` as float64; where a
person reads another unit (°/s, °, %) the converted values go to ``/view/<panel>`` beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np
import pyarrow as pa
import rerun as rr

from imumon.blocks import BoolArray, ColumnArray, FloatArray, IntArray
from imumon.charts import COLOR_NAMES, GREY, Color
from imumon.columns import KNOWN
from imumon.view.cards import DIGITS, Reading
from imumon.view.extent import LEAST_STEPS, Reach, declare_extent, entity
from imumon.view.items import Instant, ViewSetup, first_of_steps
from imumon.view.window import Window, series_view

FIRST = "Live"
"""The first tab."""
SCENE, STRIPS = "scene", "strips"
"""Places in the first tab; any other place is a tab of that name."""
OTHER = "/samples/other"
"""Float columns that no panel draws: one entity each, in a tab of their own."""
INTEGERS = "/samples/integers"
"""Integer columns (device time as sent, counters, status), exact, for those who read the recording."""

SCALARS = rr.Scalars.descriptor_scalars()
BAND_STEP_NS = 200_000_000
"""Estimates with a band are logged at the most five times a second; a replay gives every value."""
TWO_SIGMA = 4.0
"""Rerun draws a band of one square root of the variance on either side."""


def tab_of(place: str) -> str:
    """Return the name of the tab in which a place is."""
    return FIRST if place in (SCENE, STRIPS) else place


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of columns with their times; a timeline that the rows do not have is None.

    With `step_ns` they are for a recording, which is a picture (the wire has every byte): of each step
    of time only the extremes are drawn, so that spikes stay, and in one unit.  What began before them, at
    `before_ns`, the clock of the row before, has been drawn.
    """

    columns: Mapping[str, ColumnArray]
    sample: IntArray | None
    device_ns: IntArray | None
    host_ns: IntArray | None
    step_ns: int = 0
    before_ns: int | None = None

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

    @property
    def clock(self) -> IntArray | None:
        """Device time, or host time where there is none, ns."""
        return self.host_ns if self.device_ns is None else self.device_ns

    def kept(self, keep: BoolArray | IntArray) -> Rows:
        """Return the times of the rows to keep, without their columns; the same for the same rows."""
        key = keep.dtype.char, keep.tobytes()
        if key not in self._kept:
            times = (self.sample, self.device_ns, self.host_ns)
            sample, device_ns, host_ns = (None if values is None else values[keep] for values in times)
            self._kept[key] = Rows({}, sample, device_ns, host_ns)
        return self._kept[key]

    def send(self, rec: rr.RecordingStream, entity: str, values: FloatArray) -> None:
        """Log values at the times of these rows, (n,) or (n, lines).

        The column is that of ``rr.Scalars.columns``, which takes seven times as long to find out its shape.
        """
        flat = np.ascontiguousarray(values, np.float64).ravel()
        offsets = np.arange(len(values) + 1, dtype=np.int32) * np.int32(flat.size // max(len(values), 1))
        column = rr.ComponentColumn(SCALARS, rr.components.ScalarBatch(pa.array(flat)), offsets=offsets)
        rec.send_columns(entity, indexes=self.indexes, columns=[column])

    @cached_property
    def _kept(self) -> dict[tuple[str, bytes], Rows]:
        """What was kept so far: most panels keep the same rows, and times cost as much as values."""
        return {}

    def extremes(self, values: FloatArray) -> BoolArray:
        """Return which rows have the least or greatest value of a line in its step, or begin one, (n,)."""
        clock = self.clock
        if not self.step_ns or clock is None:
            return np.ones(len(values), np.bool_)
        keep = self.thinned(self.step_ns)
        starts = np.flatnonzero(keep[1:]) + 1
        for start, stop in pairwise([0, *starts.tolist(), len(values)]):
            part = values[start:stop]
            keep[start + np.argmin(np.nan_to_num(part, nan=np.inf), axis=0)] = True
            keep[start + np.argmax(np.nan_to_num(part, nan=-np.inf), axis=0)] = True
        return keep

    def thinned(self, step_ns: int) -> BoolArray:
        """Return which rows are the first in a step of time, shape (n,): all when there is no clock."""
        clock = self.clock
        if clock is None:
            return np.ones(len(next(iter(self.columns.values()))), np.bool_)
        return first_of_steps(clock, max(step_ns, self.step_ns), self.before_ns)

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Return the named columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names]).astype(np.float64, copy=False)


def at_instants(*instants: Instant) -> Rows:
    """Return the times of moments that know the same timelines, a row each, without columns."""
    times = [(at.sample, at.device_ns, at.host_ns) for at in instants]
    sample, device_ns, host_ns = (
        None if column[0] is None else np.array(column, np.int64) for column in zip(*times, strict=True)
    )
    return Rows({}, sample, device_ns, host_ns)


def log_markdown(rec: rr.RecordingStream, entity: str, texts: Sequence[str], times: Rows) -> None:
    """Log a text as it is from each moment on."""
    text = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
    rec.send_columns(entity, indexes=times.indexes, columns=text)


class Panel(Protocol):
    """One view, and how its data gets there."""

    @property
    def key(self) -> str:
        """Unique; the last part of the entity paths."""

    @property
    def place(self) -> str:
        """`SCENE`, `STRIPS`, or the name of a tab."""

    @property
    def drawn(self) -> str:
        """Entity of what is drawn."""

    @property
    def columns(self) -> Sequence[str]:
        """All of these must be there for the panel to appear."""

    def says(self, rows: Rows) -> bool:
        """Return whether the rows have something to show: a value of each column."""

    def declare(self, rec: rr.RecordingStream, *, live: bool) -> None:
        """Log what does not change: names, colours, bodies; live also the names of exact values."""

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Log rows."""

    def reach(self, rows: Rows) -> Reach | None:
        """Return what the vertical axis has to show of the rows; None where there is no such axis."""

    def readings(self, setup: ViewSetup) -> Sequence[Reading]:
        """Return what the card of its tab shows as numbers."""

    def view(self, setup: ViewSetup, window: Window) -> Any:
        """Return the view for the blueprint."""


DEG = float(np.rad2deg(1.0))
FACTORS = {"": 1.0, "°": DEG, "°/s": DEG, "°/h": 3600.0 * DEG, "°C": 1.0, "°C/h": 3600.0, "µg": 1e6}
FACTORS |= {"1/s": 1.0, "%": 100.0}
"""Units that are drawn, and how many of each are one unit of the columns."""
READ_AS = {"rad": ("°", DEG), "rad/s": ("°/s", DEG), "rad/s^2": ("°/s²", DEG), "deg": ("°", 1.0)}
READ_AS |= {"m/s^2": ("m/s²", 1.0), "uT": ("µT", 1.0), "degC": ("°C", 1.0), "arbitrary": ("a.u.", 1.0)}
READ_AS |= {"1": ("", 1.0)}
"""The unit that a person reads for one of a column, and how many of it one is; others as they are."""


def read_as(setup: ViewSetup, column: str) -> tuple[str, float]:
    """Return the unit in which a person reads a column, empty without one, and how many of it are one."""
    known = KNOWN[column].unit if column in KNOWN else ""
    unit = setup.units.get(column, known)
    return READ_AS.get(unit, (unit, 1.0))


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a panel: its column, its name in the legend, its colour, the column of its sigma."""

    column: str
    name: str
    color: Color
    sd: str | None = None


@dataclass(frozen=True, slots=True)
class Strip:
    """A panel that draws columns over time."""

    key: str
    title: str
    lines: tuple[Line, ...]
    unit: str | None = None
    """Draw the values in this unit of `FACTORS`, and keep the exact ones in ``/samples`` all the same."""
    place: str = STRIPS
    look: Literal["lines", "steps", "points"] = "lines"
    """Join the values by straight lines, or hold each until the next; or draw points and log only the rows
    that have a value, where most have none."""
    beside: str | None = None
    """Entity of another panel, drawn in the same view."""
    y_range: tuple[float, float] | None = None
    """Fixed range of the y axis; it follows the data otherwise."""
    limits: tuple[float, float] | None = None
    """Two level lines, in the unit that is drawn."""
    least: float = 0.0
    """The axis spans at least as much, in the unit that is drawn."""
    floor: float | None = None
    """The axis begins here."""
    card: str = ""
    """What the card of the tab calls the present values; it does not show them without."""
    headline: bool = False
    """Whether the card shows the last line's value large."""
    silent: float | None = None
    """While the columns have no other value there is nothing to say, and no panel."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that are drawn, and those of their sigmas."""
        return tuple(name for line in self.lines for name in (line.column, line.sd) if name is not None)

    def says(self, rows: Rows) -> bool:
        """Return whether each column has a value, and one of them another than `silent`."""
        values = rows.matrix(self.columns)
        finite = np.isfinite(values)
        return bool(finite.any(axis=0).all() and (finite & (values != self.silent)).any())

    @property
    def exact(self) -> str:
        """Entity of the exact values."""
        return f"/samples/{self.key}"

    @property
    def drawn(self) -> str:
        """Entity of what is drawn."""
        return self.exact if self.unit is None else f"/view/{self.key}"

    def declare(self, rec: rr.RecordingStream, *, live: bool) -> None:  # noqa: ARG002
        """Log names, colours and styles."""
        style: Any = {
            "names": [line.name for line in self.lines],
            "colors": [list(line.color) for line in self.lines],
        }
        if self.look == "points":
            look: Any = rr.SeriesPoints(**style, marker_sizes=[2.0] * len(self.lines))
        else:
            mode = rr.components.InterpolationMode.StepAfter if self.look == "steps" else None
            look = rr.SeriesLines(**style, widths=[1.6] * len(self.lines), interpolation_mode=mode)
        rec.log(self.drawn, look, static=True)
        if self.limits:
            grey = rr.SeriesLines(names=["limit"] * 2, colors=[list(GREY)] * 2, widths=[1.0] * 2)
            rec.log(f"{self.drawn}/limits", grey, static=True)
        declare_extent(rec, self.drawn)

    def reach(self, rows: Rows) -> Reach:
        """Return the lines, in the unit that is drawn."""
        values = self._factor * rows.matrix([line.column for line in self.lines])
        least = LEAST_STEPS * 10.0 ** -DIGITS[self.unit] if self.unit in DIGITS else 0.0
        return Reach(values, np.zeros_like(values), max(self.least, least), self.floor)

    def readings(self, setup: ViewSetup) -> list[Reading]:
        """Return one for each line, when the card is to show them."""
        if not self.card:
            return []
        last = self.lines[-1]
        return [
            Reading(
                self.card, line.name, line.column, line.sd, self._unit(setup), self._factor,
                self.headline and line is last,
            )
            for line in self.lines
        ]  # fmt: skip

    @property
    def _factor(self) -> float:
        return FACTORS[self.unit or ""]

    def _unit(self, setup: ViewSetup) -> str:
        return read_as(setup, self.lines[0].column)[0] if self.unit is None else self.unit

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Log the exact values, and those in the unit that is drawn."""
        values = rows.matrix(self.columns)
        exact = self.unit is None or not rows.step_ns
        kept: Any = np.isfinite(values).any(axis=1) if self.look == "points" else rows.extremes(values)
        if not kept.any():
            return
        values, rows = values[kept], rows.kept(kept)
        if exact:
            rows.send(rec, self.exact, values)
        if self.unit is not None:
            rows.send(rec, self.drawn, values * self._factor)
        if self.limits:
            ends = np.zeros(len(values), np.bool_)
            ends[[0, -1]] = True
            levels = np.tile(self.limits, (int(ends.sum()), 1))
            rows.kept(ends).send(rec, f"{self.drawn}/limits", levels)

    def view(self, setup: ViewSetup, window: Window) -> Any:
        """Return the view, its unit and the colours of its lines in the title: a legend would cover data."""
        unit = self._unit(setup)
        title = f"{self.title} [{unit}]" if unit else self.title
        if len(self.lines) > 1:
            title += ": " + ", ".join(f"{line.name} {COLOR_NAMES[line.color]}" for line in self.lines)
        beside = [self.beside] if self.beside else []
        ends = [entity(drawn.removesuffix("/**")) for drawn in (self.drawn, *beside)]
        return series_view(self.drawn, title, window, self.y_range, beside, ends)


@dataclass(frozen=True, slots=True)
class Bands(Strip):
    """A panel that draws estimates inside their 2σ bands, in a `unit`."""

    def declare(self, rec: rr.RecordingStream, *, live: bool) -> None:
        """Log names and colours; each band is an entity of its own."""
        if live:
            rec.log(self.exact, rr.SeriesLines(names=list(self.columns)), static=True)
        for line in self.lines:
            style = rr.Measurements.from_fields(names=[line.name], colors=[list(line.color)], widths=[1.6])
            rec.log(self._entity(line), style, static=True)
        declare_extent(rec, self.drawn)

    def reach(self, rows: Rows) -> Reach:
        """Return the estimates with the 2σ about them."""
        found = Strip.reach(self, rows)
        zero = np.zeros(len(found.values))
        sds = [zero if line.sd is None else 2.0 * self._factor * rows.columns[line.sd] for line in self.lines]
        return replace(found, reach=np.nan_to_num(np.column_stack(sds), nan=0.0))

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Log some of the exact values, and the bands, five times a second."""
        due = rows.thinned(BAND_STEP_NS)
        if not due.any():
            return
        if not rows.step_ns:
            rows.kept(due).send(rec, self.exact, rows.matrix(self.columns)[due])
        for line in self.lines:
            value = self._factor * rows.columns[line.column]
            sd = np.zeros_like(value) if line.sd is None else self._factor * rows.columns[line.sd]
            keep = due & np.isfinite(value) & np.isfinite(sd)
            if keep.any():
                measured = rr.Measurements.columns(values=value[keep], variances=TWO_SIGMA * sd[keep] ** 2)
                rec.send_columns(self._entity(line), indexes=rows.kept(keep).indexes, columns=measured)

    def _entity(self, line: Line) -> str:
        """Return the entity of a band; its name may be that of a session, with spaces."""
        return f"{self.drawn}/{rr.escape_entity_path_part(line.name)}"
