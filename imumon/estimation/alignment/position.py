"""What a unit at rest in one position measured, in rows of equal length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.geodesy import forward

SLOT_S = 0.25
"""Length of the slots into which samples are gathered: motion is detected, and rows are filled, four times a
second."""
CAPACITY = 4096
"""Largest number of rows of a record: 17 minutes of slots; then rows are merged in pairs, so that the time of
a fit stays bounded."""


class Slot(NamedTuple):
    """Means over the samples of one slot.

    `number` counts slots of `SLOT_S` since the first sample of the segment.  The samples stand for the last
    `length` slots: those since the slot with samples before.  `values` (6,) are the mean rate, rad/s, and the
    mean specific force, m/s², in body axes.
    """

    number: int
    length: int
    values: FloatArray

    @property
    def rate(self) -> FloatArray:
        """Mean rate, rad/s, (3,)."""
        return self.values[:3]

    @property
    def ended_s(self) -> float:
        """End, s since the first sample."""
        return SLOT_S * (self.number + 1)


class PositionFit(NamedTuple):
    """Rate of one position given each of h hypotheses, in horizontal axes, complex: forward + i left.

    `log_weight` (h,) is that of prior and evidence; `rate` (h,) earth rate and bias, rad/s, with the variance
    of each part; `vertical` is the vertical gyro, rad/s, and `white` the white noise of the quietest gyro,
    (rad/s)²/Hz; `attitude` (3, 3) is from body axes.  `gyro_mean` and `hann_mean` have the directions of the
    plain and the Hann-weighted mean of the gyros.
    """

    log_weight: FloatArray
    rate: ColumnArray
    variance: FloatArray
    vertical: float
    vertical_variance: float
    white: float
    attitude: FloatArray
    gyro_mean: complex
    hann_mean: complex

    def averaged(self) -> PositionFit:
        """Return the fit with one hypothesis that has the mean and the variance of all."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        weight /= weight.sum()
        mean = weight @ self.rate
        variance = weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2)
        return self._replace(log_weight=np.zeros(1), rate=np.array([mean]), variance=np.array([variance]))


@dataclass
class Position:
    """A rest in one attitude: sums over its slots, in rows of `slots_per_row` slots.

    A row of `sums` (7,) has the number of slots, and the sums of their rates (3) and specific forces (3).  A
    row without slots is a gap in the data.

    `attitude` (3, 3) is from body axes to the reference frame, which is forward, left and up of the first
    position; `azimuth_variance` is that of the angle about the vertical since then, rad².  `number` counts
    from 1 the attitudes that differ.
    """

    first_slot: int
    attitude: FloatArray
    azimuth_variance: float = 0.0
    number: int = 1
    fit: PositionFit | None = None
    slots_per_row: int = 1
    slots: int = 0
    """Slots from the first to the last."""
    sums: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, 7)))

    def add(self, slot: Slot) -> None:
        """Add a slot at rest."""
        end = slot.number + 1 - self.first_slot
        while end > CAPACITY * self.slots_per_row:
            pairs = self.sums.reshape(-1, 2, 7).sum(axis=1)
            self.sums = np.concatenate([pairs, np.zeros_like(pairs)])
            self.slots_per_row *= 2
        for k in range(max(end - slot.length, 0), end):
            self.sums[k // self.slots_per_row] += np.concatenate([[1.0], slot.values])
        self.slots = end

    def forget_half(self) -> None:
        """Drop the first half of the rows."""
        half = self.slots // self.slots_per_row // 2
        self.sums = np.concatenate([self.sums[half:], np.zeros((half, 7))])
        self.first_slot += half * self.slots_per_row
        self.slots -= half * self.slots_per_row

    @property
    def row_s(self) -> float:
        """Length of a row, s."""
        return SLOT_S * self.slots_per_row

    @property
    def rest_s(self) -> float:
        """Time at rest, s."""
        return SLOT_S * float(self.sums[:, 0].sum())

    @property
    def begun_s(self) -> float:
        """Beginning, s since the first sample of the segment."""
        return SLOT_S * self.first_slot

    @property
    def ended_s(self) -> float:
        """End of the last slot, s since the first sample of the segment."""
        return SLOT_S * (self.first_slot + self.slots)

    def rows(self) -> tuple[BoolArray, FloatArray]:
        """Return of the complete rows which have samples, (n,), and the mean rates and forces, (n, 6)."""
        sums = self.sums[: self.slots // self.slots_per_row]
        count = sums[:, 0]
        return count > 0.0, sums[:, 1:] / np.maximum(count, 1.0)[:, None]


def upright(ahead: FloatArray, force: FloatArray) -> FloatArray:
    """Return the attitude, body to horizontal axes, (3, 3), with this specific force upward.

    `ahead` (3,) is the forward direction in body axes, of which only the horizontal part counts.
    """
    up = force / math.sqrt(float(force @ force))
    ahead = ahead - (ahead @ up) * up
    ahead = ahead / math.sqrt(float(ahead @ ahead))
    return np.vstack([ahead, np.cross(up, ahead), up])


def direction_of(attitude: FloatArray) -> float:
    """Return the direction in which a body points in the reference frame, rad, from forward to left."""
    ahead = attitude @ forward(attitude[2])
    return math.atan2(ahead[1], ahead[0])


def yaw_between(before: FloatArray, after: FloatArray) -> float:
    """Return the angle about the vertical between two attitudes, rad, counter-clockwise from above."""
    turn = after @ before.T
    return math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
