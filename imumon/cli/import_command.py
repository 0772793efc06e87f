"""``imumon import``: a table or a log from elsewhere becomes a session."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

import click

from imumon.cli.common import PATH, json_option, print_json, print_rows, say, serial_option, warn
from imumon.errors import ImumonError, Reason


@click.command("import")
@click.argument("table", type=PATH)
@click.option("--map", "map_path", type=PATH, help="YAML file: column and unit of each quantity.")
@click.option("--sensor", help="Inertial sensor or topic of a log; default: the first.")
@click.option("--out", required=True, type=PATH, help="Session folder to make.")
@serial_option
@json_option
def command(
    table: Path, map_path: Path | None, sensor: str | None, out: Path, serial: str | None, as_json: bool
) -> None:
    """Make a session of TABLE: a CSV or Parquet file with a map of its columns, or a log.

    \b
    imumon import data.csv --map map.yaml --out sessions/mine
    imumon import flight.ulg --out sessions/flight

    Logs are those of ArduPilot, PX4, Betaflight (after blackbox_decode) and ROS.  A map gives the columns
    and unit of each quantity:

    \b
        time: {column: t, unit: s}
        gyro: {columns: [gx, gy, gz], unit: deg/s}
        accel: {columns: [ax, ay, az], unit: g}
        temperature: {columns: [temp], unit: degC}

    Units are products of powers: rad/s, deg/s, mdps, m/s^2, g, mg, uT, hPa, degC.  A unit divided by a
    number is that of raw counts: dps/16.4, g/16384.  docs/import-map.md has all keys.
    """
    from imumon.recordings.folder import name_unit
    from imumon.recordings.importing import import_table

    chosen: dict[str, Any] = {}
    if map_path is not None:
        if sensor is not None:
            raise ImumonError(Reason.BAD_CONFIG, "--sensor is for logs, --map for tables", "give one of them")
        report = import_table(table, map_path, out)
    else:
        found = _import_log(table, sensor, out)
        report = found.rows
        damage = found.damage
        if damage.places:
            say(
                "WARN",
                f"{damage.size:,} bytes in {damage.places:,} damaged place(s) of the log were left out",
            )
        chosen = {
            "sensor": found.sensor,
            "other_sensors": found.others,
            "scaling": found.scaling,
            "damage": asdict(damage),
        }
    name_unit(out, serial)
    if report.rows_dropped:
        why = "as their time does not increase" if map_path is None else "as the map requires"
        say("WARN", f"{report.rows_dropped} of {report.rows_in} rows were dropped, {why}")
    warn(report.warnings)
    if as_json:
        print_json({"session": out, **asdict(report), **chosen})
    rate = f" at {report.rate_hz:.4g} Hz" if isfinite(report.rate_hz) else ""
    rows = {
        "rows": f"{report.rows_in:,} in, {report.rows_out:,} out, {report.rows_dropped:,} dropped",
        "columns": ", ".join(report.columns),
        "not used": ", ".join(report.columns_unused) or "none",
        "span": f"{report.span_s:.1f} s{rate}, {report.segments} segment(s)",
        "session": str(out),
    }
    if chosen:
        others = ", ".join(chosen["other_sensors"])
        rows["sensor"] = chosen["sensor"] + (f" (--sensor: {others})" if others else "")
        rows["scaling"] = chosen["scaling"]
    print_rows(rows)


def _import_log(path: Path, sensor: str | None, out: Path) -> Any:
    """Make a session of a log that needs no map; raises BAD_CONFIG when no wing reads logs."""
    from imumon.wings import offers

    readers = offers("import_log")
    if not readers:
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: a table needs a map", "add --map MAP.yaml")
    return readers[0](path, sensor, out)
