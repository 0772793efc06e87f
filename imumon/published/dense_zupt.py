"""The textbook filter: 12 error states, mechanization, zero velocity; what the fast one is measured against.

Error states are attitude (phi, true C = (1 + [phi x]) C), velocity, gyro bias and accelerometer bias, closed
loop, in north-east-down.  After Fontanella, Accardo, Schiano Lo Moriello, Angrisani and De Simone, Sensors
2018, 18(5), 1457, sections 2 and 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY, body_to_ned

STATES = 12


@dataclass(frozen=True, slots=True)
class DenseSettings:
    """Noise and start of the filter, SI units.

    Parameters
    ----------
    interval_s : float
        Between samples.
    latitude_deg, heading_deg : float
        Of the place, and of the body's x axis clockwise from north.
    angle_random_walk, velocity_random_walk : float
        rad/sqrt(s) and m/s/sqrt(s).
    bias_random_walk, bias_sd : float
        K in rad/s/sqrt(s), and the standard deviation p0 of the bias at the start, rad/s.
    accel_bias_random_walk, accel_bias_sd : float
        m/s^2/sqrt(s) and m/s^2.
    angle_sd, velocity_sd : float
        Of tilt and yaw (rad) and of the velocity (m/s) at the start.
    zero_velocity_sd : float
        Of the velocity measurement of every sample, m/s.
    yaw_hold_sd : float or None
        Of the yaw measurement of every sample, rad.  None: yaw is free, and with it the vertical gyro's bias.
    """

    interval_s: float
    latitude_deg: float = 40.93
    heading_deg: float = 0.0
    angle_random_walk: float = math.radians(0.28) / 60
    velocity_random_walk: float = 1e-3
    bias_random_walk: float = math.radians(0.1) / 3600
    bias_sd: float = math.radians(2.2) / 3600
    accel_bias_random_walk: float = 1e-6 * STANDARD_GRAVITY
    accel_bias_sd: float = 1e-3 * STANDARD_GRAVITY
    angle_sd: float = 1e-4
    velocity_sd: float = 1e-3
    zero_velocity_sd: float = 1e-3
    yaw_hold_sd: float | None = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class DenseRun:
    """What the filter says at each sample.

    Parameters
    ----------
    bias, bias_sd : array (n, 3)
        rad/s, body axes.
    innovation : array (n, 3)
        Zero-velocity innovations north, east, down, each over its standard deviation.
    """

    bias: FloatArray
    bias_sd: FloatArray
    innovation: FloatArray


def dense_filter(
    settings: DenseSettings,
    gyro: FloatArray,
    accel: FloatArray,
    bias: FloatArray,
    drift: FloatArray | None = None,
    up: FloatArray | None = None,
) -> DenseRun:
    """Filter a record at rest.

    Parameters
    ----------
    settings : DenseSettings
    gyro, accel : array (n, 3)
        rad/s and m/s^2, body axes.
    bias : array (3,)
        Bias at the start, as from the initial zeroing, rad/s.
    drift : array (n, 3), optional
        What the thermal model adds to the bias at each sample, rad/s: T_s slope x rate in the published form,
        b(T_k) - b(T_k-1) in the better one.  None for the standard filter.
    up : array (3,), optional
        Direction of the specific force at the start; by default that of the first second.
    """
    if up is None:
        up = accel[: max(1, round(1.0 / settings.interval_s))].mean(0)
    up = up / np.linalg.norm(up)
    matrix = body_to_ned(up, math.radians(settings.heading_deg))
    latitude = math.radians(settings.latitude_deg)
    earth = EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
    s = settings
    start = np.repeat([s.angle_sd, s.velocity_sd, s.bias_sd, s.accel_bias_sd], 3) ** 2
    walks = [s.angle_random_walk, s.velocity_random_walk, s.bias_random_walk, s.accel_bias_random_walk]
    noise = np.repeat(walks, 3) ** 2 * s.interval_s
    yaw_variance = -1.0 if s.yaw_hold_sd is None else s.yaw_hold_sd**2
    n = len(gyro)
    run = DenseRun(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)))
    gravity = float(np.linalg.norm(accel[: max(1, round(1.0 / s.interval_s))].mean(0)))
    _run(
        np.ascontiguousarray(gyro),
        np.ascontiguousarray(accel),
        np.zeros((n, 3)) if drift is None else np.ascontiguousarray(drift),
        s.interval_s,
        matrix,
        earth,
        gravity,
        np.array(bias, np.float64),
        np.diag(start),
        noise,
        s.zero_velocity_sd**2,
        yaw_variance,
        run.bias,
        run.bias_sd,
        run.innovation,
    )
    return run


@njit
def _turn(matrix: FloatArray, x: float, y: float, z: float, left: bool) -> FloatArray:
    """Return exp([a x]) C (left) or C exp([a x]) for a small a, to second order."""
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + cross + 0.5 * (cross @ cross)
    turned: FloatArray = turn @ matrix if left else matrix @ turn
    return turned


@njit
def _transition(f: FloatArray, matrix: FloatArray, force: FloatArray, earth: FloatArray, dt: float) -> None:
    """Write F = 1 + A dt, and half (A dt)^2 from bias to velocity, into f (12, 12) whose diagonal is 1."""
    n, e, d = force[0] * dt, force[1] * dt, force[2] * dt
    f[0, 1], f[0, 2] = earth[2] * dt, -earth[1] * dt
    f[1, 0], f[1, 2] = -earth[2] * dt, earth[0] * dt
    f[2, 0], f[2, 1] = earth[1] * dt, -earth[0] * dt
    f[3, 1], f[3, 2] = d, -e
    f[4, 0], f[4, 2] = -d, n
    f[5, 0], f[5, 1] = e, -n
    for i in range(3):
        for j in range(3):
            f[i, 6 + j] = -matrix[i, j] * dt
            f[3 + i, 9 + j] = -matrix[i, j] * dt
    for i in range(3):
        for j in range(3):
            along = f[3 + i, 0] * f[0, 6 + j] + f[3 + i, 1] * f[1, 6 + j] + f[3 + i, 2] * f[2, 6 + j]
            f[3 + i, 6 + j] = 0.5 * along


@njit
def _measure(x: FloatArray, p: FloatArray, state: int, z: float, variance: float) -> float:
    """Take in z = x[state] + noise, in Joseph's form; return the innovation over its standard deviation."""
    row = p[state].copy()
    s = row[state] + variance
    innovation = z - x[state]
    for i in range(STATES):
        gain = row[i] / s
        x[i] += gain * innovation
        for j in range(STATES):
            other = row[j] / s
            p[i, j] += gain * other * s - gain * row[j] - row[i] * other
    return float(innovation / math.sqrt(s))


