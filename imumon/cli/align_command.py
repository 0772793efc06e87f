"""``imumon align``: the heading of a unit at rest, from a recording or a port."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, Reason, bad_config, bad_data
from imumon.estimation.alignment.report import ANY_ANGLE_SD, Estimate, Status

from . import common
from .live_run import PortRun

if TYPE_CHECKING:
    from imumon.estimation.alignment.stage import Alignment
    from imumon.pipeline import Pipeline
    from imumon.run.setup import Setup

HOPELESS_S = 120.0
"""Time at rest after which a bias that hides the north, or what looks like one, ends the alignment."""
LONGEST_S = 300.0
"""Longest time in one of several positions."""
DONE = "done"
"""The last instruction: the result is there, or will not come."""


@click.command("align")
@click.argument("source", metavar="PORT|SESSION")
@common.latitude_option
@click.option(
    "--until",
    type=common.Number(min=0, min_open=True, max=90),
    help="Wanted standard deviation of the heading, degrees; default: 0.05.",
)
@click.option("--device", help=common.device_help)
@common.baud_option
@click.option(
    "--positions",
    type=common.Whole(1, 12),
    default=1,
    show_default=True,
    help="Number of positions.  With 2 or more the unit is turned in between, and the bias of the gyros does"
    " not matter.",
)
@click.option("--seconds", type=common.SECONDS, help="Give up after this time, not before; for a port only.")
@common.session_option
@common.pipeline_option
@common.model_option
@common.json_option
def command(
    source: str,
    until: float | None,
    device: str | None,
    baud: int | None,
    positions: int,
    seconds: float | None,
    out: Path | None,
    as_json: bool,
    **options: Any,
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
    if _is_recording(source):
        if baud is not None or seconds is not None or out is not None:
            raise click.UsageError("--baud, --seconds and --out are for a port; a session is only read")
        ran, columns = _recorded(Path(source), device, options, until)
    else:
        setup = _with_sigma(common.make_setup(options), until)
        if device is None:
            raise bad_config(
                f"{source} is a port, so its device must be named",
                f"add --device NAME (imumon devices lists them) or a file; try imumon detect {source}",
            )
        ran = _live(PortRun(source, device, baud, setup, out, seconds), positions, seconds is not None)
        columns = {column.name for column in ran.columns}
    status = _stage_of(ran).status
    if status.phase == "waiting":
        needed = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
        lacking = ", ".join(name for name in needed if name not in columns)
        found = f"there is no {lacking}" if lacking else "fewer than two samples have all six readings"
        raise bad_data(
            f"{source}: {found}",
            "the heading needs angular rate and specific force of all three axes, in the same packets",
        )
    result = as_data(status, positions)
    if as_json:
        common.print_json(result | {"left_out": ran.counters.left_out})
    else:
        if status.rest_s > 0.0:
            common.print_table(["estimator", "heading [°]", "σ [°]"], estimator_rows(status))
        common.show("\n".join(common.labelled(result_rows(status))))
    return EXIT_NEGATIVE if result["settled_s"] is None else EXIT_OK


def _with_sigma(setup: "Setup", until: float | None) -> "Setup":
    """Return the setup with the sigma wanted; raises BAD_CONFIG when it does not have the latitude."""
    if setup.latitude_deg is None:
        raise bad_config(
            "the heading is found by the earth rate, and the latitude is not known",
            "add --latitude DEGREES (north is positive), or latitude_deg to the pipeline file",
        )
    if until is None:
        return setup
    return setup.with_options(alignment=setup.alignment.model_copy(update={"settled_deg": until}))


def _is_recording(source: str) -> bool:
    """Distinguish a session or capture from a port; raises NOT_FOUND for a name that can be neither."""
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


def _stage_of(pipeline: "Pipeline") -> "Alignment":
    from imumon.estimation.alignment.stage import Alignment

    return next(stage for stage in pipeline.estimators if isinstance(stage, Alignment))


def _recorded(
    path: Path, device: str | None, options: dict[str, Any], until: float | None
) -> "tuple[Pipeline, set[str]]":
    """Go through a recording to its end; return the pipeline, and the names of the columns that came."""
    from imumon.estimation.alignment.stage import Alignment
    from imumon.estimation.gyro_bias.stage import RestAndBias
    from imumon.recordings.source import open_source, run_over
    from imumon.run.stages import pipeline_of

    source = open_source(path, device)
    setup = _with_sigma(common.make_setup(options, source.session), until)
    # Only what the heading needs: the other estimators do not change it.
    pipeline = pipeline_of(source, setup, only=(RestAndBias, Alignment))
    stage = _stage_of(pipeline)
    with common.console(error=True).status("alignment") as line:
        for _ in run_over(source.items, pipeline):
            line.update(_progress(stage.status))
    common.warn([*source.warnings(), *pipeline.warnings()])
    return pipeline, {column.name for column in source.columns(pipeline)}


def _live(live: PortRun, positions: int, patient: bool) -> "Pipeline":
    """Record and align a port until the heading has settled, or will not, or the time is over."""
    stage, text = _stage_of(live.run.pipeline), ""
    try:
        live.begin(())
        with common.console(error=True).status("alignment") as line:
            while text != DONE and live.ending.wait() and live.run.processing:
                live.lines.write()
                line.update(_progress(stage.status, text))
                before, text = text, instruction(stage.status, positions, text, patient)
                if text not in (before, DONE):  # the result follows
                    common.note(text)
    finally:
        summary = live.run.stop()
        live.lines.write()
    common.note(f"recorded: {summary.session}")
    live.raise_problem(summary)
    return live.run.pipeline


def _progress(status: Status, instruction: str = "") -> str:
    """Return what the terminal's line shows: state, sigma on its way to the one wanted, and time to go."""
    text = f"{status.phase}: {status.heading_text}; {status.to_go_text}"
    return f"{instruction}; {text}" if instruction else text


