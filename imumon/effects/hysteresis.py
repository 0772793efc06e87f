"""The bias remembers from which side a temperature was reached, however long ago."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Positive, Survey, logarithmic

NARROWEST_DEGC = 0.3
WIDEST_DEGC = 14.0
RATIO = 1.35
SLACK_DEGC = 0.15
"""Travel of the thermometer that its noise and its steps make up."""


class Hysteresis(Effect):
    """Differences u^k - p^k, k = 1 .. order: u the temperature, p what it drags along, both scaled.

    p follows with a backlash of this half width, or with a smooth loop (Dahl's).  Sums of several widths make
    any loop (Prandtl and Ishlinskii); the powers let its width change with temperature.
    """

    name: ClassVar[str] = "hysteresis"
    kind: Literal["hysteresis"] = "hysteresis"
    state_size: ClassVar[int] = 2
    free_start: ClassVar[bool] = True
    nonlinear: ClassVar[tuple[str, ...]] = ("half_width_degc",)
    half_width_degc: Positive
    shape: Literal["play", "smooth"] = "play"
    order: Annotated[int, Field(ge=1, le=9)] = 1
    middle_degc: FiniteFloat
    half_span_degc: Positive

    @property
    def width(self) -> int:
        """One for each power."""
        return self.order

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return widths up to half the span; powers only where two runs can show them."""
        if not survey.thermal:
            return []
        widths = logarithmic(NARROWEST_DEGC, min(WIDEST_DEGC, survey.span_degc / 2), RATIO)
        shapes: tuple[Literal["play", "smooth"], ...] = ("play", "smooth")
        orders = (1, 3) if survey.runs > 1 or survey.reversals >= 4 else (1,)
        middle, half = survey.middle_degc, survey.half_span_degc
        return [
            cls(half_width_degc=width, shape=shape, order=order, middle_degc=middle, half_span_degc=half)
            for order in orders
            for shape in shapes
            for width in widths
        ]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:
        """Return the differences of powers, ahead less dragged."""
        from imumon.effects.operators import play, smooth_loop

        temperature = drive.temperature_degc
        if self.shape == "smooth":
            dragged = temperature - smooth_loop(state, temperature, self.half_width_degc, SLACK_DEGC)
        else:
            dragged = play(state[:1], temperature, self.half_width_degc)
        powers = np.arange(1, self.order + 1)
        ahead, behind = (
            (values - self.middle_degc) / self.half_span_degc for values in (temperature, dragged)
        )
        return np.asarray(ahead[:, np.newaxis] ** powers - behind[:, np.newaxis] ** powers)

    def start_columns(self, drive: Drive) -> FloatArray:
        """Return half the difference between the two extreme states at power-on."""
        if not len(drive):
            return np.empty((0, 1))
        low, high = (self._from(drive, sign) for sign in (-1.0, 1.0))
        return np.asarray(0.5 * (high - low)[:, :1])

    def settled(self, drive: Drive) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Tell whether both extreme states at power-on have met."""
        apart = np.abs(self.start_columns(drive)[:, 0])
        return np.asarray(apart < 0.1 * self.half_width_degc / self.half_span_degc)

    def extremes(self, temperature_degc: float) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest state that a loop can have, drawn in by the root of three.

        What is somewhere between two ends, nobody knows where, has that standard deviation.
        """
        share = self.half_width_degc / np.sqrt(3.0)
        low, high = (self._state(temperature_degc, sign * share) for sign in (-1.0, 1.0))
        return low, high

    def _state(self, temperature: float, ahead: float) -> FloatArray:
        """Return the state with the temperature so far ahead of what it drags."""
        if self.shape == "smooth":
            return np.array([ahead, temperature])
        return np.array([temperature - ahead, np.nan])

    def _from(self, drive: Drive, sign: float) -> FloatArray:
        return self.advance(self._state(float(drive.temperature_degc[0]), sign * self.half_width_degc), drive)
