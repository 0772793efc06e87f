"""Logs of autopilots and ROS bags as tables that `import` takes: one inertial sensor, and what goes with it.

A log holds several sensors at rates of their own.  The rows are those of the gyro; a sample of another sensor
stands in the row nearest to it in time, once, so that its noise is what it was; not where that is farther
than the sensors' samples are apart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.ndimage import median_filter

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.config import dump_yaml
from imumon.errors import bad_config, bad_data
from imumon.files import write_text
from imumon.recordings.map import GROUPS

TIME = "time_ns"
GAUSS_TO_TESLA = 1e-4
NEIGHBOURS = 5
"""A damaged time is detected by the median of so many: two in a row may be wrong."""
UNITS = {
    "gyro": "rad/s", "accel": "m/s^2", "mag": "T", "temperature": "degC", "pressure": "Pa", "attitude": "1",
}  # fmt: skip
"""Of each group of the map, whose columns are those of the table."""
EXACT_US = 2**53
"""A float64 holds whole numbers up to this, 285 years; a later time is damage."""


class Series(NamedTuple):
    """Samples of one sensor."""

    time_ns: IntArray  # (n,)
    values: Mapping[str, FloatArray]  # by their names in the table, (n,) each


@dataclass(frozen=True)
class Damage:
    """What of a log could not be read: how many places, and the bytes there."""

    places: int = 0
    size: int = 0

    def and_at(self, begin: int, end: int) -> "Damage":
        """Return this with what stands between two offsets, if anything does."""
        return self if end <= begin else Damage(self.places + 1, self.size + end - begin)


@dataclass(frozen=True)
class Log:
    """What is taken from a log."""

    sensor: str  # which inertial sensor it is
    others: list[str]  # the inertial sensors that are not taken
    gyro: Series  # its rows are those of the table
    beside: list[Series]  # what is put beside them
    axes: str
    scaling: str  # where the units of the values are known from
    damage: Damage = Damage()  # what could not be read
    warnings: tuple[str, ...] = ()  # what whoever works with the samples has to know

    def write(self, path: Path) -> int:
        """Write the table and, beside it, its map; return how many rows are left out, as no later."""
        kept = _increasing(self.gyro.time_ns)
        time = self.gyro.time_ns[kept]
        columns = {name: values[kept] for name, values in self.gyro.values.items()}
        for series in self.beside:
            columns |= _beside(series, time)
        # An infinite value is damage, and as good as none; the others of its row are none the worse for it.
        columns = {name: np.where(np.isfinite(values), values, np.nan) for name, values in columns.items()}
        pq.write_table(pa.table({TIME: time, **columns}), path)
        groups = {
            name: {"columns": GROUPS[name][0], "unit": unit}
            for name, unit in UNITS.items()
            if all(one in columns and np.isfinite(columns[one]).any() for one in GROUPS[name][0])
        }
        text = dump_yaml({"time": {"column": TIME, "unit": "ns"}, **groups, "axes": self.axes})
        write_text(path.with_suffix(".yaml"), f"# scaling: {self.scaling}\n{text}")
        return len(self.gyro.time_ns) - len(kept)


def _increasing(time_ns: IntArray) -> IntArray:
    """Return the rows whose times increase: first those are left out that leap away from their neighbours."""
    rows = np.flatnonzero(time_ns != NO_INT)
    away = np.abs(time_ns[rows] - median_filter(time_ns[rows], NEIGHBOURS, mode="nearest"))
    rows = rows[away <= NEIGHBOURS * _usual_step(time_ns[rows])]
    latest = np.maximum.accumulate(np.append(NO_INT, time_ns[rows]))[:-1]
    return np.asarray(rows[time_ns[rows] > latest])


def _beside(series: Series, time_ns: IntArray) -> dict[str, FloatArray]:
    """Return the samples in the rows nearest to them in time, NaN elsewhere; of two for a row the nearer.

    A sample is of a row no farther than the rows or the samples usually are apart, whichever is more: another
    has a wrong time, or the rows have a hole there.
    """
    found = {name: np.full(len(time_ns), np.nan) for name in series.values}
    if not len(time_ns):
        return found
    row = np.searchsorted(time_ns[:-1] + np.diff(time_ns) // 2, series.time_ns)
    away = np.abs(time_ns[row] - series.time_ns)
    # The nearest comes last, and stays.
    order = np.argsort(-away, kind="stable")
    order = order[away[order] <= max(_usual_step(time_ns), _usual_step(series.time_ns))]
    for name, values in series.values.items():
        found[name][row[order]] = values[order]
    return found


def _usual_step(time_ns: IntArray) -> float:
    """Return by how much times usually differ; 0 of less than two."""
    return float(np.median(np.abs(np.diff(time_ns)))) if len(time_ns) > 1 else 0.0


def named(values: Mapping[str, Any], names: Sequence[str], targets: Sequence[str], scale: float = 1.0) -> Any:
    """Return columns by other names, as floats, times a scale."""
    return {
        target: scale * np.asarray(values[name], np.float64)
        for name, target in zip(names, targets, strict=True)
        if name in values
    }


def nanoseconds(time_us: Any) -> IntArray:
    """Return times in ns of times in µs, (n,); a damaged one is the earliest there is, and left out."""
    there = (time_us >= 0) & (time_us < EXACT_US)
    return np.where(there, np.where(there, time_us, 0).astype(np.int64) * 1000, NO_INT)


def beside(
    fields: Any,
    time: Callable[[Any], IntArray],
    names: Sequence[str],
    columns: Sequence[str],
    scale: float = 1,
) -> list[Series]:
    """Return what is `named` of another sensor, none where the log has none; `time` reads its times."""
    return [] if fields is None else [Series(time(fields), named(fields, names, columns, scale))]


def pick(
    path: Path, found: Sequence[str], wanted: str | None, damage: Damage = Damage()
) -> tuple[str, list[str]]:
    """Return the sensor that is wanted, else the first, and the others.

    Raises BAD_DATA when the log has no inertial sensor, BAD_CONFIG when not that one.
    """
    if not found:
        broken = f", of which {damage.size:,} bytes are damaged" if damage.places else ""
        raise bad_data(f"{path}: there is no gyro in this log{broken}")
    if wanted is not None and wanted not in found:
        raise bad_config(f"{path}: there is no sensor {wanted!r}", f"there are: {', '.join(found)}")
    name = found[0] if wanted is None else wanted
    return name, [one for one in found if one != name]
