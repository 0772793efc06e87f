"""Which curve: the one that errs least at temperature levels left out of its fit; and the turn-on offsets."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from imumon.blocks import FloatArray, IntArray
from imumon.models.curves.network import fit_network, weights_of
from imumon.models.curves.points import Points, folds
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.spline import fit_spline, penalised_basis
from imumon.models.model import Curve

from .cells import CellMeans, weight_of

MOST_ORDER = 9  # of a polynomial.  Assumed.
MOST_NEURONS = 3  # in a layer of a network: a simulated unit (scenario `crs05-soak`) needs as many
FOLDS = 5  # every fifth of the inner levels is left out at a time.  Assumed.
Fitter = Callable[[Points], Curve]


class Choice(NamedTuple):
    """The curve chosen, and what led to it; errors are in the channel's unit."""

    name: str
    curve: Curve  # fitted to all points
    held_out_rms: dict[str, float]  # error of each candidate at levels left out
    residual_sd: float  # the same of the chosen one, without the white noise of the samples
    fit_rms: float  # of `curve` at the points that it was fitted to


def candidate_curves(points: Points, knots: FloatArray) -> dict[str, Fitter]:
    """Return what the data can support, the preferred first, by the name in reports and in the model file.

    A polynomial has no more coefficients than levels remain when the largest fold is left out.
    """
    levels = len(np.unique(points.level))
    remaining = levels - int(np.ceil((levels - 2) / FOLDS))  # the two at the ends are in no fold
    orders = range(1, min(MOST_ORDER, remaining - 1) + 1)  # order k has k + 1 coefficients
    fitters: dict[str, Fitter] = {f"polynomial {k}": partial(fit_polynomial, order=k) for k in orders}
    fitters["spline"] = partial(fit_spline, knots=knots)
    for n in range(1, MOST_NEURONS + 1):
        # A network counts as a polynomial of order 2 n + 1, and needs two means for each weight.  Assumed.
        if remaining > 2 * n + 1 and len(points) >= 2 * weights_of(n):
            fitters[f"network {n}"] = partial(fit_network, neurons=n)
    return fitters


def choose(points: CellMeans, knots: FloatArray) -> Choice:
    """Return the candidate that errs least at levels left out, fitted to all points."""
    fitters = candidate_curves(points, knots)
    residuals = {name: held_out(points, fitter) for name, fitter in fitters.items()}
    rms = {name: _rms(points, residual) for name, residual in residuals.items()}
    # An earlier candidate is preferred whose error is at most 5 % above the least.  Assumed.
    best = next(name for name in fitters if rms[name] <= 1.05 * min(rms.values()))
    curve = fitters[best](points)
    known = np.isfinite(residuals[best])  # all but the end levels
    white = np.average(points.white[known], weights=points.weight[known])
    # The noise is an estimate as well: a tenth of the variance stays in any case.  Assumed.
    beyond_white = max(rms[best] ** 2 - white, 0.1 * rms[best] ** 2)
    return Choice(
        name=best,
        curve=curve,
        held_out_rms=rms,
        residual_sd=float(np.sqrt(beyond_white)),
        fit_rms=_rms(points, points.value - curve.value(points.temperature)),
    )


def held_out(points: Points, fitter: Fitter) -> FloatArray:
    """Return the residual of each mean to a curve fitted without its level, (n,); NaN at the end levels."""
    residual = np.full(len(points), np.nan)
    for out in folds(points.level, FOLDS):
        residual[out] = points.value[out] - fitter(points.only(~out)).value(points.temperature[out])
    return residual


def reweighted(points: CellMeans, knots: FloatArray) -> CellMeans:
    """Return the means with weights by all their variance about a smooth curve, not the white noise alone."""
    excess = (points.value - fit_spline(points, knots).value(points.temperature)) ** 2 - points.white
    # The mean excess is the variance of what is slow: longer cells would not reduce it.
    return replace(points, weight=weight_of(points.white + max(float(excess.mean()), 0.0)))


def _rms(points: Points, residual: FloatArray) -> float:
    known = np.isfinite(residual)
    return float(np.sqrt(np.average(residual[known] ** 2, weights=points.weight[known])))


def comparable_runs(points: CellMeans) -> IntArray:
    """Return the runs that levels in common join, directly or through others, to the one of most cells."""
    visited = np.zeros((points.run.max() + 1, points.level.max() + 1), np.int64)
    visited[points.run, points.level] = 1
    # The product is the number of levels in common of each two runs, (runs, runs).
    _, group = connected_components(visited @ visited.T, directed=False)
    return np.flatnonzero(group == group[np.argmax(np.bincount(points.run))])


def turn_on_offsets(points: CellMeans, runs: IntArray, knots: FloatArray) -> FloatArray:
    """Return the offset of each of the comparable runs, (runs,) in the channel's unit; their mean is 0.

    Others have none: without a level in common, an offset and a bend of the curve are the same.
    """
    if len(runs) < 2:
        return np.zeros(1)
    # The offset of the first run is 0 for now; the others are estimated beside the curve.
    basis, penalty = penalised_basis(points, knots)
    is_of_run = points.run[:, None] == runs[1:]
    root = np.sqrt(points.weight)
    design = np.hstack([basis, is_of_run]) * root[:, None]
    normal = design.T @ design
    spline_terms = len(penalty)
    # Small, for where no data determines the curve.  Assumed.
    normal[:spline_terms, :spline_terms] += 1e-6 * penalty
    solution = np.linalg.solve(normal, design.T @ (points.value * root))
    offsets = np.append(0.0, solution[spline_terms:])
    return np.asarray(offsets - offsets.mean())
