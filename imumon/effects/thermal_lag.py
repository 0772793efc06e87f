"""The sensor's own temperature follows the thermometer's late: behind a lag, or a fixed time later."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import BoolArray, FloatArray
from imumon.effects.base import RATIO, Drive, Memory, NotNegative, Positive, Survey, logarithmic
from imumon.effects.follower import SHORTEST_S, Follower

UNTOLD_S = 30.0
"""sd of a gyro's lag behind the thermometer: half of the lag that means of 30 s separate from a rate."""
SPACING_S = 0.25
"""One temperature is remembered of each such interval; the temperature of a unit is straight in between."""
START_SD_DEGC = 1.0
"""How far from equilibrium a unit is at power-on, where nothing better is known (standard deviation)."""


class ThermalLag(Follower):
    """What follows is the driver behind a first-order lag.

    `start_sd` is how far what follows (the sensor's temperature) may be from its driver (the thermometer's)
    at power-on.
    """

    kind: Literal["thermal_lag"] = "thermal_lag"
    operator = "lag"
    nonlinear = ("time_constant_s",)
    free_start = True
    suspected_by = ("temperature rate",)
    time_constant_s: Positive
    start_sd: NotNegative = START_SD_DEGC

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a quarter of the shortest run."""
        times = logarithmic(SHORTEST_S, survey.shortest_s / 4)
        return [cls(time_constant_s=tau, **form) for form in cls.forms(survey) for tau in times]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return time constants up to a quarter of the shortest run; power-on finds it in equilibrium."""
        scale = asdict(survey.others[driver])
        times = logarithmic(SHORTEST_S, survey.shortest_s / 4, RATIO**2)
        return [cls(driver=driver, time_constant_s=tau, start_sd=0.0, **scale) for tau in times]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the lagged driver."""
        from imumon.effects.operators import first_order

        time, values = drive.time_s, drive.of(self.driver)
        before = memory.time_s, memory.driver, memory.follower
        lagged = first_order(time, values, self.time_constant_s, *before)
        if len(lagged):
            memory.time_s, memory.driver, memory.follower = time[-1], values[-1], lagged[-1]
        return lagged

    def starts(self, drive: Drive) -> tuple[Memory, Memory]:
        """Return a sensor colder and one warmer than its thermometer by the standard deviation."""
        first = float(drive.of(self.driver)[0])
        low, high = (first + sign * self.start_sd for sign in (-1.0, 1.0))
        return Memory(0.0, first, low), Memory(0.0, first, high)

    def with_start(self, start: FloatArray) -> Self:
        """Return it with the rms of the starts in the training runs as `start_sd`."""
        if not start.size or not self.coefficients[0]:
            return self
        rms = float(np.sqrt(np.mean(start**2))) * self.start_sd / abs(self.coefficients[0])
        return self.model_copy(update={"start_sd": max(START_SD_DEGC, rms)})


class DeadTime(Follower):
    """The bias follows the temperature of a while ago: a pure delay, as heat takes through a housing.

    Before power-on the temperature is taken for that of the first sample.
    """

    kind: Literal["dead_time"] = "dead_time"
    operator = "delay"
    nonlinear = ("delay_s",)
    suspected_by = ("temperature rate",)
    delay_s: Annotated[FiniteFloat, Field(ge=SPACING_S)]

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return delays up to an eighth of the shortest run."""
        delays = logarithmic(SHORTEST_S, survey.shortest_s / 8)
        return [cls(delay_s=delay, **form) for form in cls.forms(survey) for delay in delays]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the delayed temperature, between those remembered on a straight line."""
        time, values = drive.time_s, drive.of(self.driver)
        if not len(time):
            return values
        interval = np.floor(np.concatenate([[memory.time_s], time]) / SPACING_S)
        new = np.column_stack([time, values])[~(interval[1:] <= interval[:-1])]
        past = np.concatenate([memory.past, new])
        needed = np.searchsorted(past[:, 0], time[-1] - self.delay_s, side="right") - 1
        memory.time_s, memory.past = time[-1], past[max(needed, 0) :]
        return np.asarray(np.interp(time - self.delay_s, past[:, 0], past[:, 1]))

    def settled(self, drive: Drive) -> BoolArray:
        """Return whether the delay has passed: what was before power-on, nobody knows."""
        return np.asarray(drive.time_s > self.delay_s)
