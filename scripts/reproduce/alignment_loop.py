"""The error loop of the fixed-gain alignment: closed forms of Lee et al. beside a simulation in time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G
from imumon.geodesy import STANDARD_GRAVITY as G
from imumon.papers.self_alignment import Loop as State
from imumon.papers.self_alignment import gains, step


@dataclass(frozen=True)
class Loop:
    """Loop and errors: µg and s of the warm-up, deg/h of gyro bias, both on either horizontal axis.

    `vertical` adds the vertical earth rate, which the paper's error model leaves out.
    """

    amplitude_ug: float = 30.0
    tau_s: float = 300.0
    gyro_deg_per_h: float = 0.0
    corner_hz: float = 2.0
    damping: float = 0.7
    latitude_deg: float = 36.0
    rate_hz: float = 200.0
    vertical: bool = False

    @property
    def corner(self) -> float:
        """Corner frequency, rad/s."""
        return 2.0 * math.pi * self.corner_hz

    @property
    def k(self) -> float:
        """Feedback of the velocity, 1/s."""
        return 2.0 * self.damping * self.corner

    @property
    def kb(self) -> float:
        """Control rate per velocity, rad/m."""
        return self.corner**2 / G

    @property
    def level(self) -> float:
        """Ω cos L, rad/s."""
        return EARTH_RATE * math.cos(math.radians(self.latitude_deg))


@dataclass(frozen=True)
class Course:
    """Over time_s (n,): velocities east and north in m/s, tilts about east and north in rad, control rates.

    Velocities are control rates over k_b = corner² / g: the sampled loop has a k_b a little smaller, so that
    its poles are exactly those of the continuous one.  Control rates are in rad/s, less the earth's.
    """

    time_s: FloatArray
    velocity: FloatArray
    tilt: FloatArray
    control: FloatArray

    def at(self, values: FloatArray, second: float) -> float:
        """Return a value at a time."""
        return float(np.interp(second, self.time_s, values))


def simulate(loop: Loop, seconds: float) -> Course:
    """Run the loop of imumon on a unit whose body axes are east, north, up."""
    h, n = 1.0 / loop.rate_hz, round(seconds * loop.rate_hz)
    gain, vertical = gains(loop.corner, loop.damping, h), math.sin(math.radians(loop.latitude_deg))
    earth = np.array([0.0, loop.level, EARTH_RATE * vertical if loop.vertical else 0.0])
    gyro = loop.gyro_deg_per_h * DEG_PER_H
    rate = earth + np.array([gyro, gyro, 0.0])
    force = np.array([0.0, 0.0, G])
    state, rows = State(np.eye(3)), np.empty((n, 6))
    for i in range(n):
        force[:2] = loop.amplitude_ug * MICRO_G * -math.expm1(-(i + 1) * h / loop.tau_s)
        control = step(state, gain, earth, rate, force)
        c = state.attitude
        rows[i] = *state.velocity, -c[1, 2], c[0, 2], *control
    velocity = (gain.kb / loop.kb) * rows[:, :2].T
    return Course(h * np.arange(1, n + 1, dtype=np.float64), velocity, rows[:, 2:4].T, rows[:, 4:].T)


def closed_velocity(loop: Loop, t: FloatArray) -> FloatArray:
    """Return equations 14 and 15, (2, n), without the transient."""
    inverse = 1.0 / loop.tau_s
    warm = loop.amplitude_ug * MICRO_G * inverse / (inverse**2 - loop.k * inverse + loop.kb * G)
    gyro = loop.gyro_deg_per_h * DEG_PER_H / loop.kb
    return np.vstack([warm * np.exp(-t * inverse) + gyro, warm * np.exp(-t * inverse) - gyro])


def closed_tilt(loop: Loop, t: FloatArray) -> FloatArray:
    """Return the size of equations 16 and 17 for the accelerometers alone, (n,), without the transient."""
    inverse = 1.0 / loop.tau_s
    amplitude = loop.kb * loop.amplitude_ug * MICRO_G
    bracket = 1.0 / (loop.kb * G) - np.exp(-t * inverse) / (inverse**2 - loop.k * inverse + loop.kb * G)
    return np.asarray(amplitude * bracket)


def closed_heading(loop: Loop, t: FloatArray) -> FloatArray:
    """Return equation 19, rad, (n,), with the sign of the gyro's bias that follows from equation 15."""
    inverse = 1.0 / loop.tau_s
    factor = loop.kb * loop.amplitude_ug * MICRO_G * inverse / (inverse**2 - loop.k * inverse + loop.kb * G)
    return np.asarray((factor * np.exp(-t * inverse) - loop.gyro_deg_per_h * DEG_PER_H) / loop.level)


def short_heading(loop: Loop, t: FloatArray) -> FloatArray:
    """Return equation 22, rad, (n,)."""
    return np.asarray(loop.amplitude_ug * 1e-6 / (loop.tau_s * loop.level) * np.exp(-t / loop.tau_s))


def comparisons(loop: Loop, seconds: float = 300.0) -> list[tuple[str, float]]:
    """Return what is compared, and the largest difference over the largest value, from 30 s on."""
    quiet = replace(loop, gyro_deg_per_h=0.0)
    course, alone = simulate(loop, seconds), simulate(quiet, seconds)
    late = course.time_s >= 30.0
    t = course.time_s[late]
    east, north = closed_velocity(loop, t)
    rows = [
        ("14: velocity east", course.velocity[0, late], east),
        ("15: velocity north", course.velocity[1, late], north),
        ("16: tilt about east", np.abs(alone.tilt[0, late]), closed_tilt(quiet, t)),
        ("17: tilt about north", np.abs(alone.tilt[1, late]), closed_tilt(quiet, t)),
        ("19: heading", -course.control[0, late] / loop.level, closed_heading(loop, t)),
        ("22: heading, short form", -alone.control[0, late] / loop.level, short_heading(loop, t)),
    ]
    return [(name, float(np.max(np.abs(a - b)) / np.max(np.abs(b)))) for name, a, b in rows]
