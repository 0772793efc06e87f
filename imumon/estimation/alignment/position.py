"""Which slots are rest and which are turns, and what a unit at rest in one position measured.

A turn is followed by the gyros, sample by sample (`imumon.filters.turns`), less what they read at rest.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.filters.turns import STILL, Turn, angle_of
from imumon.geodesy import EARTH_RATE, forward

SLOT_S = 0.25
"""Length of the slots into which samples are gathered: motion is detected, and rows are filled, four times a
second."""
CAPACITY = 4096
"""Largest number of rows of a record: 17 minutes of slots; then rows are merged in pairs, so that the time of
a fit stays bounded."""

MOTION_RATE, LIMIT_FACTOR = 1e-3, 5.0
"""A rate is motion that differs from the median at rest by more than 1 mrad/s (slower than any hand; less is
sway, noise or creep), and by more than 5 times the largest deviation of the last 30 s."""
SWAYING_RATE = 20e-3
"""rad/s: at the start, a rate that varies by less for 10 s is taken for rest."""
CALM_SLOTS, SWAYING_SLOTS, MEDIAN_SLOTS = 8, 40, 120
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s."""
MOST_PENDING = 480
"""Slots: 2 minutes before the first rest may turn out to be rest; a motion of 2 minutes is a restart."""
SAME_ATTITUDE, SHORT_PATH = 1e-3, 20e-3
"""rad: a turn by less (0.06°, the noise of 1 °/√h in 10 s) on a path of less leaves the attitude as it is."""


class Slot(NamedTuple):
    """Mean rate, rad/s, (3,), and specific force, m/s², (3,), over a slot, in body axes.

    `number` counts slots of `SLOT_S` since the first sample of the segment.
    """

    number: int
    rate: FloatArray
    force: FloatArray


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
    yaw_since_fit: float = 0.0
    """Angle about the vertical since the last fit by its gyro, less the mean in that fit, rad."""
    slots_per_row: int = 1
    slots: int = 0
    """Slots from the first to the last."""
    sums: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, 7)))

    def add(self, slot: Slot) -> None:
        """Add a slot at rest."""
        if self.fit is not None:
            self.yaw_since_fit += SLOT_S * (float(self.attitude[2] @ slot.rate) - self.fit.vertical)
        self.slots = slot.number + 1 - self.first_slot
        while self.slots > CAPACITY * self.slots_per_row:
            pairs = self.sums.reshape(-1, 2, 7).sum(axis=1)
            self.sums = np.concatenate([pairs, np.zeros_like(pairs)])
            self.slots_per_row *= 2
        self.sums[(self.slots - 1) // self.slots_per_row] += np.concatenate([[1.0], slot.rate, slot.force])

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


class Motion:
    """The motion detector."""

    def __init__(self) -> None:
        self.rest_rate: FloatArray | None = None
        """Median rate at rest, rad/s, (3,); None before the first rest."""
        self.limit = MOTION_RATE
        """Distance from it that is still rest, rad/s."""
        self.recent: deque[FloatArray] = deque(maxlen=MEDIAN_SLOTS)
        """Rates of slots at rest."""
        self.pending: deque[Slot] = deque(maxlen=MOST_PENDING)
        """Slots of the motion; before the first rest, those that may belong to it."""
        self.turn: Turn = STILL
        """Since the motion began."""
        self.ended_s = 0.0
        """End of the motion, s since the first sample."""

    @property
    def begun_s(self) -> float:
        """Beginning of the motion, s since the first sample."""
        return SLOT_S * self.pending[0].number

    @property
    def moving(self) -> bool:
        """Whether the unit moves, or came to rest less than 2 s ago."""
        return self.rest_rate is not None and bool(self.pending)

    def step(self, slot: Slot, at_rest: bool, turn: Turn) -> tuple[list[Slot], bool]:
        """Return the slots at rest that are known with this slot and its turn, and whether a rest begins.

        There are none before the first rest and in motion.  After a motion that leaves the attitude as it was
        they are all of its slots; a rest that begins, the first one or after a turn, has those before it.
        """
        if self.rest_rate is None:
            self.pending.append(slot)
            begins = at_rest and self._first_rest()
            return (list(self.pending) if begins else []), begins
        in_motion = self._is_motion(slot)
        if not (self.pending or in_motion):
            return [slot], False
        self.pending.append(slot)
        if in_motion:
            self.ended_s = SLOT_S * (slot.number + 1)
        self.turn = self.turn.then(turn.less(self.rest_rate))
        calm = list(self.pending)[-CALM_SLOTS:]
        if any(map(self._is_motion, calm)):
            return [], False
        turned = angle_of(self.turn.rotation) > SAME_ATTITUDE or self.turn.path > SHORT_PATH
        return calm if turned else list(self.pending), turned

    def _first_rest(self) -> bool:
        """Return whether the unit rests for the first time; if so, drop the slots before that rest."""
        rates = np.array([one.rate for one in self.pending])
        for slots, limit in ((CALM_SLOTS, MOTION_RATE), (SWAYING_SLOTS, SWAYING_RATE)):
            if len(rates) >= slots and np.ptp(rates[-slots:], axis=0).max() < limit:
                break
        else:
            return False
        self._update_rest_rate(rates[-slots:])
        while any(map(self._is_motion, self.pending)):
            self.pending.popleft()
        return True

    def _is_motion(self, slot: Slot) -> bool:
        assert self.rest_rate is not None
        return float(np.abs(slot.rate - self.rest_rate).max()) > self.limit

    def _update_rest_rate(self, rates: FloatArray) -> None:
        self.rest_rate = np.median(rates, axis=0)
        self.limit = max(MOTION_RATE, LIMIT_FACTOR * float(np.abs(rates - self.rest_rate).max()))

    def add_rest(self, rest: Sequence[Slot]) -> None:
        """Take slots at rest, with which a motion ends; update the median every 10 s."""
        for slot in rest:
            self.recent.append(slot.rate)
            if slot.number % SWAYING_SLOTS == 0:
                self._update_rest_rate(np.array(self.recent))
        self.pending.clear()
        self.turn = STILL

    def azimuth_variance(self, up: FloatArray, scale_sd: float) -> float:
        """Return the variance of the angle by which the unit has turned about the vertical, rad².

        `up` (3,) is the vertical in body axes at the beginning, `scale_sd` is of scale factor and
        misalignment.
        """
        # The earth rate turns against the body: up to all of it is wrong while it turns by a radian.
        seconds = self.ended_s - self.begun_s if self.pending else 0.0
        drift = EARTH_RATE * seconds * min(self.turn.path, 1.0)
        by_scale = scale_sd**2 * float(np.sum(self.turn.scale_about(up) ** 2))
        return by_scale + self.turn.sampling_variance(up) + drift**2
