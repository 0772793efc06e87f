"""``imumon magnetometer``: hard and soft iron, from a recording in which the unit was turned over."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import PATH, json_option, print_json, print_rows, warn, with_warnings
from imumon.files import check_output

if TYPE_CHECKING:
    from imumon.lab.calibration.magnetometer import MagnetometerFit
    from imumon.lab.calibration.magnetometer_axes import Axes


@click.command("magnetometer")
@click.argument("session", type=PATH)
@click.option("--out", required=True, type=PATH, help="Model file to write.")
@click.option("--model", type=PATH, help="Model file of the unit; its other contents are kept.")
@click.option("--plot", type=PATH, help="Draw readings and field into this PNG.")
@json_option
def command(session: Path, out: Path, model: Path | None, plot: Path | None, as_json: bool) -> None:
    """Find hard and soft iron from SESSION, in which the unit was moved in figures of eight and turned over.

    \b
    imumon magnetometer sessions/NAME --out unit.yaml

    Stay away from iron and cables.  If there are too few directions, imumon refuses and reports what to
    turn next.  It also refuses a magnetometer whose axes are not those of the gyros.
    """
    check_output(out)
    if plot is not None:
        check_output(plot, suffix=".png")
    from datetime import UTC, datetime

    from imumon.lab.calibration.magnetometer import fit_magnetometer
    from imumon.lab.calibration.magnetometer_axes import axes_of, doubts
    from imumon.models.model import BiasModel, load_model
    from imumon.recordings.reader import open_recording
    from imumon.version import __version__

    known = None if model is None else load_model(model)
    recording = open_recording(session)
    units = dict(recording.pipeline.units)

    def warnings() -> list[str]:
        return [f"{session}: {text}" for text in recording.warnings()]

    with with_warnings(warnings):
        fit = fit_magnetometer(recording.blocks(), units.get("mag_x", "uT"), str(session))
        axes = axes_of(open_recording(session).blocks(), fit.model)  # read again: it may not fit in memory
        texts = [*fit.doubts, *doubts(axes, str(session))]
    named = {"session": recording.name, "sha256": recording.sha256()}
    found = fit.model.model_copy(update=named)
    if known is None:
        known = BiasModel(
            made_by=f"imumon {__version__}",
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            device=recording.device,
            axes=recording.axes,
            magnetometer=found,
        )
    known.model_copy(update={"magnetometer": found}).write(out)
    if plot is not None:
        from imumon.lab.calibration.plot import write_magnetometer_plot

        write_magnetometer_plot(plot, fit, recording.name)
    warned = [*warnings(), *(f"{session}: {text}" for text in texts)]
    warn(warned)
    if as_json:
        result = {"out": out, "residual_before": fit.residual_before, "points": len(fit.field)}
        turned = axes is not None and axes.is_significant
        result["axes_off_deg"] = degrees(axes.angle) if axes is not None and turned else None
        result["axes_off_sd_deg"] = degrees(axes.sd) if axes is not None and turned else None
        print_json({**result, **found.model_dump(), "warnings": warned})
    print_rows(_rows(fit, axes, out))


def _rows(fit: MagnetometerFit, axes: Axes | None, out: Path) -> dict[str, str]:
    model = fit.model
    hard = zip(model.hard_iron, model.hard_iron_sd, strict=True)
    worst = max(value for row in model.soft_iron_sd for value in row)
    return {
        "directions": f"{model.coverage:.0%}, {len(fit.field):,} readings",
        "hard iron": ", ".join(f"{value:.2f} ± {sd:.2g}" for value, sd in hard) + f" {model.unit}",
        "soft iron": "; ".join(" ".join(f"{value:.4f}" for value in row) for row in model.soft_iron)
        + f", ± {worst:.1g}",
        "strength": f"{model.field:.2f} {model.unit}, scatter {fit.residual_before:.2g} as sent, "
        f"{model.residual_sd:.2g} corrected",
        "axes": "not checked, for want of gyros or turns"
        if axes is None or not axes.is_significant
        else f"the gyros', turned against them by {degrees(axes.angle):.1f} ± {degrees(axes.sd):.1g}°",
        "written": str(out),
    }
