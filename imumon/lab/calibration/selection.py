"""Which curve: the one that errs least at temperature levels that it has not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.calibration.cells import Channel
from imumon.models.curves.network import fit_network, weights_of
from imumon.models.curves.points import Points, folds
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.spline import fit_spline
from imumon.models.model import Curve

HIGHEST_ORDER = 9
MOST_NEURONS = 3
FOLDS = 5
"""Every fifth of the inner levels is left out at a time."""
AS_GOOD = 1.05
"""A simpler curve is preferred whose error is at most this much above the least."""

Fit = Callable[[Points], Curve]


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The curve chosen, fitted to all points, and what led to it.

    `held_out_rms` has the error at levels left out for each candidate, `residual_sd` is that of the chosen
    one without what the samples' white noise explains; both in the channel's unit.
    """

    name: str
    curve: Curve
    held_out_rms: dict[str, float]
    residual_sd: float
    fit_rms: float


def candidates(points: Points, knots: FloatArray) -> dict[str, Fit]:
    """Return what the data can support, the simplest first, by the name in reports and in the model file.

    A curve may have at most so many coefficients that those levels which remain in a fold determine them.
    """
    levels = len(np.unique(points.level))
    remaining = levels - max(1, -(-(levels - 2) // FOLDS))
    orders = range(1, min(HIGHEST_ORDER, remaining - 1) + 1)
    found: dict[str, Fit] = {f"polynomial {k}": partial(fit_polynomial, order=k) for k in orders}
    found["spline"] = partial(fit_spline, knots=knots)
    for n in range(1, MOST_NEURONS + 1):
        if 2 * weights_of(n) <= len(points) and remaining > 2 * n + 1:
            found[f"network {n}"] = partial(fit_network, neurons=n)
    return found


def choose(channel: Channel, points: Points, knots: FloatArray) -> Choice:
    """Try every candidate on levels left out, and fit the best to all points."""
    tried = candidates(points, knots)
    residuals = {name: held_out(points, fit) for name, fit in tried.items()}
    rms = {name: _rms(points, residual) for name, residual in residuals.items()}
    best = next(name for name in tried if rms[name] <= AS_GOOD * min(rms.values()))
    curve = tried[best](points)
    return Choice(
        name=best,
        curve=curve,
        held_out_rms=rms,
        residual_sd=_beyond_white(points, residuals[best], channel.white),
        fit_rms=_rms(points, points.value - curve.value(points.temperature)),
    )


def held_out(points: Points, fit: Fit) -> FloatArray:
    """Return the residual of each mean to a curve that has not seen its level, (n,); NaN at the two edges."""
    residual = np.full(len(points), np.nan)
    for out in folds(points.level, FOLDS):
        curve = fit(points.only(~out))
        residual[out] = points.value[out] - curve.value(points.temperature[out])
    return residual


def slow_variance(points: Points, white: FloatArray, knots: FloatArray) -> float:
    """Return the variance that the means have about a smooth curve beyond the white noise."""
    residual = points.value - fit_spline(points, knots).value(points.temperature)
    return max(float(np.mean(residual**2 - white)), 0.0)


def _rms(points: Points, residual: FloatArray) -> float:
    known = np.isfinite(residual)
    return float(np.sqrt(np.average(residual[known] ** 2, weights=points.weight[known])))


def _beyond_white(points: Points, residual: FloatArray, white: FloatArray) -> float:
    """Return the rms residual less the white noise; of its square at least a tenth is left."""
    known = np.isfinite(residual)
    weight, square = points.weight[known], residual[known] ** 2
    whole = float(np.average(square, weights=weight))
    return float(np.sqrt(max(whole - float(np.average(white[known], weights=weight)), 0.1 * whole)))
