"""The record of a session or of a unit, for the file: one page that needs no network."""

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from imumon.blocks import FloatArray
from imumon.columns import TEMPERATURES
from imumon.files import write_text
from imumon.harmless import for_plot
from imumon.lab.diagnosis.page import COLOURS, HOUR_S, environment, shown, svg
from imumon.models.model import BiasModel
from imumon.recordings.folder import Session, fingerprint
from imumon.recordings.reduced import GYRO, Reduced, reduce
from imumon.recordings.source import open_recording
from imumon.run.setup import recorded_setup, unused_keys
from imumon.run.stages import estimators
from imumon.version import __version__

from .tables import day, drifts
from .units import Unit

POINTS = 400
"""Of a curve over time: more than a figure has pixels for is not visible."""
MARKED, DAY_NS = 20, 86_400e9
"""Of fewer points each is drawn; ns."""
BIASES = tuple((f"gyro_bias_{axis}", f"gyro_bias_sd_{axis}") for axis in "xyz")
PER_HOUR, HOURLY = shown("rad/s")


def write_unit(unit: Unit, path: Path) -> None:
    """Write the record of a unit; raises OSError when that fails."""
    model = unit.models[-1].model if unit.models else None
    drifted = drifts(unit)
    begun = min((int(one.time_ns[0]) for one in drifted), default=0)
    curves = {
        one.channel: Curve(
            (one.time_ns - begun) / DAY_NS, PER_HOUR * (one.bias - one.bias[0]), PER_HOUR * one.sd
        )
        for one in drifted
    }
    labels = {"xlabel": f"days since {day(begun)}", "ylabel": f"bias minus the first model's ± 2σ, {HOURLY}"}
    drift = _figure("Bias by each model, minus the first", curves, **labels)
    _write(path, model, unit=unit, drifted=drifted, drift=drift)


def write_session(session: Session, path: Path) -> list[str]:
    """Replay a session and write its record; return what the recording lacks, and what the stages report.

    Raises `ImumonError` and OSError when that fails.
    """
    setup = recorded_setup(session)
    recording = open_recording(session.path, lambda device: estimators(device, setup))
    names = [*GYRO, *TEMPERATURES, *itertools.chain(*BIASES)]
    slot_s = max(1.0, np.nan_to_num(session.metadata.duration_s) / POINTS)
    means = reduce(recording.blocks(), names, slot_s)
    warnings = [*recording.warnings(), *unused_keys(setup, recording.source.device)]
    _write(
        path,
        setup.bias_model,
        unit=None,
        session=session,
        sha256=fingerprint(session.truth_path),
        slot_s=means.slot_s,
        course=_course(means),
        biases=_biases(means),
        warnings=warnings,
        counters=recording.pipeline.counters,
    )
    return warnings


def _write(path: Path, model: BiasModel | None, **content: Any) -> None:
    template = environment("imumon.fleet.catalog").get_template("record.html.j2")  # all words and tables
    content |= {"per_hour": PER_HOUR, "hourly": HOURLY, "day": day, "version": __version__}
    write_text(path, template.render(model=model, curves=_curves(model) if model else {}, **content))


def _curves(model: BiasModel) -> dict[str, str]:
    figures: dict[str, str] = {}
    kinds = {"gyro": "Bias of the gyros", "accel": "Change of the accelerometers' bias"}
    for kind, caption in kinds.items():
        curves, unit = dict[str, Curve](), ""
        for name, channel in model.channels.items():
            if name.startswith(kind):
                factor, unit = shown(channel.unit)
                low, high = channel.temperature_range_degc
                t = np.linspace(low, high, 200)
                curves[name] = Curve(t, factor * channel.value(t), np.asarray(factor * channel.residual_sd))
        labels = {"xlabel": "temperature, °C", "ylabel": f"bias ± 2σ, {unit}"}
        figures |= _figure(f"{caption} over temperature", curves, **labels)
    return figures


def _course(means: Reduced) -> dict[str, str]:
    steps = np.diff(means.start_ns, prepend=means.start_ns[:1]) * 1e-9
    steps[1:][np.diff(means.run) != 0] = means.slot_s
    hours = np.cumsum(steps) / HOUR_S
    readings = {name: Curve(hours, means.of(name)) for name in TEMPERATURES if means.has(name)}
    biases = {
        bias: Curve(hours, PER_HOUR * means.of(bias), PER_HOUR * means.of(sd))
        for bias, sd in BIASES
        if means.has(sd)
    }
    widest = max((np.nanmedian(np.abs(one.y) + 2 * one.sd) for one in biases.values()), default=0.0)
    return {
        **_figure("Temperature", readings, xlabel="time, h", ylabel="temperature, °C"),
        **_figure(
            "Gyro bias, with 2σ", biases, xlabel="time, h", ylabel=HOURLY, ylim=(-2 * widest, 2 * widest)
        ),
    }


def _biases(means: Reduced) -> list[tuple[str, float, float, float]]:
    """Return name, last value and sigma, and smallest sigma of each gyro bias, rad/s."""
    rows = []
    for bias, sd_name in BIASES:
        if means.has(sd_name):
            sd = means.of(sd_name)
            last = np.flatnonzero(np.isfinite(sd))[-1]
            rows.append((bias, float(means.of(bias)[last]), float(sd[last]), float(np.nanmin(sd))))
    return rows


class Curve(NamedTuple):
    """Points of a curve, and their standard deviation; zero where none is drawn."""

    x: FloatArray
    y: FloatArray
    sd: FloatArray = np.zeros(())


def _figure(caption: str, curves: Mapping[str, Curve], **axes_settings: Any) -> dict[str, str]:
    """Return the figure of curves by their names, if any, each with a band of two standard deviations."""

    def draw(axes: Axes) -> None:
        for (name, (x, y, sd)), colour in zip(curves.items(), COLOURS, strict=False):
            marker = "." if len(x) < MARKED else ""
            axes.plot(x, y, lw=1, marker=marker, color=colour, label=for_plot(name))
            if sd.any():
                axes.fill_between(x, y - 2 * sd, y + 2 * sd, color=colour, alpha=0.2, lw=0)
        axes.set(**axes_settings)

    return {caption: svg(draw)} if curves else {}
