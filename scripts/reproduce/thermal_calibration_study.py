"""The published training on a simulated soak, slopes, and a measured chamber cycle before and after."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from samples import HIGHEST_DEGC, LOWEST_DEGC, crs05_curves, crs05_slopes
from scipy.interpolate import CubicSpline
from study import Cells, Options, Study, Table, matrix, rms

from imumon.blocks import BoolArray, FloatArray
from imumon.geodesy import DEG_PER_H
from imumon.lab.calibration.calibration import calibrate, knots_of
from imumon.lab.calibration.cells import CellMeans, Record, channel_of, find_rest, read_session, record_of
from imumon.lab.calibration.selection import choose, held_out, reweighted
from imumon.models.curves.network import NetworkCurve, Scaled, fit_network, mean_square, starts, train
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.spline import fit_spline
from imumon.models.model import Curve
from imumon.recordings.importing import import_table
from imumon.recordings.reduced import GYRO
from imumon.simulation.unit import SimulatedUnit, load_scenario

AXES = "xyz"
INSIDE = np.linspace(LOWEST_DEGC, HIGHEST_DEGC, 1373)
"""Where curves are compared with the truth, every 0.05 °C."""
DWELLING_DEGC = 0.1
EVERY = 4
"""So many means on a level are one for the network: 75 of 300 on each show the same, in less time."""
AT_ONCE = 150_000
"""Samples, nine times in the soak."""
SIZES = (1, 2, 3, 4, 5)
RESTARTS = 20
SEED = 1
"""Of the simulated soak."""
BAD = 1.5
"""A start ended badly when its error is more than this much above that of the best."""
SHARES = (0.42, 0.6, 0.8)
"""Of the chamber's record that is fitted."""
DISTANCES_DEGC = np.array([0.5, 1.0, 2.0, 3.0, 3.5])

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Soak:
    """The simulated soak in blocks of 10 s, and the truth at `INSIDE`, (n, 3) rad/s and rad/s/°C."""

    record: Record
    bias: FloatArray
    slope: FloatArray
    centers: FloatArray
    channels: list[CellMeans]

    def halfminutes(self, axis: int) -> Points:
        """Return means over 30 s of a gyro with their nearest level; every `EVERY`th of those on a level."""
        t = self.record.means.of(f"temperature_{AXES[axis]}").reshape(-1, 3).mean(axis=1)
        value = self.record.means.of(GYRO[axis]).reshape(-1, 3).mean(axis=1)
        level = np.argmin(np.abs(t[:, np.newaxis] - self.centers), axis=1)
        moving = np.abs(t - self.centers[level]) >= DWELLING_DEGC
        keep = moving | (np.arange(len(t)) % EVERY == 0)
        return Points(t, value, np.ones(len(t)), level).only(keep)

    def on_levels(self, axis: int) -> Points:
        """Return those of the means that are on a level, not on the way between two."""
        points = self.halfminutes(axis)
        return points.only(np.abs(points.temperature - self.centers[points.level]) < DWELLING_DEGC)


