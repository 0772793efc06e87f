"""``imumon batch``: a command over many sessions."""

import os
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import click

from imumon.cli import common
from imumon.cli.progress import bar
from imumon.errors import EXIT_NEGATIVE, EXIT_OK
from imumon.files import write_text
from imumon.harmless import for_log

SHOWN = 20
"""Lines that are shown of what failed, and of what is missing."""
FAILED_NAME = "failed.txt"
"""Lists all that failed, where that is more than is shown."""


@click.group("batch")
def command() -> None:
    """Run a command over many SESSIONS, here or on a Dask cluster, into one Parquet table.

    \b
    imumon batch allan sessions --out noise
    imumon batch replay sessions/2026-* s3://bucket/soaks --out estimates

    SESSIONS are session folders, folders with sessions somewhere below, or URLs of either
    (s3://bucket/folder).  The table, with a row for each session and channel, is DIR/rows/*.parquet.
    Sessions that are in the table are not repeated: after a stop the same command goes on.
    """


TABLES = click.option("--tables", is_flag=True, help="Also write DIR/tables/SESSION.parquet.")
SUBCOMMANDS: dict[str, tuple[str, tuple[Any, ...]]] = {
    "decode": ("Count, mean and scatter of every channel as sent.", (TABLES,)),
    "replay": ("Count, mean and scatter of all channels and estimates.", (
        TABLES, common.path_option("--pipeline",
            help="Pipeline file; default: as each session was recorded."),
    )),
    "allan": ("Noise of every channel, from its Allan curve.  The terms have standard deviations.", ()),
    "calibrate": ("Bias over temperature, a model for each session.  Models: DIR/models/*.yaml.", (
        click.option("--latitude", "latitude_deg", type=common.Number(min=-90, max=90),
            help="Degrees north; with --heading the earth's rotation is removed."),
        click.option("--heading", "heading_deg", type=common.Number(min=-360, max=360),
            help="Direction of the x axis, degrees clockwise from north."),
    )),
    "diagnose": ("Effects that a bias model lacks, for each session.  Reports: DIR/reports/*.json.", (
        click.option("--declared", help="Bias model that is assumed; see imumon diagnose."),
    )),
}  # fmt: skip
"""What each does, and options of its own."""
SHARED: tuple[Any, ...] = (
    click.argument("sessions", nargs=-1, required=True),
    common.path_option("--out", required=True, help="Folder of the results."),
    click.option("--scheduler", help="Address of a Dask scheduler; default: processes on this computer."),
    click.option("--workers", type=common.Whole(min=1), default=os.cpu_count(), show_default=True,
        help="Number of processes on this computer."),
    click.option("--timeout", type=common.SECONDS,
        help="Longest time for a session; one that takes longer has failed."),
    click.option("--retry", is_flag=True, help="Repeat the sessions that failed."),
)  # fmt: skip
HELP = """{what}

\b
imumon batch {name} sessions --out results

SESSIONS are session folders, folders with sessions somewhere below, or URLs of either (s3://bucket/folder).
"""


def _run(
    name: str,
    sessions: tuple[str, ...],
    out: Path,
    scheduler: str | None,
    workers: int,
    timeout: float | None,
    retry: bool,
    as_json: bool,
    **given: Any,
) -> int:
    from .batch import running
    from .batch.dataset import BatchOptions, Dataset
    from .batch.places import find
    from .batch.tasks import Job

    options = BatchOptions.model_validate({"command": name, **_chosen(given)})
    every = dict.fromkeys(place for one in sessions for place in find(one))
    results = Dataset(out.absolute(), options)
    try:
        left = results.left(every, retry)
        if left:
            jobs = (Job(place, options, str(results.folder), limit_s=timeout) for place in left)
            shown = bar("sessions", len(left), quiet=as_json)
            with running.workers(scheduler, min(workers, len(left))) as client, shown as progress:

                def take(rows: Any) -> None:
                    results.add(rows)
                    progress.count(1)

                running.run_jobs(client, jobs, take)
    except KeyboardInterrupt:
        results.write()
        kept = f"{len(results.done().keys() & every.keys()):,} of {len(every):,} sessions are done"
        common.note(f"imumon: interrupted: {kept}; the same command does the rest")
        raise
    finally:
        results.close()
    done = results.done()
    return _report(out, {place: done[place] for place in every}, len(every) - len(left), as_json)


def _report(out: Path, rows: Mapping[str, Mapping[str, Any]], before: int, as_json: bool) -> int:
    """Show what became of the sessions, of each of which there is a row; return the exit code."""
    from .batch.dataset import ROWS, lacking

    failures = {place: f"{row['reason']}: {row['error']}" for place, row in rows.items() if row.get("reason")}
    lacks = {place: texts for place, row in rows.items() if (texts := lacking(row))}
    failed = [f"{place}: {why}" for place, why in sorted(failures.items())]
    (out / FAILED_NAME).unlink(missing_ok=True)
    if len(failed) > SHOWN:
        write_text(out / FAILED_NAME, "".join(f"{for_log(line)}\n" for line in failed))
    _warn_first(failed, f"more failed; all {len(failed):,} are in {out / FAILED_NAME}")
    missing = [f"{place}: {text}" for place, texts in sorted(lacks.items()) for text in texts]
    _warn_first(missing, "more lines on missing parts, in the column warnings")
    reasons = Counter(why.partition(":")[0] for why in failures.values())
    data = {"out": out, "sessions": len(rows), "done_before": before, "failed": failures, "lacking": lacks}
    shown = {
        "sessions": f"{len(rows):,}, {before:,} of them done before",
        "failed": ", ".join(f"{n:,} {reason}" for reason, n in reasons.most_common()) or "none",
        "lacking": f"{len(lacks):,} with parts of the recording missing" if lacks else "none",
        "table": str(out / ROWS / "*.parquet"),
    }
    common.print_result(as_json, data, shown)
    return EXIT_NEGATIVE if len(failures) == len(rows) else EXIT_OK


def _warn_first(lines: list[str], more: str) -> None:
    hidden = [f"{len(lines) - SHOWN:,} {more}"] if len(lines) > SHOWN else []
    common.warn([*lines[:SHOWN], *hidden])


def _chosen(given: dict[str, Any]) -> dict[str, Any]:
    """Return the options that are given as the folder of a batch keeps them."""
    chosen = {name: value for name, value in given.items() if value is not None}
    if (pipeline := chosen.pop("pipeline", None)) is not None:
        from imumon.run.setup import load_setup

        chosen["pipeline_yaml"] = load_setup(pipeline).text()
    if "declared" in chosen:
        from imumon.lab.diagnosis.diagnose import parse_declared

        parse_declared(chosen["declared"])
    if {"latitude_deg", "heading_deg"} & chosen.keys():
        from imumon.lab.calibration.calibration import check_place

        check_place(chosen.get("latitude_deg"), chosen.get("heading_deg"))
    return chosen


for _name, (_what, _own) in SUBCOMMANDS.items():
    _function: Any = partial(_run, _name)
    for _option in reversed((*SHARED, *_own, common.json_option)):
        _function = _option(_function)
    command.command(_name, help=HELP.format(what=_what, name=_name))(_function)
