"""The sensor's own temperature follows the thermometer's with a delay."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, NotNegative, Positive, Survey, logarithmic

SHORTEST_S = 20.0
LONGEST_S = 1500.0
RATIO = 1.3
SETTLING = 3.0
"""Time constants until the state at power-on is forgotten."""
START_SD_DEGC = 1.0
"""How far from equilibrium a unit is at power-on, where nothing better is known (standard deviation)."""


class ThermalLag(Effect):
    """Differences u^k - l^k, k = 1 .. order; l is u behind a first-order lag, u = (T - middle) / half
    span.

    `start_sd_degc` is how far the sensor's temperature may be from the thermometer's at power-on.
    """

    name: ClassVar[str] = "thermal_lag"
    kind: Literal["thermal_lag"] = "thermal_lag"
    state_size: ClassVar[int] = 3
    free_start: ClassVar[bool] = True
    nonlinear: ClassVar[tuple[str, ...]] = ("time_constant_s",)
    time_constant_s: Positive
    order: Annotated[int, Field(ge=1, le=9)] = 1
    middle_degc: FiniteFloat
    half_span_degc: Positive
    start_sd_degc: NotNegative = START_SD_DEGC

    @property
    def width(self) -> int:
        """One for each power."""
        return self.order

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a quarter of the shortest run; the cubic only where two runs can show
        it."""
        if not survey.thermal:
            return []
        times = logarithmic(SHORTEST_S, min(LONGEST_S, survey.shortest_s / 4), RATIO)
        orders = (1, 3) if survey.runs > 1 or survey.reversals >= 4 else (1,)
        middle, half = survey.middle_degc, survey.half_span_degc
        return [
            cls(time_constant_s=tau, order=order, middle_degc=middle, half_span_degc=half)
            for order in orders
            for tau in times
        ]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:
        """Return the differences of powers, now less lagged."""
        from imumon.effects.operators import first_order

        lagged = first_order(state, drive.time_s, drive.temperature_degc, self.time_constant_s)
        now, then = self._scaled(drive.temperature_degc), self._scaled(lagged)
        powers = np.arange(1, self.order + 1)
        return np.asarray(now[:, np.newaxis] ** powers - then[:, np.newaxis] ** powers)

    def extremes(self, temperature_degc: float) -> tuple[FloatArray, FloatArray]:
        """Return a sensor colder and one warmer by the standard deviation."""
        low, high = (temperature_degc + sign * self.start_sd_degc for sign in (-1.0, 1.0))
        return np.array([low, 0.0, temperature_degc]), np.array([high, 0.0, temperature_degc])

    def start_columns(self, drive: Drive) -> FloatArray:
        """Return the decay of a lagged temperature that was off at power-on."""
        return np.exp(-drive.time_s / self.time_constant_s)[:, np.newaxis]

    def settled(self, drive: Drive) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Tell whether three time constants have passed."""
        return np.asarray(drive.time_s > SETTLING * self.time_constant_s)

    def _scaled(self, temperature: FloatArray) -> FloatArray:
        return (temperature - self.middle_degc) / self.half_span_degc
