"""Which slots are rest and which are turns, and the record of a rest in one attitude.

A turn is integrated from the gyros, sample by sample (`imumon.filters.turns`), less their rate at rest.  The
reference frame is forward, left and up of the first position.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import takewhile
from operator import add
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE, forward

SLOT_S = 0.25  # length of the slots into which samples are gathered, s
CAPACITY = 4096
"""Largest number of rows of a record, 17 minutes of slots: beyond, rows are merged in pairs, for speed."""

MOTION_RATE, LIMIT_FACTOR = 1e-3, 5.0
"""A slot moves if its rate differs from the median at rest by more than 1 mrad/s (slower than any hand; less
is sway, noise or creep), and by more than 5 times the largest deviation of the last 30 s."""
SWAYING_RATE = 20e-3
"""rad/s: at the start, a rate that varies by less for 10 s is rest; a larger deviation never is."""
CALM_SLOTS, SWAYING_SLOTS, MEDIAN_SLOTS = 8, 40, 120
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s."""


class Slot(NamedTuple):
    """Means over a slot, in body axes."""

    begun_s: float  # since the first sample of the segment, s: a multiple of `SLOT_S`
    rate: FloatArray  # rad/s, (3,)
    force: FloatArray  # specific force, m/s², (3,)


class AzimuthError(NamedTuple):
    """What may be wrong with the angle about the vertical by which the gyros have turned a unit."""

    variance: float = 0.0  # by all but E, rad²
    by_scale: FloatArray = np.zeros((3, 3))  # the angle by each element of E, the same in all turns, rad
    crept: float = 0.0  # by the vertical gyro less its rate at rest, which may be all wrong, rad

    @classmethod
    def of(cls, turn: Turn, up: FloatArray) -> "AzimuthError":
        """Return that of a turn; `up` (3,) is the vertical in body axes at its beginning."""
        # The earth rate turns against the body: about all of it is wrong in a turn by a radian.
        by_earth = EARTH_RATE * turn.seconds * min(turn.path, 1.0)
        return cls(turn.sampling_variance(up) + by_earth**2, turn.scale_about(up))

    def then(self, other: "AzimuthError") -> "AzimuthError":
        """Return that of both turns, one after the other."""
        return AzimuthError(*map(add, self, other))

    def variance_from(self, other: "AzimuthError", scale_sd: float = 0.0) -> float:
        """Return the variance of the angle from one to its continuation, rad²; E has `scale_sd`."""
        by_scale = scale_sd**2 * float(np.sum(np.square(self.by_scale - other.by_scale)))
        return abs(self.variance - other.variance) + (self.crept - other.crept) ** 2 + by_scale


