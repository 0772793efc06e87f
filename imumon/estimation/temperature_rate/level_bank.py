"""The default method on the samples of one thermometer."""

from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.estimation.temperature_rate.bank import START_RATE, WHITE_SIGMAS
from imumon.estimation.temperature_rate.filter import State, extrapolated, step
from imumon.estimation.temperature_rate.readings import Readings
from imumon.estimation.temperature_rate.series import RateEstimate


class LevelBankRate:
    """Temperature and rate of one thermometer by a bank of filters that hears what a level says by staying.

    Parameters
    ----------
    step_degc : float, optional
        Quantization step in °C, if it is known; it is found from the readings in any case.

    Raises
    ------
    ValueError
        When the step is not positive.
    """

    def __init__(self, step_degc: float | None = None) -> None:
        self.state = State.new(step_degc)
        self._readings = Readings()
        self._origin = (0, NO_INT)

    @property
    def step(self) -> float | None:
        """The step in °C that the readings show, None as long as they do not."""
        return self.state.sensor.finder.step

    @property
    def refuses(self) -> bool:
        """Whether the readings contradict every model of the sensor's noise, and are given themselves."""
        return self.state.refuses

    @property
    def noise(self) -> float:
        """Standard deviation in °C of white noise before quantization, as the bank weighs the level kinds."""
        bank = self.state.bank
        if bank is None:
            return float("nan")
        weight = bank.weight.sum(0)[: len(WHITE_SIGMAS)]
        return float(weight @ WHITE_SIGMAS / weight.sum() * self.state.sensor.step)

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
        sensor = self.state.sensor
        rows, shown, origins, scatter = [], [self.state.given], [self._origin], [sensor.scatter]
        for row, begins, slot in self._readings.process(time_ns, segment, reading):
            if begins:
                self.state.begin()
            rows.append(row)
            shown.append(step(self.state, slot))
            origins.append((self._readings.origin_ns, self._readings.segment))
            scatter.append(sensor.scatter)
        self._origin = origins[-1]
        which = np.searchsorted(np.array(rows, np.int64), np.arange(len(reading)), side="right")
        each, origin = np.array(shown)[which], np.array(origins, np.int64)[which]
        seconds = np.asarray((time_ns - origin[:, 0]) * 1e-9, np.float64)
        parts = extrapolated(each, seconds)
        # Before the first slot of a segment ends there is the reading.
        fresh = (segment != origin[:, 1]) | (seconds < each[:, 0])
        known = np.where(np.isfinite(reading), 1.0, np.nan)
        raw = (reading, 0.0 * known, np.array(scatter)[which] * known, START_RATE * known)
        return RateEstimate(*(np.where(fresh, own, part) for own, part in zip(raw, parts, strict=True)))
