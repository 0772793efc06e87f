"""``imumon decode``: bytes to a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    PATH,
    TABLE,
    columns_option,
    device_help,
    json_option,
    print_json,
    print_rows,
    rate_option,
    say,
    split_columns,
    warn,
)
from imumon.cli.progress import reading_bar
from imumon.errors import ImumonError, Reason

if TYPE_CHECKING:
    from imumon.pipeline import Pipeline
    from imumon.recordings.side_tables import Exported
    from imumon.recordings.source import Source


@click.command("decode")
@click.argument("file", type=PATH)
@click.option("--device", help=device_help + "  A session knows its own.")
@click.option("--out", type=PATH, required=True, help=TABLE)
@columns_option
@rate_option
@json_option
def command(
    file: Path, device: str | None, out: Path, columns: str | None, rate: float | None, as_json: bool
) -> int:
    """Decode FILE, a raw capture of any tool or a session, into a table.

    \b
    imumon decode sessions/NAME --out samples.parquet
    imumon decode capture.bin --device xsens --out samples.csv
    """
    from imumon.pipeline import Pipeline
    from imumon.recordings.side_tables import Exported, export_run
    from imumon.recordings.source import no_samples, open_source, run_over
    from imumon.run.doubts import Doubts
    from imumon.run.narration import describe_losses, describe_streams

    source = open_source(file, device, rate)
    source.refuse_output(out)
    pipeline = Pipeline(source.device)
    doubts = Doubts(source.device is not None and source.device.protocol.startswith("fixed"))
    try:
        with reading_bar([file], quiet=as_json) as progress:
            blocks = doubts.through(run_over(source.items, pipeline, progress.count))
            exported = export_run(blocks, pipeline, source, out, split_columns(columns))
    except ImumonError as error:
        unread = not pipeline.counters.bytes_received and file.is_file() and file.stat().st_size
        if error.reason is not Reason.BAD_DATA or pipeline.counters.samples or unread:
            raise
        if as_json:
            print_json(_result(source, pipeline, Exported(0, {})))
        raise no_samples(source, pipeline) from error
    doubtful = doubts.found(pipeline.counters)
    warn([*source.warnings(), *pipeline.warnings(), *exported.warnings, *doubtful])
    for notice in pipeline.notices():
        say("INFO", f"device: {notice}")
    if as_json:
        print_json(_result(source, pipeline, exported) | {"doubts": doubtful})
    counters = pipeline.counters
    print_rows(
        {
            "packets": ", ".join(f"{count:,} {name}" for name, count in counters.packets_by_type.items()),
            "bytes": f"{counters.bytes_received:,} received, {counters.bytes_in_packets:,} in packets, "
            f"{counters.bytes_skipped:,} skipped, {counters.bytes_pending:,} pending",
            "losses": describe_losses(counters),
            **describe_streams(counters, exported.tables),
        }
    )
    return 0


def _result(source: Source, pipeline: Pipeline, exported: Exported) -> dict[str, object]:
    device = source.device.name if source.device is not None else None
    return {"file": source.path, "device": device} | exported_as_data(source, pipeline, exported)


def exported_as_data(source: Source, pipeline: Pipeline, exported: Exported) -> dict[str, object]:
    """Return what ``--json`` prints of a run that was exported: the table, what came, what is missing."""
    return {**exported.as_dict(), **pipeline.counters.as_dict(), **source.losses()}
