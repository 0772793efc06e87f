"""The default method on the samples of one thermometer."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.estimation.temperature_rate.bank import SLOT_S, WHITE_SIGMAS
from imumon.estimation.temperature_rate.filter import State, extrapolate, step
from imumon.estimation.temperature_rate.readings import SLOT_NS, Readings
from imumon.filters.rates import RateEstimate


class LevelBankRate:
    """Temperature and rate of one thermometer by a bank of filters that hears what a level says by staying.

    Raises ValueError when the step is not positive.

    Parameters
    ----------
    step_degc : float, optional
        Quantization step in °C, if it is known; it is found from the readings in any case.
    """

    def __init__(self, step_degc: float | None = None) -> None:
        _compile()
        self.state = State.new(step_degc)
        self._readings = Readings()
        self._origin = (0, NO_INT)
        self._before = np.nan

    @property
    def step(self) -> float | None:
        """The step in °C that the readings show, None as long as they do not."""
        return self.state.sensor.finder.step

    @property
    def refuses(self) -> bool:
        """Whether the readings contradict every model of the sensor's noise, and are given themselves."""
        return self.state.refuses

    @property
    def stuck(self) -> float | None:
        """Where readings stuck last after a leap that no temperature makes, °C; None if they never did."""
        at = self.state.stuck_at
        return at if np.isfinite(at) else None

    @property
    def noise(self) -> float:
        """Standard deviation in °C of white noise before quantization, as the bank weighs the level kinds."""
        bank = self.state.bank
        if bank is None:
            return float("nan")
        weight = bank.kinds[: len(WHITE_SIGMAS)]
        return float(weight @ WHITE_SIGMAS / weight.sum() * self.state.sensor.step)

    @property
    def _late_s(self) -> float:
        """Age of what is shown from which on readings are missing; a slot may be on its way."""
        return SLOT_S + self.state.late_s

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts anew but keeps what is known of
            the sensor.
        reading : array, (n,)
            °C; NaN where there is none.
        """
        sensor, result = self.state.sensor, RateEstimate.empty(len(reading))
        parts = (result.temperature, result.rate, result.temperature_sd, result.rate_sd)
        first, holds = 0, (self.state.given, self._origin, sensor.scatter, self._late_s)

        def hold(until: int | None = None) -> None:
            """Write what has been given so far to the rows until the next slot's."""
            rows = slice(first, until)
            before = float(reading[first - 1]) if first else self._before
            into = (part[rows] for part in parts)
            extrapolate(time_ns[rows], segment[rows], reading[rows], *holds, before, *into)

        for row, begins, slot in self._readings.process(time_ns, segment, reading):
            hold(row)
            if begins:
                self.state.begin()
            self._origin = (self._readings.origin_ns, self._readings.segment)
            first, holds = row, (step(self.state, slot), self._origin, sensor.scatter, self._late_s)
        hold()
        self._before = float(reading[-1]) if len(reading) else self._before
        return result


@lru_cache(maxsize=1)
def _compile() -> None:
    """Compile what the first slots need, so that no packet waits for it."""
    state, slots = State.new(None), Readings()
    time_ns = np.arange(8) * SLOT_NS
    for _, _, slot in slots.process(time_ns, np.zeros(8, np.int64), np.zeros(8)):
        shown = step(state, slot)
    extrapolate(time_ns[:0], time_ns[:0], np.zeros(0), shown, (0, 0), 0.0, 0.0, np.nan, *np.zeros((4, 0)))
