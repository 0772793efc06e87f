"""A bias that depends on the side from which a temperature was reached, however long ago."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal, Self, get_args

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Memory, NotNegative, Positive, Survey, logarithmic
from imumon.effects.follower import Follower

SHARES = (0.05, 0.1, 0.2, 0.4)
"""Half widths of a loop of another driver, of its span."""
SLACK_DEGC = 0.15
"""Way of the thermometer that its noise and its steps make up."""

Shape = Literal["play", "smooth"]


class Hysteresis(Follower):
    """What follows is dragged along with a backlash of this half width, or in a smooth loop (Dahl's).

    The powers let its width change with temperature.  A smooth loop goes behind a backlash of half width
    `slack`, so that the noise of a thermometer moves nothing.
    """

    kind: Literal["hysteresis"] = "hysteresis"
    operator = "loop"
    nonlinear = ("half_width",)
    start_share = 3.0**-0.5  # equally likely anywhere between its ends
    suspected_by = ("temperature", "temperature rate")
    half_width: Positive
    shape: Shape = "play"
    slack: NotNegative = SLACK_DEGC

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return widths from twice the slack up to half the span."""
        return [
            cls(half_width=width, shape=shape, **form)
            for form in cls.forms(survey)
            for shape in get_args(Shape)
            for width in logarithmic(2 * SLACK_DEGC, survey.span_degc / 2)
        ]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return backlashes of a tenth to four fifths of the span."""
        scale = asdict(survey.others[driver])
        widths = [share * 2 * scale["half_span"] for share in SHARES]
        return [cls(driver=driver, half_width=width, slack=0.0, **scale) for width in widths]

    @classmethod
    def of_curve(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - whatever the runs can show
        """Return none: a loop of the third order bends as well."""
        return []

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return what is dragged along."""
        from imumon.effects.operators import play, smooth_loop

        values = drive.of(self.driver)
        if not len(values):
            return values
        if self.shape == "play":
            dragged = play(values, self.half_width, memory.follower)
            memory.follower = dragged[-1]
            return dragged
        steady = play(values, self.slack, memory.driver)
        ahead = smooth_loop(steady, self.half_width, memory.driver, memory.ahead)
        memory.driver, memory.ahead = steady[-1], ahead[-1]
        return np.asarray(values - ahead)

    def starts(self, drive: Drive) -> tuple[Memory, Memory]:
        """Return the ends between which a loop can be."""
        first = float(drive.of(self.driver)[0])
        low = Memory(driver=first, follower=first + self.half_width, ahead=-self.half_width)
        return low, Memory(driver=first, follower=first - self.half_width, ahead=self.half_width)
