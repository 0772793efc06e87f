"""The sensor has the thermometer's temperature a fixed time later."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import BoolArray, FloatArray
from imumon.effects.base import Drive, Memory, Survey, logarithmic
from imumon.effects.follower import SHORTEST_S, Follower

SPACING_S = 0.25
"""One temperature is remembered of each such interval; the temperature of a unit is straight in between."""


class DeadTime(Follower):
    """The bias follows the temperature of a while ago: a pure delay, as heat takes through a housing.

    Before power-on the temperature is taken for that of the first sample.
    """

    kind: Literal["dead_time"] = "dead_time"
    operator = "delay"
    nonlinear = ("delay_s",)
    suspected_by = ("temperature rate",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "temperature_rate": "a fast ramp into a soak: the delay goes on for its time",
        "thermal_lag": "a fast ramp into a soak: a lag bends at once and slowly, a delay later and at once",
        "hysteresis": "two ramp rates: a loop does not care, a delay doubles",
        "temperature_curve": "a second ramp at another rate, or downwards",
    }
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
