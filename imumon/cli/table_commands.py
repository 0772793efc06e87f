"""``imumon decode``, ``export``, ``import``, ``mark``, ``recover``: sessions, tables and logs."""

from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.errors import bad_config
from imumon.files import check_output
from imumon.wing import offers

from .common import (
    TABLE,
    columns_option,
    device_help,
    json_option,
    log,
    path_argument,
    path_option,
    print_json,
    print_result,
    rate_option,
    serial_option,
    split_columns,
    warn,
)
from .progress import reading_bar

if TYPE_CHECKING:
    from imumon.pipeline import Pipeline
    from imumon.recordings.exports import Exported
    from imumon.recordings.source import Source

KINDS = ["parquet", "csv", "npz", "mat", "mcap"]


@click.command("decode")
@path_argument("file")
@click.option("--device", help=device_help + "  A session knows its own.")
@path_option("--out", required=True, help=TABLE)
@columns_option
@rate_option
@json_option
def decode(
    file: Path, device: str | None, out: Path, columns: str | None, rate: float | None, as_json: bool
) -> None:
    """Decode FILE, a raw capture of any tool or a session, into a table.

    \b
    imumon decode sessions/NAME --out samples.parquet
    imumon decode capture.bin --device xsens --out samples.csv
    """
    _write_table(file, device, rate, out, columns, as_json)


def _write_table(
    file: Path, device: str | None, rate: float | None, out: Path, columns: str | None, as_json: bool
) -> None:
    from imumon.intake import SpecificForce
    from imumon.pipeline import Pipeline
    from imumon.recordings.exports import export_run
    from imumon.recordings.source import open_source, run_over
    from imumon.run.account import doubts
    from imumon.run.narration import describe_losses, describe_streams

    source = open_source(file, device, rate)
    source.refuse_output(out)
    pipeline, sender, session = Pipeline(source.device), source.device, source.session
    named = {"file": source.path, "session": session and session.path, "device": sender and sender.name}
    described, force = sender is not None and sender.protocol.startswith("fixed"), SpecificForce()
    with reading_bar([file], quiet=as_json) as progress:
        blocks = force.through(run_over(source.items, pipeline, progress.count))
        exported = export_run(blocks, pipeline, source, out, split_columns(columns))
    counters = pipeline.counters
    doubtful = doubts(described, counters, force)
    warn([*source.warnings(), *pipeline.warnings(), *exported.warnings, *doubtful])
    for notice in pipeline.notices():
        log("INFO", f"device: {notice}")
    rows = {
        "packets": ", ".join(f"{count:,} {name}" for name, count in counters.packets_by_type.items()),
        "bytes": f"{counters.bytes_received:,} received, {counters.bytes_in_packets:,} in packets, "
        f"{counters.bytes_skipped:,} skipped, {counters.bytes_pending:,} pending",
        "losses": describe_losses(counters),
    }
    rows = (rows if counters.bytes_received else {}) | describe_streams(counters, exported.tables)
    data = named | exported_as_data(source, pipeline, exported) | {"doubts": doubtful}
    print_result(as_json, data, rows)


def exported_as_data(source: "Source", pipeline: "Pipeline", exported: "Exported") -> dict[str, object]:
    """Return what ``--json`` prints of a run that was exported: the table, what came, what is missing."""
    from imumon.protocols.base import MAIN

    tables = exported.tables
    table = {"out": tables.get(MAIN), "rows": exported.rows, "tables": tables}
    return table | pipeline.counters.as_dict() | source.losses()


@click.command("export")
@path_argument("session")
@click.option("--to", "kind", required=True, type=click.Choice(KINDS), help="Format; mcap: ROS 2 messages.")
@path_option("--out", help="Table to write; default: export.FORMAT in the session.")
@columns_option
@json_option
def export(session: Path, kind: str, out: Path | None, columns: str | None, as_json: bool) -> None:
    """Write the samples of SESSION, recorded or imported, as a table.

    \b
    imumon export sessions/NAME --to csv
    """
    from imumon.recordings.folder import open_session

    folder = open_session(session).path
    table = folder / f"export.{kind}" if out is None else out
    if table.suffix[1:] not in KINDS and table.name != "-" and not table.exists():  # a bare name
        table = table.with_name(f"{table.name}.{kind}")
    if table.suffix != f".{kind}":
        check_output(table, replace=True, suffix=f".{kind}")
    _write_table(folder, None, None, table, columns, as_json)


