"""The record of a session or of a unit, for the file: one page that needs no network."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from imumon.blocks import FloatArray
from imumon.columns import TEMPERATURES
from imumon.files import write_text
from imumon.fleet.catalog.drift import Drift, Outlier, drifts
from imumon.fleet.catalog.tables import day
from imumon.fleet.catalog.units import BEST, COLDEST, HOTTEST, WORST, Entry, Unit
from imumon.harmless import for_plot
from imumon.lab.diagnosis.page import COLOURS, HOUR_S, environment, shown, svg
from imumon.models.model import BiasModel
from imumon.recordings.folder import Session, fingerprint
from imumon.recordings.reader import open_recording
from imumon.recordings.reduced import GYRO, Reduced, reduce
from imumon.run.setup import recorded_setup
from imumon.run.stages import estimators
from imumon.version import __version__

TEMPLATE = "record.html.j2"
POINTS = 400
"""Of a curve over time: more than a figure has pixels for is not visible."""
BIASES = tuple((f"gyro_bias_{axis}", f"gyro_bias_sd_{axis}") for axis in "xyz")
PER_HOUR, HOURLY = shown("rad/s")


class Section(NamedTuple):
    """A part of the page: a table, and figures by their captions."""

    title: str
    words: str = ""
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str | float]] = ()
    figures: Mapping[str, str] = {}


def write_unit(unit: Unit, unusual: Sequence[Outlier], path: Path) -> None:
    """Write the record of a unit; raises OSError when that fails."""
    row = unit.row
    facts = {
        "serial number": unit.name,
        "device": unit.device,
        "sessions": f"{row['sessions']}, {row['hours']:.2f} h, {day(row['first'])} to {day(row['last'])}",
        "temperature": f"{row[COLDEST]:.2f} to {row[HOTTEST]:.2f} °C",
        "smallest σ of the gyro bias": f"{row[BEST] * PER_HOUR:.3g} to {row[WORST] * PER_HOUR:.3g} {HOURLY}",
        "made by": f"imumon {__version__}",
    }
    caveats = [str(outlier) for outlier in unusual if outlier.unit == unit.name]
    if any(dated.model.earth_rate == "included" for dated in unit.models):
        caveats.append(
            "the models hold the earth rate of the place and the pose of their test (up to 15.04 °/h): what"
            " is called drift is one only if both stayed the same"
        )
    models = [dated.model for dated in unit.models[-1:]]
    sections = [_sessions(unit.entries), _drift(drifts(unit)), *map(_model, models)]
    _write(path, f"Calibration record of {unit.name}", facts, caveats, sections)


def write_session(session: Session, path: Path) -> list[str]:
    """Replay a session and write its record; return what the recording lacks, and what the stages report.

    Raises `ImumonError` and OSError when that fails.
    """
    setup, metadata = recorded_setup(session), session.metadata
    recording = open_recording(session.path, lambda device: estimators(device, setup))
    names = [*GYRO, *TEMPERATURES, *itertools.chain(*BIASES)]
    slot_s = max(1.0, np.nan_to_num(metadata.duration_s) / POINTS)
    means = reduce(recording.blocks(), names, slot_s)
    counters, port = recording.pipeline.counters, metadata.port
    facts = {
        "serial number": metadata.serial or "not given",
        "device": metadata.device,
        "recorded": f"{metadata.created} to {metadata.ended or 'it was interrupted'}",
        "port": "-" if port is None else port.url,
        "samples": f"{counters.samples:,}; {counters.packets_missing:,} packets missing, "
        f"{counters.checksum_errors + counters.length_errors:,} damaged",
        "SHA-256 of the data": fingerprint(session.truth_path),
        "versions": ", ".join(f"{name} {version}" for name, version in metadata.versions.items()),
        "made by": f"imumon {__version__}",
    }
    sections = [_course(means), *([] if setup.bias_model is None else [_model(setup.bias_model)])]
    warnings = recording.warnings()
    _write(path, f"Record of {session.path.name}", facts, warnings, sections)
    return warnings


def _write(
    path: Path, title: str, facts: Mapping[str, str], caveats: Sequence[str], sections: Sequence[Section]
) -> None:
    content = {"title": title, "facts": facts, "caveats": caveats, "sections": sections}
    write_text(path, environment("imumon.fleet.catalog").get_template(TEMPLATE).render(**content))


def _sessions(entries: Sequence[Entry]) -> Section:
    rows: list[Sequence[str | float]] = [
        [
            entry.session.path.name, day(row["begun"]), row["hours"], row[COLDEST], row[HOTTEST],
            PER_HOUR * row[BEST], PER_HOUR * row[WORST],
            np.nan if row["lost"] is None else float(row["lost"]), row["error"] or "",
        ]
        for entry in entries
        for row in [entry.row]
    ]  # fmt: skip
    heads = ["session", "day", "h", "from °C", "to °C", f"best σ, {HOURLY}", "worst", "packets lost", ""]
    words = "best, worst: the smallest σ that the gyro bias reached, on the best axis and on the worst."
    return Section("Sessions", words, heads, rows)


def _drift(drifted: Sequence[Drift]) -> Section:
    if not drifted:
        return Section("Drift", "There is no bias model of this unit.")
    rows: list[Sequence[str | float]] = [
        [one.channel, one.at_degc, float(len(one.bias)), *(PER_HOUR * value for value in of)]
        for one in drifted
        for of in [(one.bias[-1], one.sd[-1], one.per_month, one.per_month_sd)]
    ]
    heads = ["channel", "at °C", "models", f"latest bias, {HOURLY}", "σ", f"per month, {HOURLY}", "σ"]
    words = (
        "The bias of each model at the middle of the temperatures that all of them know. σ is of the curve"
        " and of the turn-on offset; that of the drift is larger where the models scatter more than their σ."
    )

    def draw(axes: Axes) -> None:
        for one, colour in zip(drifted, COLOURS, strict=False):
            when = one.time_ns.astype("datetime64[ns]").astype("datetime64[s]")
            apart, sd = PER_HOUR * (one.bias - one.bias[0]), PER_HOUR * one.sd
            look: dict[str, Any] = {"fmt": "o-", "ms": 3, "lw": 1, "capsize": 2, "color": colour}
            axes.errorbar(when, apart, sd, label=one.channel, **look)
        axes.set(ylabel=f"bias less the first model's, {HOURLY}")
        axes.tick_params(axis="x", rotation=30)
        axes.legend(fontsize=6)

    return Section("Drift", words, heads, rows, {"Bias by each model, less the first": svg(draw)})


def _model(model: BiasModel) -> Section:
    """Return the section of a model: its channels, its data, its curves."""
    rows: list[Sequence[str | float]] = []
    for name, channel in model.channels.items():
        factor, unit = shown(channel.unit)
        middle = 0.5 * sum(channel.temperature_range_degc)
        effects = ", ".join(effect.name for effect in channel.effects)
        numbers = (channel.value(middle), channel.slope(middle), channel.residual_sd)
        rows.append(
            [name, *channel.temperature_range_degc, *(factor * float(x) for x in numbers), unit, effects]
        )
    data = "; ".join(f"{run.session} (SHA-256 {run.sha256[:16]}…)" for run in model.trained_on)
    made = f"Made {model.created} by {model.made_by}; earth rate {model.earth_rate}."
    heads = [
        "channel", "from °C", "to °C", "bias in the middle", "slope per °C", "residual σ", "unit", "effects",
    ]  # fmt: skip
    kinds = {"gyro": "Bias of the gyros", "accel": "Change of the accelerometers' bias"}
    figures = {}
    for kind, caption in kinds.items():
        curves = dict[str, Curve]()
        for name, channel in model.channels.items():
            if name.startswith(kind):
                factor, unit = shown(channel.unit)
                low, high = channel.temperature_range_degc
                t = np.linspace(low, high, 200)
                curves[name] = Curve(t, factor * channel.value(t), np.asarray(factor * channel.residual_sd))
        if curves:
            labels = {"xlabel": "temperature, °C", "ylabel": f"bias ± 2σ, {unit}"}
            figures[f"{caption} over temperature"] = svg(_lines(curves, **labels))
    return Section("Bias model", f"{made} Of: {data or 'unknown'}.", heads, rows, figures)


def _course(means: Reduced) -> Section:
    """Return temperature and gyro bias over time, and the bias at the end."""
    hours = (means.start_ns - means.start_ns[:1]).astype(np.float64) * 1e-9 / HOUR_S
    figures: dict[str, str] = {}
    rows: list[Sequence[str | float]] = []
    if readings := {name: Curve(hours, means.of(name)) for name in TEMPERATURES if means.has(name)}:
        figures["Temperature"] = svg(_lines(readings, xlabel="time, h", ylabel="temperature, °C"))
    biases = {
        bias: Curve(hours, PER_HOUR * means.of(bias), PER_HOUR * means.of(sd))
        for bias, sd in BIASES
        if means.has(bias) and means.has(sd)
    }
    if biases:
        widest = max(np.nanmedian(np.abs(one.y) + 2 * one.sd) for one in biases.values())
        labels: dict[str, Any] = {"xlabel": "time, h", "ylabel": HOURLY, "ylim": (-2 * widest, 2 * widest)}
        figures["Gyro bias, with 2σ"] = svg(_lines(biases, **labels))
    for bias, (_, value, sd) in biases.items():
        known = np.flatnonzero(np.isfinite(value) & np.isfinite(sd))
        if len(known):
            rows.append([bias, float(value[known[-1]]), float(sd[known[-1]]), float(np.nanmin(sd))])
    heads = ["", f"at the end, {HOURLY}", "σ", "smallest σ"]
    return Section("Course", f"Means of {means.slot_s:.0f} s.", heads, rows, figures)


class Curve(NamedTuple):
    """Points of a curve, and their standard deviation; zero where none is drawn."""

    x: FloatArray
    y: FloatArray
    sd: FloatArray = np.zeros(())


def _lines(curves: Mapping[str, Curve], **axes_settings: Any) -> Callable[[Axes], None]:
    """Return what draws curves by their names, each with a band of two standard deviations."""

    def draw(axes: Axes) -> None:
        for (name, (x, y, sd)), colour in zip(curves.items(), COLOURS, strict=False):
            axes.plot(x, y, lw=1, color=colour, label=for_plot(name))
            if sd.any():
                axes.fill_between(x, y - 2 * sd, y + 2 * sd, color=colour, alpha=0.2, lw=0)
        axes.set(**axes_settings)
        axes.legend(fontsize=6)

    return draw
