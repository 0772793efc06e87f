"""Quaternions from body to east-north-up, as matrices and as angles."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import LEAST_HORIZONTAL

BEYOND = 3.0
"""Standard deviations that count as significant; convention."""


def matrix(q: FloatArray) -> FloatArray:
    """Return the matrix of a quaternion w, x, y, z, (4,): from body axes to the axes it refers to, (3, 3)."""
    w, x, y, z = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def level_angles(q: FloatArray, down: float) -> tuple[FloatArray, FloatArray]:
    """Return roll and pitch, rad, (n,) each: ZYX, of forward-right-down axes or of forward-left-up ones.

    Parameters
    ----------
    q : array (n, 4)
        w, x, y, z, from body axes to any axes whose third points up.
    down : float
        1 for forward-right-down, -1 for forward-left-up.
    """
    w, x, y, z = q.T
    # The third axis of the level frame that the body axes are like, in body axes.
    along = -down * 2.0 * (x * z - w * y)
    across = -down * 2.0 * (y * z + w * x)
    third = -down * (1.0 - 2.0 * (x * x + y * y))
    return np.arctan2(across, third), -np.arcsin(np.clip(along, -1.0, 1.0))


def heading(q: FloatArray) -> FloatArray:
    """Return the heading of the x axis, rad, clockwise from north, 0 to 2π, (n,); where x is vertical, of -z.

    Parameters
    ----------
    q : array (n, 4)
        w, x, y, z, body to east-north-up.
    """
    w, x, y, z = q.T
    east, north = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    steep = east * east + north * north < LEAST_HORIZONTAL**2
    if steep.any():
        east = np.where(steep, -2.0 * (x * z + w * y), east)
        north = np.where(steep, -2.0 * (y * z - w * x), north)
    return np.asarray(np.mod(np.arctan2(east, north), 2.0 * np.pi))


def slope(q: FloatArray, tilt_sd: FloatArray) -> FloatArray:
    """Return the tangent of how far the axis that `heading` is of rises or falls, without sign, (n,).

    It is infinite where the tilt, with its standard deviation in rad, (n,), leaves open which axis that is.
    """
    w, x, y, z = q.T
    forward, side, upward = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    level = np.sqrt(side * side + upward * upward)
    rise = np.abs(np.where(level < LEAST_HORIZONTAL, upward, forward))
    tangent = rise / np.sqrt(np.maximum(1.0 - rise * rise, LEAST_HORIZONTAL**2))
    return np.where(np.abs(level - LEAST_HORIZONTAL) < BEYOND * tilt_sd, np.inf, tangent)


def turned_about_up(q: FloatArray, angle: FloatArray) -> FloatArray:
    """Return attitudes (n, 4) turned counterclockwise about the vertical by angles in rad, (n,)."""
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    w, x, y, z = q.T
    return np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])


def up_of(q: FloatArray) -> FloatArray:
    """Return the third axis of the frame that q, (n, 4), leads to, in the frame it starts from, (n, 3)."""
    w, x, y, z = q.T
    return np.column_stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
