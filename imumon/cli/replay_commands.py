"""``imumon replay``: a recording through the same code again; ``imumon view``: several on one time axis."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, Reason, bad_config
from imumon.files import check_output
from imumon.wing import offers

from .common import (
    TABLE,
    View,
    bind_option,
    chosen_view,
    columns_option,
    json_option,
    make_setup,
    note,
    path_argument,
    path_option,
    print_json,
    print_result,
    print_rows,
    rate_option,
    setup_options,
    split_columns,
    truth_option,
    warn,
    window_option,
)
from .live_run import serve
from .progress import reading_bar
from .table_commands import exported_as_data

if TYPE_CHECKING:
    import rerun as rr

    from imumon.pipeline import Pipeline
    from imumon.recordings.folder import Session
    from imumon.recordings.source import Count, Source
    from imumon.run.setup import Setup
    from imumon.run.truth import Truth
    from imumon.view.compare import Alignment, Comparison
    from imumon.view.items import ViewSetup
    from imumon.view.publisher import ViewPublisher
    from imumon.view.viewer import Mode

STARTING_S = 15.0
"""How long a viewer may take until it is there, or has an address."""
CLOSE_S = 5.0
"""How long the view may take to show the last samples of a replay."""


@click.command("replay")
@path_argument("session")
@click.option("--speed", help="1: as recorded; N: N times as fast; max.  Default: 1 with a view, else max.")
@path_option("--out", help=TABLE)
@columns_option
@rate_option
@click.option(
    "--view",
    type=click.Choice(["native", "web", "none"]),
    default="none",
    show_default=True,
    help="Show the run: in a window, in a browser, or not.",
)
@path_option(
    "--compare-models",
    nargs=2,
    metavar="A B",
    help="Only compare two bias models (files, or sessions that ran with one) on this session;"
    " --out PAGE.html.",
)
@click.option(
    "--smooth", is_flag=True, help="Also estimate with the data after each sample: columns ..._smoothed."
)
@truth_option
@setup_options
@window_option
@bind_option
@json_option
def replay(
    session: Path,
    speed: str | None,
    out: Path | None,
    columns: str | None,
    rate: float | None,
    view: Literal["native", "web", "none"],
    window: float,
    bind: str,
    as_json: bool,
    smooth: bool,
    compare_models: tuple[Path, Path] | None,
    truth: bool,
    **options: Any,
) -> int:
    """Run the recorded SESSION again through the same code, to a table or to the view.

    \b
    imumon replay sessions/NAME --view web
    imumon replay sessions/NAME --out samples.parquet

    The results are those of the live run, bit for bit; the exit code is 1 where they are not.
    """
    if compare_models is not None:
        return _compare(session, compare_models, out, as_json)
    from imumon.pipeline import Digest
    from imumon.recordings.exports import Exported, export_run
    from imumon.recordings.folder import open_session
    from imumon.recordings.source import no_samples, open_source
    from imumon.run.narration import Narrator, describe_losses, describe_streams, view_setup
    from imumon.run.replay import Comparison, compare_with_live, digested, replay
    from imumon.run.stages import pipeline_of, smoothed

    opened = open_session(session)  # a raw capture has no times: that is for decode
    setup = make_setup(options, opened)
    true = _truth(session, setup) if truth else None
    source = open_source(session, rate_hz=rate)
    source.refuse_output(out)
    pace = _speed(speed, view)
    smoothers = [smoothed(open_source(session, rate_hz=rate), setup)] if smooth else []
    pipeline, digest = pipeline_of(source, setup, smoothers), Digest()
    publisher = narrator = None
    if view != "none":
        units = {column.name: column.unit for column in source.imported.values()} | pipeline.units
        publisher = _begun(view, view_setup(opened, units, window, replay=True), bind)
        card = {"session": str(session), "replay": "as fast as it goes" if pace is None else f"{pace:g} x"}
        narrator = Narrator(pipeline, None, [publisher.publish], lambda *_: None, card)
    try:
        with reading_bar([session], quiet=as_json) as progress:
            blocks = replay(source.items, pipeline, narrator, pace, progress.count)
            blocks = digested(blocks, pipeline, digest)
            if true is not None:
                blocks = true.through(blocks)
            if out is None:
                exported = Exported(sum(map(len, blocks)), {})
            else:
                exported = export_run(blocks, pipeline, source, out, split_columns(columns))
        if publisher is not None and view == "web":
            serve(publisher.url)
    finally:
        if publisher is not None:
            publisher.close(CLOSE_S)
    if smooth or rate is not None:
        comparison = Comparison(None, reason="it ran otherwise, by --smooth or --rate")
    else:
        comparison = compare_with_live(opened, setup, digest, pipeline)
    texts = [*source.warnings(), *pipeline.warnings(), *exported.warnings]
    if pipeline.counters.bytes_received and not pipeline.counters.streams:
        what = no_samples(source, pipeline).seen
        texts.append(f"{what}: is it another device?  Try: imumon decode SESSION --device NAME --out TABLE")
    if setup.bias_model is not None:
        texts.insert(0, setup.bias_model.of_another(opened.metadata.serial, opened.metadata.axes))
    warn(filter(None, texts))
    data = {
        "session": source.path,
        **exported_as_data(source, pipeline, exported),
        "results_digest": digest.hexdigest(),
        **comparison.as_dict(),
    }
    rows = {
        "samples": f"{exported.rows:,}, {comparison}",
        "losses": describe_losses(pipeline.counters),
        **describe_streams(pipeline.counters, exported.tables),
    }
    for smoother in smoothers:
        data["disagreement"] = smoother.residuals
        text = ", ".join(f"{name} {value:.2f}" for name, value in smoother.residuals.items())
        rows["forward minus backward"] = f"{text} σ rms" if text else "nothing to compare"
    if true is not None:
        data["truth"] = true.as_data()
        rows |= true.rows()
    print_result(as_json, data, rows)
    return EXIT_NEGATIVE if comparison.identical is False else EXIT_OK


def _truth(session: Path, setup: Setup) -> Truth:
    """Return the truth of a simulated session; raises BAD_DATA without, BAD_CONFIG with half a place."""
    from imumon.run.truth import read_truth

    if setup.latitude_deg is not None and setup.heading_deg is None:
        raise bad_config(
            "--truth with a latitude alone: only a part of the earth's rotation is removed from the bias",
            "add --heading, or leave --latitude away",
        )
    return read_truth(session, earth_removed=setup.latitude_deg is not None)


def _compare(session: Path, given: tuple[Path, Path], out: Path | None, as_json: bool) -> int:
    if out is None:
        raise bad_config("--compare-models makes a page, which has no name", "add --out PAGE.html")
    check_output(out, suffix=".html")
    compare, *_ = offers("compare_models")  # that of imumon comes first
    data, rows = compare(session, given, out)
    print_result(as_json, data, {**rows, "page": str(out)})
    return EXIT_OK


def _begun(view: Mode, setup: ViewSetup, bind: str) -> ViewPublisher:
    """Return a view that begins, and report where it is before what it shows is over."""
    from imumon.view.publisher import ViewPublisher

    chosen_view(view, bind)
    publisher = ViewPublisher(view, setup, bind=bind).start()
    end = time.monotonic() + STARTING_S
    while not publisher.url and time.monotonic() < end:
        time.sleep(0.05)
    note(f"view: {publisher.url or publisher.text}")
    return publisher


def _speed(text: str | None, view: str) -> float | None:
    text = text or ("max" if view == "none" else "1")
    if text == "max":
        return None
    with suppress(ValueError):
        if 0 < (speed := float(text)) < 1e9:
            return speed
    raise bad_config(f"--speed {text!r}: expected a positive number or max")


@click.command("view")
@path_argument("sessions", nargs=-1, required=True, metavar="SESSION...")
@click.option(
    "--align",
    type=click.Choice(["power-on", "host"]),
    default="power-on",
    show_default=True,
    help="Begin each session at zero, or put it at the time of its computer's clock.",
)
@click.option(
    "--view", type=click.Choice(["native", "web"]), help="Default: native with a display, else web."
)
@path_option("--out", help="Write the comparison as NAME.rrd for Rerun, and show nothing.")
@bind_option
@json_option
def view(
    sessions: tuple[Path, ...],
    align: Alignment,
    view: View | None,
    out: Path | None,
    bind: str,
    as_json: bool,
) -> None:
    """Show SESSIONs on one time axis, each quantity in a view, each session in its own colour.

    \b
    imumon view sessions/before sessions/after

    Each runs through the estimators with the setup that it was recorded with, so that, for one, the bias
    before and after a new model can be compared side by side.
    """
    import rerun as rr

    from imumon.recordings.folder import open_session
    from imumon.recordings.source import source_of
    from imumon.run.setup import recorded_setup
    from imumon.run.stages import pipeline_of
    from imumon.view.compare import Comparison
    from imumon.view.items import ViewSetup
    from imumon.view.viewer import APPLICATION

    if out is not None:
        check_output(out, suffix=".rrd")
    names = [path.resolve().name for path in sessions]
    if len(set(names)) < len(names):
        names = [f"{name} {number}" for number, name in enumerate(names, 1)]
    opened = []
    for path in sessions:  # what is wrong with one is reported before a viewer comes
        session = open_session(path)
        source = source_of(session)
        opened.append((session, source, pipeline_of(source, recorded_setup(session))))
    setup = ViewSetup(" and ".join(names), f"view-{time.time_ns()}")
    rec = rr.RecordingStream(APPLICATION, recording_id=setup.recording_id)
    url = ""
    if out is not None:
        rec.set_sinks(rr.FileSink(out))
    else:
        view = chosen_view(view, bind)
        url = _shown(rec, view, bind)
    comparison = Comparison(rec, setup, align)
    found = dict[str, tuple[dict[str, object], dict[str, str]]]()
    try:
        for one, name in zip(opened, names, strict=True):
            with reading_bar([one[0].path], quiet=as_json) as progress:
                found[name] = _log_session(*one, name, comparison, progress.count)
        comparison.arrange()
        rec.flush()
    except BaseException:
        if out is not None:  # no file that is a part
            rec.disconnect()
            out.unlink(missing_ok=True)
        raise
    if url:
        note(f"view: {url}")
    if as_json:
        print_json({"sessions": [data for data, _ in found.values()], "out": out, "url": url or None})
    for name, (_, rows) in found.items():
        note(name)
        print_rows(rows)
    if url and view == "web":
        serve(url)
    rec.disconnect()


def _log_session(
    recorded: Session,
    source: Source,
    pipeline: Pipeline,
    name: str,
    comparison: Comparison,
    count: Count,
) -> tuple[dict[str, object], dict[str, str]]:
    """Run a session and log it; return the result, for programs and for people."""
    from imumon.recordings.source import run_over
    from imumon.run.account import Outages, describe_disk, describe_span, file_sizes, wall_clock
    from imumon.run.narration import describe_losses

    metadata, path, outages = recorded.metadata, recorded.path, Outages()
    comparison.begin(name)
    for block in run_over(outages.watch(source.items), pipeline, count):
        comparison.log(block)
    counters, began_ns = pipeline.counters, metadata.created_ns
    warn([*source.warnings(), *pipeline.warnings()])
    if counters.samples and comparison.began_ns is None:
        warn([f"{name}: has no times of a computer, and is not shown; --align power-on shows it"])
    ended_ns = max(metadata.ended_ns or 0, outages.last_ns) or began_ns
    span = describe_span(began_ns, ended_ns)
    if metadata.table is not None:  # when a table was measured is not known
        span = f"{metadata.duration_s:.1f} s, imported {wall_clock(began_ns, day=True)}"
    data = {
        "session": path,
        "name": name,
        "created_ns": began_ns,
        "ended_ns": ended_ns,
        "outages": outages.as_data(),
        "files": file_sizes(path),
        **counters.as_dict(),
    }
    return data, {
        "recorded": span,
        "samples": f"{counters.samples:,}",
        "outages": outages.describe(),
        "losses": describe_losses(counters),
        "on disk": describe_disk(path),
    }


def _shown(rec: rr.RecordingStream, mode: View, bind: str) -> str:
    """Connect the stream to a viewer or to the page that shows it; return where that is.

    Raises NOT_FOUND when no viewer comes up.
    """
    from imumon.view.viewer import SERVER_MEMORY, probe, proxy_url, start_viewer, viewer_port
    from imumon.view.web import WebServer, serve_stream

    if mode == "web":
        return WebServer(serve_stream(rec, SERVER_MEMORY), bind=bind).url
    port = viewer_port()
    viewer = None if probe(port) else start_viewer(port)
    deadline = time.monotonic() + STARTING_S
    while not probe(port):
        if time.monotonic() > deadline or (viewer is not None and viewer.poll() is not None):
            raise ImumonError(
                Reason.NOT_FOUND, "the viewer could not start", "use --view web, or --out NAME.rrd"
            )
        time.sleep(0.1)
    rec.connect_grpc(proxy_url(port))
    return proxy_url(port)