@njit
def _run(
    gyro: FloatArray,
    accel: FloatArray,
    drift: FloatArray,
    dt: float,
    matrix: FloatArray,
    earth: FloatArray,
    gravity: float,
    bias: FloatArray,
    p: FloatArray,
    noise: FloatArray,
    velocity_variance: float,
    yaw_variance: float,
    out_bias: FloatArray,
    out_sd: FloatArray,
    out_innovation: FloatArray,
) -> None:
    held, accel_bias, velocity = matrix.copy(), np.zeros(3), np.zeros(3)
    f, x = np.eye(STATES), np.zeros(STATES)
    for k in range(len(gyro)):
        bias += drift[k]
        rate = gyro[k] - bias - matrix.T @ earth
        x[:3] = 0.5 * dt * rate
        matrix = _turn(matrix, x[0], x[1], x[2], False)
        force = matrix @ (accel[k] - accel_bias)
        matrix = _turn(matrix, x[0], x[1], x[2], False)
        velocity += force * dt
        velocity[2] += gravity * dt
        _transition(f, matrix, force, earth, dt)
        p = f @ p @ f.T
        for i in range(STATES):
            p[i, i] += noise[i]
        x[:] = 0.0
        for i in range(3):
            out_innovation[k, i] = _measure(x, p, 3 + i, -velocity[i], velocity_variance)
        if yaw_variance > 0.0:
            off = held @ matrix.T
            _measure(x, p, 2, 0.5 * (off[1, 0] - off[0, 1]), yaw_variance)
        matrix = _turn(matrix, x[0], x[1], x[2], True)
        velocity += x[3:6]
        bias += x[6:9]
        accel_bias += x[9:12]
        for i in range(3):
            out_bias[k, i] = bias[i]
            out_sd[k, i] = math.sqrt(p[6 + i, 6 + i])
