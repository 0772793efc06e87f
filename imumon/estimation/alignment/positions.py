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

TURNING = 1e-3
"""rad/s: a rate that differs by less from that at rest is sway, noise or creep; a hand is not slower."""
SWAYING = 20e-3
"""rad/s: a rate that varies by less for PATIENT slots is taken for rest at the start."""
FARTHEST = 5.0
"""A rate is no rest's beyond so many times the largest of the last half minute."""
CALM, PATIENT, RECENT, RENEWED = 8, 40, 120, 40
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s, every 10 s."""
SAME = 1e-4
"""rad: a turn by less leaves the position as it is, which costs less than 0.006° of heading."""
NEW_POSITION = 0.01
"""rad: a turn by less does not tell the bias from the earth rate."""
SIGMAS = 6.0
LONGEST_S = 120.0
"""After a longer motion the alignment begins anew."""


class Slot(NamedTuple):
    """A slot: middle and length, s, samples, mean rate and specific force (6,), and the rates as floats."""

    time_s: float
    length_s: float
    samples: int
    values: FloatArray
    rate: tuple[float, float, float]


@dataclass
class Stance:
    """Where the unit rested.

    Parameters
    ----------
    attitude : array, (3, 3)
        Body axes to the reference frame: forward, left and up of the first position.
    turn_variance : float
        Of the angle about the vertical since the first position, rad².
    record : Record or None
        Its rows; none once the unit has left it.
    fit : PositionFit or None
    number : int
        Counts positions whose orientation differs by more than NEW_POSITION.
    begun_s, ended_s : float
    """

    attitude: FloatArray
    turn_variance: float
    record: Record | None
    number: int
    begun_s: float
    fit: PositionFit | None = None
    ended_s: float = 0.0


class Outcome(Enum):
    """What a slot is."""

    WAITING = "no rest yet"
    FIRST_REST = "the first position begins"
    REST = "the slot counts"
    TURNING = "the attitude follows the gyros"
    BACK = "the unit rests as before: the slots of the motion count"
    TURNED = "the unit rests otherwise: a new record, and the motion is left out"
    LOST = "motion for too long: the alignment begins anew"


@dataclass
class Motion:
    """What is known of rest and turn.

    Parameters
    ----------
    base : array, (3,), or None
        Median rate at rest, rad/s; None before the first rest.
    limit : float
        Distance from it that is still rest, rad/s.
    recent : list
        Rates of the last slots at rest; before the first rest, of all slots.
    held : list of Slot
        Slots of the motion, and before the first rest those that may belong to it.
    calm : int
        Slots within the limit, the last ones of the motion.
    turning : bool
    turned : Turn
        Since the motion began.
    """

    base: FloatArray | None = None
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limit: float = TURNING
    recent: list[tuple[float, float, float]] = field(default_factory=list)
    since_renewed: int = 0
    held: list[Slot] = field(default_factory=list)
    calm: int = 0
    turning: bool = False
    turned: Turn = STILL

    def classify(self, slot: Slot, at_rest: bool) -> Outcome:
        """Return what a slot is; the table of docs/alignment.md, from above."""
        if self.base is None:
            return self._first(slot, at_rest)
        x, y, z = slot.rate
        a, b, c = self.centre
        moving = max(abs(x - a), abs(y - b), abs(z - c)) > self.limit
        if not (moving or self.turning):
            return Outcome.REST
        self.turning = True
        self.held.append(slot)
        self.calm = 0 if moving else self.calm + 1
        if self.moving_s > LONGEST_S:
            return Outcome.LOST
        if self.calm < CALM:
            return Outcome.TURNING
        return Outcome.BACK if self.angle <= max(SAME, SIGMAS * self.noise) else Outcome.TURNED

    def _first(self, slot: Slot, at_rest: bool) -> Outcome:
        self.held.append(slot)
        del self.held[: -4 * RECENT]
        rates = np.array([one.rate for one in self.held[-PATIENT:]])
        calm = len(rates) >= CALM and np.ptp(rates[-CALM:], axis=0).max() < TURNING
        sways = len(rates) == PATIENT and np.ptp(rates, axis=0).max() < SWAYING
        if not (at_rest and (calm or sways)):
            return Outcome.WAITING
        self.rest_rate(rates[-CALM:] if calm else rates)
        far = [k for k, one in enumerate(self.held) if self._distance(one.rate) > self.limit]
        del self.held[: far[-1] + 1 if far else 0]
        return Outcome.FIRST_REST

    def _distance(self, rate: tuple[float, float, float]) -> float:
        return max(abs(x - a) for x, a in zip(rate, self.centre, strict=True))

    def rest_rate(self, rates: FloatArray) -> None:
        """Renew the rate at rest from rates, (n, 3)."""
        self.base = np.median(rates, axis=0)
        x, y, z = self.base.tolist()
        self.centre = x, y, z
        self.limit = max(TURNING, FARTHEST * float(np.abs(rates - self.base).max()))
        self.since_renewed = 0

    def rest(self, rate: tuple[float, float, float]) -> None:
        """Add the rate of a slot at rest."""
        self.recent.append(rate)
        self.since_renewed += 1
        if self.since_renewed >= RENEWED:
            del self.recent[:-RECENT]
            self.rest_rate(np.array(self.recent))

    def follow(self, turn: Turn) -> FloatArray:
        """Add the turn of a slot; return its rotation, (3, 3)."""
        assert self.base is not None
        turn = turn.less(self.base)
        self.turned = self.turned.then(turn)
        return turn.rotation

    def settle(self) -> list[Slot]:
        """End the motion; return its slots."""
        held = self.held
        self.held, self.calm, self.turning, self.turned = [], 0, False, STILL
        return held

    @property
    def begun_s(self) -> float:
        """Beginning of the motion."""
        return self.held[0].time_s - 0.5 * self.held[0].length_s

    @property
    def moving_s(self) -> float:
        """Length of the motion, with the calm after it."""
        return self.held[-1].time_s + 0.5 * self.held[-1].length_s - self.begun_s

    @property
    def angle(self) -> float:
        """Angle between the attitudes before and now, rad."""
        return math.sqrt(max(3.0 - float(np.trace(self.turned.rotation)), 0.0))

    @property
    def noise(self) -> float:
        """Noise of that angle, rad: of the slots, and of the rate at rest."""
        if len(self.recent) < 2:
            return SAME
        spread = float(np.std(np.array(self.recent[-RECENT:]), axis=0).max())
        length_s, slots = self.held[-1].length_s, len(self.held)
        return spread * length_s * math.sqrt(slots + slots**2 / len(self.recent[-RECENT:]))


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

    Parameters
    ----------
    turn : Turn
    before : array, (3, 3)
        Attitude at its beginning.
    after : array, (3,)
        Vertical after it by the accelerometers, body axes.
    seconds : float
    noise : float
        Of the gyros' angle, rad.
    scale_sd : float
        Of scale factor and misalignment of the gyros.
    level_sd : float
        Of the vertical by the accelerometers, rad.
    """
    scale = [scale_sd**2 * float(np.sum(turn.scale_about(axis) ** 2)) for axis in before]
    sampling = [turn.sampling_variance(axis) for axis in before]
    # The earth rate turns against the body: up to all of it is wrong while it turns by a radian.
    drift = EARTH_RATE * seconds * min(turn.path, 1.0)
    # What gravity shows to be wrong about the level axes beyond that may be wrong about the vertical, too.
    off = (before @ (turn.rotation @ after))[:2]
    expected = level_sd**2 + 0.5 * (scale[0] + scale[1] + sampling[0] + sampling[1])
    unexplained = max(0.5 * float(off @ off) - expected, 0.0)
    return scale[2] + sampling[2] + noise**2 + drift**2 + unexplained
