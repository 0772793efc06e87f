"""The bias model of one unit, from means at rest."""

from collections.abc import Callable, Sequence
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

from .cells import BLOCK_S, COVERED_S, ONE_WAY, CellMeans, Record, RestBlocks, channel_of, find_rest, one_way
from .selection import Choice, choose, comparable_runs, reweighted, turn_on_offsets

# What a model needs, all assumed.
LEAST_SPAN_DEGC = 5.0  # of the temperature at rest
LEAST_REST_S = 600.0
WIDEST_HOLE = 0.4  # share of the span without data that a curve may bridge
MOST_LAG = 0.1  # share of the span: rms error of the temperature of a gyro `OWN_LAG_S` behind it
# Of an accelerometer: the two at the ends stay in each fit, one is left out.  Gyros have it: `WIDEST_HOLE`.
LEAST_LEVELS = 3


class ChannelFit(NamedTuple):
    """The fit of one channel, in its unit."""

    choice: Choice  # its curve
    points: CellMeans  # what that is fitted to: the means of each run less its `offset`
    lag_rms: float  # error in this data of a sensor that is `OWN_LAG_S` behind its thermometer
    # Turn-on offset of each run from the mean of all, (runs,); NaN where no other run is comparable, and
    # where it would be gravity's: of an accelerometer in several poses.
    offset: FloatArray
    repeatability: float | None  # standard deviation of the offsets; None without any


class Calibration(NamedTuple):
    """A model, what it rests on, and warnings for the user."""

    model: BiasModel
    fits: dict[str, ChannelFit]
    at_rest: RestBlocks
    warnings: list[str]


def calibrate(
    records: Sequence[Record],
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
    at_rest = find_rest(records, latitude_deg, heading_deg)
    check_coverage(at_rest)
    if np.isnan(at_rest.earth_rate).any():
        raise bad_config(
            "the earth rate cannot be removed: the unit has no accelerometers",
            "leave --latitude and --heading away",
        )
    warnings: list[str] = []
    fits = {}
    for name in (*GYRO, *ACCEL):
        progress(f"trying curves for {name}")
        if fit := _fit_channel(name, at_rest, warnings):
            fits[name] = fit
    if not any(name in fits for name in GYRO):
        raise bad_data("no gyro ever changes at rest", "does the device set small rates to zero?")
    devices = sorted({record.device for record in records if record.device})
    units = sorted({record.serial for record in records if record.serial})
    return Calibration(
        BiasModel(
            made_by=f"imumon {__version__}",
            created=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            device=devices[0] if len(devices) == 1 else None,
            serial=serial or (units[0] if len(units) == 1 else None),
            axes=next((record.axes for record in records if record.axes), None),  # the same: `check_columns`
            earth_rate="included" if latitude_deg is None else "removed",
            latitude_deg=latitude_deg,
            heading_deg=heading_deg,
            block_s=BLOCK_S,
            levels_degc=[round(level, 3) for level in at_rest.levels.tolist()],
            trained_on=_trained_on(at_rest, fits),
            channels={name: _channel_model(name, fit, records[0]) for name, fit in fits.items()},
        ),
        fits,
        at_rest,
        warnings + _remarks(at_rest, fits, devices, units),
    )


def check_place(latitude_deg: float | None, heading_deg: float | None) -> None:
    """Raise BAD_CONFIG where only one of them is given."""
    if (latitude_deg is None) != (heading_deg is None):
        missing = "latitude" if latitude_deg is None else "heading"
        raise bad_config(
            f"the earth rate needs latitude and heading; there is no {missing}",
            "give both, or neither: then the earth rate stays in the constant of the curves",
        )


def _fit_channel(name: str, at_rest: RestBlocks, warnings: list[str]) -> ChannelFit | None:
    """Take the runs' offsets off a channel, and choose its curve; without one a warning is added."""
    means = channel_of(at_rest, name)
    is_accel = name in ACCEL
    if means is None:
        if not is_accel:  # accelerometers may be missing
            warnings.append(f"{name}: it never changes at rest: no curve")
        return None
    compared = comparable_runs(means)
    is_compared = np.isin(means.run, compared)
    if not is_compared.all():
        runs = ", ".join(
            f"{run.number} of {run.record.name}"
            for index, run in enumerate(at_rest.runs)
            if index in means.run[~is_compared]
        )
        what = "left out" if is_accel else "taken as they are, without a turn-on offset"
        warnings.append(f"{name}: runs {runs} have no temperature in common with the others: {what}")
    if is_accel and len(np.unique(means.level[is_compared])) < LEAST_LEVELS:
        warnings.append(f"{name}: fewer than {LEAST_LEVELS} temperature levels: no curve")
        return None
    knots = knots_of(means, at_rest.levels)
    # The weights are needed for the offsets, and include them: too equal, which biases no estimate.
    weighted = reweighted(means, knots)
    offset = np.full(len(at_rest.runs), np.nan)
    offset[compared] = turn_on_offsets(weighted.only(is_compared), compared, knots)
    # Of a run without an offset nothing is subtracted.
    points = replace(weighted, value=weighted.value - np.nan_to_num(offset)[weighted.run])
    if is_accel:  # of a run without an offset the gravity of its pose would be taken for bias
        points = points.only(is_compared)
    choice = choose(points, knots)
    lag_rms = at_rest.rms(OWN_LAG_S * at_rest.rate * choice.curve.slope(at_rest.temperature_of(name)))
    if len(compared) < 2 or (is_accel and at_rest.turned):  # alone, or gravity's
        return ChannelFit(choice, points, lag_rms, np.full_like(offset, np.nan), None)
    return ChannelFit(choice, points, lag_rms, offset, offset[compared].std(ddof=1))


def _channel_model(name: str, fit: ChannelFit, record: Record) -> ChannelModel:
    low, high = float(fit.points.temperature.min()), float(fit.points.temperature.max())
    margin = 0.005 * (high - low)  # assumed: noise at a level at an end does not leave the range
    # An accelerometer's constant has gravity in it: its curve is the change from the middle.
    constant = float(fit.choice.curve.value(0.5 * (low + high))) if name in ACCEL else 0.0
    return ChannelModel(
        unit="m/s^2" if name in ACCEL else "rad/s",
        temperature_column=record.temperature_column(name),
        temperature_range_degc=[low - margin, high + margin],
        residual_sd=fit.choice.residual_sd,
        held_out_rms=fit.choice.held_out_rms,
        curve=fit.choice.curve.minus(constant),
    )


def knots_of(means: CellMeans, levels: FloatArray) -> FloatArray:
    """Return the knots of a channel's spline, °C upwards: its own ends, and the inner `levels`.

    The ends stand for the outermost levels.  With more than six levels (assumed) the level next to each end
    is no knot, as it would only make the slope there uncertain ("not a knot" of an interpolating spline).
    """
    low, high = means.temperature.min(), means.temperature.max()
    inner = levels[2:-2] if len(levels) > 6 else levels[1:-1]
    least = (high - low) / (4 * len(levels))  # from an end: a quarter of the levels' distance.  Assumed.
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
                name: float(fit.offset[index]) for name, fit in fits.items() if np.isfinite(fit.offset[index])
            },
        )
        for index, run in enumerate(at_rest.runs)
    ]


