"""A bias proportional to the rate of the temperature, or of another driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, DrivenEffect, Memory, Positive, Survey
from imumon.effects.thermal_lag import ThermalLag

FILTERS_S = (5.0, 15.0, 45.0)
"""Of the rate of another driver."""


class TemperatureRate(DrivenEffect):
    """The rate of the driver, in its unit per second.

    Live it is the rate behind a first-order filter of `smoothing_s`; over a whole run, a difference of
    means on both sides, which has no delay.
    """

    kind: Literal["temperature_rate"] = "temperature_rate"
    operator = "rate"
    suspected_by = ("temperature rate",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "temperature_curve": "a second ramp at another rate, or downwards"
    }
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

    def columns(self, drive: Drive) -> FloatArray:
        """Return the mean over the next two filter times less that over the last two, by their distance.

        Of another driver, whose rate may change at any moment, the filter is part of what is looked for.
        """
        if not self.of_temperature:
            return self.advance(Memory(), drive)
        time, values, width = drive.time_s, drive.of(self.driver), 2 * self.smoothing_s
        if len(time) < 2:
            return np.zeros((len(time), 1))
        steps = np.diff(time)
        middle = 0.5 * (values[1:] + values[:-1])
        integral = np.concatenate([[0.0], np.cumsum(middle * steps)])
        low, high = np.clip(time - width, time[0], time[-1]), np.clip(time + width, time[0], time[-1])
        at_low, at_high = np.interp(low, time, integral), np.interp(high, time, integral)
        before, after = np.maximum(time - low, 0.0), np.maximum(high - time, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean_before = np.where(before > 0, (integral - at_low) / before, values)
            mean_after = np.where(after > 0, (at_high - integral) / after, values)
        return np.asarray((mean_after - mean_before) / (0.5 * (before + after)))[:, np.newaxis]
