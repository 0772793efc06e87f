"""``imumon replay``: a recording through the same code again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from imumon.cli.common import (
    PATH,
    TABLE,
    bind_option,
    columns_option,
    json_option,
    print_json,
    print_rows,
    say,
    split_columns,
    window_option,
)
from imumon.cli.setup_options import SetupOptions, make_setup, setup_options
from imumon.errors import ImumonError, Reason

if TYPE_CHECKING:
    from imumon.blocks import SampleBlock
    from imumon.pipeline import Digest, Pipeline
    from imumon.recordings.source import Source
    from imumon.view.publisher import ViewPublisher

CLOSE_S = 5.0
"""How long the view may take to show the last samples of a replay."""


@click.command("replay")
@click.argument("session", type=PATH)
@click.option("--speed", help="1 as recorded, N times as fast, or max.  Default: 1 with a view, else max.")
@click.option("--out", type=PATH, help=TABLE)
@columns_option
@click.option("--view", type=click.Choice(["native", "web", "none"]), default="none", show_default=True)
@click.option("--smooth", is_flag=True, help="Also estimate with what came later: columns ..._smoothed.")
@setup_options
@window_option
@bind_option
@json_option
def command(
    session: Path,
    speed: str | None,
    out: Path | None,
    columns: str | None,
    view: str,
    window: float,
    bind: str,
    as_json: bool,
    smooth: bool,
    **options: Unpack[SetupOptions],
) -> int:
    """Run SESSION again through the same code, bit for bit, to a table or to the view."""
    from imumon.pipeline import Digest, Pipeline
    from imumon.recordings.folder import open_session
    from imumon.recordings.source import open_source
    from imumon.run.narration import Narrator
    from imumon.run.replay import replay
    from imumon.run.stages import estimators

    recorded = open_session(session).metadata.pipeline_yaml  # a raw capture has no times: that is for decode
    setup = make_setup(options, recorded, f"{session} (pipeline_yaml)")
    source = open_source(session)
    source.refuse_output(out)
    pace = _speed(speed, view)
    stages = estimators(source.device, setup)
    disagreement: dict[str, float] | None = None
    if smooth:
        from imumon.run.smoothing import smoothed

        stage = smoothed(open_source(session), setup)
        stages, disagreement = [*stages, stage], stage.disagreement
    pipeline, digest = Pipeline(source.device, stages), Digest()
    publisher = None if view == "none" else _publisher(source, pipeline, view, window, bind)
    narrator = None
    if publisher is not None:
        card = {"session": str(session), "replay": "as fast as it goes" if pace is None else f"{pace:g} x"}
        narrator = Narrator(pipeline, None, [publisher.publish], lambda *_: None, card, session)
    blocks = _digested(replay(source.items, pipeline, narrator, pace), pipeline, digest)
    try:
        rows, tables = _run(blocks, source, pipeline, out, columns)
    finally:
        if publisher is not None:
            publisher.close(CLOSE_S)
    comparable = setup.text() == recorded and not smooth
    _report(source, pipeline, digest.hexdigest(), tables, rows, as_json, comparable, disagreement)
    return 0


def _run(
    blocks: Iterator[SampleBlock], source: Source, pipeline: Pipeline, out: Path | None, columns: str | None
) -> tuple[int, dict[str, Path]]:
    if out is None:
        return sum(len(block) for block in blocks), {}
    from imumon.recordings.side_tables import export_run

    rows, tables = export_run(blocks, pipeline, out, split_columns(columns), lambda: source.columns(pipeline))
    return rows, tables


def _report(
    source: Source,
    pipeline: Pipeline,
    digest: str,
    tables: dict[str, Path],
    rows: int,
    as_json: bool,
    comparable: bool,
    disagreement: dict[str, float] | None,
) -> None:
    from imumon.protocols.base import MAIN
    from imumon.run.narration import advised, describe_losses, describe_streams

    assert source.session is not None
    live = source.session.metadata.results_digest if comparable else None
    identical = None if live is None else live == digest
    for text in [*source.warnings(), *pipeline.warnings()]:
        say("WARN", advised(text, source.session.path))
    if identical is False:
        say(
            "WARN",
            "the samples differ from those of the live run: another version, or bytes missing",
        )
    counters = pipeline.counters
    if as_json:
        print_json(
            {
                "session": source.path,
                "out": tables.get(MAIN),
                "rows": rows,
                "tables": tables,
                **counters.as_dict(),
                "results_digest": digest,
                "identical_to_live": identical,
                **({} if disagreement is None else {"disagreement": disagreement}),
            }
        )
    verdict = {
        True: "bit for bit those of the live run",
        False: "NOT those of the live run",
        None: "with no live run of the same setup to compare",
    }
    print_rows(
        {
            "samples": f"{rows:,}, {verdict[identical]}",
            "losses": describe_losses(counters),
            **describe_streams(counters, tables),
            **_smoothing(disagreement),
        }
    )


def _smoothing(disagreement: dict[str, float] | None) -> dict[str, str]:
    if disagreement is None:
        return {}
    said = ", ".join(f"{name} {value:.2f}" for name, value in disagreement.items())
    return {"forward less backward": f"{said} σ rms" if said else "nothing to compare"}


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


def _publisher(source: Source, pipeline: Pipeline, view: str, window: float, bind: str) -> ViewPublisher:
    from imumon.run.narration import view_setup
    from imumon.view.publisher import ViewPublisher

    assert source.session is not None
    units = {column.name: column.unit for column in source.imported} | pipeline.units
    setup = view_setup(source.session, units, window, replay=True)
    return ViewPublisher("native" if view == "native" else "web", setup, bind=bind).start()


def _digested(blocks: Iterator[SampleBlock], pipeline: Pipeline, digest: Digest) -> Iterator[SampleBlock]:
    for block in blocks:
        digest.update(block, pipeline.side)
        yield block
