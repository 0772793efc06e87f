"""What knows the heading without the gyros: a magnetometer, or the device's own yaw."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray, SampleBlock


def reference(block: SampleBlock) -> FloatArray | None:
    """Return a vector that turns with the heading, (n, 3), or None when the block has none.

    It is the magnetic field in body axes, else cosine and sine of the yaw and zero.
    """
    field = block.mag
    if field is not None:
        return field
    yaw = block.columns.get("yaw")
    q = block.quaternion
    if yaw is None and q is not None:
        w, x, y, z = q.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if yaw is None:
        return None
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])


def temperature(block: SampleBlock) -> FloatArray:
    """Return the temperature of the unit in °C, (n,): the estimate, else the reading, else NaN.

    The mean of the axes where each has a thermometer.
    """
    # The reading is a stopgap where there is no estimate at all; mixed with it, it would jump.
    for name in ("temperature_estimate", "temperature"):
        if name in block:
            return np.asarray(block[name])
        axes = block.vector(name)
        if axes is not None:
            return np.asarray(axes.mean(1))
    return np.full(len(block), np.nan)
