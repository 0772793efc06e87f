"""Total biases of the sensors: what is in a signal besides motion, gravity, earth rate and white noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory
from imumon.effects.since_power_on import RunOffset, WarmUp
from imumon.effects.thermal_lag import Hysteresis
from imumon.geodesy import DEG_PER_H, MICRO_G

from .noise import GaussMarkov, RandomWalk, White, generator
from .parameters import Curves, Effects, Polynomial, Term, UnitParameters
from .thermal import Lags

MG = 1e3 * MICRO_G
"""m/s²."""
Random = GaussMarkov | RandomWalk


def curve_value(terms: Sequence[Term], temperature_degc: FloatArray) -> FloatArray:
    """Return the sum of the terms of a curve at each temperature, in their unit; same shape."""
    total = np.zeros_like(temperature_degc)
    for term in terms:
        u = (temperature_degc - term.at_degc) / term.width_degc
        if isinstance(term, Polynomial):
            total += polynomial.polyval(u, term.coefficients)
        else:
            total += term.amplitude * (np.tanh(u) if term.kind == "tanh" else np.sin(u))
    return total


def axis_values(curves: Curves, temperature_degc: FloatArray) -> FloatArray:
    """Return the bias of each axis at its own temperature; both of shape (n, 3)."""
    return np.column_stack(
        [curve_value(getattr(curves, axis), temperature_degc[:, i]) for i, axis in enumerate("xyz")]
    )


@dataclass(eq=False)
class Bias:
    """Bias of the three axes of a sensor: curve over their temperature, effects, and slow random errors."""

    curves: Curves
    scale: float  # curve over temperature, and its unit in SI units
    lags: Lags  # by which the sensors follow the temperature at them
    effects: Sequence[Sequence[Effect]]  # of each axis, in SI units
    random: Sequence[Random]  # in SI units

    def __post_init__(self) -> None:
        self._carried = [[(effect, Memory()) for effect in axis] for axis in self.effects]

    def process(
        self,
        time_s: FloatArray,
        temperature_degc: FloatArray,
        force: FloatArray,
        others: Mapping[str, FloatArray],
    ) -> FloatArray:
        """Return the biases at the next times (n,), temperatures and specific forces in m/s²; each (n, 3).

        `others` are further drivers of effects, (n,) each.
        """
        inside = self.lags.process(time_s, temperature_degc)
        bias = axis_values(self.curves, inside) * self.scale
        for axis, carried in enumerate(self._carried):
            drive = Drive(time_s, np.ascontiguousarray(inside[:, axis]), force, others)
            for effect, memory in carried:
                bias[:, axis] += effect.added(memory, drive)
        for drift in self.random:
            bias += drift.take(len(time_s))
        return bias


def gyro_bias(unit: UnitParameters, step_s: float, seed: int) -> Bias:
    """Return the bias of the gyros in rad/s; `step_s` is the time between samples."""
    turn_on, noise, loop = unit.gyro_turn_on, unit.gyro_noise, unit.gyro_hysteresis
    offset = White(turn_on.sd_deg_per_h, generator(seed, "gyro turn-on")).take(1)[0]
    offset = (turn_on.offset_deg_per_h + offset) * DEG_PER_H
    effects = _scaled(unit.gyro_effects_deg_per_h, DEG_PER_H)
    for axis, added in enumerate(effects):
        added.insert(0, RunOffset(coefficients=[offset[axis]]))
        if loop is not None:
            width, height = loop.width_degc, loop.half_width_deg_per_h[axis] * DEG_PER_H
            added.append(
                Hysteresis(
                    coefficients=[height],
                    half_width=width,
                    shape=loop.kind,
                    slack=0.0,
                    middle=0.0,
                    half_span=width,
                )
            )
    flicker = [(np.array(part.sd_deg_per_h) * DEG_PER_H, part.tau_s) for part in noise.flicker]
    walk = np.array(noise.random_walk_deg_per_h_per_sqrt_s) * DEG_PER_H
    drift = RandomWalk(walk, step_s, generator(seed, "gyro random walk"))
    random = [*_flicker("gyro", flicker, step_s, seed), drift]
    return Bias(unit.gyro_bias_deg_per_s, np.pi / 180, Lags(unit.gyro_lag_s), effects, random)


def accel_bias(unit: UnitParameters, step_s: float, seed: int) -> Bias:
    """Return the bias of the accelerometers in m/s²; `step_s` is the time between samples."""
    turn_on, warm_up = unit.accel_turn_on, unit.accel_warm_up
    offset = White(turn_on.sd_mg, generator(seed, "accel turn-on")).take(1)[0]
    offset = (turn_on.offset_mg + offset) * MG
    effects = _scaled(unit.accel_effects_ug, MICRO_G)
    for axis, added in enumerate(effects):
        if warm_up is not None:
            grown = warm_up.amplitude_ug[axis] * MICRO_G
            offset[axis] += grown
            added.append(WarmUp(time_constant_s=warm_up.tau_s, coefficients=[-grown]))
        added.append(RunOffset(coefficients=[offset[axis]]))
    flicker = [(np.array(part.sd_ug) * MICRO_G, part.tau_s) for part in unit.accel_noise.flicker]
    return Bias(unit.accel_bias_mg, MG, Lags([0.0] * 3), effects, _flicker("accel", flicker, step_s, seed))


def _flicker(
    sensor: str, parts: Sequence[tuple[FloatArray, float]], step_s: float, seed: int
) -> list[Random]:
    """Return the processes of these standard deviations, (3,), and correlation times (s)."""
    return [
        GaussMarkov(sd, tau_s, step_s, generator(seed, f"{sensor} flicker {i}"))
        for i, (sd, tau_s) in enumerate(parts)
    ]


def _scaled(effects: Effects, scale: float) -> list[list[Effect]]:
    """Return the effects of each axis with coefficients in SI units."""
    return [
        [effect.with_coefficients(scale * np.array(effect.coefficients)) for effect in axis]
        for axis in (effects.x, effects.y, effects.z)
    ]
