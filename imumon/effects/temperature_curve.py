"""A curve over temperature of a higher degree than the one declared, or over another driver."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.polynomial import Polynomial
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, DrivenEffect, Memory, Positive, Scale, Survey

MORE_DEGREES = (2, 4, 6)
DEGREES = (1, 2, 3)
"""Of a curve over another driver."""


class TemperatureCurve(DrivenEffect):
    """Powers of u = (driver - middle) / half span from `first_power` on, `powers` of them."""

    kind: Literal["temperature_curve"] = "temperature_curve"
    operator = "curve"
    suspected_by = ("temperature",)
    middle: FiniteFloat
    half_span: Positive
    first_power: Annotated[int, Field(ge=1, le=20)]
    powers: Annotated[int, Field(ge=1, le=20)] = 2

    def scale_of(self, driver: str) -> Scale | None:
        """Return that of its driver."""
        return Scale(self.middle, self.half_span) if driver == self.driver else None

    @property
    def width(self) -> int:
        """One for each power."""
        return self.powers

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the next powers, two, four or six of them; none at constant temperature."""
        return [
            cls(
                middle=survey.middle_degc,
                half_span=survey.half_span_degc,
                first_power=survey.degree + 1,
                powers=powers,
            )
            for powers in (MORE_DEGREES if survey.thermal else ())
        ]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return a line, a parabola and a cubic."""
        scale = survey.others[driver]
        return [
            cls(
                driver=driver,
                middle=scale.middle,
                half_span=scale.half_span,
                first_power=1,
                powers=powers,
            )
            for powers in DEGREES
        ]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the powers of u."""
        u = (drive.of(self.driver) - self.middle) / self.half_span
        return np.asarray(u[:, np.newaxis] ** np.arange(self.first_power, self.first_power + self.powers))

    @property
    def is_curve(self) -> bool:
        """Whether it is one of the temperature that the curve is over."""
        return self.of_temperature

    def polynomial(self) -> Polynomial | None:
        """Return its powers as they are, of the temperature."""
        if not self.is_curve:
            return None
        ends = self.middle - self.half_span, self.middle + self.half_span
        return Polynomial([0.0] * self.first_power + self.coefficients, domain=ends)
