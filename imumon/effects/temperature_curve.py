"""A curve over temperature of a higher degree than the one declared."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey

MORE_DEGREES = (2, 4, 6)


class TemperatureCurve(Effect):
    """Powers of u = (T - middle) / half span, from `first_power` on, as many as there are coefficients."""

    name: ClassVar[str] = "temperature_curve"
    kind: Literal["temperature_curve"] = "temperature_curve"
    middle_degc: float
    half_span_degc: float
    first_power: int
    powers: int = 2

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