class PositionFit(NamedTuple):
    """Rate of one position given each of h hypotheses, in horizontal axes, complex: forward + i left."""

    log_weight: FloatArray  # of prior and evidence, (h,)
    rate: ColumnArray  # earth rate and bias, rad/s, (h,)
    variance: FloatArray  # of each part of it, (h,)
    vertical: float  # gyro, rad/s
    vertical_variance: float
    white: float  # noise of the horizontal gyros, or of the vertical one if less, (rad/s)²/Hz
    attitude: FloatArray  # from body axes, (3, 3)
    azimuth_error: AzimuthError
    gyro_mean: complex  # has the direction of the plain mean
    hann_mean: complex  # and of the Hann-weighted one

    def averaged(self) -> "PositionFit":
        """Return the fit with one hypothesis that has the mean and the variance of all."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        weight /= weight.sum()
        mean = weight @ self.rate
        variance = weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2)
        return self._replace(log_weight=np.zeros(1), rate=np.array([mean]), variance=np.array([variance]))


@dataclass
class Position:
    """A rest in one attitude: sums over its slots, in rows of `row_s` s.

    A row of `sums` (7,) has the number of slots (0 in a gap), and sums of rates (3) and specific forces (3).

    `attitude` (3, 3) is from body axes to the reference frame, and `azimuth_error` what may be wrong with the
    turns from the first position to now.  `ordinal` counts from 1 the attitudes that differ enough to
    separate a bias from the earth rate.  Times are since the first sample of the segment.
    """

    begun_s: float
    attitude: FloatArray
    azimuth_error: AzimuthError = field(default_factory=AzimuthError)
    ordinal: int = 1
    still_rate: float = math.nan  # of the vertical gyro, rad/s; NaN before a fit with the same axis up
    fit: PositionFit | None = None
    ended_s: float = math.nan
    row_s: float = SLOT_S
    sums: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, 7)))

    def add(self, slot: Slot) -> None:
        """Add a slot at rest."""
        self.ended_s = slot.begun_s + SLOT_S
        while self.ended_s - self.begun_s > CAPACITY * self.row_s:
            pairs = self.sums.reshape(-1, 2, 7).sum(axis=1)
            self.sums = np.concatenate([pairs, np.zeros_like(pairs)])
            self.row_s *= 2.0
        row = int((slot.begun_s - self.begun_s) / self.row_s)
        self.sums[row] += np.concatenate([[1.0], slot.rate, slot.force])
        if not math.isnan(self.still_rate):
            crept = SLOT_S * (float(self.attitude[2] @ slot.rate) - self.still_rate)
            self.azimuth_error = self.azimuth_error.then(AzimuthError(crept=crept))

    def forget_half(self) -> None:
        """Drop the first half of the rows."""
        half = len(self.rows()[0]) // 2
        self.sums = np.concatenate([self.sums[half:], np.zeros((half, 7))])
        self.begun_s += half * self.row_s

    @property
    def rest_s(self) -> float:
        """Time at rest in this position, s."""
        return SLOT_S * float(self.sums[:, 0].sum())

    def rows(self) -> tuple[BoolArray, FloatArray]:
        """Return which complete rows have samples, (n,), and the mean rates and forces, (n, 6)."""
        sums = self.sums[: int((self.ended_s - self.begun_s) / self.row_s)]
        count = sums[:, 0]
        return count > 0.0, sums[:, 1:] / np.maximum(count, 1.0)[:, None]


def upright(ahead: FloatArray, force: FloatArray) -> FloatArray:
    """Return the attitude, body to horizontal axes, (3, 3), with this specific force upward.

    `ahead` (3,) is the forward direction in body axes, of which only the horizontal part counts.
    """
    up = force / math.sqrt(force @ force)
    ahead = ahead - (ahead @ up) * up
    ahead = ahead / math.sqrt(ahead @ ahead)
    return np.vstack([ahead, np.cross(up, ahead), up])


def direction_of(attitude: FloatArray) -> float:
    """Return the direction in which a body points in the reference frame, rad, from forward to left."""
    ahead = attitude @ forward(attitude[2])
    return math.atan2(ahead[1], ahead[0])


class Motion:
    """The motion detector: which slots are rest, and how the unit has turned in between.

    A slot is calm if its rate is within `limit` of `rest_rate`.  Without a motion, a calm slot is rest, and
    any other begins a motion; a motion ends with 2 s of calm.  The first rest has its own conditions.
    """

    def __init__(self) -> None:
        self.rest_rate = np.full(3, np.nan)  # median rate at rest, rad/s; NaN before the first rest
        self.limit = MOTION_RATE  # distance from it that is still rest, rad/s
        self.recent: deque[FloatArray] = deque(maxlen=MEDIAN_SLOTS)  # rates of slots at rest
        self.pending: deque[Slot] = deque(maxlen=SWAYING_SLOTS)  # slots that are not known to be rest
        self.moving, self.begun_s = False, 0.0
        """Whether the unit has moved within 2 s; when the last motion began, s since the first sample."""
        self.turn = STILL  # since the motion began

    def step(self, slot: Slot, at_rest: bool, turn: Turn) -> tuple[list[Slot], Turn]:
        """Return the slots that are known to be rest with this one, and the turn before them.

        `turn` is that within the slot.  There are none in motion and before the first rest, for which alone
        `at_rest` counts; a rest that begins has those before it.
        """
        self.pending.append(slot)
        if np.isnan(self.rest_rate[0]) and not (at_rest and self._is_first_rest()):
            return [], STILL
        rest = list(takewhile(self._is_calm, reversed(self.pending)))[::-1]
        if not (rest or self.moving):
            self.moving, self.begun_s = True, slot.begun_s
        if self.moving:
            self.turn = self.turn.then(turn.less(self.rest_rate))
            if len(rest) < CALM_SLOTS:
                return [], STILL
        self.pending.clear()
        self.recent.extend(one.rate for one in rest)
        if self.moving or slot.begun_s % (SLOT_S * SWAYING_SLOTS) == 0.0:
            self.rest_rate = np.median(self.recent, axis=0)
            largest = float(np.abs(self.recent - self.rest_rate).max())
            # A deviation up to the limit may raise it; the cap bounds that.
            self.limit = min(max(MOTION_RATE, LIMIT_FACTOR * largest), SWAYING_RATE)
        ended, self.moving, self.turn = self.turn, False, STILL
        return rest, ended

    def _is_first_rest(self) -> bool:
        rates = np.array([one.rate for one in self.pending])
        for slots, limit in ((CALM_SLOTS, MOTION_RATE), (SWAYING_SLOTS, SWAYING_RATE)):
            if len(rates) >= slots and np.ptp(rates[-slots:], axis=0).max() < limit:
                self.rest_rate, self.limit = np.median(rates[-slots:], axis=0), limit
                return True
        return False

    def _is_calm(self, slot: Slot) -> bool:
        return float(np.abs(slot.rate - self.rest_rate).max()) <= self.limit
