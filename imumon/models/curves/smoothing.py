"""Fit of a cubic smoothing spline: no more shape than the levels show, and no wiggle that they do not."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from imumon.blocks import FloatArray, IntArray
from imumon.models.curves.points import Points, folds
from imumon.models.curves.spline import SplineCurve

DEGREE = 3


def fit_spline(points: Points, knots: FloatArray) -> SplineCurve:
    """Fit a cubic spline by penalised least squares: sum of w r² + λ ∫ b''² dT.

    λ is that of the least error at levels left out, so the noise within a level, which is not white, has no
    say in it.  With fewer than three levels, λ is large: nothing but a straight line.

    Parameters
    ----------
    knots : array (m,)
        Breaks, °C, increasing, at least the two ends of the range.
    """
    basis, penalty = penalised_basis(points, knots)
    root = np.sqrt(points.weight / points.weight.mean())
    weighted, target = basis * root[:, np.newaxis], points.value * root
    strength = _best_strength(weighted, target, penalty, points.level)
    coefficients = np.linalg.solve(weighted.T @ weighted + strength * penalty, weighted.T @ target)
    fitted = BSpline(_extended(knots), coefficients, DEGREE)
    return SplineCurve(
        knots_degc=knots.tolist(), values=fitted(knots).tolist(), slopes=fitted(knots, nu=1).tolist()
    )


def penalised_basis(points: Points, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the B-splines at the points, (n, p), and ∫ b''² dT as a matrix of like size."""
    extended = _extended(knots)
    basis = BSpline.design_matrix(points.temperature, extended, DEGREE, extrapolate=True).toarray()
    penalty = _roughness(extended)
    scale = np.sum(basis**2 * (points.weight / points.weight.mean())[:, np.newaxis]) / np.trace(penalty)
    return basis, penalty * scale


def _extended(knots: FloatArray) -> FloatArray:
    return np.pad(knots, DEGREE, mode="edge")


_STRENGTHS = 10.0 ** np.arange(-9.0, 4.1, 0.5)


def _best_strength(basis: FloatArray, target: FloatArray, penalty: FloatArray, level: IntArray) -> float:
    """Return the λ with the least error at the levels left out."""
    normal, moment = basis.T @ basis, basis.T @ target
    errors = np.zeros(len(_STRENGTHS))
    for out in folds(level, len(level)):
        own = basis[out]
        without = normal - own.T @ own + _STRENGTHS[:, np.newaxis, np.newaxis] * penalty
        fitted = np.linalg.solve(
            without, np.broadcast_to(moment - own.T @ target[out], without.shape[:2])[..., None]
        )
        errors += np.sum((own @ fitted[..., 0].T - target[out][:, np.newaxis]) ** 2, axis=0)
    return float(_STRENGTHS[np.argmin(errors)] if errors.any() else _STRENGTHS[-1])


def _roughness(extended: FloatArray) -> FloatArray:
    """Return the matrix of ∫ b''² dT; b'' is linear between knots, so two Gauss points a piece are exact."""
    knots = extended[DEGREE:-DEGREE]
    middle, half = 0.5 * (knots[1:] + knots[:-1]), 0.5 * np.diff(knots)
    every = BSpline(extended, np.eye(len(extended) - DEGREE - 1), DEGREE)
    second = [every(middle + side * half / np.sqrt(3.0), nu=2) for side in (-1.0, 1.0)]
    return np.asarray(sum((part * half[:, np.newaxis]).T @ part for part in second))
