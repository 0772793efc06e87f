"""``imumon export``: the samples of a session as a table."""

from __future__ import annotations

from pathlib import Path

import click

from imumon.cli.common import PATH, columns_option, json_option, print_json, print_rows, split_columns, warn
from imumon.errors import ImumonError, Reason
from imumon.files import check_output

KINDS = ["parquet", "csv", "npz", "mat", "mcap"]


@click.command("export")
@click.argument("session", type=PATH)
@click.option(
    "--to",
    "kind",
    required=True,
    type=click.Choice(KINDS),
    help="Format; mcap: ROS 2 messages.",
)
@click.option("--out", type=PATH, help="Table to write; default: export.FORMAT in the session.")
@columns_option
@json_option
def command(session: Path, kind: str, out: Path | None, columns: str | None, as_json: bool) -> None:
    """Write the samples of SESSION, recorded or imported, as a table.

    \b
    imumon export sessions/NAME --to csv
    """
    from imumon.pipeline import Pipeline
    from imumon.recordings.folder import open_session
    from imumon.recordings.side_tables import export_run
    from imumon.recordings.source import open_source, run_over
    from imumon.run.narration import describe_streams

    folder = open_session(session).path
    source = open_source(folder)
    table = folder / f"export.{kind}" if out is None else _named(out, kind)
    source.refuse_output(table)
    pipeline = Pipeline(source.device)
    exported = export_run(run_over(source.items, pipeline), pipeline, source, table, split_columns(columns))
    warn([*source.warnings(), *exported.warnings])
    if as_json:
        streams = pipeline.counters.as_dict()["streams"]
        print_json({"session": session, **exported.as_dict(), "streams": streams} | source.losses())
    print_rows(describe_streams(pipeline.counters, exported.tables))


def _named(out: Path, kind: str) -> Path:
    """Return the path of a table of this kind: a bare name, of nothing that is there, gets the suffix."""
    if out.suffix == f".{kind}":
        return out
    check_output(out, replace=True)
    if out.exists() or out.suffix[1:] in KINDS:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"{out}: the output of --to {kind} ends in .{kind}",
            f"name it {out.stem}.{kind}, or give another --to",
        )
    return out.with_name(f"{out.name}.{kind}")
