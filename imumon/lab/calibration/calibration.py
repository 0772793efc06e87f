"""From recordings to a bias model."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.thermal_lag import OWN_LAG_S
from imumon.errors import bad_config, bad_data
from imumon.geodesy import DEG_PER_H
from imumon.intake import RANGES
from imumon.models.model import BiasModel, ChannelModel, TrainedOn
from imumon.recordings.reduced import ACCEL, GYRO
from imumon.version import __version__

from .cells import BLOCK_S, LEAST_COVERED, ONE_WAY, CellMeans, Records, RestBlocks, channel_of, group, one_way
from .selection import Choice, choose, comparable_runs, slow_variance, turn_on_offsets

# What a model needs, all assumed.
LEAST_SPAN_DEGC = 5.0  # of the temperature at rest
LEAST_REST_S = 600.0
WIDEST_HOLE = 0.4  # share of the span without data that a curve may bridge
MOST_LAG = 0.1  # share of the span, of the error of temperature (rms) of a gyro `OWN_LAG_S` behind it
LEAST_LEVELS = 3  # of an accelerometer: the two at the ends stay in each fit, and one has to be left out


class ChannelFit(NamedTuple):
    """One channel: `choice` is its curve, fitted to `points`.

    `points` are the means of each run less its turn-on `offset` from the mean of all, in the channel's unit,
    (runs,); that is NaN where it cannot be determined.  `repeatability` is the standard deviation of the
    offsets: None with fewer than two, and of an accelerometer in several poses, whose offsets are gravity's.
    `lag_rms`: error in this data of a sensor that is `OWN_LAG_S` behind its thermometer.
    """

    choice: Choice
    points: CellMeans
    offset: FloatArray
    lag_rms: float
    repeatability: float | None


class Calibration(NamedTuple):
    """A model, what it rests on, and what the user should know."""

    model: BiasModel
    fits: dict[str, ChannelFit]
    at_rest: RestBlocks
    warnings: list[str]


def calibrate(
    records: Records,
    latitude_deg: float | None = None,
    heading_deg: float | None = None,
    serial: str | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Make a bias model of recordings of one unit.

    With latitude and heading, the earth rate is taken from the gyros (levelled by the accelerometers);
    otherwise it stays in the constant of their curves.  `progress` is called with what is being done.

    Raises BAD_DATA, with the numbers found, when the data does not allow a model; BAD_CONFIG when only one of
    latitude and heading is given, or the heading cannot be used.
    """
    check_place(latitude_deg, heading_deg)
    check_columns(records)
    at_rest = group(records, latitude_deg, heading_deg)
    check_coverage(records, at_rest)
    if latitude_deg is not None and any(run.earth_rate is None for run in at_rest.runs):
        raise bad_config(
            "the earth rate cannot be removed: the unit has no accelerometers",
            "leave --latitude and --heading away",
        )
    warnings: list[str] = []
    fits = {}
    for name in (*GYRO, *ACCEL):
        progress(f"trying curves for {name}")
        if fit := _fit_channel(name, records, at_rest, warnings):
            fits[name] = fit
    if not fits:
        raise bad_data("no gyro ever changes at rest", "does the device set small rates to zero?")
    return Calibration(
        model=BiasModel(
            made_by=f"imumon {__version__}",
            created=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            device=_common(record.device for record in records),
            serial=serial or _common(record.serial for record in records),
            axes=next((record.axes for record in records if record.axes), None),  # no others: `check_columns`
            earth_rate="included" if latitude_deg is None else "removed",
            latitude_deg=latitude_deg,
            heading_deg=heading_deg,
            block_s=BLOCK_S,
            levels_degc=[round(level, 3) for level in at_rest.levels.tolist()],
            trained_on=_trained_on(at_rest, fits),
            channels={name: _channel_model(name, fit, records) for name, fit in fits.items()},
        ),
        fits=fits,
        at_rest=at_rest,
        warnings=warnings + _remarks(records, at_rest, fits),
    )


def check_place(latitude_deg: float | None, heading_deg: float | None) -> None:
    """Raise BAD_CONFIG where only one of them is given."""
    if (latitude_deg is None) != (heading_deg is None):
        missing = "latitude" if latitude_deg is None else "heading"
        raise bad_config(
            f"the earth rate needs latitude and heading; there is no {missing}",
            "give both, or neither: then the earth rate stays in the constant of the curves",
        )


