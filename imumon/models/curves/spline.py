"""A piecewise cubic, fitted as a smoothing spline: no more shape than the levels show."""

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray, IntArray
from imumon.config import StrictModel

from .points import Points, folds

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

MOST_KNOTS = 1000
DEGREE = 3
_STRENGTHS = 10.0 ** np.arange(-9.0, 4.1, 0.5)  # λ that are tried


class SplineCurve(StrictModel):
    """A piecewise cubic by its values and slopes at the knots."""

    kind: Literal["spline"] = "spline"
    knots_degc: Annotated[list[FiniteFloat], Field(min_length=2, max_length=MOST_KNOTS)]
    """°C, increasing; the first and the last piece go on outside."""
    values: list[FiniteFloat]
    slopes: list[FiniteFloat]
    """b and db/dT at the knots, in the unit of the channel and per °C."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = len(self.knots_degc)
        if not n == len(self.values) == len(self.slopes):
            raise ValueError(
                f"{n} knots need {n} values, {n} slopes; {len(self.values)}, {len(self.slopes)} given"
            )
        if np.any(np.diff(self.knots_degc) <= 0.0):
            raise ValueError("knots_degc do not increase")
        return self

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return b at temperatures in °C, in the unit of the channel."""
        return np.asarray(self._cubics(temperature))

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C."""
        return np.asarray(self._cubics(temperature, nu=1))

    def minus(self, constant: float) -> "SplineCurve":
        """Return the curve lowered by a constant."""
        values = [value - constant for value in self.values]
        return SplineCurve(knots_degc=self.knots_degc, values=values, slopes=self.slopes)  # no stale cubics

    @cached_property
    def _cubics(self) -> "CubicHermiteSpline":
        from scipy.interpolate import CubicHermiteSpline  # takes 0.4 s, and few models have a spline

        return CubicHermiteSpline(self.knots_degc, self.values, self.slopes)


def fit_spline(points: Points, knots: FloatArray) -> SplineCurve:
    """Fit a cubic spline by penalised least squares: sum of w r² + λ ∫ b''² dT.

    λ is that of the least error at levels left out, so the noise within a level, which is not white, has no
    part in it.  With fewer than three levels, λ is large: nothing but a straight line.

    `knots` (m,): breaks, °C, increasing, at least the two ends of the range.
    """
    from scipy.interpolate import BSpline

    basis, penalty = penalised_basis(points, knots)
    root = np.sqrt(points.weight / points.weight.mean())
    weighted, target = basis * root[:, None], points.value * root
    strength = _best_strength(weighted, target, penalty, points.level)
    coefficients = np.linalg.solve(weighted.T @ weighted + strength * penalty, weighted.T @ target)
    fitted = BSpline(np.pad(knots, DEGREE, mode="edge"), coefficients, DEGREE)
    return SplineCurve(
        knots_degc=knots.tolist(), values=fitted(knots).tolist(), slopes=fitted(knots, nu=1).tolist()
    )


def penalised_basis(points: Points, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the B-splines at the points, (n, p), and ∫ b''² dT as a matrix of like size."""
    from scipy.interpolate import BSpline

    extended = np.pad(knots, DEGREE, mode="edge")
    basis = BSpline.design_matrix(points.temperature, extended, DEGREE, extrapolate=True).toarray()
    # b'' is linear between knots: two Gauss points a piece are exact.
    middle, half = 0.5 * (knots[1:] + knots[:-1]), 0.5 * np.diff(knots)
    every = BSpline(extended, np.eye(len(extended) - DEGREE - 1), DEGREE)
    second = [every(middle + side * half / np.sqrt(3.0), nu=2) for side in (-1.0, 1.0)]
    penalty = sum((part * half[:, None]).T @ part for part in second)
    scale = np.sum(basis**2 * (points.weight / points.weight.mean())[:, None]) / np.trace(penalty)
    return basis, penalty * scale


def _best_strength(basis: FloatArray, target: FloatArray, penalty: FloatArray, level: IntArray) -> float:
    normal, moment = basis.T @ basis, basis.T @ target
    errors = np.zeros(len(_STRENGTHS))
    for out in folds(level, len(level)):
        own = basis[out]
        without = normal - own.T @ own + _STRENGTHS[:, None, None] * penalty
        fitted = np.linalg.solve(without, (moment - own.T @ target[out])[:, None])
        errors += np.sum((own @ fitted - target[out][:, None]) ** 2, axis=(1, 2))
    return float(_STRENGTHS[np.argmin(errors)] if errors.any() else _STRENGTHS[-1])
