"""The strapdown attitude of a unit at rest, with the second-order fixed-gain control that keeps it level.

The frame is east-north-up, turned about the vertical by the error of the coarse heading.  With the attitude
M (body to frame), the rate w of the gyros and the specific force f of the accelerometers

    v' = (M f)_h - k v,   W_E = -k_b v_N,   W_N = k_b v_E + (earth rate),   M' = M [w x] - [W x] M

which has the characteristic s² + k s + k_b g in each of the two horizontal channels (Lee et al., Sensors
2020, 20(8), 2188, figure 3 and equations 4 to 7).  The gains of the sampled loop put its poles at exactly
exp(s h), so it is stable at every sampling rate.
"""

from __future__ import annotations

import math

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.estimation.alignment.state import INNER, OUTER
from imumon.geodesy import LEAST_HORIZONTAL

SLOWEST_POLE = 0.3
"""The corner is held below this many radians per sample: a loop cannot be faster than its samples."""


@njit(**OUTER)
def loop_gains(corner: float, damping: float, interval: float, gravity: float) -> tuple[float, float]:
    """Return the decay of a velocity over one sample, and k_b in rad/s per m/s.

    Parameters
    ----------
    corner : float
        rad/s.
    interval : float
        s.
    gravity : float
        m/s².
    """
    corner = min(corner, SLOWEST_POLE / interval)
    decay = math.exp(-2.0 * damping * corner * interval)
    inside = 1.0 - damping * damping
    angle = corner * interval * math.sqrt(abs(inside))
    swing = math.cos(angle) if inside >= 0.0 else math.cosh(angle)
    trace = 2.0 * math.exp(-damping * corner * interval) * swing
    return decay, (1.0 + decay - trace) / (interval * interval * gravity)


@njit(**OUTER)
def loop_step(
    attitude: FloatArray,
    velocity: FloatArray,
    rate: FloatArray,
    force: FloatArray,
    reference: FloatArray,
    decay: float,
    gain: float,
    interval: float,
    turned: FloatArray,
) -> None:
    """Go on by one sample, in place.

    Parameters
    ----------
    attitude : array (3, 3)
        Body to frame.
    velocity : array (2,)
        East, north, m/s.
    rate, force : array (3,)
        Angular rate in rad/s and specific force in m/s², body axes.
    reference : array (3,)
        Rate of the frame without control, east, north, up, rad/s.
    decay, gain, interval : float
        From `loop_gains`; s.
    turned : array (5,)
        Result: angle of the gyros in the frame, east, north, up, and of the control, east, north, rad.
    """
    for i in range(3):
        turned[i] = interval * (
            attitude[i, 0] * rate[0] + attitude[i, 1] * rate[1] + attitude[i, 2] * rate[2]
        )
    for i in range(2):
        level = attitude[i, 0] * force[0] + attitude[i, 1] * force[1] + attitude[i, 2] * force[2]
        velocity[i] = decay * velocity[i] + interval * level
    turned[3] = -interval * gain * velocity[1]
    turned[4] = interval * gain * velocity[0]
    # turn() applies exp(-[a x]); M exp([w x]) is exp([M w x]) M.
    turn(
        attitude,
        turned[3] + interval * reference[0] - turned[0],
        turned[4] + interval * reference[1] - turned[1],
        interval * reference[2] - turned[2],
    )


@njit(**INNER)
def dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product of two vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@njit(**OUTER)
def level_attitude(up: FloatArray, north: FloatArray, attitude: FloatArray) -> None:
    """Set an attitude from the directions up and north in body axes; north need not be level or of length 1.

    A north that is vertical or zero is replaced by the direction of the x axis, or of -z.  Both may be rows
    of the attitude itself.
    """
    length = math.sqrt(dot(up, up))
    for i in range(3):
        attitude[2, i] = up[i] / length
    vertical, level = attitude[2], attitude[1]
    _project(north[0], north[1], north[2], vertical, level)
    if dot(level, level) <= 0.0:
        _project(1.0, 0.0, 0.0, vertical, level)
        if dot(level, level) < LEAST_HORIZONTAL**2:
            _project(0.0, 0.0, -1.0, vertical, level)
    length = math.sqrt(dot(level, level))
    for i in range(3):
        level[i] /= length
    attitude[0, 0] = level[1] * vertical[2] - level[2] * vertical[1]
    attitude[0, 1] = level[2] * vertical[0] - level[0] * vertical[2]
    attitude[0, 2] = level[0] * vertical[1] - level[1] * vertical[0]


@njit(**INNER)
def _project(x: float, y: float, z: float, up: FloatArray, level: FloatArray) -> None:
    """Set `level` (3,) to the part of a vector that is at right angles to `up`, (3,) of length 1."""
    along = x * up[0] + y * up[1] + z * up[2]
    level[0], level[1], level[2] = x - along * up[0], y - along * up[1], z - along * up[2]


@njit(**INNER)
def orthonormal(attitude: FloatArray) -> None:
    """Take away what rounding did to an attitude, in place."""
    level_attitude(attitude[2], attitude[1], attitude)


@njit(**OUTER)
def azimuth(attitude: FloatArray) -> float:
    """Return the direction of the body's x axis (of -z where x is vertical), rad clockwise from north."""
    east, north = attitude[0, 0], attitude[1, 0]
    if math.sqrt(east * east + north * north) < LEAST_HORIZONTAL:
        east, north = -attitude[0, 2], -attitude[1, 2]
    return math.atan2(east, north)


@njit(**INNER)
def roll_pitch(attitude: FloatArray, down: float) -> tuple[float, float]:
    """Return roll and pitch in rad, ZYX; `down` is 1 for forward-right-down axes, -1 for forward-left-up."""
    x, y, z = -down * attitude[2, 0], -down * attitude[2, 1], -down * attitude[2, 2]
    return math.atan2(y, z), -math.asin(min(max(x, -1.0), 1.0))


@njit
def turn(matrix: FloatArray, x: float, y: float, z: float) -> None:
    """Turn body axes by the rotation vector (x, y, z) rad: M ← exp(-[a x]) M, in place, (3, 3)."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return
    half = math.sin(0.5 * angle)
    first, second = math.sin(angle) / angle, 2.0 * half * half / (angle * angle)
    for j in range(3):
        a, b, c = matrix[0, j], matrix[1, j], matrix[2, j]
        u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
        matrix[0, j] += second * (y * w - z * v) - first * u
        matrix[1, j] += second * (z * u - x * w) - first * v
        matrix[2, j] += second * (x * v - y * u) - first * w
