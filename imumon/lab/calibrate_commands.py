"""``imumon calibrate``, ``magnetometer``: bias over temperature, hard and soft iron, from recordings."""

from collections.abc import Callable
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from imumon.cli.common import (
    Whole,
    heading_option,
    json_option,
    latitude_option,
    note,
    path_argument,
    path_option,
    print_json,
    print_rows,
    show,
    truth_option,
    warn,
    with_warnings,
)
from imumon.cli.progress import announce, reading_bar, size_of
from imumon.files import check_outputs, write_text

from .calibration import DISPLAY_UNITS

if TYPE_CHECKING:
    from .calibration.calibration import Calibration, ChannelFit


@click.command("calibrate")
@path_argument("sessions", nargs=-1, required=True, metavar="SESSION...")
@path_option("--out", required=True, help="Model file to write.")
@path_option("--plot", help="Draw curves, points and residuals into this PNG.")
@latitude_option
@heading_option
@click.option("--serial", help="Serial number of the unit, for the model file.")
@truth_option
@click.option(
    "--export",
    type=click.Choice(["ardupilot", "px4"]),
    help="Also write the model in the parameters of an autopilot, beside --out.",
)
@click.option("--imu", type=Whole(0, 3), default=0, help="Number of the autopilot's sensor, from 0.")
@click.option(
    "--device-ids", nargs=2, type=int, metavar="GYRO ACCEL", help="PX4's identifiers of the sensors."
)
@json_option
def calibrate(
    sessions: tuple[Path, ...],
    out: Path,
    plot: Path | None,
    latitude: float | None,
    heading: float | None,
    serial: str | None,
    truth: bool,
    export: Literal["ardupilot", "px4"] | None,
    imu: int,
    device_ids: tuple[int, int] | None,
    as_json: bool,
) -> None:
    """Find the bias of a unit over temperature from SESSIONs at rest with a changing temperature.

    \b
    imumon calibrate sessions/soak --out unit.yaml --plot unit.png

    Several kinds of curve are fitted without some of the temperature levels, and compared at these levels.
    The curve with the smallest error there is then fitted to all data.  Sessions that cannot give a good
    model are refused, with the reason.
    """
    from imumon.run.truth import check_truth, errors_of_model

    from .calibration import autopilot, calibration, cells

    file = out.with_suffix(autopilot.SUFFIX[export]) if export else None
    check_outputs(plot, out, file)
    autopilot.check_ids(export, device_ids)
    if truth:
        check_truth(sessions)
    warnings: list[str] = []
    samples, span_s = size_of(sessions)
    # Right to a factor of two, as networks take long for few points too.  Measured on one core: 41 s of
    # computing for 30,000 samples of 0.8 h, 19 s for 21,600 of 3 h, 103 s for 600,000 of 17 h.
    expected_s = 20.0 + samples / 55_000.0 + span_s / 1000.0
    announce("reading", samples, span_s, expected_s, quiet=as_json)
    with with_warnings(lambda: warnings), reading_bar(sessions, quiet=as_json) as progress:
        calibration.check_place(latitude, heading)
        records = []
        for path in sessions:
            record, found = cells.read_session(path, progress.count)
            records.append(record)
            warnings += found
        result = calibration.calibrate(records, latitude, heading, serial, progress)
        result.warnings[:0] = warnings
        model = result.model
    written: dict[str, Path] = {}
    if export and file:
        text, notes = autopilot.parameters(model, export, imu, device_ids)
        write_text(file, text)
        warn(notes)
        written["parameters"] = file
    model.write(out)
    if plot:
        from .calibration.plot import write_calibration_plot

        write_calibration_plot(plot, result, ", ".join(path.name for path in sessions))
    errors = {str(path): errors_of_model(path, model) for path in sessions} if truth else {}
    warn(result.warnings)
    if as_json:
        of_truth = {"truth": {path: one.as_data() for path, one in errors.items()}} if truth else {}
        print_json(_report(result, out) | of_truth | written)
    else:
        _show(result)
    written |= {"picture": plot} if plot else {}
    print_rows(_summary(result, out) | {name: str(path) for name, path in written.items()})
    for name, one in errors.items():
        note(f"against the truth of {name}, at rest")
        print_rows(one.rows())


def _report(result: "Calibration", out: Path) -> dict[str, Any]:
    model, at_rest = result.model, result.at_rest
    return {
        "out": out,
        "rest_s": at_rest.seconds.sum(),
        "temperature_range_degc": [at_rest.temperature.min(), at_rest.temperature.max()],
        "temperature_rate_rms_degc_per_s": at_rest.rms(at_rest.rate),
        "levels_degc": model.levels_degc,
        "earth_rate": model.earth_rate,
        "runs": [run.model_dump() for run in model.trained_on],
        "warnings": result.warnings,
        "channels": {
            name: {
                "unit": model.channels[name].unit,
                "temperature_column": model.channels[name].temperature_column,
                "curve": fit.choice.name,
                "held_out_rms": fit.choice.held_out_rms,
                "fit_rms": fit.choice.fit_rms,
                "residual_sd": fit.choice.residual_sd,
                "lag_rms": fit.lag_rms,
                "turn_on_sd": fit.repeatability,
            }
            for name, fit in result.fits.items()
        },
    }


