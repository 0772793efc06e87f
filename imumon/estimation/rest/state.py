"""What the rest detector remembers: a few small arrays, the same size for ever."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray

AXES = 6
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
LEVELS = 8
"""Windows of 1, 2, 4 ... 128 slots are compared with their predecessors."""
RING = 32
"""Slots that a trial looks at."""

COARSEST_STEPS = (2.2e-3, 0.16)
"""No gyro (rad/s) and no accelerometer (m/s²) reads in coarser steps."""

# Per axis: the slot that is being filled (deviations from a centre), the last sample, the least difference of
# two samples, the band in which samples of a resting unit lie, variance of a sample, mean at rest, sums since
# the last sign of motion, the mean before the last motion and its variance.
(CENTRE, SUM, SQUARES, COUNT, LAST, STEP, LOW, HIGH, KNOWN, SAMPLE_VAR, REST_MEAN, RUN_SUM, RUN_COUNT,
 ANCHOR, ANCHOR_VAR) = range(15)  # fmt: skip

# Per axis and level: sum and count of the half window that waits for its other half, the last two means, the
# variance of a mean and the share that the next window has in it.
HALF_SUM, HALF_COUNT, MEAN_1, MEAN_2, VARIANCE, GAIN = range(6)

# Per axis, of the slot that has just ended and of the windows that end with it.
SUMS, COUNTS, MEANS, VARIANCES = range(4)

# Integers.
(STARTED, SEGMENT, LAST_NS, SLOT_NS, AT_REST, HOLD_NS, QUIET_SLOTS, RING_COUNT, SPIKE, ANCHORED, ANCHOR_NS,
 DOUBT_NS, SLOTS, LONG_HOLD_NS) = range(14)  # fmt: skip


class State(NamedTuple):
    """Arrays of one detector.

    axis (15, 6), level (8, 6, 6), slot (4, 6), ring (6, 32, 2) of slot means and variances within slots,
    waiting (8,) seconds of the half windows that wait (0: none), durations (32,) of the slots in the ring,
    integers (14,).
    """

    axis: FloatArray
    level: FloatArray
    slot: FloatArray
    ring: FloatArray
    waiting: FloatArray
    durations: FloatArray
    integers: IntArray


def new_state() -> State:
    """Return the state of a detector that has seen nothing."""
    axis = np.zeros((15, AXES))
    axis[LAST] = np.nan
    axis[STEP] = np.repeat(COARSEST_STEPS, 3)
    axis[LOW], axis[HIGH] = -np.inf, np.inf
    level = np.zeros((LEVELS, 6, AXES))
    level[:, MEAN_1 : MEAN_2 + 1] = np.nan
    return State(
        axis,
        level,
        np.zeros((4, AXES)),
        np.full((AXES, RING, 2), np.nan),
        np.zeros(LEVELS),
        np.zeros(RING),
        np.zeros(14, np.int64),
    )
