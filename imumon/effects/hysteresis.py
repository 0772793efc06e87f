"""The bias remembers from which side a temperature was reached, however long ago."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey, logarithmic
from imumon.effects.operators import play, smooth_loop

NARROWEST_DEGC = 0.3
WIDEST_DEGC = 14.0
RATIO = 1.35
SLACK_DEGC = 0.15
"""Travel of the thermometer that its noise and its steps make up."""


class Hysteresis(Effect):
    """Distance of the temperature from a backlash of this half width, or a smooth loop of this width.

    Sums of several widths make any loop (Prandtl and Ishlinskii); the smooth one is Dahl's.
    """

    name: ClassVar[str] = "hysteresis"
    kind: Literal["hysteresis"] = "hysteresis"
    state_size: ClassVar[int] = 2
    free_start: ClassVar[bool] = True
    nonlinear: ClassVar[tuple[str, ...]] = ("half_width_degc",)
    half_width_degc: float
    shape: Literal["play", "smooth"] = "play"

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return widths up to half the span; none where the temperature never turns and there is one run
        only."""
        if not survey.thermal:
            return []
        widths = logarithmic(NARROWEST_DEGC, min(WIDEST_DEGC, survey.span_degc / 2), RATIO)
        shapes: tuple[Literal["play", "smooth"], ...] = ("play", "smooth")
        return [cls(half_width_degc=width, shape=shape) for shape in shapes for width in widths]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:
        """Return how far the temperature is ahead of what it drags along."""
        temperature = drive.temperature_degc
        if self.shape == "smooth":
            return smooth_loop(state, temperature, self.half_width_degc, SLACK_DEGC)[:, np.newaxis]
        return (temperature - play(state[:1], temperature, self.half_width_degc))[:, np.newaxis]

    def start_columns(self, drive: Drive) -> FloatArray:
        """Return half the difference between the two extreme states at power-on."""
        if not len(drive):
            return np.empty((0, 1))
        low, high = (self._from(drive, sign) for sign in (-1.0, 1.0))
        return np.asarray(0.5 * (high - low))

    def settled(self, drive: Drive) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Tell whether both extreme states at power-on have met."""
        apart = np.abs(self.start_columns(drive)[:, 0])
        return np.asarray(apart < 0.1 * self.half_width_degc)

    def _from(self, drive: Drive, sign: float) -> FloatArray:
        state = np.array([drive.temperature_degc[0] - sign * self.half_width_degc, np.nan])
        if self.shape == "smooth":
            state = np.array([sign * self.half_width_degc, drive.temperature_degc[0]])
        return self.advance(state, drive)
