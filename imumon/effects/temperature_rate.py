"""A bias proportional to the rate of the temperature, or of another driver."""

from __future__ import annotations

from typing import Literal, Self

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, DrivenEffect, Memory, Positive, Survey
from imumon.effects.thermal_lag import ThermalLag

FILTERS_S = (5.0, 15.0, 45.0)
"""Of the rate of another driver."""


class TemperatureRate(DrivenEffect):
    """The rate of the driver behind a first-order filter of `smoothing_s`, in its unit per second."""

    kind: Literal["temperature_rate"] = "temperature_rate"
    operator = "rate"
    suspected_by = ("temperature rate",)
    smoothing_s: Positive = 15.0

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none at constant temperature."""
        return [cls()] if survey.thermal else []

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:  # noqa: ARG003 - whatever varies has a rate
        """Return one behind a fast, a usual and a slow filter."""
        return [cls(driver=driver, smoothing_s=seconds) for seconds in FILTERS_S]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the filtered rate: how far a lag is behind, over its time constant."""
        lag = ThermalLag(driver=self.driver, time_constant_s=self.smoothing_s, middle=0.0, half_span=1.0)
        return lag.advance(memory, drive)[:, :1] / self.smoothing_s