def _fit_channel(name: str, records: Records, at_rest: RestBlocks, warnings: list[str]) -> ChannelFit | None:
    """Take the runs' offsets off a channel, and choose its curve; None without values for one."""
    means = channel_of(records, at_rest, name)
    if means is None:
        return None
    is_accel = name in ACCEL
    compared = comparable_runs(means)
    is_compared = np.isin(means.run, compared)
    if not is_compared.all():
        runs = ", ".join(str(run + 1) for run in np.unique(means.run[~is_compared]))
        what = "left out" if is_accel else "taken as they are, without a turn-on offset"
        warnings.append(f"{name}: runs {runs} have no temperature in common with the others: {what}")
    if is_accel and len(np.unique(means.level[is_compared])) < LEAST_LEVELS:
        warnings.append(f"{name}: fewer than {LEAST_LEVELS} temperature levels: no curve")
        return None
    knots = knots_of(means, at_rest.levels)
    # Weights come before the offsets, which are estimated with them: so the slow variance includes the
    # offsets.  That makes the weights more alike, and no estimate biased.
    weighted = means.weighted(slow_variance(means, knots))
    offset = np.full(len(at_rest.runs), np.nan)
    offset[compared] = turn_on_offsets(weighted.only(is_compared), compared, knots)
    to_subtract = np.nan_to_num(offset)  # 0 for a run without an offset
    points = replace(weighted, value=weighted.value - to_subtract[weighted.run])
    if is_accel:  # of a run without an offset the gravity of its pose would be taken for bias
        points = points.only(is_compared)
    choice = choose(points, knots)
    lag_rms = at_rest.rms(OWN_LAG_S * at_rest.rate * choice.curve.slope(at_rest.temperature))
    offsets_are_gravity = is_accel and at_rest.turned
    repeatability = None if len(compared) < 2 or offsets_are_gravity else offset[compared].std(ddof=1)
    return ChannelFit(choice, points, offset, lag_rms, repeatability)


def _channel_model(name: str, fit: ChannelFit, records: Records) -> ChannelModel:
    curve, temperature = fit.choice.curve, fit.points.temperature
    low, high = float(temperature.min()), float(temperature.max())
    margin = 0.005 * (high - low)  # assumed: noise at a level at an end does not leave the range
    if name in ACCEL:  # its constant has gravity in it: the curve is the change from the middle
        curve = curve.minus(float(curve.value(0.5 * (low + high))))
    return ChannelModel(
        unit="m/s^2" if name in ACCEL else "rad/s",
        temperature_column=str(records[0].temperature_column(name)),
        temperature_range_degc=[low - margin, high + margin],
        residual_sd=fit.choice.residual_sd,
        held_out_rms=fit.choice.held_out_rms,
        curve=curve,
    )


def knots_of(means: CellMeans, centers: FloatArray) -> FloatArray:
    """Return the knots of a channel's spline, °C upwards: its own ends, and the inner levels of `centers`.

    The ends stand for the outermost levels.  With more than six levels (assumed) the level next to each end
    is no knot, as it would only make the slope there uncertain ("not a knot" of an interpolating spline).
    """
    low, high = means.temperature.min(), means.temperature.max()
    inner = centers[2:-2] if len(centers) > 6 else centers[1:-1]
    least = (high - low) / (4 * len(centers))  # a quarter of the mean distance between levels.  Assumed.
    return np.concatenate([[low], inner[(inner > low + least) & (inner < high - least)], [high]])


def _trained_on(at_rest: RestBlocks, fits: dict[str, ChannelFit]) -> list[TrainedOn]:
    return [
        TrainedOn(
            session=run.record.name,
            run=run.number,
            sha256=run.record.sha256,
            rest_s=float(run.seconds.sum()),
            blocks=len(run.rows),
            temperature_range_degc=[float(run.temperature.min()), float(run.temperature.max())],
            offset={
                name: float(fit.offset[index])
                for name, fit in fits.items()
                if fit.repeatability is not None and np.isfinite(fit.offset[index])
            },
        )
        for index, run in enumerate(at_rest.runs)
    ]


