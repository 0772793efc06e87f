"""Which slots are rest and which are turns: one decision table per slot.

A turn is followed by the gyros, sample by sample (`imumon.filters.turns`), less what they read at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import PositionFit
from imumon.estimation.alignment.record import Record
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE

MOTION_RATE = 1e-3
"""rad/s: a rate that differs by less from that at rest is sway, noise or creep; a hand is not slower."""
LIMIT_FACTOR = 5.0
"""Motion limit: this factor times the largest deviation from the median of the last 30 s."""
SWAYING_RATE = 20e-3
"""rad/s: a rate that varies by less for SWAYING_SLOTS slots is taken for rest at the start."""
CALM_SLOTS, SWAYING_SLOTS, MEDIAN_SLOTS = 8, 40, 120
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s."""
SAME_ATTITUDE, NEW_POSITION = 1e-4, 0.01
"""rad: a turn by less leaves the position as it is, or does not tell the bias from the earth rate."""
LONGEST_MOTION_S = 120.0
"""After a longer motion the alignment begins anew."""


class Slot(NamedTuple):
    """Middle and length of a slot, s, number of samples, mean rate (3) and specific force (3), body axes."""

    time_s: float
    length_s: float
    samples: int
    values: FloatArray

    @property
    def rate(self) -> FloatArray:
        """Mean rate, rad/s, (3,)."""
        return self.values[:3]

    @property
    def ended_s(self) -> float:
        """End of the slot, s."""
        return self.time_s + 0.5 * self.length_s


@dataclass
class Position:
    """A position: an attitude in which the unit rests.

    `attitude` (3, 3) is from body axes to forward, left and up of the first position, `turn_variance` that
    of the angle about the vertical since then, rad².  The record goes when the unit leaves the position.
    `number` counts positions whose orientation differs by more than NEW_POSITION.
    """

    attitude: FloatArray
    turn_variance: float
    record: Record | None
    number: int
    begun_s: float
    ended_s: float = 0.0
    fit: PositionFit | None = None


class Outcome(Enum):
    """Classification of a slot."""

    WAITING = "no rest yet"
    FIRST_REST = "the first position begins"
    REST = "the slot is added to the record"
    TURNING = "the attitude follows the gyros"
    SAME_ATTITUDE = "the attitude is unchanged: the slots of the motion are added to the record"
    TURNED = "the attitude has changed: a new record begins, and the motion is left out"
    LOST = "motion for too long: the alignment begins anew"


@dataclass
class Motion:
    """State of the motion detector."""

    rest_rate: FloatArray | None = None
    """Median rate at rest, rad/s, (3,); None before the first rest."""
    limit: float = MOTION_RATE
    """Distance from it that is still rest, rad/s."""
    recent: list[FloatArray] = field(default_factory=list)
    """Rates of slots at rest."""
    renewed: int = 0
    """Slots at rest since the median was taken."""
    held: list[Slot] = field(default_factory=list)
    """Slots of the motion; before the first rest those that may belong to it."""
    calm: int = 0
    """How many of the last of them were within the limit."""
    turning: bool = False
    turned: Turn = STILL
    """Since the motion began."""

    def classify(self, slot: Slot, at_rest: bool) -> Outcome:
        """Classify a slot by the table of docs/alignment.md, evaluated top down."""
        if self.rest_rate is None:
            self.held = [*self.held[1 - 4 * MEDIAN_SLOTS :], slot]
            return Outcome.FIRST_REST if at_rest and self._first_rest() else Outcome.WAITING
        moving = self._distance(slot) > self.limit
        if not (moving or self.turning):
            return Outcome.REST
        self.turning = True
        self.held.append(slot)
        self.calm = 0 if moving else self.calm + 1
        if self.moving_s > LONGEST_MOTION_S:
            return Outcome.LOST
        if self.calm < CALM_SLOTS:
            return Outcome.TURNING
        return Outcome.SAME_ATTITUDE if self.angle <= max(SAME_ATTITUDE, 6.0 * self.noise) else Outcome.TURNED

    def _first_rest(self) -> bool:
        """Return whether the unit rests for the first time; if so, drop the held slots before that rest."""
        rates = np.array([one.rate for one in self.held[-SWAYING_SLOTS:]])
        calm = len(rates) >= CALM_SLOTS and np.ptp(rates[-CALM_SLOTS:], axis=0).max() < MOTION_RATE
        if not (calm or (len(rates) == SWAYING_SLOTS and np.ptp(rates, axis=0).max() < SWAYING_RATE)):
            return False
        self._update_rest_rate(rates[-CALM_SLOTS:] if calm else rates)
        far = [k for k, one in enumerate(self.held) if self._distance(one) > self.limit]
        del self.held[: far[-1] + 1 if far else 0]
        return True

    def _distance(self, slot: Slot) -> float:
        assert self.rest_rate is not None
        return float(np.abs(slot.rate - self.rest_rate).max())

    def _update_rest_rate(self, rates: FloatArray) -> None:
        self.rest_rate = np.median(rates, axis=0)
        self.limit = max(MOTION_RATE, LIMIT_FACTOR * float(np.abs(rates - self.rest_rate).max()))
        self.renewed = 0

    def add_rest(self, rate: FloatArray) -> None:
        """Add the rate of a slot at rest; update the median after 10 s."""
        self.recent.append(rate)
        self.renewed += 1
        if self.renewed >= SWAYING_SLOTS:
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
        held, self.held, self.calm, self.turning, self.turned = self.held, [], 0, False, STILL
        return held

    @property
    def begun_s(self) -> float:
        """Beginning of the motion."""
        return self.held[0].ended_s - self.held[0].length_s

    @property
    def moving_s(self) -> float:
        """Length of the motion, with the calm after it."""
        return self.held[-1].ended_s - self.begun_s

    @property
    def angle(self) -> float:
        """Angle between the attitudes before and now, rad."""
        return math.sqrt(max(3.0 - float(np.trace(self.turned.rotation)), 0.0))

    @property
    def noise(self) -> float:
        """Noise of that angle, rad: of the slots, and of the rate at rest."""
        recent = self.recent[-MEDIAN_SLOTS:]
        if len(recent) < 2:
            return SAME_ATTITUDE
        spread = float(np.std(np.array(recent), axis=0).max()) * self.held[-1].length_s
        return spread * math.sqrt(len(self.held) + len(self.held) ** 2 / len(recent))


def turn_variance(
    turn: Turn,
    before: FloatArray,
    after: FloatArray,
    seconds: float,
    noise: float,
    scale_sd: float,
    level_sd: float,
) -> float:
    """Return the variance of the angle about the vertical of a turn, rad².

    `before` (3, 3) is the attitude at its beginning, `after` (3,) the vertical by the accelerometers after
    `seconds`; `noise` is that of the gyros' angle, rad, `scale_sd` that of their scale factor and
    misalignment, and `level_sd` that of the vertical, rad.
    """
    errors = [
        scale_sd**2 * float(np.sum(turn.scale_about(axis) ** 2)) + turn.sampling_variance(axis)
        for axis in before
    ]
    # The earth rate turns against the body: up to all of it is wrong while it turns by a radian.
    drift = EARTH_RATE * seconds * min(turn.path, 1.0)
    # What gravity shows to be wrong about the level axes beyond that may be wrong about the vertical, too.
    off = (before @ (turn.rotation @ after))[:2]
    unexplained = 0.5 * (float(off @ off) - errors[0] - errors[1]) - level_sd**2
    return errors[2] + noise**2 + drift**2 + max(unexplained, 0.0)
