"""Attitude of a simulated unit: angles to body axes, and what devices report of it.

Angles are roll, pitch and heading in rad, ZYX, of forward-right-down body axes to north-east-down.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.geodesy import EARTH_RATE, quaternions

FIELD_UT = np.array([20.0, 1.0, 43.0])
"""Magnetic field north, east, down, as in central Europe."""

FRD_TO_FLU = np.diag([1.0, -1.0, -1.0])
"""Forward-right-down to forward-left-up."""


def body_rates(angles: FloatArray, rates: FloatArray) -> FloatArray:
    """Turn Euler angle rates (roll, pitch, heading) into angular rates in forward-right-down axes, (n, 3)."""
    roll, pitch = angles[:, 0], angles[:, 1]
    roll_rate, pitch_rate, yaw_rate = rates.T
    return np.column_stack(
        [
            roll_rate - np.sin(pitch) * yaw_rate,
            np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
            -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
        ]
    )


def to_body(angles: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn north-east-down vectors, (3,) or (n, 3), into forward-right-down axes, (n, 3)."""
    sin_roll, sin_pitch, sin_yaw = np.sin(angles).T
    cos_roll, cos_pitch, cos_yaw = np.cos(angles).T
    north, east, down = vectors.T
    along = cos_yaw * north + sin_yaw * east
    across = cos_yaw * east - sin_yaw * north
    below = sin_pitch * along + cos_pitch * down
    return np.column_stack(
        [
            cos_pitch * along - sin_pitch * down,
            cos_roll * across + sin_roll * below,
            cos_roll * below - sin_roll * across,
        ]
    )


def earth_rate(latitude_deg: float) -> FloatArray:
    """Return the earth rate north, east, down in rad/s, (3,)."""
    latitude = np.deg2rad(latitude_deg)
    return EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])


def reported(angles: FloatArray, axes: Literal["FLU", "FRD"]) -> dict[str, ColumnArray]:
    """Return the columns of the attitude as a device reports it: to NED for FRD, to ENU for FLU."""
    w, x, y, z = quaternions(angles)
    if axes == "FLU":  # half a turn about forward in the body, and about north-east in the world
        w, x, y, z = np.sqrt(0.5) * np.array([w + z, x + y, x - y, w - z])
    w, x, y, z = np.where(w < 0.0, -1.0, 1.0) * np.array([w, x, y, z])
    yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    pitch = -np.arcsin(np.clip(2.0 * (x * z - w * y), -1.0, 1.0))
    roll = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    if axes == "FRD":  # a compass heading, 0 to 360 degrees
        yaw = np.mod(yaw, 2 * np.pi)
    return {"q_w": w, "q_x": x, "q_y": y, "q_z": z, "roll": roll, "pitch": pitch, "yaw": yaw}


def split(name: str, values: FloatArray) -> dict[str, ColumnArray]:
    """Return the columns name_x, name_y, name_z of values of shape (n, 3)."""
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
