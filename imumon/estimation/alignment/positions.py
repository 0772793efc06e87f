"""Which slots are rest and which are turns: one decision table per slot.

A turn is followed by the gyros, sample by sample (`imumon.filters.turns`), less what they read at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import PositionFit
from imumon.estimation.alignment.record import SLOT_S, Record, Slot
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE

MOTION_RATE, LIMIT_FACTOR = 1e-3, 5.0
"""A rate is motion that differs from the median at rest by more than 1 mrad/s (slower than any hand; less is
sway, noise or creep), and by more than 5 times the largest deviation of the last 30 s."""
SWAYING_RATE = 20e-3
"""rad/s: at the start, a rate that varies by less for 10 s is taken for rest."""
CALM_SLOTS, SWAYING_SLOTS, MEDIAN_SLOTS = 8, 40, 120
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s."""
SAME_ATTITUDE, NEW_POSITION = 1e-4, 0.01
"""rad: a turn by less leaves the position as it is, or does not separate the bias from the earth rate."""
LONGEST_MOTION_S = 120.0
"""After a longer motion the alignment starts anew."""


@dataclass
class Position:
    """A position: an attitude in which the unit rests.

    `attitude` (3, 3) is from body axes to forward, left and up of the first position, `turn_variance` that
    of the angle about the vertical since then, rad².  The record goes when the unit leaves the position.
    `number` counts positions whose orientation differs by more than NEW_POSITION; `magnetic` (3,) is the sum
    of the magnetometer's means in body axes.
    """

    attitude: FloatArray
    turn_variance: float
    record: Record | None
    number: int
    begun_s: float
    ended_s: float = 0.0
    fit: PositionFit | None = None
    magnetic: FloatArray = field(default_factory=lambda: np.zeros(3))


class Outcome(Enum):
    """Classification of a slot."""

    WAITING = "no rest yet"
    FIRST_REST = "the first position begins"
    REST = "the slot is added to the record"
    TURNING = "the attitude follows the gyros"
    SAME_ATTITUDE = "the attitude is unchanged: the slots of the motion are added to the record"
    TURNED = "the attitude has changed: a new record begins, and the motion is left out"
    LOST = "motion for too long: the alignment starts anew"


@dataclass
class Motion:
    """State of the motion detector."""

    rest_rate: FloatArray | None = None
    """Median rate at rest, rad/s, (3,); None before the first rest."""
    limit: float = MOTION_RATE
    """Distance from it that is still rest, rad/s."""
    recent: list[FloatArray] = field(default_factory=list)
    """Rates of slots at rest in this position, of the last 30 to 40 s."""
    since_update: int = 0
    """Slots at rest since the median was updated, in earlier positions, too: a strong sway is taken for turns
    until then."""
    held: list[Slot] = field(default_factory=list)
    """Slots of the motion; before the first rest, those that may belong to it."""
    turned: Turn = STILL
    """Since the motion began."""

    def classify(self, slot: Slot, at_rest: bool) -> Outcome:
        """Classify a slot by the table of docs/alignment.md, evaluated top down."""
        if self.rest_rate is None:
            self.held = [*self.held[1 - 4 * MEDIAN_SLOTS :], slot]
            return Outcome.FIRST_REST if at_rest and self._first_rest() else Outcome.WAITING
        if not (self.moving or self._is_motion(slot)):
            return Outcome.REST
        self.held.append(slot)
        if self.moving_s > LONGEST_MOTION_S:
            return Outcome.LOST
        if any(self._is_motion(one) for one in self.held[-CALM_SLOTS:]):
            return Outcome.TURNING
        return Outcome.SAME_ATTITUDE if self.angle <= max(SAME_ATTITUDE, 6.0 * self.noise) else Outcome.TURNED

    def _first_rest(self) -> bool:
        """Return whether the unit rests for the first time; if so, drop the held slots before that rest."""
        rates = np.array([one.rate for one in self.held[-SWAYING_SLOTS:]])
        calm = len(rates) >= CALM_SLOTS and np.ptp(rates[-CALM_SLOTS:], axis=0).max() < MOTION_RATE
        if not (calm or (len(rates) == SWAYING_SLOTS and np.ptp(rates, axis=0).max() < SWAYING_RATE)):
            return False
        self._update_rest_rate(rates[-CALM_SLOTS:] if calm else rates)
        while any(self._is_motion(one) for one in self.held):
            del self.held[0]
        return True

    def _is_motion(self, slot: Slot) -> bool:
        assert self.rest_rate is not None
        return float(np.abs(slot.rate - self.rest_rate).max()) > self.limit

    def _update_rest_rate(self, rates: FloatArray) -> None:
        self.rest_rate = np.median(rates, axis=0)
        self.limit = max(MOTION_RATE, LIMIT_FACTOR * float(np.abs(rates - self.rest_rate).max()))
        self.since_update = 0

    def add_rest(self, rate: FloatArray) -> None:
        """Add the rate of a slot at rest; update the median every 10 s."""
        self.recent.append(rate)
        self.since_update += 1
        if self.since_update >= SWAYING_SLOTS:
            del self.recent[:-MEDIAN_SLOTS]
            self._update_rest_rate(np.array(self.recent))

    def follow(self, turn: Turn) -> FloatArray:
        """Add the turn of a slot; return its rotation, (3, 3)."""
        assert self.rest_rate is not None
        turn = turn.less(self.rest_rate)
        self.turned = self.turned.then(turn)
        return turn.rotation

    def end(self) -> list[Slot]:
        """End the motion; return its slots."""
        held, self.held, self.turned = self.held, [], STILL
        return held

    @property
    def moving(self) -> bool:
        """Whether the unit moves, or came to rest less than 2 s ago."""
        return self.rest_rate is not None and bool(self.held)

    @property
    def moving_s(self) -> float:
        """Length of the motion, with the calm after it."""
        return SLOT_S * (self.held[-1].index + 1 - self.held[0].index)

    @property
    def angle(self) -> float:
        """Angle between the attitudes before and now, rad."""
        return math.sqrt(max(3.0 - float(np.trace(self.turned.rotation)), 0.0))

    @property
    def noise(self) -> float:
        """Noise of that angle, rad: of the slots, and of the rate at rest."""
        if len(self.recent) < 2:
            return SAME_ATTITUDE
        spread = float(np.std(np.array(self.recent), axis=0).max()) * self.held[-1].length_s
        return spread * math.sqrt(len(self.held) + len(self.held) ** 2 / len(self.recent))

    def turn_variance(
        self, before: FloatArray, after: FloatArray, seconds: float, scale_sd: float, level_sd: float
    ) -> float:
        """Return the variance of the angle about the vertical by which the unit has turned, rad².

        `before` (3, 3) is the attitude at the beginning, `after` (3,) the vertical by the accelerometers
        after `seconds`; `scale_sd` is that of scale factor and misalignment of the gyros, and `level_sd` that
        of the vertical, rad.
        """
        # Of the angles about forward, left and up.
        forward, left, up = (
            scale_sd**2 * float(np.sum(self.turned.scale_about(axis) ** 2))
            + self.turned.sampling_variance(axis)
            for axis in before
        )
        # The earth rate turns against the body: up to all of it is wrong while it turns by a radian.
        drift = EARTH_RATE * seconds * min(self.turned.path, 1.0)
        # Errors of the level beyond that, as gravity shows them, are as likely in the vertical axis.
        ahead_off, left_off, _ = before @ (self.turned.rotation @ after)
        unexplained = 0.5 * (ahead_off**2 + left_off**2 - forward - left) - level_sd**2
        return up + self.noise**2 + drift**2 + max(float(unexplained), 0.0)
