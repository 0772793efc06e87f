"""Temperatures: what the chamber does, what the sensors have of it, and what the thermometers read."""

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Memory
from imumon.effects.thermal_lag import ThermalLag

from .noise import White, generator
from .parameters import NONE, SelfHeating, Thermometer
from .scenario import Chamber, Scenario


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
    return value


class Lags:
    """Temperatures behind first-order lags, from equilibrium at power-on; a time constant of 0 is none."""

    def __init__(self, time_constants_s: Sequence[float]) -> None:
        self._lags = {
            at: (ThermalLag(time_constant_s=tau, middle=0.0, half_span=1.0), Memory())
            for at, tau in enumerate(time_constants_s)
            if tau
        }

    def process(self, time_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """Return the lagging temperatures at the next times (n,); both of shape (n, k)."""
        out = temperature_degc.copy()
        for at, (lag, memory) in self._lags.items():
            out[:, at] = lag.follow(memory, Drive(time_s, temperature_degc[:, at].copy()))
        return out


class SensorTemperature:
    """True temperature of each gyro: the chamber's through the unit's lag, plus its own heat."""

    def __init__(self, chamber: Chamber, heating: SelfHeating | None) -> None:
        self._chamber, self._lag = chamber, Lags([chamber.lag_s])
        self._heating = heating or SelfHeating(rise_degc=NONE, tau_s=1.0)

    def process(self, time_s: FloatArray) -> FloatArray:
        """Return the temperatures (°C) at the next times (s), (n, 3)."""
        around = self._lag.process(time_s, chamber_temperature(self._chamber, time_s)[:, None])
        rise = np.array(self._heating.rise_degc)
        decay = np.exp(-time_s / self._heating.tau_s)[:, None]
        return np.asarray(around + (rise - rise * decay))


class Thermometers:
    """Readings of k thermometers: noise, quantization, and held between readings.

    `rate_hz` are packets per second; a reading is held for a whole number of packets.
    """

    def __init__(
        self, parameters: Thermometer, count: int, rate_hz: float, seed: int, name: str = "thermometer"
    ) -> None:
        self._step = parameters.step_degc
        self._noise = White([parameters.noise_degc] * count, generator(seed, name))
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
        return readings[np.arange(first, first + n) // self._packets - before]


def chamber_log(scenario: Scenario, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return times since power-on (s), (n,), and what the log reads of wall and case (°C), (n, 2).

    The case has the temperature of the unit without its own heat.
    """
    chamber, log = scenario.chamber, scenario.chamber.log
    assert log is not None
    time_s = np.arange(0.0, scenario.duration_s, log.interval_s)
    wall = np.tile(chamber_temperature(chamber, time_s)[:, None], 2)
    true = Lags([0.0, chamber.lag_s]).process(time_s, wall)
    sensors = Thermometers(log.thermometer, 2, 1.0 / log.interval_s, seed, "chamber log")
    return time_s, sensors.process(0, true)
