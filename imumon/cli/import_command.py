"""``imumon import``: a table from elsewhere becomes a session."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from imumon.cli.common import PATH, json_option, print_json, print_rows, say


@click.command("import")
@click.argument("table", type=PATH)
@click.option("--map", "map_path", required=True, type=PATH, help="YAML file: what is in which column.")
@click.option("--out", required=True, type=PATH, help="Session folder to make.")
@json_option
def command(table: Path, map_path: Path, out: Path, as_json: bool) -> None:
    """Make a session of TABLE, a CSV or Parquet file of any origin.  docs/import-map.md explains the map."""
    from imumon.recordings.importing import import_table

    report = import_table(table, map_path, out)
    if report.rows_dropped:
        say("WARN", f"{report.rows_dropped} of {report.rows_in} rows were dropped, as the map asks")
    if as_json:
        print_json({"session": out, **asdict(report)})
    print_rows(
        {
            "rows": f"{report.rows_in:,} in, {report.rows_out:,} out, {report.rows_dropped:,} dropped",
            "columns": ", ".join(report.columns),
            "not used": ", ".join(report.columns_unused) or "none",
            "span": f"{report.span_s:.1f} s at {report.rate_hz:.4g} Hz, {report.segments} segment(s)",
            "session": str(out),
        }
    )
