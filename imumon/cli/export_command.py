"""``imumon export``: the samples of a session as a table."""

from __future__ import annotations

from pathlib import Path

import click

from imumon.cli.common import columns_option, json_option, print_json, print_rows, say, split_columns
from imumon.pipeline import Pipeline
from imumon.recordings.folder import open_session
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import export_blocks


@click.command("export")
@click.argument("session", type=click.Path(path_type=Path))
@click.option("--to", "kind", required=True, type=click.Choice(["parquet", "csv"]), help="Format.")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Table to write; default: export.FORMAT in the session."
)
@columns_option
@json_option
def command(session: Path, kind: str, out: Path | None, columns: str | None, as_json: bool) -> None:
    """Write the samples of SESSION, recorded or imported, as a table."""
    folder = open_session(session).path
    source = open_source(folder)
    table = out or folder / f"export.{kind}"
    if table.suffix != f".{kind}":
        table = table.with_name(f"{table.name}.{kind}")
    source.refuse_output(table)
    pipeline = Pipeline(source.device)
    rows = export_blocks(
        run_over(source.items, pipeline), table, split_columns(columns), lambda: source.columns(pipeline)
    )
    for text in source.warnings():
        say("WARN", text)
    if as_json:
        print_json({"session": session, "out": table, "rows": rows})
    print_rows({"table": f"{table}: {rows:,} rows"})
