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
from imumon.fleet.catalog.units import Entry, Unit

_TEXT, _NUMBER, _TIME = pa.string(), pa.float64(), pa.timestamp("ns", "UTC")
_FOUND = [(name, _NUMBER) for name in ("hours", "coldest_degc", "hottest_degc")]
_FOUND += [(name, _NUMBER) for name in ("best_sigma_rad_per_s", "worst_sigma_rad_per_s")]
SCHEMAS = {
    "sessions": pa.schema(
        [
            *((name, _TEXT) for name in ("session", "unit", "device", "state")),
            ("begun", _TIME),
            *_FOUND,
            ("lost", pa.int64()),
            ("model", _TEXT),
            ("error", _TEXT),
        ]
    ),
    "units": pa.schema(
        [
            *((name, _TEXT) for name in ("unit", "device")),
            ("sessions", pa.int64()),
            ("first", _TIME),
            ("last", _TIME),
            *_FOUND,
            ("models", pa.int64()),
            ("latest_model", _TEXT),
            ("outliers", pa.list_(_TEXT)),
        ]
    ),
    "models": pa.schema(
        [
            *((name, _TEXT) for name in ("unit", "device", "channel", "unit_of_bias")),
            ("time", _TIME),
            *((name, _NUMBER) for name in ("at_degc", "bias", "bias_sd", "per_month", "per_month_sd")),
        ]
    ),
}
"""Columns of each table; a model's row is the bias of a channel at a temperature that all its models know."""


def tables(units: Sequence[Unit], unusual: Sequence[Outlier]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each of `SCHEMAS`; times are Unix time in ns, NaN is None."""
    rows = {
        "sessions": [_session(unit, entry) for unit in units for entry in unit.entries],
        "units": [_unit(unit, unusual) for unit in units],
        "models": [row for unit in units for row in _models(unit)],
    }
    return {name: [plain(row) for row in given] for name, given in rows.items()}


def write_tables(rows: Mapping[str, Sequence[Mapping[str, Any]]], folder: Path) -> list[Path]:
    """Write each table as Parquet; return the files.  Raises OSError when that fails."""
    written = []
    for name, given in rows.items():
        path = folder / f"{name}.parquet"
        with replacing(path) as partial:
            pq.write_table(pa.Table.from_pylist(given, SCHEMAS[name]), partial, compression="zstd")
        written.append(path)
    return written


def _found(of: Unit | Entry) -> dict[str, float]:
    (coldest, hottest), (best, worst) = of.temperatures, of.sigmas
    values = (of.hours, coldest, hottest, best, worst)
    return dict(zip((name for name, _ in _FOUND), values, strict=True))


def _session(unit: Unit, entry: Entry) -> dict[str, Any]:
    metadata = entry.session.metadata
    return {
        "session": str(entry.session.path),
        "unit": unit.name,
        "device": unit.device,
        "state": entry.session.state,
        "begun": metadata.created_ns,
        **_found(entry),
        "lost": entry.lost,
        "model": None if entry.model is None else entry.model.created,
        "error": entry.failure or None,
    }


def _unit(unit: Unit, unusual: Sequence[Outlier]) -> dict[str, Any]:
    return {
        "unit": unit.name,
        "device": unit.device,
        "sessions": len(unit.entries),
        "first": min(unit.begun, default=None),
        "last": max(unit.begun, default=None),
        **_found(unit),
        "models": len(unit.models),
        "latest_model": unit.models[-1].model.created if unit.models else None,
        "outliers": [str(outlier) for outlier in unusual if outlier.unit == unit.name],
    }


def _models(unit: Unit) -> list[dict[str, Any]]:
    return [
        {
            "unit": unit.name,
            "device": unit.device,
            "channel": drift.channel,
            "unit_of_bias": "rad/s",
            "time": time_ns,
            "at_degc": drift.at_degc,
            "bias": bias,
            "bias_sd": sd,
            "per_month": drift.per_month,
            "per_month_sd": drift.per_month_sd,
        }
        for drift in drifts(unit)
        for time_ns, bias, sd in zip(drift.time_ns, drift.bias, drift.sd, strict=True)
    ]


def day(time_ns: int | None) -> str:
    """Return the day of a Unix time in ns."""
    return "-" if time_ns is None else str(np.datetime64(time_ns, "ns").astype("datetime64[D]"))