def simulated_soak(seed: int) -> Soak:
    """Run the scenario of the soak; the truth is its curve plus the earth rate, which stays in it."""
    name = "crs05-soak"
    scenario = load_scenario(name)
    unit = SimulatedUnit(scenario, seed)
    blocks = (unit.run(AT_ONCE)[0] for _ in range(scenario.samples // AT_ONCE))
    record = record_of(blocks, name, "0" * 64)
    at_rest = find_rest([record], None, None)
    channels = [channel_of(at_rest, name) for name in GYRO]
    earth = matrix(SimulatedUnit(scenario, seed).run(1)[1], "rate")
    bias, slope = crs05_curves(INSIDE) + earth, crs05_slopes(INSIDE)
    return Soak(record, bias, slope, at_rest.levels, [channel for channel in channels if channel is not None])


def during(record: Record, first: float, last: float) -> Record:
    """Return a record with only the blocks of a part of its time, as shares of the whole."""
    place = np.arange(len(record.means)) / len(record.means)
    return record._replace(rest=record.rest & (place >= first) & (place < last))


def split(count: int, random: np.random.Generator) -> list[BoolArray]:
    """Return which samples are for training, validation and test: 65/20/15 %, drawn at random."""
    place = (random.permutation(count) + 0.5) / count
    return [place < 0.65, (place >= 0.65) & (place < 0.85), place >= 0.85]


def stopped(start: FloatArray, training: Scaled, validation: Scaled) -> FloatArray:
    """Return the weights of the least validation error on the way from a start."""
    way = [start]
    train(start, training, accepted=lambda weights: way.append(weights.copy()))
    return min(way[1:] or way, key=lambda weights: mean_square(weights, validation))


def published(points: Points, neurons: int, seed: int) -> tuple[NetworkCurve, list[float], int]:
    """Train a network as published: with a split by sample, the start with the best validation is kept.

    Returns the curve, rms residuals of training, validation and test samples, and the number of bad starts.
    """
    random = np.random.default_rng(seed)
    parts = split(len(points), random)
    scaled = Scaled.of(points)
    training, validation = (
        scaled._replace(u=scaled.u[part], y=scaled.y[part], w=scaled.w[part] / scaled.w[part].mean())
        for part in parts[:2]
    )
    weights = [stopped(start, training, validation) for start in starts(neurons, RESTARTS, random)]
    error = np.sqrt([mean_square(one, validation) for one in weights])
    curve = scaled.curve(weights[np.argmin(error)])
    return curve, residuals(curve, points, parts), int(np.sum(error > BAD * error.min()))


def residuals(curve: Curve, points: Points, parts: list[BoolArray]) -> list[float]:
    """Return the rms residual of each part of the points."""
    residual = points.value - curve.value(points.temperature)
    return [rms(residual[part]) for part in parts]


def sizes(title: str, points: list[Points], truth: FloatArray, channels: list[CellMeans]) -> Table:
    """Return S_r, the rms over the axes, of networks of each size: what splits show, and the truth."""
    rows: list[Cells] = []
    for n in SIZES:
        found = [published(one, n, seed=n) for one in points]
        by_sample = [rms(part) / DEG_PER_H for part in zip(*(parts for _, parts, _ in found), strict=True)]
        true = rms(np.column_stack([curve.value(INSIDE) for curve, _, _ in found]) - truth) / DEG_PER_H
        fit = partial(fit_network, neurons=n, restarts=3)
        apart = rms([rms(held_out(channel, fit)) for channel in channels]) / DEG_PER_H
        rows.append([n, *by_sample, apart if channels else "", true])
    heads = ["neurons", "training samples", "validation samples", "test samples", "levels left out"]
    formats = ("", ".2f", ".2f", ".2f", ".1f", ".2f")
    return Table(title, [*heads, "against the truth"], rows, formats=formats)


def level_means(soak: Soak, axis: int) -> Points:
    """Return the mean of each level."""
    points = soak.on_levels(axis)
    number = np.unique(points.level)
    t, value = (
        np.array([of[points.level == k].mean() for k in number]) for of in (points.temperature, points.value)
    )
    return Points(t, value, np.ones(len(t)), number)


def level_differences(soak: Soak, axis: int) -> Points:
    """Return slopes from each level to the next, at the temperature half way."""
    means = level_means(soak, axis)
    middle = 0.5 * (means.temperature[1:] + means.temperature[:-1])
    slope = np.diff(means.value) / np.diff(means.temperature)
    return Points(middle, slope, np.ones(len(slope)), means.level[1:])


def slope_methods(soak: Soak, axis: int) -> dict[str, Function]:
    """Return db/dT by each method."""
    channel, all_points = soak.channels[axis], soak.halfminutes(axis)
    means = level_means(soak, axis)
    knots = knots_of(channel, soak.centers)
    points = reweighted(channel, knots)
    return {
        "derivative of the published b(T) network": published(all_points, 2, 1)[0].slope,
        "network on differences of levels": published(level_differences(soak, axis), 2, 1)[0].value,
        "cubic spline through the level means": CubicSpline(means.temperature, means.value).derivative(),
        "imumon: smoothing spline": fit_spline(points, knots).slope,
        "imumon: network 2": fit_network(points, 2).slope,
        "imumon: network 3": fit_network(points, 3).slope,
        "imumon calibrate: its choice": choose(points, knots).curve.slope,
    }


def slopes(soak: Soak) -> Table:
    """Errors of db/dT by each method."""
    methods = [slope_methods(soak, axis) for axis in range(3)]
    rows: list[Cells] = []
    for name in methods[0]:
        errors = [rms(methods[axis][name](INSIDE) - soak.slope[:, axis]) / DEG_PER_H for axis in range(3)]
        rows.append([name, *errors])
    bad = [published(soak.halfminutes(axis), 2, 1)[2] for axis in range(3)]
    points = soak.on_levels(2)
    parts = split(len(points), np.random.default_rng(1))
    curve = fit_polynomial(points.only(parts[0]), 12)
    found = [f"{value / DEG_PER_H:.1f}" for value in residuals(curve, points, parts)]
    between = rms(curve.value(INSIDE) - soak.bias[:, 2]) / DEG_PER_H
    note = (
        f"Of {RESTARTS} starts of the 1-2-2-1 network {' / '.join(map(str, bad))} (x / y / z) ended with more"
        " than 1.5 times the validation error of the best.  A polynomial of order 12 on the levels alone,"
        f" split by sample: rms residual of training, validation and test {' / '.join(found)} °/h; its error"
        f" between the levels {between:.1f} °/h (z)."
    )
    title = "## Error of the slope\n\nrms from -20.53 to 48.08 °C against the truth, °/h/°C."
    return Table(title, ["method", *AXES], rows, note, ("", ".2f", ".2f", ".2f"))


def outside(soak: Soak) -> Table:
    """Return errors outside levels 2 to 14 of 15, over axes and ends: by tangent, and value held."""
    errors: dict[str, list[FloatArray]] = {"tangent": [], "held": []}
    for axis, channel in enumerate(soak.channels):
        low, high = soak.centers[1] - DWELLING_DEGC, soak.centers[-2] + DWELLING_DEGC
        inner = channel.only((channel.temperature > low) & (channel.temperature < high))
        knots = knots_of(inner, soak.centers[1:-1])
        curve = fit_spline(inner, knots)
        for end, sign in ((knots[0], -1.0), (knots[-1], 1.0)):
            truth = np.interp(end + sign * DISTANCES_DEGC, INSIDE, soak.bias[:, axis])
            value, slope = float(curve.value(end)), float(curve.slope(end))
            errors["tangent"].append(value + slope * sign * DISTANCES_DEGC - truth)
            errors["held"].append(value - truth)
    rows: list[Cells] = []
    for name, off in errors.items():
        rows.append([name, *(np.sqrt(np.mean(np.square(off), axis=0)) / DEG_PER_H)])
    title = (
        "## Outside the calibrated range\n\n"
        "Spline fitted to levels 2 to 14; rms error over axes and both ends, °/h."
    )
    formats = ("", *[".1f"] * len(DISTANCES_DEGC))
    return Table(title, ["", *(f"{d:g} °C" for d in DISTANCES_DEGC)], rows, formats=formats)


def chamber(record: Record, share: float) -> Table:
    """Errors of curves fitted to the first `share` of a record's time, on the rest in the trained range."""
    first, rest = during(record, 0.0, share), during(record, share, 1.0)
    model = calibrate([first])
    at_rest = find_rest([first], None, None)
    rows = []
    for axis, name in zip(AXES, GYRO, strict=True):
        channel = channel_of(at_rest, name)
        assert channel is not None
        knots = knots_of(channel, at_rest.levels)
        points = reweighted(channel, knots)
        curves: dict[str, Curve] = {
            "line": fit_polynomial(points, 1),
            "cubic": fit_polynomial(points, 3),
            "spline": fit_spline(points, knots),
            "network 2": fit_network(points, 2),
        }
        found = model.model.channels[name]
        t, value = rest.means.of(found.temperature_column)[rest.rest], rest.means.of(name)[rest.rest]
        inside = found.inside(t)
        cell_s = np.bincount(at_rest.cell_of_block, at_rest.seconds)
        constant = float(np.average(channel.value, weights=cell_s))
        errors = {"constant": rms(value[inside] - constant)}
        errors |= {key: rms(value[inside] - curve.value(t[inside])) for key, curve in curves.items()}
        errors["chosen"] = rms(value[inside] - found.value(t[inside]))
        white = np.rad2deg(rms(np.sqrt(rest.means.mean_variance(name)[rest.rest])))
        cells = [axis, *np.rad2deg(list(errors.values())), model.fits[name].choice.name]
        rows.append([*cells, np.rad2deg(found.residual_sd), inside.mean(), white])
    heads = ["axis", *errors, "what was chosen", "promised", "inside", "noise of a block"]
    formats = ("", *[".3f"] * len(errors), "", ".3f", ".0%", ".4f")
    return Table(f"Fitted to the first {share:.0%} of the time:", heads, rows, formats=formats)


def tables(given: Options) -> Iterator[Table]:
    """Yield the tables of the soak, and of the measured recording where it is here."""
    soak = simulated_soak(SEED)
    if given.quick:
        yield outside(soak)
        return
    title = (
        "## Size of the network, and what a split by sample hides\n\n"
        "Scenario crs05-soak, 30 s means at the levels, 65/20/15 % of the samples at random, as published;"
        " S_r is the rms over the three axes, °/h.  The three parts agree whatever happens in between."
    )
    yield sizes(title, [soak.on_levels(axis) for axis in range(3)], soak.bias, soak.channels)
    title = "The same on db/dT from differences of levels, °/h/°C: 14 of them, 9 for training."
    yield sizes(title, [level_differences(soak, axis) for axis in range(3)], soak.slope, [])
    yield slopes(soak)
    yield outside(soak)
    folder = given.data / "chamber-cycle"
    if not folder.is_dir():
        return
    with tempfile.TemporaryDirectory() as scratch:
        session = Path(scratch) / "chamber-cycle"
        import_table(folder / "cooling-heating.csv", folder / "map.yaml", session)
        record = read_session(session)[0]
    text = (
        "## Measured: before and after\n\n"
        "rms error of the bias in the part of the chamber cycle after the fit, where its temperature is in"
        " the fitted range, °/s; `constant` is before: the mean of the fitted part.  `promised` is the"
        " `residual_sd` of the model."
    )
    yield Table(text, (), ())
    for share in SHARES:
        yield chamber(record, share)


STUDY = Study(tables, page="appendix/thermal-calibration-results.md")
