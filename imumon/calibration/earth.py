"""Earth rate in body axes, from latitude, heading and what the accelerometers call down."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray

EARTH_RATE = 7.292115e-5
"""rad/s, WGS-84."""
STEEPEST = np.cos(np.deg2rad(80.0))
"""Horizontal part that the x axis must have for a heading to mean something."""


def earth_rate_in_body(accel: FloatArray, latitude_deg: float, heading_deg: float) -> FloatArray | None:
    """Return the earth rate in body axes, (3,) rad/s, of a unit at rest; None when its x axis is upright.

    Parameters
    ----------
    accel : array (3,)
        Mean specific force at rest, m/s², in right-handed body axes of any kind; its direction is up.  An
        accelerometer bias of 10 mg tilts the result by 0.6°, 0.15 °/h at most.
    latitude_deg : float
    heading_deg : float
        Of the body's x axis, clockwise from north.
    """
    down = -accel / np.linalg.norm(accel)
    forward = np.array([1.0, 0.0, 0.0]) - down[0] * down
    length = np.linalg.norm(forward)
    if length < STEEPEST:
        return None
    forward = forward / length
    right = np.cross(down, forward)
    heading, latitude = np.deg2rad(heading_deg), np.deg2rad(latitude_deg)
    north = np.cos(heading) * forward - np.sin(heading) * right
    return np.asarray(EARTH_RATE * (np.cos(latitude) * north - np.sin(latitude) * down))