def _remarks(records: Records, at_rest: RestBlocks, fits: dict[str, ChannelFit]) -> list[str]:
    devices = sorted({record.device for record in records if record.device})
    units = sorted({record.serial for record in records if record.serial})
    differing = {
        name: f"{fit.repeatability / DEG_PER_H:.3g}"
        for name, fit in fits.items()
        if name in GYRO and fit.repeatability and fit.repeatability > fit.choice.residual_sd
    }
    remarks = {
        f"the sessions are of different devices: {', '.join(devices)}": len(devices) > 1,
        f"the sessions are of different units: {', '.join(units)}": len(units) > 1,
        "a session is there twice: it counts twice, and its repeatability means nothing": (
            len({record.sha256 for record in records}) < len(records)
        ),
        ONE_WAY: one_way([run.temperature for run in at_rest.runs]),
        f"{', '.join(differing)}: the bias differs by {', '.join(differing.values())} °/h between the"
        " poses, by g or by the earth rate, which no curve over temperature has: the residual is that of"
        " one pose; imumon diagnose finds which": at_rest.turned and bool(differing),
    }
    return [text for text, applies in remarks.items() if applies]


def _common(values: Iterable[str | None]) -> str | None:
    known = {*values} - {None}
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
        lowest = {name: np.nanmin(record.means.of(name)) for name in GYRO}
        stuck = [name for name in GYRO if lowest[name] == np.nanmax(record.means.of(name))]
        if stuck and len(record.means) > 1:  # one block cannot vary
            raise bad_data(
                f"{record.name}: {', '.join(stuck)} never changes from {lowest[stuck[0]]:g} rad/s",
                "a sensor that measures is never so quiet: is it switched off, or the column a constant?",
            )
    for what, names in (
        ("thermometers", {str(record.temperature_column(GYRO[0])) for record in records}),
        ("body axes", {record.axes for record in records if record.axes}),
    ):
        if len(names) > 1:
            raise bad_data(
                f"the sessions have different {what}: {', '.join(sorted(names))}",
                "calibrate them apart: a model has one of them",
            )


def check_coverage(records: Records, at_rest: RestBlocks) -> None:
    """Raise BAD_DATA when time at rest, span, holes or rate do not allow a model."""
    rest_s = at_rest.seconds.sum()
    if rest_s < LEAST_REST_S:
        recorded_s = sum(record.means.span_s.sum() for record in records)
        raise bad_data(
            f"{rest_s:.0f} s at rest, of {recorded_s:.0f} s with several samples in {BLOCK_S:g} s; a model"
            f" needs {LEAST_REST_S:.0f}",
            f"let the unit stand still on a firm base for longer, with a sample every"
            f" {LEAST_COVERED * BLOCK_S:g} s at least",
        )
    temperature = np.sort(at_rest.temperature)
    low, high = temperature[0], temperature[-1]
    span = high - low
    if span < LEAST_SPAN_DEGC:
        raise bad_data(
            f"the temperature at rest spans {span:.2f} °C ({low:.2f} to {high:.2f}); a model needs"
            f" {LEAST_SPAN_DEGC:g}",
            "record while the unit warms up or cools down over the range in which it will be used",
        )
    widest = np.argmax(np.diff(temperature))
    below, above = temperature[widest : widest + 2]
    if above - below > WIDEST_HOLE * span:
        raise bad_data(
            f"nothing at rest from {below:.2f} to {above:.2f} °C, {(above - below) / span:.0%} of the span; a"
            f" curve bridges {WIDEST_HOLE:.0%}",
            "record levels in between",
        )
    rate_rms = at_rest.rms(at_rest.rate)
    lag_error_degc = OWN_LAG_S * rate_rms
    if lag_error_degc > MOST_LAG * span:
        raise bad_data(
            f"the temperature moves at {60 * rate_rms:.2f} °C/min (rms): a gyro {OWN_LAG_S:g} s"
            f" behind its thermometer would be wrong by {lag_error_degc:.2f} °C,"
            f" {lag_error_degc / span:.0%} of the {span:.2f} °C span; a model allows {MOST_LAG:.0%}",
            "heat and cool more slowly, hold levels, or cover a wider range",
        )
