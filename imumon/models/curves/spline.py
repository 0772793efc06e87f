"""A piecewise cubic by its values and slopes at the knots."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray
from imumon.config import StrictModel

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

MOST_KNOTS = 1000


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
        if len(self.values) != n or len(self.slopes) != n:
            raise ValueError(
                f"{n} knots need {n} values, {n} slopes; {len(self.values)}, {len(self.slopes)} given"
            )
        if any(b <= a for a, b in zip(self.knots_degc, self.knots_degc[1:], strict=False)):
            raise ValueError("knots_degc do not increase")
        return self

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return b at temperatures in °C, in the unit of the channel."""
        return np.asarray(self._cubics(temperature))

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C."""
        return np.asarray(self._cubics(temperature, nu=1))

    def minus(self, constant: float) -> SplineCurve:
        """Return the curve lowered by a constant."""
        return self.model_copy(update={"values": [value - constant for value in self.values]})

    @cached_property
    def _cubics(self) -> CubicHermiteSpline:
        from scipy.interpolate import CubicHermiteSpline  # takes 0.4 s, and few models have a spline

        return CubicHermiteSpline(self.knots_degc, self.values, self.slopes)