def _show(result: "Calibration") -> None:
    names = list(dict.fromkeys(name for f in result.fits.values() for name in f.choice.held_out_rms))
    heads = [name.replace("polynomial", "poly").replace("network", "net") for name in names]
    show("rms error at temperature levels left out; * is chosen")
    show(f"{'':14}" + "".join(f"{head:>9}" for head in heads))
    for channel, fit in result.fits.items():
        unit, factor = DISPLAY_UNITS[result.model.channels[channel].unit]
        cells = []
        for name in names:
            value = fit.choice.held_out_rms.get(name)
            mark = "*" if name == fit.choice.name else " "
            cells.append(f"{'-':>8} " if value is None else f"{value * factor:8.3g}{mark}")
        show(f"{channel:8}{unit:>6}" + "".join(cells))


def _summary(result: "Calibration", out: Path) -> dict[str, str]:
    model, at_rest = result.model, result.at_rest
    rows = {
        "at rest": f"{at_rest.seconds.sum() / 3600:.2f} h, {len(model.levels_degc)} temperature levels",
        "temperature": f"{at_rest.temperature.min():.2f} to {at_rest.temperature.max():.2f} °C,"
        f" {at_rest.rms(at_rest.rate) * 60:.2f} °C/min rms",
        "residual": _per_channel(result, lambda fit: fit.choice.residual_sd),
        "30 s of lag": _per_channel(result, lambda fit: fit.lag_rms) + ", if the gyro has it",
    }
    if any(fit.repeatability is not None for fit in result.fits.values()):
        rows["by pose" if at_rest.turned else "turn-on"] = _per_channel(result, lambda fit: fit.repeatability)
    included = "in the constant of the gyro curves (--latitude, --heading)"
    rows["earth rate"] = "removed" if model.earth_rate == "removed" else included
    return {**rows, "model": str(out)}


def _per_channel(result: "Calibration", of: "Callable[[ChannelFit], float | None]") -> str:
    """Return a number of each channel, those of one unit together."""
    parts: dict[str, list[str]] = {}
    for name, fit in result.fits.items():
        unit, factor = DISPLAY_UNITS[result.model.channels[name].unit]
        value = of(fit)
        parts.setdefault(unit, []).append("-" if value is None else f"{value * factor:.3g}")
    return "; ".join(f"{' '.join(values)} {unit}" for unit, values in parts.items())


@click.command("magnetometer")
@path_argument("session")
@path_option("--out", required=True, help="Model file to write.")
@path_option("--model", help="Model file of the unit; its other contents are kept.")
@path_option("--plot", help="Draw readings and field into this PNG.")
@json_option
def magnetometer(session: Path, out: Path, model: Path | None, plot: Path | None, as_json: bool) -> None:
    """Find hard and soft iron from SESSION, in which the unit was moved in figures of eight and turned over.

    \b
    imumon magnetometer sessions/NAME --out unit.yaml

    Stay away from iron and cables.  If there are too few directions, imumon refuses and reports what to
    turn next.  It also refuses a magnetometer whose axes are not those of the gyros.
    """
    check_outputs(plot, out)
    from datetime import UTC, datetime

    from imumon.models.model import BiasModel, load_model
    from imumon.recordings.source import open_recording
    from imumon.version import __version__

    from .calibration.magnetometer import axes_of, doubts, fit_magnetometer

    known = load_model(model) if model else None
    recording = open_recording(session)
    units = dict(recording.pipeline.units)

    def warnings() -> list[str]:
        return [f"{session}: {text}" for text in recording.warnings()]

    with with_warnings(warnings):
        fit = fit_magnetometer(recording.blocks(), units.get("mag_x", "uT"), str(session))
        axes = axes_of(open_recording(session).blocks(), fit.model)  # read again: it may not fit in memory
        texts = doubts(fit.model, axes, str(session))
    found = fit.model.model_copy(update={"session": recording.name, "sha256": recording.sha256()})
    if not known:
        known = BiasModel(
            made_by=f"imumon {__version__}",
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            device=recording.device,
            axes=recording.source.axes,
            magnetometer=found,
        )
    known.model_copy(update={"magnetometer": found}).write(out)
    if plot:
        from .calibration.plot import write_magnetometer_plot

        write_magnetometer_plot(plot, fit, recording.name)
    warned = [*warnings(), *(f"{session}: {text}" for text in texts)]
    warn(warned)
    off = [degrees(axes.angle), degrees(axes.sd)] if axes and axes.is_significant else None
    if as_json:
        angle, sd = off or (None, None)
        result = {"out": out, "residual_before": fit.residual_before, "points": len(fit.readings)}
        result |= {"axes_off_deg": angle, "axes_off_sd_deg": sd, **found.model_dump(), "warnings": warned}
        print_json(result)
    worst = max(value for row in found.soft_iron_sd for value in row)
    soft = "; ".join(" ".join(f"{value:.4f}" for value in row) for row in found.soft_iron)
    hard = zip(found.hard_iron, found.hard_iron_sd, strict=True)
    rows = {
        "directions": f"{found.coverage:.0%}, {len(fit.readings):,} readings",
        "hard iron": ", ".join(f"{value:.2f} ± {sd:.2g}" for value, sd in hard) + f" {found.unit}",
        "soft iron": f"{soft}, ± {worst:.1g}",
        "strength": f"{found.field:.2f} {found.unit}, scatter {fit.residual_before:.2g} as sent,"
        f" {found.residual_sd:.2g} corrected",
        "axes": "not checked: no gyros, or too few turns",
        "written": str(out),
    }
    if off:
        rows["axes"] = f"the gyros', turned against them by {off[0]:.1f} ± {off[1]:.1g}°"
    print_rows(rows)
