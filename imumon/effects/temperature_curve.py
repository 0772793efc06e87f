"""A curve over temperature of a higher degree than the one declared, or over another driver."""

from typing import Annotated, Literal, Self

import numpy as np
from numpy.polynomial import Polynomial
from pydantic import Field

from imumon.blocks import FloatArray

from .base import Drive, Memory, ScaledEffect, Survey

MORE_DEGREES = (2, 4, 6)
"""Further powers that are tried."""


class TemperatureCurve(ScaledEffect):
    """Powers of u = (driver - middle) / half span from `first_power` on, `powers` of them."""

    kind: Literal["temperature_curve"] = "temperature_curve"
    operator = "curve"
    suspected_by = ("temperature",)
    first_power: Annotated[int, Field(ge=1, le=20)]
    powers: Annotated[int, Field(ge=1, le=20)] = 2

    @property
    def width(self) -> int:
        """One for each power."""
        return self.powers

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the next powers, two, four or six of them; none at constant temperature."""
        if not survey.thermal:
            return []
        first, scale = survey.degree + 1, survey.scale._asdict()
        return [cls(first_power=first, powers=powers, **scale) for powers in MORE_DEGREES]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return a line, a parabola and a cubic."""
        scale = survey.others[driver]._asdict()
        return [cls(driver=driver, first_power=1, powers=powers, **scale) for powers in (1, 2, 3)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the powers of u."""
        u = (drive.of(self.driver) - self.middle) / self.half_span
        return u[:, None] ** np.arange(self.first_power, self.first_power + self.powers)

    def polynomial(self) -> Polynomial | None:
        """Return its powers as they are, of the temperature."""
        if not self.of_temperature:
            return None
        ends = self.middle - self.half_span, self.middle + self.half_span
        return Polynomial([0.0] * self.first_power + self.coefficients, domain=ends)
