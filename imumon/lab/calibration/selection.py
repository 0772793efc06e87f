"""Which curve: the one that errs least at temperature levels left out of its fit; and the turn-on offsets."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from imumon.blocks import FloatArray
from imumon.models.curves.network import fit_network, weights_of
from imumon.models.curves.points import Points, folds
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.spline import fit_spline, penalised_basis
from imumon.models.model import Curve

from .cells import Channel

MOST_NEURONS = 3
FOLDS = 5
"""Every fifth of the inner levels is left out at a time."""
Fit = Callable[[Points], Curve]


class Choice(NamedTuple):
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
    orders = range(1, min(9, remaining - 1) + 1)
    found: dict[str, Fit] = {f"polynomial {k}": partial(fit_polynomial, order=k) for k in orders}
    found["spline"] = partial(fit_spline, knots=knots)
    for n in range(1, MOST_NEURONS + 1):
        if 2 * weights_of(n) <= len(points) and remaining > 2 * n + 1:
            found[f"network {n}"] = partial(fit_network, neurons=n)
    return found


def choose(points: Channel, knots: FloatArray) -> Choice:
    """Try every candidate on levels left out, and fit the best to all points."""
    tried = candidates(points, knots)
    residuals = {name: held_out(points, fit) for name, fit in tried.items()}
    rms = {name: _rms(points, residual) for name, residual in residuals.items()}
    # A simpler curve is preferred whose error is at most 5 % above the least.
    best = next(name for name in tried if rms[name] <= 1.05 * min(rms.values()))
    curve = tried[best](points)
    known = np.isfinite(residuals[best])
    # Of the square at least a tenth is left.
    noise = np.average(points.white[known], weights=points.weight[known])
    beyond_white = max(rms[best] ** 2 - noise, 0.1 * rms[best] ** 2)
    return Choice(
        name=best,
        curve=curve,
        held_out_rms=rms,
        residual_sd=float(np.sqrt(beyond_white)),
        fit_rms=_rms(points, points.value - curve.value(points.temperature)),
    )


def held_out(points: Points, fit: Fit) -> FloatArray:
    """Return the residual of each mean to a curve fitted without its level, (n,); NaN at the two edges."""
    residual = np.full(len(points), np.nan)
    for out in folds(points.level, FOLDS):
        residual[out] = points.value[out] - fit(points.only(~out)).value(points.temperature[out])
    return residual


def slow_variance(points: Channel, knots: FloatArray) -> float:
    """Return the variance that the means have about a smooth curve beyond the white noise."""
    residual = points.value - fit_spline(points, knots).value(points.temperature)
    return max(float(np.mean(residual**2 - points.white)), 0.0)


def _rms(points: Points, residual: FloatArray) -> float:
    known = np.isfinite(residual)
    return float(np.sqrt(np.average(residual[known] ** 2, weights=points.weight[known])))


def turn_on_offsets(points: Channel, runs: int, knots: FloatArray) -> FloatArray:
    """Return the offset of each run, (runs,) in the channel's unit; NaN where it cannot be determined.

    A run is compared only where others were at the same temperatures: with no level in common, an offset and
    a bend of the curve are the same.  The mean over the runs that can be compared is 0.
    """
    # Those that levels in common join, directly or through others, to the one with most data.
    visited = np.zeros((runs, int(points.level.max()) + 1), np.int64)
    visited[points.run, points.level] = 1
    _, group = connected_components(visited @ visited.T, directed=False)
    together = np.flatnonzero(group == group[np.argmax(np.bincount(points.run, minlength=runs))])
    offset = np.full(runs, np.nan)
    offset[together] = 0.0
    if len(together) < 2:
        return offset
    points = points.only(np.isin(points.run, together))
    basis, penalty = penalised_basis(points, knots)
    root, m = np.sqrt(points.weight), len(penalty)
    design = np.hstack([basis, points.run[:, None] == together[1:]]) * root[:, None]
    normal = design.T @ design
    normal[:m, :m] += 1e-6 * penalty  # enough to make the curve unique that they are estimated beside
    own = np.append(0.0, np.linalg.solve(normal, design.T @ (points.value * root))[m:])
    offset[together] = own - own.mean()
    return offset
