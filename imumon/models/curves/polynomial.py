"""A polynomial in temperature, in Chebyshev form: well conditioned at any order that is of use."""

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.config import StrictModel

from .points import Points

HIGHEST_ORDER = 12
CUBIC = "polynomial 3"
"""The words for the curve that a diagnosis assumes where none is given; here, as they are wanted early."""


class PolynomialCurve(StrictModel):
    """b(T) = sum of c_k C_k(u), u = (T - center) / half_width, C_k the Chebyshev polynomials."""

    kind: Literal["polynomial"] = "polynomial"
    center_degc: FiniteFloat
    half_width_degc: Annotated[FiniteFloat, Field(gt=0.0)]
    """°C; u is -1 to 1 over the calibrated range."""
    coefficients: Annotated[list[FiniteFloat], Field(min_length=1, max_length=HIGHEST_ORDER + 1)]
    """c_0, c_1, ..., in the unit of the channel."""

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return b at temperatures in °C, in the unit of the channel."""
        return np.asarray(chebyshev.chebval(self._scaled(temperature), self.coefficients), np.float64)

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C."""
        derivative = chebyshev.chebder(self.coefficients)
        slope = chebyshev.chebval(self._scaled(temperature), derivative) / self.half_width_degc
        return np.asarray(slope, np.float64)

    def minus(self, constant: float) -> "PolynomialCurve":
        """Return the curve lowered by a constant."""
        first, *others = self.coefficients
        return self.model_copy(update={"coefficients": [first - constant, *others]})

    def _scaled(self, temperature: npt.ArrayLike) -> FloatArray:
        return (np.asarray(temperature, np.float64) - self.center_degc) / self.half_width_degc


def fit_polynomial(points: Points, order: int) -> PolynomialCurve:
    """Fit a polynomial of this order by weighted least squares.

    Raises ValueError when there are fewer distinct temperatures than coefficients.
    """
    low, high = float(points.temperature.min()), float(points.temperature.max())
    if len(np.unique(points.temperature)) <= order:
        raise ValueError(f"{order + 1} coefficients from fewer temperatures")
    center, half_width = 0.5 * (low + high), 0.5 * (high - low) or 1.0
    basis = chebyshev.chebvander((points.temperature - center) / half_width, order)
    root = np.sqrt(points.weight)
    coefficients = np.linalg.lstsq(basis * root[:, None], points.value * root, rcond=None)[0]
    return PolynomialCurve(center_degc=center, half_width_degc=half_width, coefficients=coefficients.tolist())
