"""The map of a foreign table: which column is what, in which unit.  Described in docs/import-map.md."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, NonNegativeInt, model_validator

from imumon.columns import KNOWN
from imumon.config import StrictModel
from imumon.recordings.units import Unit, parse_unit

TIMESTAMPS = "iso8601"
"""In place of a unit of time: the column holds dates with times."""


def _one_is_a_unit(value: Any) -> Any:
    return "1" if value == 1 and not isinstance(value, bool) else value


def _check_unit(text: str, targets: tuple[str, ...]) -> str:
    if text not in targets:
        parse_unit(text, targets[0])
    return text


def _check_time_unit(text: str) -> str:
    if text != TIMESTAMPS:
        parse_unit(text, "ns")
    return text


Three = Annotated[list[str], Field(min_length=3, max_length=3)]
RateUnit = Annotated[str, AfterValidator(partial(_check_unit, targets=("rad/s",)))]
ForceUnit = Annotated[str, AfterValidator(partial(_check_unit, targets=("m/s^2",)))]
FieldUnit = Annotated[
    str, BeforeValidator(_one_is_a_unit), AfterValidator(partial(_check_unit, targets=("uT", "1")))
]
TemperatureUnit = Annotated[str, AfterValidator(partial(_check_unit, targets=("degC",)))]
PressureUnit = Annotated[str, AfterValidator(partial(_check_unit, targets=("Pa",)))]
"""Units are checked where the map is read, so that the error names the line."""


class TimeColumn(StrictModel):
    """The column of time; `backwards` says what a time before the one above means."""

    column: str
    unit: Annotated[str, AfterValidator(_check_time_unit)]
    backwards: Literal["error", "segment"] = "error"


class Gyro(StrictModel):
    """Angular rate about x, y, z."""

    columns: Three
    unit: RateUnit


class Accel(StrictModel):
    """Specific force along x, y, z."""

    columns: Three
    unit: ForceUnit


class Mag(StrictModel):
    """Magnetic field along x, y, z; unit 1 when the sensor has arbitrary units."""

    columns: Three
    unit: FieldUnit


class Temperature(StrictModel):
    """Temperature of the sensor, one for all or one for each of x, y, z."""

    columns: Annotated[list[str], Field(min_length=1, max_length=3)]
    unit: TemperatureUnit

    @model_validator(mode="after")
    def _one_or_three(self) -> Temperature:
        if len(self.columns) == 2:
            raise ValueError("temperature has one column, or three for x, y, z; got 2")
        return self


class Pressure(StrictModel):
    """Static pressure."""

    columns: Annotated[list[str], Field(min_length=1, max_length=1)]
    unit: PressureUnit


class Attitude(StrictModel):
    """Attitude as the device reports it: quaternion w, x, y, z with unit 1, or roll, pitch, yaw."""

    columns: Annotated[list[str], Field(min_length=3, max_length=4)]
    unit: Annotated[str, BeforeValidator(_one_is_a_unit)]

    @model_validator(mode="after")
    def _unit_fits(self) -> Attitude:
        if len(self.columns) == 4 and self.unit != "1":
            raise ValueError(f"a quaternion (4 columns) has unit 1, got {self.unit!r}")
        if len(self.columns) == 3:
            parse_unit(self.unit, "rad")
        return self


class TextFormat(StrictModel):
    """How the text is laid out, where it is not commas below one line of names."""

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | Literal["whitespace"] = ","
    header: bool = True
    skip_rows: NonNegativeInt = 0
    columns: list[str] | None = None

    @model_validator(mode="after")
    def _names_come_from_one_place(self) -> TextFormat:
        if self.header and self.columns is not None:
            raise ValueError("csv.columns names the columns of a table without header; add header: false")
        if not self.header and self.columns is None:
            raise ValueError("a table without header needs csv.columns: the names of all its columns")
        if twice := [name for name, count in Counter(self.columns or []).items() if count > 1]:
            raise ValueError(f"csv.columns names {', '.join(twice)} more than once")
        return self


@dataclass(frozen=True, slots=True)
class Source:
    """A column of the table and the canonical column that it becomes."""

    column: str
    target: str
    unit: Unit


class TableMap(StrictModel):
    """The whole map."""

    time: TimeColumn | None = None
    rate_hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    gyro: Gyro | None = None
    accel: Accel | None = None
    mag: Mag | None = None
    temperature: Temperature | None = None
    attitude: Attitude | None = None
    pressure: Pressure | None = None
    axes: Literal["FLU", "FRD"] | None = None
    csv: TextFormat = TextFormat()
    bad_rows: Literal["error", "drop"] = "error"

    @model_validator(mode="after")
    def _is_whole(self) -> TableMap:
        if (self.time is None) == (self.rate_hz is None):
            given = "neither is there" if self.time is None else "both are there"
            raise ValueError(f"a map has either time: {{column: ..., unit: ...}} or rate_hz: ...; {given}")
        sources = self.sources()
        if not sources:
            raise ValueError("the map names no data: add gyro, accel, mag, temperature, attitude or pressure")
        names = Counter(source.column for source in sources)
        if self.time is not None:
            names[self.time.column] += 1
        if twice := [name for name, count in names.items() if count > 1]:
            raise ValueError(f"column {', '.join(map(repr, twice))} is used more than once")
        return self

    def sources(self) -> list[Source]:
        """Return the columns of data that the map names, in canonical order."""
        groups = (self.gyro, self.accel, self.mag, self.temperature, self.attitude, self.pressure)
        found = [
            Source(column, target, parse_unit(group.unit, _unit_of(target, group.unit)))
            for group in groups
            if group is not None
            for column, target in zip(group.columns, _targets(group), strict=True)
        ]
        order = list(KNOWN)
        return sorted(found, key=lambda source: order.index(source.target))


_TARGETS: dict[tuple[type[StrictModel], int], tuple[str, ...]] = {
    (Gyro, 3): ("gyro_x", "gyro_y", "gyro_z"),
    (Accel, 3): ("accel_x", "accel_y", "accel_z"),
    (Mag, 3): ("mag_x", "mag_y", "mag_z"),
    (Temperature, 1): ("temperature",),
    (Temperature, 3): ("temperature_x", "temperature_y", "temperature_z"),
    (Attitude, 4): ("q_w", "q_x", "q_y", "q_z"),
    (Attitude, 3): ("roll", "pitch", "yaw"),
    (Pressure, 1): ("pressure",),
}


def _targets(group: Gyro | Accel | Mag | Temperature | Attitude | Pressure) -> tuple[str, ...]:
    return _TARGETS[type(group), len(group.columns)]


def _unit_of(target: str, given: str) -> str:
    """Return the unit to convert to; arbitrary units of a magnetic field stay arbitrary."""
    return "1" if given == "1" and target.startswith("mag_") else KNOWN[target].unit
