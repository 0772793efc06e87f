"""Columns for tables of messages; those that are computed: times from dates, quaternions from matrices."""

from __future__ import annotations

from functools import partial

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray
from imumon.columns import KNOWN, Column
from imumon.protocols.numbers import Columns, Derived

DATE_PARTS = ("of_second", "year", "month", "day", "hour", "minute", "second")


def number(name: str, unit: str, description: str) -> Column:
    """Make a float64 column."""
    return Column(name, unit, "float64", description)


def count(name: str, description: str, unit: str = "1") -> Column:
    """Make an int64 column."""
    return Column(name, unit, "int64", description)


def vector(name: str, unit: str, description: str, axes: str = "xyz") -> tuple[Column, ...]:
    """Make a float64 column for each axis."""
    return tuple(number(f"{name}_{axis}", unit, f"{description}, {axis}") for axis in axes)


_VECTORS = {base: tuple(f"{base}_{axis}" for axis in "xyz") for base in ("accel", "gyro", "mag")} | {
    "q": ("q_w", "q_x", "q_y", "q_z"),
    "angles": ("roll", "pitch", "yaw"),
    "place": ("latitude", "longitude", "altitude"),
}
"""Canonical columns that come together."""


def known(*names: str) -> tuple[Column, ...]:
    """Look up canonical columns; accel, gyro, mag, q, angles and place are several."""
    return tuple(KNOWN[column] for name in names for column in _VECTORS.get(name, (name,)))


def date(prefix: str) -> tuple[Column, ...]:
    """Columns, not shown, of a calendar date; `utc_time` makes a time of them."""
    return tuple(count(f"_{prefix}{part}", part) for part in DATE_PARTS)


QUATERNION = known("q")
MATRIX = tuple(
    number(f"_matrix_{i}{j}", "1", "rotation matrix, reference to body") for i in "123" for j in "123"
)


def _time_to_parts(name: str, per_s: int, columns: Columns) -> list[ColumnArray]:
    """Split a Unix time into counts of a second, year, month, day, hour, minute, second."""
    time = columns[name]
    seconds, rest = np.divmod(np.where(time == NO_INT, 0, time), per_s)
    moments = seconds.astype("datetime64[s]").tolist()
    parts = np.array([moment.timetuple()[:6] for moment in moments], np.int64).reshape(-1, 6)
    return [np.where(time == NO_INT, NO_INT, part) for part in (rest, *parts.T)]


def _parts_to_time(prefix: str, per_s: int, columns: Columns) -> list[ColumnArray]:
    """Make a Unix time of a date; an impossible date (all zero before the first fix) is missing."""
    rest, year, month, day, hour, minute, second = (columns[f"_{prefix}{part}"] for part in DATE_PARTS)
    good = (year > 1900) & (year < 2262) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    months = np.where(good, (year - 1970) * 12 + month - 1, 0).astype("datetime64[M]")
    days = months.astype("datetime64[D]").astype(np.int64) + day - 1
    seconds = days * 86_400 + hour * 3600 + minute * 60 + second
    return [np.where(good, seconds * per_s + rest, NO_INT)]


def utc_time(prefix: str, result: Column, per_s: int = 1_000_000_000) -> Derived:
    """Derive a time, so many counts a second, from the columns of `date`."""
    return Derived(
        tuple(f"_{prefix}{part}" for part in DATE_PARTS),
        (result,),
        partial(_parts_to_time, prefix, per_s),
        partial(_time_to_parts, result.name, per_s),
    )


def _matrix_to_quaternion(columns: Columns) -> list[ColumnArray]:
    """Convert the matrix reference to body, row by row, to the quaternion body to reference.

    Shepperd (1978): of four formulas the one with the largest divisor.  The scalar part is not negative.
    """
    a, b, c, d, e, f, g, h, i = (np.asarray(columns[column.name], np.float64) for column in MATRIX)
    squares = np.stack([1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i])
    products = [[squares[0], f - h, g - c, b - d], [f - h, squares[1], b + d, c + g],
                [g - c, b + d, squares[2], f + h], [b - d, c + g, f + h, squares[3]]]  # fmt: skip
    best = np.argmax(np.nan_to_num(squares), axis=0)
    scaled = np.stack([np.choose(best, [row[k] for row in products]) for k in range(4)])
    with np.errstate(all="ignore"):  # what is not a rotation becomes NaN
        quaternion = scaled / (2 * np.sqrt(np.max(squares, axis=0)))
    quaternion = np.where(np.isfinite(quaternion).all(axis=0), quaternion, np.nan)
    quaternion = np.where(quaternion[0] < 0, -quaternion, quaternion)
    return list(quaternion)


def _quaternion_to_matrix(columns: Columns) -> list[ColumnArray]:
    """Convert the quaternion body to reference to the matrix reference to body, row by row."""
    w, x, y, z = (np.asarray(columns[column.name], np.float64) for column in QUATERNION)
    rows: list[FloatArray] = [
        1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
        2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return list(rows)


FROM_MATRIX = Derived(
    tuple(column.name for column in MATRIX), QUATERNION, _matrix_to_quaternion, _quaternion_to_matrix
)
