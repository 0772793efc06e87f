"""A bias that depends on the side from which a temperature was reached, however long ago."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Memory, NotNegative, Positive, Survey, logarithmic
from imumon.effects.follower import Follower, sums_of

NARROWEST_DEGC = 0.3
WIDEST_DEGC = 14.0
RATIO = 1.35
SLACK_DEGC = 0.15
"""Way of the thermometer that its noise and its steps make up."""


class Hysteresis(Follower):
    """What follows is dragged along with a backlash of this half width, or in a smooth loop (Dahl's).

    Sums of several widths make any loop (Prandtl and Ishlinskii); the powers let its width change with
    temperature.  A smooth loop goes behind a backlash of half width `slack_degc`, so that the noise of a
    thermometer moves nothing.
    """

    kind: Literal["hysteresis"] = "hysteresis"
    nonlinear = ("half_width_degc",)
    free_start = "alone"
    suspected_by = ("temperature", "temperature rate")
    separated_by: ClassVar[Mapping[str, str]] = {
        "temperature_rate": "two ramp rates: a loop does not care, a rate effect doubles",
        "temperature_curve": "a turn of the temperature inside the range",
        "warm_up": "power-on in equilibrium with the ambient temperature held",
        "drift": "a second ramp in the other direction",
    }
    half_width_degc: Positive
    shape: Literal["play", "smooth"] = "play"
    slack_degc: NotNegative = SLACK_DEGC

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return widths up to half the span."""
        widths = logarithmic(NARROWEST_DEGC, min(WIDEST_DEGC, survey.span_degc / 2), RATIO)
        shapes: tuple[Literal["play", "smooth"], ...] = ("play", "smooth")
        return [
            cls(half_width_degc=width, shape=shape, **form)
            for form in cls.forms(survey)
            for shape in shapes
            for width in widths
        ]

    @classmethod
    def sums(cls, grid: Sequence[Self]) -> list[tuple[Self, ...]]:
        """Return sums of two and three backlashes, and of two smooth loops."""
        plays, smooth = (
            [loop for loop in grid if loop.order == 1 and loop.shape == shape] for shape in ("play", "smooth")
        )
        return [*sums_of(plays, (2, 3)), *sums_of(smooth, (2,))]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the temperature that is dragged along."""
        from imumon.effects.operators import play, smooth_loop

        temperature = drive.temperature_degc
        if not len(temperature):
            return temperature
        if self.shape == "play":
            dragged = play(temperature, self.half_width_degc, memory.follower_degc)
            memory.follower_degc = dragged[-1]
            return dragged
        steady = play(temperature, self.slack_degc, memory.temperature_degc)
        ahead = smooth_loop(steady, self.half_width_degc, memory.temperature_degc, memory.ahead_degc)
        memory.temperature_degc, memory.ahead_degc = steady[-1], ahead[-1]
        return np.asarray(temperature - ahead)

    def starts(self, temperature_degc: float) -> tuple[Memory, Memory]:
        """Return the ends between which a loop can be."""
        low, high = (
            Memory(
                temperature_degc=temperature_degc, follower_degc=temperature_degc - ahead, ahead_degc=ahead
            )
            for ahead in (-self.half_width_degc, self.half_width_degc)
        )
        return low, high

    @property
    def start_sd(self) -> float:
        """Somewhere between two ends, nobody knows where: that over the root of three."""
        return 1.0 / float(np.sqrt(3.0))