def _remarks(
    at_rest: RestBlocks, fits: dict[str, ChannelFit], devices: list[str], units: list[str]
) -> list[str]:
    differing = {
        name: f"{fit.repeatability / DEG_PER_H:.3g}"
        for name, fit in fits.items()
        if name in GYRO and fit.repeatability and fit.repeatability > fit.choice.residual_sd
    }
    remarks = [
        (len(devices) > 1, f"the sessions are of different devices: {', '.join(devices)}"),
        (len(units) > 1, f"the sessions are of different units: {', '.join(units)}"),
        (
            len({record.sha256 for record in at_rest.records}) < len(at_rest.records),
            "a session is there twice: it counts twice, and its repeatability means nothing",
        ),
        (one_way([run.temperature for run in at_rest.runs]), ONE_WAY),
        (
            at_rest.turned and bool(differing),
            f"{', '.join(differing)}: the bias differs by {', '.join(differing.values())} °/h between the"
            " poses, by g or by the earth rate, which no curve over temperature has: the residual is that of"
            " one pose; imumon diagnose finds which",
        ),
    ]
    return [text for applies, text in remarks if applies]


def check_columns(records: Sequence[Record]) -> None:
    """Raise BAD_DATA when a record has no gyro, a constant one, no temperature, or others than the rest."""
    for record in records:
        if lacking := [name for name in GYRO if not record.means.has(name)]:
            raise bad_data(
                f"{record.name}: no values of {', '.join(lacking)}",
                "a bias model is made of angular rates; let the device send them, or name them in the map",
            )
        if not all(record.temperature_column(name) for name in GYRO):
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
    for what, names in [
        *(("thermometers", {record.temperature_column(name) for record in records}) for name in GYRO),
        ("body axes", {str(record.axes) for record in records if record.axes}),
    ]:
        if len(names) > 1:
            raise bad_data(
                f"the sessions have different {what}: {', '.join(sorted(names))}",
                "calibrate them apart: a model has one of them",
            )


def check_coverage(at_rest: RestBlocks) -> None:
    """Raise BAD_DATA when time at rest, span, holes or rate do not allow a model."""
    rest_s = at_rest.seconds.sum()
    if rest_s < LEAST_REST_S:
        recorded_s = sum(record.means.span_s.sum() for record in at_rest.records)
        raise bad_data(
            f"{rest_s:.0f} s at rest, of {recorded_s:.0f} s with several samples in {BLOCK_S:g} s; a model"
            f" needs {LEAST_REST_S:.0f}",
            "let the unit stand still on a firm base for longer, with a sample every"
            f" {COVERED_S:g} s at least",
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