@click.command("import")
@path_argument("table")
@path_option("--map", "map_path", help="YAML file: column and unit of each quantity.")
@click.option("--sensor", help="Inertial sensor or topic of a log; default: the first.")
@path_option("--out", required=True, help="Session folder to make.")
@serial_option
@json_option
def import_(
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

    details: Any = None
    if map_path is None:
        import_log, *_ = offers("import_log")  # that of imumon comes first
        report, details = import_log(table, sensor, out)
    elif sensor is not None:
        raise bad_config("--sensor is for logs, --map for tables", "give one of them")
    else:
        report = import_table(table, map_path, out)
    name_unit(out, serial)
    if details is not None and details.damage.places:
        lost = f"{details.damage.size:,} bytes in {details.damage.places:,} damaged place(s) of the log"
        log("WARN", f"{lost} were left out")
    if report.rows_dropped:
        why = "as the map requires" if details is None else "as their time does not increase"
        log("WARN", f"{report.rows_dropped} of {report.rows_in} rows were dropped, {why}")
    warn(report.warnings)
    rate = f" at {report.rate_hz:.4g} Hz" if isfinite(report.rate_hz) else ""
    gaps = f", {report.gaps_s:.1f} s of it in gaps" if report.gaps_s >= 0.1 else ""
    rows = {
        "rows": f"{report.rows_in:,} in, {report.rows_out:,} out, {report.rows_dropped:,} dropped",
        "columns": ", ".join(report.columns),
        "not used": ", ".join(report.columns_unused) or "none",
        "span": f"{report.span_s:.1f} s{rate}, {report.segments} segment(s){gaps}",
        "session": str(out),
    }
    data = {"session": out, **asdict(report)}
    if details is not None:
        data |= {
            "sensor": details.sensor,
            "other_sensors": details.others,
            "scaling": details.scaling,
            "damage": asdict(details.damage),
        }
        others = f" (--sensor: {', '.join(details.others)})" if details.others else ""
        rows |= {"sensor": details.sensor + others, "scaling": details.scaling}
    print_result(as_json, data, rows)


@click.command("mark")
@path_argument("session")
@click.argument("text")
@click.option("--start", is_flag=True, help="A part of the recording called TEXT begins here.")
@click.option("--stop", is_flag=True, help="The part called TEXT ends here.")
def mark(session: Path, text: str, start: bool, stop: bool) -> None:
    """Put TEXT into SESSION, which is being recorded: an event in the recording, and a lane in the view.

    \b
    imumon mark sessions/NAME "heater on"
    imumon mark sessions/NAME turning --start
    """
    from imumon.run.marks import ask_for_mark
    from imumon.transport.reader import EventKind

    if start and stop:
        raise bad_config("--start and --stop are both given", "give one of them")
    ask_for_mark(session, EventKind.START if start else EventKind.STOP if stop else EventKind.MARK, text)


@click.command("recover")
@path_argument("session")
@click.option(
    "--device", help=device_help + "  Only where session.yaml is lost and wire.mcap does not hold it."
)
@json_option
def recover(session: Path, device: str | None, as_json: bool) -> None:
    """Finish SESSION, which was interrupted or damaged: its recording and its counters.

    \b
    imumon recover sessions/NAME

    A lost or damaged session.yaml is written anew from wire.mcap.  A file that is replaced is kept beside the
    new one as NAME.original.  A session that is whole is left as it is.
    """
    from imumon.run.recovery import recover as recovered

    result = recovered(session, device)
    originals = [f"the original is {path}" for path in result.originals]
    for sentence in [*result.done, *originals] or ["the session is whole; nothing was written"]:
        log("INFO", sentence)
    warn(result.warnings)
    if as_json:
        found = asdict(result)
        del found["before"]["metadata"]
        print_json(found)
