"""Rows of a unit at rest in one position, and its rates in level axes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.geodesy import STANDARD_GRAVITY, forward

CAPACITY = 4096
"""Rows kept for a position: 17 minutes of slots of 1/4 s; then neighbours are merged."""


@dataclass
class Record:
    """Rows of equal length; a slot that is left out keeps its place with weight zero.

    A row (7,) is the number of valid samples, the mean rate of the gyros (3), rad/s, and the specific force
    (3), m/s², in body axes; times are those of the first and behind the last slot, since the first sample.
    """

    begun_s: float
    ended_s: float = 0.0
    rows: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, 7)))
    slots: int = 0
    slots_per_row: int = 1
    rest_s: float = 0.0

    def add(self, samples: float, values: FloatArray, ended_s: float, length_s: float) -> None:
        """Add a slot; `samples` is zero for a slot that is left out."""
        k, within = divmod(self.slots, self.slots_per_row)
        if k == CAPACITY:
            self._merge()
            k, within = divmod(self.slots, self.slots_per_row)
        row = self.rows[k]
        if not within:
            row[0], row[1:] = samples, values
        elif samples:
            row[0] += samples
            row[1:] += samples / row[0] * (values - row[1:])
        self.slots += 1
        self.ended_s = ended_s
        self.rest_s += length_s if samples else 0.0

    def _merge(self) -> None:
        pairs = self.rows.reshape(-1, 2, 7)
        weight = pairs[:, :, :1]
        total = weight.sum(axis=1)
        half = CAPACITY // 2
        self.rows[:half, 1:] = (weight * pairs[:, :, 1:]).sum(axis=1) / np.maximum(total, 1e-9)
        self.rows[:half, :1] = total
        self.slots_per_row *= 2

    @property
    def row_s(self) -> float:
        """Length of a row."""
        return (self.ended_s - self.begun_s) / max(self.slots, 1) * self.slots_per_row

    @property
    def whole_rows(self) -> FloatArray:
        """The rows that are complete, (n, 7)."""
        return self.rows[: self.slots // self.slots_per_row]


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """A record in level axes, complex: forward + i left of the reference frame.

    `rate` (n,) are the level gyros, rad/s, in axes that follow the level by the accelerometers, `vertical`
    (n,) is the vertical gyro, and `level` (n,) the tilt by the accelerometers, rad, whose derivative appears
    in the rate; `attitude` (3, 3) is from body to level axes by the mean specific force.
    """

    row_s: float
    valid: BoolArray
    rate: ColumnArray
    vertical: FloatArray
    level: ColumnArray
    attitude: FloatArray


def levelled(
    record: Record, attitude: FloatArray, earth_vertical: float, known_tau_s: FloatArray, known_g: FloatArray
) -> Levelled:
    """Return a record in level axes; of the attitude, body to reference frame, only the azimuth is used.

    `earth_vertical` is Ω sin L, rad/s; `known_tau_s` and `known_g` (3,) are time constant and amplitude of
    the accelerometers' known warm-up since the first sample.
    """
    rows, row_s = record.whole_rows, record.row_s
    valid = rows[:, 0] > 0.0
    attitude = upright(attitude, rows[valid, 4:].mean(axis=0))
    time_s = record.begun_s + row_s * (np.arange(len(rows)) + 0.5)
    warm_up = -np.expm1(-time_s[:, None] / known_tau_s) * known_g
    force = (rows[:, 4:] / STANDARD_GRAVITY - warm_up) @ attitude.T
    rate = rows[:, 1:4] @ attitude.T
    ahead, left = np.where(valid[:, None], force[:, :2], 0.0).T
    level = left - 1j * ahead
    horizontal = rate[:, 0] + 1j * rate[:, 1] - 1j * level * earth_vertical
    return Levelled(row_s, valid, horizontal, rate[:, 2], level, attitude)


def upright(attitude: FloatArray, force: FloatArray) -> FloatArray:
    """Return the attitude, (3, 3), of the same azimuth whose vertical is a specific force, (3,)."""
    up = force / math.sqrt(float(force @ force))
    ahead = attitude[0] - (attitude[0] @ up) * up
    ahead /= math.sqrt(float(ahead @ ahead))
    return np.vstack([ahead, np.cross(up, ahead), up])


def first_attitude(force: FloatArray) -> FloatArray:
    """Return the attitude, (3, 3), of the first position: its forward, left and up are the reference."""
    up = force / math.sqrt(float(force @ force))
    ahead = forward(up)
    return np.vstack([ahead, np.cross(up, ahead), up])


def direction_of(attitude: FloatArray) -> float:
    """Return the direction in which a body points in the reference frame, rad, from forward to left."""
    ahead = attitude @ forward(attitude[2])
    return math.atan2(ahead[1], ahead[0])


def turned_about_vertical(before: FloatArray, after: FloatArray) -> float:
    """Return the angle about the vertical between two attitudes, rad, counter-clockwise from above."""
    turn = after @ before.T
    return math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
