"""``imumon align``: the heading of a unit at rest, from a port or a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    PATH,
    SECONDS,
    Number,
    Whole,
    baud_option,
    console,
    device_help,
    json_option,
    labelled,
    note,
    print_json,
    show,
    warn,
)
from imumon.cli.live_run import PortRun
from imumon.cli.setup_options import make_setup
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, Reason

if TYPE_CHECKING:
    from imumon.estimation.alignment.report import Guide, Status
    from imumon.estimation.alignment.stage import Alignment
    from imumon.pipeline import Pipeline
    from imumon.run.setup import Setup


@click.command("align")
@click.argument("source", metavar="PORT|SESSION")
@click.option("--latitude", type=Number(min=-90, max=90), help="Latitude of the place, degrees north.")
@click.option(
    "--until",
    type=Number(min=0, min_open=True, max=90),
    help="Wanted standard deviation of the heading, degrees; default: 0.05.",
)
@click.option("--device", help=device_help)
@baud_option
@click.option(
    "--positions",
    type=Whole(1, 12),
    default=1,
    show_default=True,
    help="Number of positions.  With 2 or more the unit is turned in between, and the bias of the gyros does"
    " not matter.",
)
@click.option("--seconds", type=SECONDS, help="Give up after this time; for a port only.")
@click.option("--out", type=PATH, help="Folder for the live session; default: a new one in ./sessions.")
@click.option("--pipeline", type=PATH, help="Pipeline file: place, model and parameters of the estimators.")
@click.option("--model", type=PATH, help="Bias model, for instance with the warm-up of the accelerometers.")
@json_option
def command(
    source: str,
    latitude: float | None,
    until: float | None,
    device: str | None,
    baud: int | None,
    positions: int,
    seconds: float | None,
    out: Path | None,
    pipeline: Path | None,
    model: Path | None,
    as_json: bool,
) -> int:
    """Find the heading of the resting unit on PORT or in SESSION from the earth's rotation.

    \b
    imumon align /dev/ttyUSB0 --device xsens --latitude 52
    imumon align sessions/NAME --latitude 52

    A port is recorded until the standard deviation of the heading is small enough, or until it is clear that
    it will not become so.  A session is read to its end.  Exit code 0: settled; 1: not settled.

    With --positions 2 imumon reports when to turn the unit by about 180° about the vertical.  The gyros
    measure the angle.  The earth's rotation stays where it is and the bias turns with the unit, so that the
    two can be separated.
    """

    def setup(recorded: str | None = None, where: str = "") -> Setup:
        made = make_setup({"pipeline": pipeline, "model": model, "latitude": latitude}, recorded, where)
        return _with_sigma(made, until)

    if _is_recording(source):
        if baud is not None or seconds is not None or out is not None:
            raise click.UsageError("--baud, --seconds and --out are for a port; a session is only read")
        ran = _recorded(Path(source), device, setup)
    else:
        made = setup()
        live = PortRun(source, _needed(device, source), baud, made, out, seconds)
        ran = _live(live, positions)
    stage = _stage_of(ran)
    status = stage.status
    if as_json:
        print_json(as_data(status, positions) | {"left_out": ran.counters.left_out})
    else:
        _report(status)
    settled = status.settled_s is not None and status.positions >= positions
    return EXIT_OK if settled else EXIT_NEGATIVE


def _with_sigma(setup: Setup, until: float | None) -> Setup:
    """Return the setup with the sigma wanted; raises BAD_CONFIG when it does not tell the latitude."""
    if setup.latitude_deg is None:
        raise ImumonError(
            Reason.BAD_CONFIG,
            "the heading is found by the earth rate, and the latitude is not known",
            "add --latitude DEGREES (north is positive), or latitude_deg to the pipeline file",
        )
    if until is None:
        return setup
    return setup.with_options(alignment=setup.alignment.model_copy(update={"settled_deg": until}))


def _is_recording(source: str) -> bool:
    """Tell a session or capture from a port; raises NOT_FOUND for a name that can be neither."""
    path = Path(source)
    if path.is_dir() or path.is_file():
        return True
    if "://" in source or path.exists() or source.startswith("/dev/"):
        return False
    raise ImumonError(
        Reason.NOT_FOUND,
        f"{source}: there is neither a session nor a port of this name",
        "imumon ports lists the ports; sessions are folders with a session.yaml, usually in ./sessions",
    )


def _stage_of(pipeline: Pipeline) -> Alignment:
    from imumon.estimation.alignment.stage import Alignment

    return next(stage for stage in pipeline.estimators if isinstance(stage, Alignment))


def _recorded(path: Path, device: str | None, make: Callable[..., Setup]) -> Pipeline:
    """Go through a recording to its end."""
    from imumon.estimation.alignment.stage import Alignment
    from imumon.estimation.gyro_bias.stage import RestAndBias
    from imumon.recordings.source import open_source, run_over
    from imumon.run.stages import pipeline_of

    source = open_source(path, device)
    recorded = None if source.session is None else source.session.metadata.pipeline_yaml
    setup = make(recorded, f"{path} (pipeline_yaml)")
    # Only what the heading needs: the other estimators do not change it.
    pipeline = pipeline_of(source, setup, only=(RestAndBias, Alignment))
    stage = _stage_of(pipeline)
    with _Shown(stage) as shown:
        for _ in run_over(source.items, pipeline):
            shown.renew()
    warn([*source.warnings(), *pipeline.warnings()])
    _refuse_without_sensors(stage.status, str(path), [column.name for column in source.columns(pipeline)])
    return pipeline


def _needed(device: str | None, port: str) -> str:
    """Return the device; raises BAD_CONFIG when none was named, as a port cannot tell."""
    from imumon.protocols.device import device_names

    if device is None:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"{port} is a port, so its device must be named",
            f"add --device NAME: {', '.join(device_names())}, or a file; imumon detect {port} may tell",
        )
    return device


def _live(live: PortRun, positions: int) -> Pipeline:
    """Record and align a port until the heading has settled, or will not, or the time is over."""
    stage = _stage_of(live.run.pipeline)
    try:
        live.begin(())
        _wait(live, stage, positions)
    finally:
        summary = live.run.stop()
        live.lines.write()
    note(f"recorded: {summary.session}")
    live.raise_problem(summary)
    columns = [column.name for column in live.run.pipeline.columns]
    _refuse_without_sensors(stage.status, live.port, columns)
    return live.run.pipeline


def _wait(live: PortRun, stage: Alignment, positions: int) -> None:
    from imumon.estimation.alignment.report import Guide

    guide = Guide(positions)
    with _Shown(stage, guide) as shown:
        while not guide.done and live.ending.wait() and live.run.processing:
            live.lines.write()
            shown.renew()
            for text in guide.update(stage.status):
                note(text)


class _Shown:
    """A line on the terminal: the state, the sigma on its way to the one wanted, and the time to go."""

    def __init__(self, stage: Alignment, guide: Guide | None = None) -> None:
        from rich.status import Status as Line

        self._stage, self._guide = stage, guide
        self._line = Line("alignment", console=console(error=True))

    def __enter__(self) -> _Shown:
        self._line.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._line.stop()

    def renew(self) -> None:
        from imumon.estimation.alignment.report import heading_text, to_go_text

        status = self._stage.status
        text = f"{status.phase}: {heading_text(status)}; {to_go_text(status)}"
        if self._guide is not None and self._guide.instruction:
            text = f"{self._guide.instruction}; {text}"
        self._line.update(text)


def _refuse_without_sensors(status: Status, where: str, columns: Sequence[str]) -> None:
    """Raise BAD_DATA when there was not one whole reading of gyros and accelerometers."""
    if status.phase != "waiting" or status.elapsed_s > 0.0:
        return
    needed = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    lacking = ", ".join(name for name in needed if name not in columns)
    seen = f"there is no {lacking}" if lacking else "fewer than two samples have all six readings"
    hint = "the heading needs angular rate and specific force of all three axes, in the same packets"
    raise ImumonError(Reason.BAD_DATA, f"{where}: {seen}", hint)


def as_data(status: Status, positions: int = 1) -> dict[str, object]:
    """Return what ``--json`` prints; headings in degrees clockwise from true north, 0 to 360."""
    import math

    def degrees(heading: float) -> float:
        return math.degrees(heading) % 360.0

    shown = status.shown
    return {
        "heading_deg": math.nan if shown is None else degrees(shown.heading),
        "heading_sd_deg": math.nan if shown is None else math.degrees(shown.sd),
        "estimator": None if shown is None else "joint",
        "settled_s": status.settled_s if status.positions >= positions else None,
        "observable": status.observable,
        "positions": status.positions,
        "estimators": {
            name: {
                "heading_deg": degrees(estimate.heading) if estimate.known else math.nan,
                "sd_deg": math.degrees(estimate.sd) if estimate.known else math.nan,
            }
            for name, estimate in status.estimates.items()
        },
    }


def _report(status: Status) -> None:
    from rich.box import SIMPLE
    from rich.table import Table

    from imumon.estimation.alignment.report import estimator_rows, rows

    if status.rest_s > 0.0:
        table = Table("estimator", "heading [°]", "σ [°]", box=SIMPLE, padding=(0, 1, 0, 0))
        for row in estimator_rows(status):
            table.add_row(*row)
        console().print(table)
    show("\n".join(labelled(rows(status))))
