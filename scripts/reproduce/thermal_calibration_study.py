"""The published training on the simulated soak: size of the network, what a split hides, slopes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline
from study import rms
from thermal_calibration_data import DEG_H, DWELLING_DEGC, INSIDE, Function, Soak

from imumon.blocks import BoolArray, FloatArray
from imumon.lab.calibration.calibration import knots_of
from imumon.lab.calibration.cells import Channel
from imumon.lab.calibration.selection import choose, held_out, slow_variance
from imumon.models.curves.network import NetworkCurve
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.smoothing import fit_spline
from imumon.models.curves.training import Scaling, fit_network, mean_square, starts, train

SIZES = (1, 2, 3, 4, 5)
RESTARTS = 20
SEED = 1
"""Of the simulated soak."""
BAD = 1.5
"""A start ended badly when its error is more than this much above that of the best."""


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A network trained in the published way.

    `residual` has the rms residual of training, validation and test samples, `bad` counts the starts that
    ended badly; in the unit of the points.
    """

    curve: NetworkCurve
    residual: tuple[float, float, float]
    bad: int


def split(count: int, random: np.random.Generator) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Return which samples are for training, validation and test: 65/20/15 %, drawn at random."""
    place = (random.permutation(count) + 0.5) / count
    return place < 0.65, (place >= 0.65) & (place < 0.85), place >= 0.85


def published(points: Points, neurons: int, seed: int, restarts: int = RESTARTS) -> Trained:
    """Train with a split by sample; the start with the best validation is kept."""
    random = np.random.default_rng(seed)
    parts = split(len(points), random)
    scaling = Scaling.of(points)
    training, validation = (scaling.apply(points.only(part)) for part in parts[:2])
    weights = [train(start, training, validation) for start in starts(neurons, restarts, random)]
    error = np.sqrt([mean_square(one, validation) for one in weights])
    curve = scaling.curve(weights[np.argmin(error)])
    residual = points.value - curve.value(points.temperature)
    of_training, of_validation, of_test = (rms(residual[part]) for part in parts)
    return Trained(curve, (of_training, of_validation, of_test), int(np.sum(error > BAD * error.min())))


@dataclass(frozen=True, slots=True)
class SizeRow:
    """S_r of one size of network: the rms over the axes, °/h or °/h/°C."""

    neurons: int
    by_sample: list[float]
    """Of training, validation and test samples."""
    levels_left_out: float
    truth: float


def size_study(soak: Soak) -> list[SizeRow]:
    """Figure 7: networks on b(T), trained on 30 s means at the levels; what splits say, and the truth."""
    points = [soak.halfminutes(axis) for axis in range(3)]
    return _sizes([one.only(soak.dwelling(one)) for one in points], soak.bias, soak.channels)


def slope_size_study(soak: Soak) -> list[SizeRow]:
    """Figure 8: networks on differences of levels, and the truth."""
    return _sizes([level_differences(soak, axis) for axis in range(3)], soak.slope, [])


def _sizes(points: list[Points], truth: FloatArray, channels: list[Channel]) -> list[SizeRow]:
    rows = []
    for n in SIZES:
        found = [published(one, n, seed=n) for one in points]
        by_sample = [rms([one.residual[k] for one in found]) / DEG_H for k in range(3)]
        true = rms(np.column_stack([one.curve.value(INSIDE) for one in found]) - truth)
        fit = partial(fit_network, neurons=n, restarts=3)
        apart = rms([rms(held_out(channel.points(), fit)) for channel in channels])
        rows.append(SizeRow(n, by_sample, apart / DEG_H, true / DEG_H))
    return rows


def level_means(soak: Soak, axis: int) -> Points:
    """Return the mean of each level."""
    points = soak.halfminutes(axis)
    return means_of_levels(points.only(soak.dwelling(points)))


def means_of_levels(points: Points) -> Points:
    """Return the mean of the points of each level."""
    number = np.unique(points.level)
    t = np.array([points.temperature[points.level == k].mean() for k in number])
    value = np.array([points.value[points.level == k].mean() for k in number])
    return Points(t, value, np.ones(len(t)), number)


def level_differences(soak: Soak, axis: int) -> Points:
    """Return slopes from each level to the next, at the temperature half way."""
    return differences(level_means(soak, axis))


def differences(means: Points) -> Points:
    """Return slopes from each of the means to the next, at the temperature half way."""
    middle = 0.5 * (means.temperature[1:] + means.temperature[:-1])
    slope = np.diff(means.value) / np.diff(means.temperature)
    return Points(middle, slope, np.ones(len(slope)), means.level[1:])


def slope_methods(soak: Soak, axis: int) -> dict[str, Function]:
    """Return db/dT by each method."""
    channel, all_points = soak.channels[axis], soak.halfminutes(axis)
    means = level_means(soak, axis)
    knots = knots_of(channel, soak.centers)
    points = channel.points(slow_variance(channel.points(), channel.white, knots))
    return {
        "derivative of the published b(T) network": published(all_points, 2, 1).curve.slope,
        "network on differences of levels": published(level_differences(soak, axis), 2, 1).curve.value,
        "cubic spline through the level means": CubicSpline(means.temperature, means.value).derivative(),
        "imumon: smoothing spline": fit_spline(points, knots).slope,
        "imumon: network 2": fit_network(points, 2).slope,
        "imumon: network 3": fit_network(points, 3).slope,
        "imumon calibrate: its choice": choose(channel, points, knots).curve.slope,
    }


def polynomial_leak(soak: Soak) -> tuple[float, float, float, float]:
    """Return residuals of a split by sample and the true error, rad/s, of 13 coefficients on 15 levels; z."""
    points = soak.halfminutes(2)
    points = points.only(soak.dwelling(points))
    parts = split(len(points), np.random.default_rng(1))
    curve = fit_polynomial(points.only(parts[0]), 12)
    residual = points.value - curve.value(points.temperature)
    training, validation, test = (rms(residual[part]) for part in parts)
    return training, validation, test, rms(curve.value(INSIDE) - soak.bias[:, 2])


def beyond_the_range(soak: Soak, distances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rms errors over axes and both ends, rad/s, of following the tangent and of holding the value.

    The curve is fitted to levels 2 to 14 of 15; it is evaluated `distances` °C outside.
    """
    tangent, hold = [], []
    for axis, channel in enumerate(soak.channels):
        low, high = soak.centers[1] - DWELLING_DEGC, soak.centers[-2] + DWELLING_DEGC
        inner = channel.only((channel.temperature > low) & (channel.temperature < high))
        knots = knots_of(inner, soak.centers[1:-1])
        curve = fit_spline(inner.points(), knots)
        for end, sign in ((knots[0], -1.0), (knots[-1], 1.0)):
            truth = np.interp(end + sign * distances, INSIDE, soak.bias[:, axis])
            value, slope = float(curve.value(end)), float(curve.slope(end))
            tangent.append(value + slope * sign * distances - truth)
            hold.append(value - truth)
    return np.sqrt(np.mean(np.square(tangent), axis=0)), np.sqrt(np.mean(np.square(hold), axis=0))
