"""A curve over temperature of a higher degree than the one declared."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.polynomial import Polynomial
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Positive, Survey

MORE_DEGREES = (2, 4, 6)


class TemperatureCurve(Effect):
    """Powers of u = (T - middle) / half span, from `first_power` on, as many as there are coefficients."""

    kind: Literal["temperature_curve"] = "temperature_curve"
    suspected_by = ("temperature",)
    middle_degc: FiniteFloat
    half_span_degc: Positive
    first_power: Annotated[int, Field(ge=1, le=20)]
    powers: Annotated[int, Field(ge=1, le=20)] = 2

    @property
    def width(self) -> int:
        """One for each power."""
        return self.powers

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the next powers, two, four or six of them; none at constant temperature."""
        return [
            cls(
                middle_degc=survey.middle_degc,
                half_span_degc=survey.half_span_degc,
                first_power=survey.degree + 1,
                powers=powers,
            )
            for powers in (MORE_DEGREES if survey.thermal else ())
        ]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the powers of u."""
        u = (drive.temperature_degc - self.middle_degc) / self.half_span_degc
        return np.asarray(u[:, np.newaxis] ** np.arange(self.first_power, self.first_power + self.powers))

    def polynomial(self) -> Polynomial:
        """Return its powers as they are."""
        ends = self.middle_degc - self.half_span_degc, self.middle_degc + self.half_span_degc
        return Polynomial([0.0] * self.first_power + self.coefficients, domain=ends)
