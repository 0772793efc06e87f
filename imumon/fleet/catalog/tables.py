"""The catalog as tables: with how models change over months, and which units differ from their kind."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imumon.blocks import FloatArray, IntArray
from imumon.files import plain, replacing
from imumon.models.model import BiasModel, ChannelModel
from imumon.recordings.reduced import GYRO

from .units import BEST, COLDEST, HOTTEST, WORST, Outlier, Unit

MONTH_NS = 365.25 / 12 * 86_400e9
FEWEST_UNITS = 5
"""Of fewer the median deviation is that of one or two."""
OUTLYING = 3.5
"""Modified z-score, with `TO_SIGMA`, as of Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993)."""
TO_SIGMA = 0.6745
"""Median absolute deviation of a normal distribution, in sigmas."""


class Drift(NamedTuple):
    """The bias of a channel, in its unit, at the middle of the temperatures that all of a unit's models know.

    Each model has, (n,), the Unix time of its latest data, the bias, and its sigma: that of the curve and of
    the turn-on offset together.  The slope of the straight line is NaN with one model, or with all from one
    moment.
    """

    channel: str
    at_degc: float
    time_ns: IntArray
    bias: FloatArray
    sd: FloatArray
    per_month: float
    per_month_sd: float


def drifts(unit: Unit) -> list[Drift]:
    """Return the drift of every gyro, as far as its models can be compared.

    Those with the earth rate and those without are not; the accelerometers' constant is gravity's.
    """
    if not unit.models:
        return []
    state = unit.models[-1].model.earth_rate
    alike = [dated for dated in unit.models if dated.model.earth_rate == state]
    found = []
    for name in GYRO:
        having = [dated for dated in alike if name in dated.model.channels]
        at = common_temperature([dated.model.channels[name] for dated in having])
        if at is None:
            continue
        time_ns = np.array([dated.time_ns for dated in having], np.int64)
        bias = np.array([dated.model.channels[name].value(at) for dated in having])
        sd = np.array([_sigma(dated.model, name) for dated in having])
        slope = line((time_ns - time_ns[0]) / MONTH_NS, bias, sd)
        found.append(Drift(name, at, time_ns, bias, sd, *slope))
    return found


def common_temperature(channels: Sequence[ChannelModel]) -> float | None:
    """Return the middle of the temperatures that all know, °C; None where there is none."""
    low = max((channel.temperature_range_degc[0] for channel in channels), default=np.inf)
    high = min((channel.temperature_range_degc[1] for channel in channels), default=-np.inf)
    return 0.5 * (low + high) if low <= high else None


def _sigma(model: BiasModel, name: str) -> float:
    """Return by how much the bias of the next power-on may differ from the curve."""
    offsets = [run.offset[name] for run in model.trained_on if name in run.offset]
    turn_on = float(np.std(offsets, ddof=1)) if len(offsets) > 1 else 0.0
    return float(np.hypot(model.channels[name].residual_sd, turn_on))


def line(x: FloatArray, y: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the slope of the weighted straight line through points, and its sigma; NaN without a span.

    Where the points scatter by more than they should, the sigma is as much larger (Birge, Phys. Rev. 40,
    207, 1932, eq. 5).
    """
    if len(x) < 2 or np.ptp(x) == 0.0:
        return float("nan"), float("nan")
    weight = 1.0 / np.maximum(sd, np.finfo(float).tiny ** 0.25)
    coefficients, covariance = np.polyfit(x, y, 1, w=weight, cov="unscaled")
    left = weight * (y - np.polyval(coefficients, x))
    excess = float((left**2).sum()) / (len(x) - 2) if len(x) > 2 else 1.0
    return float(coefficients[0]), float(np.sqrt(max(excess, 1.0) * covariance[0, 0]))


