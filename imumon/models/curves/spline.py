"""A cubic smoothing spline: no more shape than the levels show, and no wiggle that they do not."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray, IntArray
from imumon.config import StrictModel
from imumon.models.curves.points import Points, folds

MOST_KNOTS = 1000


class SplineCurve(StrictModel):
    """A piecewise cubic by its values and slopes at the knots.

    Parameters
    ----------
    knots_degc : list of float
        °C, increasing; the first and the last piece go on outside.
    values, slopes : list of float
        b and db/dT at the knots, in the unit of the channel and per °C.
    """

    kind: Literal["spline"] = "spline"
    knots_degc: Annotated[list[FiniteFloat], Field(min_length=2, max_length=MOST_KNOTS)]
    values: list[FiniteFloat]
    slopes: list[FiniteFloat]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = len(self.knots_degc)
        if len(self.values) != n or len(self.slopes) != n:
            raise ValueError(
                f"{n} knots need {n} values, {n} slopes; {len(self.values)}, {len(self.slopes)} given"
            )
        if any(b <= a for a, b in zip(self.knots_degc, self.knots_degc[1:], strict=False)):
            raise ValueError("knots_degc do not increase")
        return self

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return b at temperatures in °C, in the unit of the channel."""
        s, h, y0, y1, d0, d1 = self._piece(temperature)
        c2, c3 = 3.0 * (y1 - y0) - h * (2.0 * d0 + d1), 2.0 * (y0 - y1) + h * (d0 + d1)
        return y0 + s * (h * d0 + s * (c2 + s * c3))

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C."""
        s, h, y0, y1, d0, d1 = self._piece(temperature)
        c2, c3 = 3.0 * (y1 - y0) - h * (2.0 * d0 + d1), 2.0 * (y0 - y1) + h * (d0 + d1)
        return d0 + s * (2.0 * c2 + 3.0 * s * c3) / h

    def minus(self, constant: float) -> SplineCurve:
        """Return the curve lowered by a constant."""
        return self.model_copy(update={"values": [value - constant for value in self.values]})

    def _piece(self, temperature: npt.ArrayLike) -> tuple[FloatArray, ...]:
        """Return where in its piece each temperature is (0 to 1), the piece's width, and its ends."""
        t = np.asarray(temperature, np.float64)
        knots, values, slopes = np.array(self.knots_degc), np.array(self.values), np.array(self.slopes)
        at = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
        h = knots[at + 1] - knots[at]
        return (t - knots[at]) / h, h, values[at], values[at + 1], slopes[at], slopes[at + 1]


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
    extended = _extended(knots)
    return SplineCurve(
        knots_degc=knots.tolist(),
        values=(b_spline_basis(extended, knots, 0) @ coefficients).tolist(),
        slopes=(b_spline_basis(extended, knots, 1) @ coefficients).tolist(),
    )


def penalised_basis(points: Points, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the B-splines at the points, (n, p), and ∫ b''² dT as a matrix of like size."""
    extended = _extended(knots)
    basis = b_spline_basis(extended, points.temperature, 0)
    penalty = _roughness(extended, knots)
    scale = np.sum(basis**2 * (points.weight / points.weight.mean())[:, np.newaxis]) / np.trace(penalty)
    return basis, penalty * scale


def _extended(knots: FloatArray) -> FloatArray:
    return np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])


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


def b_spline_basis(knots: FloatArray, x: FloatArray, derivative: int) -> FloatArray:
    """Return the cubic B-splines, or a derivative of them, at x: (len(x), len(knots) - 4).

    `knots` has its ends four times.  De Boor, A Practical Guide to Splines (1978), chapter IX, equation 14,
    and for the derivative chapter X, equation 12.
    """
    last = len(knots) - 5
    at = np.clip(np.searchsorted(knots, x, side="right") - 1, 3, last)
    basis = np.zeros((len(x), len(knots) - 1))
    basis[np.arange(len(x)), at] = 1.0
    for degree in range(1, 4 - derivative):
        width = knots[degree:] - knots[:-degree]
        inverse = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0)
        rising = (x[:, np.newaxis] - knots[: -degree - 1]) * inverse[:-1]
        falling = (knots[degree + 1 :] - x[:, np.newaxis]) * inverse[1:]
        basis = rising * basis[:, :-1] + falling * basis[:, 1:]
    for degree in range(4 - derivative, 4):
        width = knots[degree:] - knots[:-degree]
        inverse = np.divide(degree, width, out=np.zeros_like(width), where=width > 0)
        basis = inverse[:-1] * basis[:, :-1] - inverse[1:] * basis[:, 1:]
    return basis


def _roughness(extended: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the matrix of ∫ b''² dT; b'' is linear between knots, so two Gauss points a piece are exact."""
    middle, half = 0.5 * (knots[1:] + knots[:-1]), 0.5 * np.diff(knots)
    reach = half / np.sqrt(3.0)
    second = [b_spline_basis(extended, middle + side * reach, 2) for side in (-1.0, 1.0)]
    return np.asarray(sum((part * half[:, np.newaxis]).T @ part for part in second))