def as_data(status: Status, positions: int = 1) -> dict[str, object]:
    """Return what ``--json`` prints; headings in degrees clockwise from true north, 0 to 360."""
    estimators = {}
    for name, one in status.estimates.items():
        heading, sd = one if one.sd < ANY_ANGLE_SD else Estimate()
        estimators[name] = {"heading_deg": math.degrees(heading), "sd_deg": math.degrees(sd)}
    return {
        "heading_deg": math.degrees(status.shown.heading),
        "heading_sd_deg": math.degrees(status.shown.sd),
        "estimator": "joint" if status.estimates else None,
        "settled_s": status.settled_s if status.positions >= positions else None,
        "observable": status.observable,
        "positions": status.positions,
        "estimators": estimators,
    }


def result_rows(status: Status) -> dict[str, str]:
    """Return texts by label: the heading, whether it settled, and the conditions that limit it."""
    wanted = f"(σ ≤ {math.degrees(status.wanted_sd):g}°)"
    settled = f"no {wanted}: {status.to_go_text}"
    if status.settled_s is not None:
        settled = f"yes, {status.settled_s:.1f} s after the first sample {wanted}"
    texts = {
        "heading": status.heading_text,
        "settled": settled,
        "data": f"{min(status.rest_s, status.elapsed_s):.0f} of {status.elapsed_s:.0f} s counted",
    }
    if status.positions > 1:
        texts["positions"] = f"{status.positions}, the last turned by {math.degrees(status.turned):.1f}°"
    return texts


def estimator_rows(status: Status) -> list[tuple[str, str, str]]:
    """Return name, heading and sigma of each estimator in degrees; the one shown is marked."""
    found = []
    for name, one in status.estimates.items():
        mark = " *" if name == "joint" and status.observable else ""
        known = one.sd < ANY_ANGLE_SD
        heading = f"{math.degrees(one.heading):.4f}" if known and math.isfinite(one.heading) else "-"
        sd = f"{math.degrees(one.sd):.4f}" if known else "not known"
        found.append((name.replace("_", " ") + mark, heading, sd))
    return found


def instruction(status: Status, positions: int, before: str, patient: bool) -> str:
    """Return what the operator should do now, or `DONE`; `before` is the instruction until now.

    A position is held until its white noise alone allows the wanted sigma.  With N positions the unit is
    turned by a Nth of a turn each time; the gyros measure the actual turn.  With one there is nothing to do.
    `patient`: a sigma that seems out of reach is waited for, as a slow sway looks like a bias at first.
    """
    hopeless = status.rest_s >= HOPELESS_S and math.isinf(status.remaining_s) and not patient
    settled, at = status.settled_s is not None, status.positions
    if positions == 1:
        return DONE if settled or hopeless else ""
    too_long = status.position_s >= LONGEST_S
    held = too_long or status.position_sd <= status.wanted_sd
    # Before the first fit in a position the heading is that of the positions before.
    settled_here = settled and math.isfinite(status.position_sd)
    if at >= positions and (settled_here or too_long or (held and hopeless)):
        return DONE
    if at < positions and held:
        return f"turn the unit now by about {360.0 / positions:.0f}° about the vertical"
    return f"position {at} of {positions}: do not touch the unit" if at and not status.moving else before
