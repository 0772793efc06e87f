"""Temperatures: what the chamber does, what the sensors have of it, and what the thermometers say."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.simulation.unit.filters import Lag
from imumon.simulation.unit.noise import White, generator
from imumon.simulation.unit.parameters import SelfHeating, Thermometer
from imumon.simulation.unit.scenario import Chamber


def chamber_knots(chamber: Chamber) -> tuple[FloatArray, FloatArray]:
    """Return times (s) and temperatures (°C) of the corners of a chamber's profile, both of shape (k,)."""
    times, temperatures = [0.0], [chamber.start_degc]
    for step in chamber.steps:
        if step.to_degc is not None and step.rate_degc_per_min is not None:
            times.append(times[-1] + abs(step.to_degc - temperatures[-1]) / step.rate_degc_per_min * 60.0)
            temperatures.append(step.to_degc)
        if step.hold_s:
            times.append(times[-1] + step.hold_s)
            temperatures.append(temperatures[-1])
    return np.array(times), np.array(temperatures)


def chamber_temperature(chamber: Chamber, time_s: FloatArray) -> FloatArray:
    """Return the temperature (°C) around the unit at each time since power-on (s), (n,)."""
    value = np.interp(time_s, *chamber_knots(chamber))
    if chamber.wobble is not None:
        value = value + chamber.wobble.amplitude_degc * np.sin(2 * np.pi / chamber.wobble.period_s * time_s)
    return np.asarray(value)


class SensorTemperature:
    """True temperature of each gyro: the chamber's through the unit's lag, plus its own heat."""

    def __init__(self, chamber: Chamber, heating: SelfHeating | None, step_s: float) -> None:
        self._chamber, self._heating = chamber, heating
        self._lag = Lag([chamber.lag_s], step_s, np.array([chamber.start_degc]))
        self.start_degc: FloatArray = np.full(3, chamber.start_degc)
        """At power-on, (3,)."""

    def process(self, time_s: FloatArray) -> FloatArray:
        """Return the temperatures (°C) at the next times (s), (n, 3)."""
        around = self._lag.process(chamber_temperature(self._chamber, time_s)[:, np.newaxis])
        if self._heating is None:
            return np.repeat(around, 3, axis=1)
        grown = -np.expm1(-time_s / self._heating.tau_s)
        return np.asarray(around + np.outer(grown, self._heating.rise_degc))


class Thermometers:
    """Readings of the thermometers: noise, quantization, and held between readings.

    Parameters
    ----------
    parameters : Thermometer
    count : int
        Number of thermometers k.
    rate_hz : float
        Packets per second; a reading is held for a whole number of packets.
    seed : int
    """

    def __init__(self, parameters: Thermometer, count: int, rate_hz: float, seed: int) -> None:
        self._step = parameters.step_degc
        self._noise = White([parameters.noise_degc] * count, generator(seed, "thermometer"))
        self._packets = max(round(rate_hz / parameters.rate_hz), 1) if parameters.rate_hz else 1
        self._held: FloatArray = np.full((1, count), np.nan)

    def process(self, first: int, true_degc: FloatArray) -> FloatArray:
        """Return the readings in °C of the next samples, (n, k), from index `first` on."""
        n = len(true_degc)
        fresh = np.arange(-first % self._packets, n, self._packets)
        readings = true_degc[fresh] + self._noise.take(len(fresh))
        if self._step:
            readings = np.rint(readings / self._step) * self._step
        readings = np.vstack([self._held, readings])  # row 0 is the reading before the first fresh one
        self._held = readings[-1:]
        before = -(-first // self._packets) - 1
        return np.asarray(readings[np.arange(first, first + n) // self._packets - before])
