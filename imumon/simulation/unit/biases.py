"""Total biases of the sensors: what is in a signal besides motion, gravity, earth rate and white noise."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.simulation.unit.curves import axis_values
from imumon.simulation.unit.filters import Lag
from imumon.simulation.unit.hysteresis import HysteresisLoop
from imumon.simulation.unit.noise import GaussMarkov, RandomWalk, White, generator
from imumon.simulation.unit.parameters import UnitParameters

"""rad/s."""
MG = 1e3 * MICRO_G
"""m/s²."""


class GyroBias:
    """Bias of each gyro: curve over its temperature, loop, turn-on, bias instability and random walk.

    Parameters
    ----------
    unit : UnitParameters
    start_degc : array of shape (3,)
        Temperature of each gyro at power-on.
    step_s : float
        Time between samples.
    seed : int
    """

    def __init__(self, unit: UnitParameters, start_degc: FloatArray, step_s: float, seed: int) -> None:
        self._curves = unit.gyro_bias_deg_per_s
        self._lag = Lag(unit.gyro_lag_s, step_s, start_degc)
        self._loop: HysteresisLoop | None = None
        if unit.gyro_hysteresis is not None:
            self._loop = HysteresisLoop(unit.gyro_hysteresis, start_degc)
            self._half_width = np.array(unit.gyro_hysteresis.half_width_deg_per_h) * DEG_PER_H
        turn_on, noise = unit.gyro_turn_on, unit.gyro_noise
        drawn = White(turn_on.sd_deg_per_h, generator(seed, "gyro turn-on")).take(1)[0]
        self._constant = (turn_on.offset_deg_per_h + drawn) * DEG_PER_H
        self._drifts: list[GaussMarkov | RandomWalk] = []
        for i, part in enumerate(noise.flicker):
            sd = np.array(part.sd_deg_per_h) * DEG_PER_H
            self._drifts.append(GaussMarkov(sd, part.tau_s, step_s, generator(seed, f"gyro flicker {i}")))
        walk = np.array(noise.random_walk_deg_per_h_per_sqrt_s) * DEG_PER_H
        self._drifts.append(RandomWalk(walk, step_s, generator(seed, "gyro random walk")))

    def process(self, temperature_degc: FloatArray) -> FloatArray:
        """Return the biases in rad/s at the next temperatures; both of shape (n, 3)."""
        inside = self._lag.process(temperature_degc)
        bias = np.deg2rad(axis_values(self._curves, inside)) + self._constant
        if self._loop is not None:
            bias += self._half_width * self._loop.process(inside)
        for drift in self._drifts:
            bias += drift.take(len(inside))
        return np.asarray(bias)


class AccelBias:
    """Bias of each accelerometer: curve over temperature, turn-on, warm-up and bias instability.

    Parameters as of `GyroBias`.
    """

    def __init__(self, unit: UnitParameters, step_s: float, seed: int) -> None:
        self._curves, self._warm_up = unit.accel_bias_mg, unit.accel_warm_up
        drawn = White(unit.accel_turn_on.sd_mg, generator(seed, "accel turn-on")).take(1)[0]
        self._constant = (unit.accel_turn_on.offset_mg + drawn) * MG
        self._drifts = [
            GaussMarkov(
                np.array(part.sd_ug) * MICRO_G, part.tau_s, step_s, generator(seed, f"accel flicker {i}")
            )
            for i, part in enumerate(unit.accel_noise.flicker)
        ]

    def process(self, time_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """Return the biases in m/s² at the next times (n,) and temperatures (n, 3); shape (n, 3)."""
        bias = axis_values(self._curves, temperature_degc) * MG + self._constant
        if self._warm_up is not None:
            grown = -np.expm1(-time_s / self._warm_up.tau_s)
            bias += np.outer(grown, np.array(self._warm_up.amplitude_ug) * MICRO_G)
        for drift in self._drifts:
            bias += drift.take(len(time_s))
        return np.asarray(bias)
