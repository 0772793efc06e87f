"""`imumon.geodesy` for compiled code, and a turn of axes."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import FloatArray
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL


@njit(cache=True, nogil=True)
def north(up: FloatArray, heading: float) -> FloatArray:
    """Return the direction of north in body axes, (3,).

    Parameters
    ----------
    up : array (3,)
        Unit vector up, body axes; the specific force at rest points there.
    heading : float
        rad clockwise from north, of the body's x axis; of -z where x is vertical.
    """
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if np.sqrt((ahead * ahead).sum()) < LEAST_HORIZONTAL:
        ahead = up[2] * up - np.array([0.0, 0.0, 1.0])
    ahead /= np.sqrt((ahead * ahead).sum())
    right = cross(ahead, up)
    northward: FloatArray = math.cos(heading) * ahead - math.sin(heading) * right
    return northward


@njit(cache=True, nogil=True)
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product of two vectors, (3,)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True, nogil=True)
def earth_rate(up: FloatArray, northward: FloatArray, latitude: float) -> FloatArray:
    """Return the earth rate in body axes, rad/s, (3,).

    Parameters
    ----------
    up, northward : array (3,)
        Unit vectors in body axes; `northward` nought where the heading is not known: the vertical part only.
    latitude : float
        rad.
    """
    return EARTH_RATE * (math.cos(latitude) * northward + math.sin(latitude) * up)


@njit(cache=True, nogil=True)
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
