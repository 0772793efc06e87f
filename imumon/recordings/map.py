"""The map of a foreign table: which column is what, in which unit.  Described in docs/import-map.md."""

import re
from collections import Counter
from datetime import UTC, datetime
from fractions import Fraction
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    NonNegativeInt,
    ValidationInfo,
    field_validator,
    model_validator,
)

from imumon.columns import KNOWN, NAME, BodyAxes
from imumon.config import StrictModel
from imumon.protocols.ranges import Ranges
from imumon.units import Unit, parse_own_unit, parse_unit

TIMESTAMPS = "iso8601"
"""In place of a unit of time: the column holds dates with times."""

UnitText = Annotated[str, BeforeValidator(lambda given: "1" if given == 1 and given is not True else given)]
"""A unit; 1 may be written as a number."""


def _check_time_unit(text: str) -> str:
    if text != TIMESTAMPS:
        parse_unit(text, "ns")
    return text


def _check_own_unit(text: str) -> str:
    parse_own_unit(text)
    return text


MOMENT = datetime(2026, 1, 31, 13, 14, 15, tzinfo=UTC)
"""Whose parts differ, so that a format which mixes them up is found."""


def _check_format(text: str) -> str:
    if "%Z" in text:
        raise ValueError("%Z: the name of a zone does not give its offset; %z is +01:00")
    try:
        parsed = datetime.strptime(MOMENT.strftime(text), text).replace(tzinfo=UTC)
    except re.error as error:
        raise ValueError(f"{text!r} has a directive twice") from error
    if parsed not in (MOMENT, MOMENT.replace(1900, 1, 1)):
        raise ValueError(
            "a format has hours, minutes and seconds, and a whole date or none: %d.%m.%Y %H:%M:%S.%f"
        )
    return text