def find_outliers(units: Sequence[Unit]) -> None:
    """Add to the units what is unusual of them, among at least `FEWEST_UNITS` units of each device."""
    for device in dict.fromkeys(unit.device for unit in units):
        for what, of in _quantities([unit for unit in units if unit.device == device]).items():
            known = {unit: value for unit, value in of.items() if np.isfinite(value)}
            if len(known) < FEWEST_UNITS:
                continue
            median = float(np.median([*known.values()]))
            spread = float(np.median([abs(value - median) for value in known.values()]))
            for unit, value in known.items():
                score = TO_SIGMA * (value - median) / spread if spread else 0.0
                if abs(score) > OUTLYING:
                    unit.outliers.append(Outlier(what, value, median, score))
    for unit in units:
        unit.outliers.sort(key=lambda outlier: -abs(outlier.score))


def _quantities(units: Sequence[Unit]) -> dict[str, dict[Unit, float]]:
    """Return what units of a device are compared by: name to unit to value, in rad/s."""
    found: dict[str, dict[Unit, float]] = {
        "smallest σ of the bias": {unit: unit.row[BEST] for unit in units},
        "largest σ of the bias": {unit: unit.row[WORST] for unit in units},
    }
    latest = {unit: unit.models[-1].model.channels for unit in units if unit.models}
    for channel in GYRO:
        having = {unit: channels[channel] for unit, channels in latest.items() if channel in channels}
        at = common_temperature([*having.values()])
        if at is not None:
            found |= {
                f"{channel} at {at:.0f} °C": {unit: float(c.value(at)) for unit, c in having.items()},
                f"{channel} slope per °C": {unit: float(c.slope(at)) for unit, c in having.items()},
                f"{channel} residual": {unit: c.residual_sd for unit, c in having.items()},
            }
    return found


_RANGES = ("hours", COLDEST, HOTTEST, BEST, WORST)
_DRIFT = ("at_degc", "bias", "bias_sd", "per_month", "per_month_sd")
COLUMNS = {
    "sessions": ("session", "unit", "device", "state", "begun", *_RANGES, "lost", "model", "error"),
    "units": ("unit", "device", "sessions", "first", "last", *_RANGES, "models", "latest_model", "outliers"),
    "models": ("unit", "device", "channel", "unit_of_bias", "time", *_DRIFT),
}
"""Of each table; a model's row is the bias of a channel at a temperature that all its models know."""
_TYPES: dict[str, pa.DataType] = {
    **dict.fromkeys((*_RANGES, *_DRIFT), pa.float64()),
    **dict.fromkeys(("begun", "first", "last", "time"), pa.timestamp("ns", "UTC")),
    **dict.fromkeys(("lost", "sessions", "models"), pa.int64()),
    "outliers": pa.list_(pa.string()),
}
"""Of the columns that are not text."""


def tables(units: Sequence[Unit]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each of `COLUMNS`; times are Unix time in ns, NaN is None."""
    rows = {
        "sessions": [{**entry.row, "unit": unit.name} for unit in units for entry in unit.entries],
        "units": [{**unit.row, "outliers": [*map(str, unit.outliers)]} for unit in units],
        "models": [
            {
                **drift._asdict(),
                "unit": unit.name,
                "device": unit.device,
                "unit_of_bias": "rad/s",
                "time": time_ns,
                "bias": bias,
                "bias_sd": sd,
            }
            for unit in units
            for drift in drifts(unit)
            for time_ns, bias, sd in zip(drift.time_ns, drift.bias, drift.sd, strict=True)
        ],
    }
    return {
        table: [plain({name: row[name] for name in COLUMNS[table]}) for row in given]
        for table, given in rows.items()
    }


def write_tables(rows: Mapping[str, Sequence[Mapping[str, Any]]], folder: Path) -> list[Path]:
    """Write each table as Parquet; return the files.  Raises OSError when that fails."""
    written = []
    for table, given in rows.items():
        schema = pa.schema([(name, _TYPES.get(name, pa.string())) for name in COLUMNS[table]])
        written.append(folder / f"{table}.parquet")
        with replacing(written[-1]) as partial:
            pq.write_table(pa.Table.from_pylist(given, schema), partial, compression="zstd")
    return written


def day(time_ns: int | None) -> str:
    """Return the day of a Unix time in ns."""
    return "-" if time_ns is None else str(np.datetime64(time_ns, "ns").astype("datetime64[D]"))
