"""A bias proportional to the rate of the temperature, or of another driver."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, DrivenEffect, Memory, Positive, Survey
from imumon.effects.thermal_lag import ThermalLag

FILTERS_S = (5.0, 15.0, 45.0)
"""Of the rate of another driver."""


class TemperatureRate(DrivenEffect):
    """The rate of the driver behind a first-order filter of `smoothing_s`, in its unit per second.

    Over a whole run that of the temperature has no delay: it is a difference of means on both sides.
    """

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

    def columns(self, drive: Drive) -> FloatArray:
        """Return the mean over the next two filter times less that over the last two, by their distance.

        Of another driver, whose rate may change at any moment, the filter is part of the effect.
        """
        if not self.of_temperature or len(drive) < 2:
            return self.advance(Memory(), drive)
        time, values, width = drive.time_s, drive.of(self.driver), 2.0 * self.smoothing_s
        area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
        low, high = (np.clip(time + ahead, time[0], time[-1]) for ahead in (-width, width))
        before, after = time - low, high - time
        earlier = _mean(area - np.interp(low, time, area), before, values)
        later = _mean(np.interp(high, time, area) - area, after, values)
        return np.asarray((later - earlier) / (0.5 * (before + after)))[:, np.newaxis]


def _mean(area: FloatArray, length: FloatArray, otherwise: FloatArray) -> FloatArray:
    return np.divide(area, length, out=otherwise.copy(), where=length > 0)
