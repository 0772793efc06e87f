"""Names, units and types of the columns that samples, tables and recordings have."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

ColumnType = Literal["float64", "int64"]
BodyAxes = Literal["FLU", "FRD"]
"""Forward, left, up; or forward, right, down."""

NAME = "^[a-z][a-z0-9_]*$"
"""Pattern of the names that device files, maps and stages give to columns."""


@dataclass(frozen=True)
class Column:
    """A column: its name, unit ("1" when dimensionless), type and meaning."""

    name: str
    unit: str
    dtype: ColumnType = "float64"
    description: str = ""


def vector_columns(name: str, unit: str, description: str, axes: str = "xyz") -> list[Column]:
    """Return the columns of a vector, one for each axis."""
    return [Column(f"{name}_{axis}", unit, description=f"{description}, {axis}") for axis in axes]


KNOWN: dict[str, Column] = {
    column.name: column
    for column in [
        Column("device_time_ns", "ns", "int64", "device clock, unwrapped; starts anew in each segment"),
        Column("arrival_time_ns", "ns", "int64", "Unix time at which the packet's last byte was read"),
        Column("host_time_ns", "ns", "int64", "device clock in Unix time, fitted to the earliest arrivals"),
        Column("segment", "1", "int64", "counts restarts of the device's clock or counter, from 0"),
        Column("packet_counter", "1", "int64", "packet counter as the device sends it"),
        Column("device_ticks", "1", "int64", "device clock as the device sends it, in its own ticks"),
        *vector_columns("gyro", "rad/s", "angular rate"),
        *vector_columns("accel", "m/s^2", "specific force"),
        *vector_columns("mag", "uT", "magnetic field"),
        Column("temperature", "degC", description="sensor temperature"),
        *vector_columns("temperature", "degC", "sensor temperature of the axis"),
        *vector_columns("q", "1", "attitude quaternion, body to the device's reference frame", "wxyz"),
        Column("roll", "rad", description="roll as the device reports it"),
        Column("pitch", "rad", description="pitch as the device reports it"),
        Column("yaw", "rad", description="yaw as the device reports it"),
        Column("pressure", "Pa", description="static pressure"),
        Column("latitude", "deg", description="geodetic latitude, WGS-84"),
        Column("longitude", "deg", description="geodetic longitude, WGS-84"),
        Column("altitude", "m", description="altitude as the device reports it"),
        Column("status", "1", "int64", "status word as the device sends it"),
    ]
}
"""The canonical columns.  A device may add others; these names always mean this."""

TEMPERATURES = ("temperature", "temperature_x", "temperature_y", "temperature_z")
"""Readings of the thermometers: of the unit, or of each axis."""
TIME_COLUMNS = ("device_time_ns", "arrival_time_ns", "host_time_ns", "segment", "packet_counter")
"""Columns that every decoded table begins with (where the source has them)."""
ALIKE = 0.9
"""Share of letters in common from which a name may be a slip: one too few of 5, or a wrong one of 10."""


def mistyped(names: Iterable[str]) -> list[str]:
    """Return a warning for each name that is a letter off a canonical one, but for numbers and axes."""
    return [
        f"column {name} is one of the device's own: if {known} is meant, correct the name in the device file"
        for name in names
        if name not in KNOWN and not name[-1].isdigit()
        for known in get_close_matches(name, KNOWN, 1, ALIKE)
        if name[:-1] != known[:-1]
    ]
