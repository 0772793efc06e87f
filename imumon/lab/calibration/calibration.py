"""From recordings to a bias model."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import NamedTuple, TypeVar

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.thermal_lag import OWN_LAG_S
from imumon.errors import bad_config, bad_data
from imumon.geodesy import DEG_PER_H
from imumon.intake import RANGES
from imumon.models.model import UNITS, BiasModel, ChannelModel, TrainedOn
from imumon.recordings.reduced import ACCEL, GYRO
from imumon.version import __version__

from .cells import (
    BLOCK_S,
    LEAST_COVERED,
    ONE_WAY,
    Cells,
    Channel,
    Records,
    channel_of,
    group,
    levels,
    one_way,
)
from .selection import Choice, choose, slow_variance, turn_on_offsets

Name = TypeVar("Name", bound=str)
Progress = Callable[[str], None]
"""Takes what is being done now."""
LEAST_SPAN_DEGC = 5.0
LEAST_REST_S = 600.0
WIDEST_HOLE = 0.4
"""Share of the span without data that a curve cannot bridge."""
MOST_LAG = 0.1
"""Share of the span that the temperature may be wrong by as the gyro lags behind its thermometer."""


class Finding(NamedTuple):
    """What was found of one channel; `choice` is its curve, fitted to `points`.

    `points` are those of each run less its turn-on `offset` from the mean of all, in the channel's unit,
    (runs,); that is NaN where it cannot be determined.  `repeatability` is the standard deviation of the
    offsets: None with fewer than two, and of an accelerometer in several poses, whose offsets are gravity's.
    `lag_rms`: what a gyro `OWN_LAG_S` behind its thermometer would err by in this data.
    """

    choice: Choice
    points: Channel
    offset: FloatArray
    lag_rms: float
    repeatability: float | None


class Calibration(NamedTuple):
    """A model, what it rests on, and what the user should know."""

    model: BiasModel
    findings: dict[str, Finding]
    cells: Cells
    warnings: list[str]

    @property
    def rest_s(self) -> float:
        """Time at rest, s."""
        return float(self.cells.seconds.sum())


def calibrate(
    records: Records,
    latitude_deg: float | None = None,
    heading_deg: float | None = None,
    serial: str | None = None,
    progress: Progress = lambda _: None,
) -> Calibration:
    """Make a bias model of recordings of one unit.

    With latitude and heading, the earth rate is taken from the gyros (levelled by the accelerometers);
    otherwise it stays in the constant of their curves.

    Raises BAD_DATA, with the numbers found, when the data does not allow a model; BAD_CONFIG when only one of
    latitude and heading is given, or the heading cannot be used.
    """
    check_place(latitude_deg, heading_deg)
    check_columns(records)
    cells = group(records, latitude_deg, heading_deg)
    check_coverage(records, cells)
    if latitude_deg is not None and any(run.earth_rate is None for run in cells.runs):
        raise bad_config(
            "the earth rate cannot be removed: the unit has no accelerometers",
            "leave --latitude and --heading away",
        )
    findings, channels, warnings = _all_channels(records, cells, progress)
    return Calibration(
        model=BiasModel(
            made_by=f"imumon {__version__}",
            created=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            device=_common([record.device for record in records]),
            serial=serial or _common([record.serial for record in records]),
            axes=_common([record.axes for record in records]),
            earth_rate="included" if latitude_deg is None else "removed",
            latitude_deg=latitude_deg,
            heading_deg=heading_deg,
            block_s=BLOCK_S,
            levels_degc=[round(level, 3) for level in levels(cells).tolist()],
            trained_on=_trained_on(records, cells, findings),
            channels=channels,
        ),
        findings=findings,
        cells=cells,
        warnings=[*warnings, *_remarks(records, cells, findings)],
    )


def check_place(latitude_deg: float | None, heading_deg: float | None) -> None:
    """Raise BAD_CONFIG where only one of them is given."""
    if (latitude_deg is None) != (heading_deg is None):
        missing = "latitude" if latitude_deg is None else "heading"
        raise bad_config(
            f"the earth rate needs latitude and heading; there is no {missing}",
            "give both, or neither: then the earth rate stays in the constant of the curves",
        )


def _all_channels(
    records: Records, cells: Cells, progress: Progress
) -> tuple[dict[str, Finding], dict[str, ChannelModel], list[str]]:
    findings, channels, warnings = {}, {}, []
    centers = levels(cells)
    for name in (*GYRO, *ACCEL):
        progress(f"trying curves for {name}")
        channel, is_accel = channel_of(records, cells, name, centers), name in ACCEL
        if channel is None:
            continue
        knots = knots_of(channel, centers)
        channel = channel.weighted(slow_variance(channel, knots))
        offset = turn_on_offsets(channel, len(cells.runs), knots)
        apart = np.isnan(offset[channel.run])
        if apart.any():
            runs = ", ".join(str(run + 1) for run in np.unique(channel.run[apart]))
            what = "left out" if is_accel else "taken as they are, without a turn-on offset"
            warnings.append(f"{name}: runs {runs} have no temperature in common with the others: {what}")
        shifted = replace(channel, value=channel.value - np.nan_to_num(offset)[channel.run])
        points = shifted.only(~(apart & is_accel))
        choice = choose(points, knots)
        missed = OWN_LAG_S * cells.rate * choice.curve.slope(cells.temperature)
        lag_rms = np.sqrt(np.average(missed**2, weights=cells.seconds))
        known = offset[np.isfinite(offset)]
        own = len(known) > 1 and not (cells.turned and is_accel)
        repeatability = known.std(ddof=1) if own else None
        findings[name] = Finding(choice, points, offset, lag_rms, repeatability)
        low, high = float(points.temperature.min()), float(points.temperature.max())
        margin = 0.005 * (high - low)  # or a level at an end would now be in and now out
        constant = float(choice.curve.value(0.5 * (low + high))) if is_accel else 0.0
        channels[name] = ChannelModel.model_validate(
            {
                "unit": UNITS[name],
                "temperature_column": records[0].temperature_column(name),
                "temperature_range_degc": [low - margin, high + margin],
                "residual_sd": choice.residual_sd,
                "held_out_rms": choice.held_out_rms,
                "curve": choice.curve.minus(constant),
            }
        )
    return findings, channels, warnings


def knots_of(channel: Channel, centers: FloatArray) -> FloatArray:
    """Return the knots of a channel's spline: its ends and its levels, but for the levels next to the ends.

    There a knot would only make the slope at the end uncertain, as in an interpolating spline ("not a knot").
    """
    low, high = channel.temperature.min(), channel.temperature.max()
    inner = centers[2:-2] if len(centers) > 6 else centers[1:-1]
    least = (high - low) / (4 * len(centers))
    return np.concatenate([[low], inner[(inner > low + least) & (inner < high - least)], [high]])


def _trained_on(records: Records, cells: Cells, findings: dict[str, Finding]) -> list[TrainedOn]:
    return [
        TrainedOn(
            session=records[run.record].name,
            run=run.number,
            sha256=records[run.record].sha256,
            rest_s=float(run.seconds.sum()),
            blocks=len(run.rows),
            temperature_range_degc=[float(run.temperature.min()), float(run.temperature.max())],
            offset={
                name: float(finding.offset[number])
                for name, finding in findings.items()
                if finding.repeatability is not None and np.isfinite(finding.offset[number])
            },
        )
        for number, run in enumerate(cells.runs)
    ]


def _remarks(records: Records, cells: Cells, findings: dict[str, Finding]) -> list[str]:
    devices = sorted({record.device for record in records if record.device})
    units = sorted({record.serial for record in records if record.serial})
    far = {
        name: f"{spread / DEG_PER_H:.3g}"
        for name, finding in findings.items()
        if name in GYRO
        and (spread := finding.repeatability) is not None
        and spread > finding.choice.residual_sd
    }
    remarks = {
        f"the sessions are of different devices: {', '.join(devices)}": len(devices) > 1,
        f"the sessions are of different units: {', '.join(units)}": len(units) > 1,
        "a session is there twice: it counts twice, and its repeatability means nothing": (
            len({record.sha256 for record in records}) < len(records)
        ),
        ONE_WAY: one_way([run.temperature for run in cells.runs]),
        f"{', '.join(far)}: the bias differs by {', '.join(far.values())} °/h between the poses, by g or by "
        "the earth rate, which no curve over temperature has: the residual is that of one pose; imumon "
        "diagnose finds which": cells.turned and bool(far),
    }
    return [text for text, applies in remarks.items() if applies]


def _common(names: Sequence[Name | None]) -> Name | None:
    known = {*names} - {None}
    return known.pop() if len(known) == 1 else None


def check_columns(records: Records) -> None:
    """Raise BAD_DATA when a record has no gyro, a constant one, no temperature, or others than the rest."""
    for record in records:
        if lacking := [name for name in GYRO if not record.means.has(name)]:
            raise bad_data(
                f"{record.name}: no values of {', '.join(lacking)}",
                "a bias model is made of angular rates; let the device send them, or name them in the map",
            )
        if any(record.temperature_column(name) is None for name in GYRO):
            coldest, hottest, unit = RANGES["temperature"]
            raise bad_data(
                f"{record.name}: there is no temperature",
                "let the device send its temperature, or name the column in the map with its unit; "
                f"readings beyond {coldest:g} to {hottest:g} {unit}, and zero alone, are left out",
            )
        values = {name: record.means.of(name) for name in GYRO} if len(record.means) > 1 else {}
        if stuck := [name for name, of in values.items() if np.nanmin(of) == np.nanmax(of)]:
            raise bad_data(
                f"{record.name}: {', '.join(stuck)} never changes from {values[stuck[0]][0]:g} rad/s",
                "a sensor that measures is never so quiet: is it switched off, or the column a constant?",
            )
    thermometers = {str(record.temperature_column(GYRO[0])) for record in records}
    axes = {record.axes for record in records if record.axes}
    for what, found in (("thermometers", thermometers), ("body axes", axes)):
        if len(found) > 1:
            raise bad_data(
                f"the sessions have different {what}: {', '.join(sorted(found))}",
                "calibrate them apart: a model has one of them",
            )


def check_coverage(records: Records, cells: Cells) -> None:
    """Raise BAD_DATA when time at rest, span, holes or rate do not allow a model."""
    rest_s = cells.seconds.sum()
    if rest_s < LEAST_REST_S:
        recorded_s = sum(record.means.span_s.sum() for record in records)
        raise bad_data(
            f"{rest_s:.0f} s at rest, of {recorded_s:.0f} s with several samples in {BLOCK_S:g} s; a model"
            f" needs {LEAST_REST_S:.0f}",
            f"let the unit stand still on a firm base for longer, with a sample every"
            f" {LEAST_COVERED * BLOCK_S:g} s at least",
        )
    known = np.sort(cells.temperature)
    low, high = known[0], known[-1]
    span = high - low
    if span < LEAST_SPAN_DEGC:
        raise bad_data(
            f"the temperature at rest spans {span:.2f} °C ({low:.2f} to {high:.2f}); a model needs"
            f" {LEAST_SPAN_DEGC:g}",
            "record while the unit warms up or cools down over the range in which it will be used",
        )
    at = np.argmax(np.diff(known))
    below, above = known[at : at + 2]
    if above - below > WIDEST_HOLE * span:
        raise bad_data(
            f"nothing at rest from {below:.2f} to {above:.2f} °C, {(above - below) / span:.0%} of the span; a"
            f" curve bridges {WIDEST_HOLE:.0%}",
            "record levels in between",
        )
    wrong = OWN_LAG_S * cells.rate_rms
    if wrong > MOST_LAG * span:
        raise bad_data(
            f"the temperature moves at {60 * cells.rate_rms:.2f} °C/min (rms): a gyro {OWN_LAG_S:g} s behind "
            f"its thermometer would be wrong by {wrong:.2f} °C, {wrong / span:.0%} of the {span:.2f} °C "
            f"span; a model allows {MOST_LAG:.0%}",
            "heat and cool more slowly, hold levels, or cover a wider range",
        )