class TimeColumn(StrictModel):
    """The column of time; `backwards` states what a time before the one above means.

    `wraps_at`, in its unit, or in s of a time of day, is where a count begins at 0 again.  `format`, in place
    of a unit, is how dates are written, by the directives of `datetime.strptime`.
    """

    column: str
    unit: Annotated[str, AfterValidator(_check_time_unit)]
    format: Annotated[str, AfterValidator(_check_format)] | None = None
    backwards: Literal["error", "segment"] = "error"
    wraps_at: float | None = Field(default=None, gt=0)

    @property
    def wrap_ns(self) -> Fraction | None:
        """After how many ns the count begins at 0 again; None for a time that does not."""
        if self.wraps_at is None:
            return None
        return Fraction(str(self.wraps_at)) * parse_unit("s" if self.format else self.unit, "ns").factor

    @model_validator(mode="before")
    @classmethod
    def _a_format_is_of_dates(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("format") is not None:
            if given.get("unit", TIMESTAMPS) != TIMESTAMPS:
                raise ValueError("time has a unit, or the format of its dates; not both")
            return {**given, "unit": TIMESTAMPS}
        return given

    @model_validator(mode="after")
    def _wraps_as_a_count_can(self) -> "TimeColumn":
        if self.wraps_at is not None and self.unit == TIMESTAMPS and self.format is None:
            raise ValueError("dates do not wrap: leave wraps_at out")
        if self.wraps_at is not None and self.backwards == "segment":
            raise ValueError(
                "a restart cannot be distinguished from a wrap of the time: leave backwards or wraps_at out,"
                " and import what came after a restart by itself"
            )
        if self.wrap_ns is not None and not 1 <= self.wrap_ns < 2**63:
            raise ValueError(f"wraps_at: {self.wraps_at:g} {self.unit} is no time that 64 bits hold in ns")
        return self


class Source(NamedTuple):
    """A column of the table and the canonical column that it becomes."""

    column: str
    target: str
    unit: Unit


class Group(StrictModel):
    """The columns of one quantity and their unit, as `GROUPS` has them."""

    columns: list[str]
    unit: UnitText


def triple(name: str) -> tuple[str, ...]:
    """Return the columns of a vector."""
    return tuple(f"{name}_{axis}" for axis in "xyz")


GROUPS: dict[str, tuple[tuple[str, ...], ...]] = {
    "gyro": (triple("gyro"),),
    "accel": (triple("accel"),),
    "mag": (triple("mag"),),
    "temperature": (("temperature",), triple("temperature")),
    "attitude": (("q_w", "q_x", "q_y", "q_z"), ("roll", "pitch", "yaw")),
    "pressure": (("pressure",),),
}
"""Of each quantity the canonical columns, for each number of columns that there may be.

Angular rate about and specific force along x, y, z; field along x, y, z, with unit 1 when the sensor has
arbitrary units; temperature of the sensor, one for all or one for each axis; attitude as the device reports
it, a quaternion w, x, y, z with unit 1, or roll, pitch, yaw; static pressure.
"""


def _sources(quantity: str, group: Group) -> list[Source]:
    """Return what becomes of each column of a group; raises ValueError where that cannot be."""
    targets = {len(targets): targets for targets in GROUPS[quantity]}
    if len(group.columns) not in targets:
        counts = " or ".join(map(str, targets))
        raise ValueError(f"expected {counts} columns, got {len(group.columns)}")
    found = []
    for column, target in zip(group.columns, targets[len(group.columns)], strict=True):
        # Arbitrary units of a field stay arbitrary.
        unit = "1" if group.unit == "1" and quantity == "mag" else KNOWN[target].unit
        if unit == "1" != group.unit:
            raise ValueError(f"a quaternion has unit 1, got {group.unit!r}")
        found.append(Source(column, target, parse_unit(group.unit, unit)))
    return found


RESERVED = (*KNOWN, "accel", "gyro", "vibration", "at_rest")
"""Names that mean something already."""


class Other(StrictModel):
    """A further column, whatever it is; it keeps its unit."""

    column: str
    unit: Annotated[UnitText, AfterValidator(_check_own_unit)]


Name = Annotated[str, Field(pattern=NAME)]


class TextFormat(StrictModel):
    """How the text is laid out, where it is not commas below one line of names."""

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | Literal["whitespace"] = ","
    decimal: Literal[".", ","] = "."
    comment: str | None = Field(default=None, min_length=1)
    header: bool = True
    skip_rows: NonNegativeInt = 0
    columns: list[str] | None = None

    @model_validator(mode="after")
    def _names_come_from_one_place(self) -> "TextFormat":
        if self.header == (self.columns is not None):
            raise ValueError(
                "a table without header needs csv.columns, the names of all its columns; with these add"
                " header: false"
            )
        if self.decimal == self.delimiter:
            raise ValueError('a decimal comma needs another delimiter, such as csv: {delimiter: ";"}')
        if twice := [name for name, count in Counter(self.columns or []).items() if count > 1]:
            raise ValueError(f"csv.columns names {', '.join(twice)} more than once")
        return self


class TableMap(StrictModel):
    """The whole map."""

    time: TimeColumn | None = None
    rate_hz: float | None = Field(default=None, gt=0, le=1e6)
    gyro: Group | None = None
    accel: Group | None = None
    mag: Group | None = None
    temperature: Group | None = None
    attitude: Group | None = None
    pressure: Group | None = None
    other: dict[Name, Other] = Field(default_factory=dict)
    axes: BodyAxes | None = None
    range: Ranges = Ranges()
    csv: TextFormat = TextFormat()
    bad_rows: Literal["error", "drop"] = "error"

    @field_validator(*GROUPS)
    @classmethod
    def _measures_its_quantity(cls, given: Group | None, info: ValidationInfo) -> Group | None:
        if given is not None:
            _sources(str(info.field_name), given)
        return given

    @model_validator(mode="after")
    def _is_whole(self) -> "TableMap":
        if (self.time is None) == (self.rate_hz is None):
            given = "neither is there" if self.time is None else "both are there"
            raise ValueError(f"a map has either time: {{column: ..., unit: ...}} or rate_hz: ...; {given}")
        if taken := [name for name in self.other if name in RESERVED]:
            raise ValueError(f"other.{taken[0]} is the name of something else; give the column another")
        if not self.sources():
            raise ValueError(
                "the map names no data: add gyro, accel, mag, temperature, attitude, pressure or other"
            )
        if twice := [name for name, count in Counter(self.columns()).items() if count > 1]:
            raise ValueError(f"column {', '.join(map(repr, twice))} is used more than once")
        return self

    def columns(self) -> list[str]:
        """Return the columns of the table that the map names, that of time last."""
        return [*(source.column for source in self.sources()), *([self.time.column] if self.time else [])]

    def sources(self) -> list[Source]:
        """Return the columns of data that the map names, in canonical order; others come last."""
        groups = {name: group for name in GROUPS if (group := getattr(self, name)) is not None}
        found = [source for name, group in groups.items() for source in _sources(name, group)]
        others = [Source(one.column, name, parse_own_unit(one.unit)) for name, one in self.other.items()]
        return [*found, *others]
