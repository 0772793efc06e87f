"""``imumon view``: several sessions on one time axis."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import PATH, bind_option, chosen_view, json_option, note, print_json, print_rows, warn
from imumon.cli.live_run import serve
from imumon.cli.progress import reading_bar
from imumon.errors import ImumonError, Reason
from imumon.files import check_output

if TYPE_CHECKING:
    import rerun as rr

    from imumon.pipeline import Pipeline
    from imumon.recordings.folder import Session as RecordedSession
    from imumon.recordings.source import Count, Source
    from imumon.view.compare import Alignment, Session
    from imumon.view.items import ViewSetup
    from imumon.view.viewer import Mode

STARTING_S = 15.0
"""How long a viewer may take to come up."""


@click.command("view")
@click.argument("sessions", nargs=-1, required=True, metavar="SESSION...", type=PATH)
@click.option(
    "--align",
    type=click.Choice(["power-on", "host"]),
    default="power-on",
    show_default=True,
    help="Begin each session at zero, or put it where its computer's clock says.",
)
@click.option(
    "--view", type=click.Choice(["native", "web"]), help="Default: native with a display, else web."
)
@click.option("--out", type=PATH, help="Write the comparison as NAME.rrd for Rerun, and show nothing.")
@bind_option
@json_option
def command(
    sessions: tuple[Path, ...],
    align: Alignment,
    view: Mode | None,
    out: Path | None,
    bind: str,
    as_json: bool,
) -> None:
    """Show SESSIONs on one time axis, each quantity in a view, each session in its own colour.

    \b
    imumon view sessions/before sessions/after

    Each runs through the estimators with the setup that it was recorded with, so that, for one, the bias
    before and after a new model can be seen side by side.
    """
    import rerun as rr

    from imumon.view.compare import Comparison
    from imumon.view.items import ViewSetup
    from imumon.view.viewer import APPLICATION, default_mode

    if out is not None:
        check_output(out)
    folders = [path.resolve().name for path in sessions]
    names = [  # with a number where two have the same
        name if folders.count(name) == 1 else f"{name} {folders[: at + 1].count(name)}"
        for at, name in enumerate(folders)
    ]
    opened = [_opened(path) for path in sessions]  # what is wrong with one is reported before a viewer comes
    setup = ViewSetup(" and ".join(names), f"view-{time.time_ns()}")
    mode = view or default_mode()
    rec = rr.RecordingStream(APPLICATION, recording_id=setup.recording_id)
    url = ""
    if out is not None:
        rec.set_sinks(rr.FileSink(out))
    else:
        chosen_view(mode, bind)
        url = _shown(rec, setup, mode, bind)
    comparison = Comparison(rec, setup, align)
    titles = []
    try:
        for one, path, name in zip(opened, sessions, names, strict=True):
            with reading_bar([path], quiet=as_json) as progress:
                titles.append(_log(*one, name, comparison.session(name), progress.count))
        if comparison.arrange() is None:
            hint = "an imported table has no times of a computer: --align power-on" if align == "host" else ""
            raise ImumonError(Reason.BAD_DATA, "the sessions have no samples with such times", hint)
        rec.flush()
    except BaseException:
        if out is not None:  # no file that is a part
            rec.disconnect()
            out.unlink(missing_ok=True)
        raise
    if url:
        note(f"view: {url}")
    if as_json:
        print_json({"sessions": [data for data, _ in titles], "out": out, "url": url or None})
    for name, (_, rows) in zip(names, titles, strict=True):
        note(name)
        print_rows(rows)
    if mode == "web" and out is None:
        serve(url)
    rec.disconnect()


def _opened(path: Path) -> tuple[RecordedSession, Source, Pipeline]:
    """Open a session, with the pipeline that it is to run through.

    Raises ImumonError as `open_source` and `recorded_setup` do.
    """
    from imumon.recordings.folder import open_session
    from imumon.recordings.source import open_source
    from imumon.run.setup import recorded_setup
    from imumon.run.stages import pipeline_of

    session, source = open_session(path), open_source(path)
    return session, source, pipeline_of(source, recorded_setup(session))


def _log(
    recorded: RecordedSession,
    source: Source,
    pipeline: Pipeline,
    name: str,
    session: Session,
    count: Count,
) -> tuple[dict[str, object], dict[str, str]]:
    """Run a session and log it; return the result, for programs and for people."""
    from imumon.recordings.source import run_over
    from imumon.run.account import Outages, describe_disk, describe_span, file_sizes, wall_clock
    from imumon.run.narration import describe_losses

    metadata, path, outages, samples = recorded.metadata, recorded.path, Outages(), 0
    for block in run_over(outages.watch(source.items), pipeline, count):
        samples += len(block)
        session.log(block)
    warn([*source.warnings(), *pipeline.warnings()])
    ended_ns = max(metadata.ended_ns or 0, outages.last_ns) or metadata.created_ns
    span = describe_span(metadata.created_ns, ended_ns)
    if metadata.table is not None:  # nobody knows when a table was measured
        span = f"{metadata.duration_s:.1f} s, imported {wall_clock(metadata.created_ns, day=True)}"
    data = {
        "session": path,
        "name": name,
        "samples": samples,
        "created_ns": metadata.created_ns,
        "ended_ns": ended_ns,
        "outages": outages.as_data(),
        "files": file_sizes(path),
        **pipeline.counters.as_dict(),
    }
    rows = {
        "recorded": span,
        "samples": f"{samples:,}",
        "outages": outages.describe(),
        "losses": describe_losses(pipeline.counters),
        "on disk": describe_disk(path),
    }
    return data, rows


def _shown(rec: rr.RecordingStream, setup: ViewSetup, mode: Mode, bind: str) -> str:
    """Connect the stream to a viewer or to the page that shows it; return where that is.

    Raises NOT_FOUND when no viewer comes up.
    """
    from imumon.view.viewer import Answer, probe, proxy_url, start_viewer, viewer_port
    from imumon.view.web import serve_page

    if mode == "web":
        return serve_page(rec, setup, bind=bind).url
    port = viewer_port()
    viewer = None if probe(port) is Answer.RERUN else start_viewer(port)
    deadline = time.monotonic() + STARTING_S
    while probe(port) is not Answer.RERUN:
        if time.monotonic() > deadline or (viewer is not None and viewer.poll() is not None):
            raise ImumonError(
                Reason.NOT_FOUND, "the viewer could not start", "use --view web, or --out NAME.rrd"
            )
        time.sleep(0.1)
    rec.connect_grpc(proxy_url(port))
    return proxy_url(port)
