"""What the stages of rest and bias read from a block, and the slots of its readings."""

from __future__ import annotations

import numpy as np

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.estimation.rest.quiet import AXES, COARSEST_STEPS, Slot
from imumon.filters.slots import Slots

READINGS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")


def readings_of(block: SampleBlock, dated: BoolArray) -> FloatArray:
    """Return rates and specific forces, rad/s and m/s², (n, 6); NaN where there is none or no time."""
    readings = np.full((len(block), AXES), np.nan)
    for j, name in enumerate(READINGS):
        if name in block:
            readings[:, j] = block[name]
    if not dated.all():
        readings[~dated] = np.nan
    return readings


def heading_of(block: SampleBlock) -> FloatArray:
    """Return a vector that turns with the heading, (n, 3): the magnetic field in body axes, else cosine and
    sine of the yaw and zero, else NaN."""
    if block.mag is not None:
        return block.mag
    yaw, q = block.columns.get("yaw"), block.quaternion
    if yaw is None and q is not None:
        w, x, y, z = q.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if yaw is None:
        return np.full((len(block), 3), np.nan)
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])


def slots_of(ended: Slots) -> list[Slot]:
    """Return the first six columns of slots that ended; their length is not known yet."""
    count = ended.count[:, :AXES].astype(np.float64)
    several = count > 1.0
    variance = np.where(
        several, ended.variance[:, :AXES] * count / np.where(several, count - 1.0, 1.0), np.nan
    )
    changes, pairs = ended.changes[:, :AXES], ended.step_count[:, :AXES]
    rare = (changes > 0) & (2 * changes <= pairs)
    step = np.where(rare, np.sqrt(ended.step_squares[:, :AXES] / np.maximum(changes, 1)), np.inf)
    step = np.where(step <= np.repeat(COARSEST_STEPS, 3), step, np.inf)
    means = ended.mean[:, :AXES]
    return [Slot(0.0, *one) for one in zip(count, means, variance, step, strict=True)]
