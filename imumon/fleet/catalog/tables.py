"""The catalog as tables: sessions, units, and the models of the units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imumon.files import plain, replacing
from imumon.fleet.catalog.drift import Outlier, drifts
from imumon.fleet.catalog.units import BEST, COLDEST, HOTTEST, WORST, Unit

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


def tables(units: Sequence[Unit], unusual: Sequence[Outlier]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each of `COLUMNS`; times are Unix time in ns, NaN is None."""
    of_units = [
        {**unit.row, "outliers": [str(one) for one in unusual if one.unit == unit.name]} for unit in units
    ]
    rows = {
        "sessions": [{**entry.row, "unit": unit.name} for unit in units for entry in unit.entries],
        "units": of_units,
        "models": [row for unit in units for row in _models(unit)],
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


def _models(unit: Unit) -> list[dict[str, Any]]:
    return [
        {
            "unit": unit.name, "device": unit.device, "channel": drift.channel, "unit_of_bias": "rad/s",
            "time": time_ns, "at_degc": drift.at_degc, "bias": bias, "bias_sd": sd,
            "per_month": drift.per_month, "per_month_sd": drift.per_month_sd,
        }
        for drift in drifts(unit)
        for time_ns, bias, sd in zip(drift.time_ns, drift.bias, drift.sd, strict=True)
    ]  # fmt: skip


def day(time_ns: int | None) -> str:
    """Return the day of a Unix time in ns."""
    return "-" if time_ns is None else str(np.datetime64(time_ns, "ns").astype("datetime64[D]"))
