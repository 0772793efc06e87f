"""Earth rate, gravity, and attitude: of a unit at rest from its vertical and a heading, and of angles.

The heading is that of the body's x axis, clockwise from true north; where x is within 6° of the vertical it
is that of -z, which then lies level.  Body axes are right-handed, of any kind.  The specific force at rest
points up.
"""

import math

import numpy as np

from .blocks import FloatArray

EARTH_RATE = 7.292115e-5
"""rad/s, WGS-84."""
STANDARD_GRAVITY = 9.80665
"""m/s², 3rd CGPM 1901: what a device that reports in g means."""
MICRO_G = 1e-6 * STANDARD_GRAVITY
"""m/s²."""
DEG_PER_H = math.pi / 180.0 / 3600.0
"""rad/s."""
LEAST_HORIZONTAL = 0.1
"""The x axis has a heading when its horizontal part is at least this; below, -z stands for it."""


def forward(up: FloatArray) -> FloatArray:
    """Return the level direction whose heading is meant, a unit vector in body axes, (3,).

    `up` (3,): unit vector up, body axes.
    """
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if math.sqrt((ahead * ahead).sum()) < LEAST_HORIZONTAL:
        ahead = up[2] * up - np.array([0.0, 0.0, 1.0])
    return np.asarray(ahead / math.sqrt((ahead * ahead).sum()))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b, (3,); `np.cross` takes 25 times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def north_in_body(up: FloatArray, heading: float) -> FloatArray:
    """Return the direction of north in body axes, (3,); heading in rad."""
    ahead = forward(up)
    return math.cos(heading) * ahead - math.sin(heading) * _cross(ahead, up)


def heading_of(up: FloatArray, northward: FloatArray) -> float:
    """Return the heading in rad, -π to π, from a vector in body axes whose level part points north, (3,)."""
    ahead = forward(up)
    return math.atan2(-_cross(ahead, up) @ northward, ahead @ northward)


def body_to_ned(up: FloatArray, heading: float) -> FloatArray:
    """Return the matrix from body axes to north-east-down, (3, 3); heading in rad."""
    north = north_in_body(up, heading)
    return np.vstack([north, _cross(north, up), -up])


def quaternions(angles: FloatArray) -> FloatArray:
    """Return quaternions w, x, y, z, (4, n), of roll, pitch and yaw, (n, 3) in rad: first yaw is turned."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.stack([w, x, y, z])


def earth_rate_along(up: FloatArray, northward: FloatArray, latitude: float) -> FloatArray:
    """Return the earth rate in the axes of the given directions, rad/s, (3,).

    `up`, `northward` (3,): unit vectors; `northward` zero where the heading is not known: the vertical part
        only.
    `latitude`: rad.
    """
    return EARTH_RATE * (math.cos(latitude) * northward + math.sin(latitude) * up)
