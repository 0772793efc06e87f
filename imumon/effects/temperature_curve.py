"""A curve over temperature of a higher degree than the one declared."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Positive, Survey

MORE_DEGREES = (2, 4, 6)


class TemperatureCurve(Effect):
    """Powers of u = (T - middle) / half span, from `first_power` on, as many as there are coefficients."""

    name: ClassVar[str] = "temperature_curve"
    kind: Literal["temperature_curve"] = "temperature_curve"
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
        if not survey.thermal:
            return []
        return [
            cls(
                middle_degc=survey.middle_degc,
                half_span_degc=survey.half_span_degc,
                first_power=survey.degree + 1,
                powers=powers,
            )
            for powers in MORE_DEGREES
        ]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the powers of u."""
        u = (drive.temperature_degc - self.middle_degc) / self.half_span_degc
        return np.asarray(u[:, np.newaxis] ** np.arange(self.first_power, self.first_power + self.powers))
