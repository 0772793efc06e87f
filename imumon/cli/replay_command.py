"""``imumon replay``: a recording through the same code again."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

import click

from imumon.cli.common import (
    PATH,
    TABLE,
    bind_option,
    chosen_view,
    columns_option,
    json_option,
    note,
    print_result,
    rate_option,
    split_columns,
    truth_option,
    warn,
    window_option,
)
from imumon.cli.live_run import serve
from imumon.cli.progress import reading_bar
from imumon.cli.setup_options import SetupOptions, make_setup, setup_options
from imumon.cli.table_commands import exported_as_data
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, Reason
from imumon.files import check_output
from imumon.wings import offers

if TYPE_CHECKING:
    from imumon.pipeline import Estimator
    from imumon.run.setup import Setup
    from imumon.run.truth import Truth
    from imumon.view.items import ViewSetup
    from imumon.view.publisher import ViewPublisher
    from imumon.view.viewer import Mode

STARTING_S = 10.0
"""How long a view may take until it has an address."""
CLOSE_S = 5.0
"""How long the view may take to show the last samples of a replay."""


@click.command("replay")
@click.argument("session", type=PATH)
@click.option("--speed", help="1: as recorded; N: N times as fast; max.  Default: 1 with a view, else max.")
@click.option("--out", type=PATH, help=TABLE)
@columns_option
@rate_option
@click.option(
    "--view",
    type=click.Choice(["native", "web", "none"]),
    default="none",
    show_default=True,
    help="Show the run: in a window, in a browser, or not.",
)
@click.option(
    "--compare-models",
    nargs=2,
    type=PATH,
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
def command(
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
    **options: Unpack[SetupOptions],
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
    from imumon.recordings.source import open_source
    from imumon.run.narration import Narrator, advised, describe_losses, describe_streams, view_setup
    from imumon.run.replay import Comparison, compare_with_live, digested, replay
    from imumon.run.stages import pipeline_of

    opened = open_session(session)  # a raw capture has no times: that is for decode
    recorded = opened.metadata.pipeline_yaml
    setup = make_setup(options, recorded, f"{session} (pipeline_yaml)")
    true = _truth(session, setup) if truth else None
    source = open_source(session, rate_hz=rate)
    source.refuse_output(out)
    pace = _speed(speed, view)
    more: list[Estimator] = []
    disagreement: dict[str, float] | None = None
    if smooth:
        from imumon.run.smoothing import smoothed

        stage = smoothed(open_source(session, rate_hz=rate), setup)
        more, disagreement = [stage], stage.residuals
    pipeline, digest = pipeline_of(source, setup, more), Digest()
    publisher = narrator = None
    if view != "none":
        units = {column.name: column.unit for column in source.imported} | pipeline.units
        publisher = _begun(view, view_setup(opened, units, window, replay=True), bind)
        card = {"session": str(session), "replay": "as fast as it goes" if pace is None else f"{pace:g} x"}
        narrator = Narrator(pipeline, None, [publisher.publish], lambda *_: None, card, session)
    try:
        with reading_bar([session], quiet=as_json) as progress:
            again = replay(source.items, pipeline, narrator, pace, progress.count)
            blocks = digested(again, pipeline, digest)
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
    comparison = Comparison(None, "it ran otherwise, by --smooth or --rate")
    if not smooth and rate is None:
        comparison = compare_with_live(opened, setup, digest, pipeline)
    warn(advised(text, opened.path) for text in [*source.warnings(), *pipeline.warnings()])
    if comparison.identical is False:
        warn(["the samples differ from those of the live run: another version, or bytes missing"])
    warn(exported.warnings)
    data = {"session": source.path} | exported_as_data(source, pipeline, exported)
    data |= {"results_digest": digest.hexdigest()} | comparison.as_dict()
    rows = {"samples": f"{exported.rows:,}, {comparison}", "losses": describe_losses(pipeline.counters)}
    rows |= describe_streams(pipeline.counters, exported.tables)
    if disagreement is not None:
        data["disagreement"] = disagreement
        text = ", ".join(f"{name} {value:.2f}" for name, value in disagreement.items())
        rows["forward less backward"] = f"{text} σ rms" if text else "nothing to compare"
    if true is not None:
        data["truth"] = true.as_data()
        rows |= true.rows()
    print_result(as_json, data, rows)
    return EXIT_NEGATIVE if comparison.identical is False else EXIT_OK


def _truth(session: Path, setup: Setup) -> Truth:
    """Return the truth of a simulated session; raises BAD_DATA without, BAD_CONFIG with half a place."""
    from imumon.run.truth import read_truth

    if setup.latitude_deg is not None and setup.heading_deg is None:
        what = "--truth with a latitude alone: only a part of the earth's rotation is removed from the bias"
        raise ImumonError(Reason.BAD_CONFIG, what, "add --heading, or leave --latitude away")
    return read_truth(session, earth_removed=setup.latitude_deg is not None)


def _compare(session: Path, given: tuple[Path, Path], out: Path | None, as_json: bool) -> int:
    """Write the page of what two models leave of a session."""
    if out is None or out.suffix != ".html":
        what = "--compare-models makes a page, which has no name"
        raise ImumonError(Reason.BAD_CONFIG, what, "add --out PAGE.html")
    check_output(out)
    compare, *_ = offers("compare_models")  # that of imumon comes first
    data, rows = compare(session, given, out)
    print_result(as_json, data, {**rows, "page": str(out)})
    return EXIT_OK


def _begun(view: Mode, setup: ViewSetup, bind: str) -> ViewPublisher:
    """Return a view that begins, and say where it is before what it shows is over."""
    from imumon.view.publisher import ViewPublisher

    chosen_view(view, bind)
    publisher = ViewPublisher(view, setup, bind=bind).start()
    end = time.monotonic() + STARTING_S
    while not publisher.url and time.monotonic() < end:
        time.sleep(0.05)
    note(f"view: {publisher.url or publisher.state}")
    return publisher


def _speed(text: str | None, view: str) -> float | None:
    if text is None:
        return None if view == "none" else 1.0
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < 1e9:
        raise ImumonError(Reason.BAD_CONFIG, f"--speed {text!r}: expected a positive number or max")
    return speed
