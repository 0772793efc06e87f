"""A steady rate that is not the bias as believed: a turn, or a change of the bias?  Odds, and what bears
witness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

USUAL_CHANGE = 50.0 * DEG_PER_H
"""Changes of a bias are half-Cauchy of this scale, rad/s."""
TURNS = np.radians([0.01, 300.0])
"""Turns are as likely on a logarithmic scale between these, rad/s."""
OBLIQUE = 0.3
"""Share of a rate across the vertical from which on gravity bears witness: no turntable leans so much
(17°)."""
PLAIN_SIGMAS = 6.0
"""Of the tilt: a turn by more, where it has tilted by less than half of it, was none."""
MOSTLY = 3.0
"""The level part over the vertical one from which on that decides for the whole."""
OBLIQUE_NO_MORE = 3.0
"""Log likelihood ratio from which on only the part about the vertical may be a turn."""
TINY = 1e-24
MOST_EVIDENCE = 50.0
COMPASS_ERROR = 0.2
"""Error of a change of heading by hard and soft iron, over that change."""
COMPASS_CLEAR = 8.0
"""Standard deviations of a reading by which a turn moves the heading before it bears witness."""
COMPASS_RAD = 0.7
"""Turn that the compass compares: much more is ambiguous."""
BEGAN_TURNING = 0.05
"""Prior that the first rest of a recording was a turn, where two steady means cannot both be the bias."""

LEANING = 0.04
"""rad: by so much accelerometers with a bias of 40 mg miss the vertical."""


class Second(NamedTuple):
    """Means over about a second in which the unit was quiet."""

    end_s: float
    seconds: float
    """What its samples cover: the white noise is that of so long."""
    rate: FloatArray
    """rad/s, (3,)."""
    force: FloatArray
    """m/s², (3,); NaN without accelerometers."""
    degc: FloatArray
    """Temperature of each gyro, (3,); NaN without one."""
    heading: FloatArray
    """A vector that turns with the heading, (3,) (`imumon.estimation.rest.compass`); NaN without one."""


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """What bears witness to a change of the rate."""

    evidence: float = 0.0
    """Log likelihood ratio of no turn over a turn."""
    others: float = 0.0
    """Odds of what else it may be, over a turn: the bias as believed, or that the first rest was a turn."""
    change: FloatArray = field(default_factory=lambda: np.zeros(3))
    """The part of the difference that may be a turn, rad/s, (3,)."""


def probability_of_turn(witness: Witness, largest: float, changes: int) -> float:
    """Return the probability that an unexplained change of the mean, rad/s, is a turn.

    With equal priors, a log-uniform density of turns and a half-Cauchy one of changes of the bias the odds
    are π/(2 ln(300/0.01)) (d/50 + 50/d) (1 + changes): of as many changes as there were one may be of the
    bias. No bias changes by more than `largest`.
    """
    size = math.sqrt(float(witness.change @ witness.change))
    u = max(size, 1e-12) / USUAL_CHANGE
    changed = 2.0 * math.log(TURNS[1] / TURNS[0]) / (math.pi * (u + 1.0 / u) * (1.0 + changes))
    no_turn = (changed if size <= largest else 0.0) + witness.others
    return 1.0 / (1.0 + no_turn * math.exp(max(min(witness.evidence, MOST_EVIDENCE), -MOST_EVIDENCE)))


def as_believed(difference: FloatArray, variance: FloatArray) -> float:
    """Return the odds of the bias as believed over a turn: much where its law has become vague, (3,) each."""
    size2 = float(difference @ difference) + TINY
    along = (float(difference**2 @ variance) + TINY * float(variance.max())) / size2
    density = 2.0 * math.exp(-0.5 * size2 / along) / math.sqrt(2.0 * math.pi * along)
    return density * math.sqrt(size2) * math.log(float(TURNS[1] / TURNS[0]))


def by_gravity(
    history: Sequence[Second],
    change: FloatArray,
    turn: FloatArray,
    variance: float,
    noise: float,
    drift: float,
) -> tuple[float, FloatArray]:
    """Return the evidence of gravity, unmoved or moved as by a turn, and the part of the change
    that may be a turn, rad/s, (3,).

    A turn is about the vertical, or oblique.  Of an oblique one, the tilt is normal about the angle turned;
    of a change of the bias, about none.  Of one about the vertical the level axes show the noise of the
    bias alone, else a change of it.

    Parameters
    ----------
    history : sequence of Second
        Up to 16 s of rest.
    change, turn : array (3,)
        By how much the rate differs from the bias, rad/s, and the angle by which it has turned since the
        first of the seconds if that is a turn, rad; `variance` is that of an axis of the difference.
    noise, drift : float
        Variance of the mean force of a second, (m/s²)², and drift of the accelerometers, m/s³.
    """
    force = history[-1].force
    gravity = math.sqrt(float(force @ force))
    if len(history) < 3 or not gravity > 0.5 * STANDARD_GRAVITY:
        return 0.0, change
    up = force / gravity
    across = change - (change @ up) * up
    if math.sqrt(float(across @ across)) < OBLIQUE * math.sqrt(float(change @ change)):
        return 0.0, change
    level2 = float(across @ across)
    seconds = sum(one.seconds for one in history[1:])
    turn = turn - (turn @ up) * up
    tilt = cross(force, history[0].force) / (gravity * gravity)
    of_tilt = ((math.sqrt(2.0 * noise) + drift * seconds) / gravity) ** 2
    of_turn = of_tilt + variance * seconds * seconds
    oblique = 0.5 * (float((tilt - turn) @ (tilt - turn)) / of_turn - float(tilt @ tilt) / of_tilt)
    plain2 = PLAIN_SIGMAS**2 * of_tilt
    excluded = float(turn @ turn) > plain2 > 4.0 * float(tilt @ tilt)
    if excluded and level2 > MOSTLY**2 * float(change @ up) ** 2:
        return MOST_EVIDENCE, change  # most of it is no turn, whatever the bias was: nor is the rest
    # About the vertical: what the level axes show is noise of the bias, or a change of it.
    upright = 0.5 * level2 / variance + math.log(variance * USUAL_CHANGE / (USUAL_CHANGE**2 + level2) ** 1.5)
    evidence = -float(np.logaddexp(-oblique, -max(upright, 0.0))) + math.log(2.0)
    return evidence, change - across if oblique > OBLIQUE_NO_MORE else change


def by_compass(recent: Sequence[Second], change: FloatArray) -> float:
    """Return the evidence of the heading, in the same way, for a turn by `change`, rad/s, (3,)."""
    size = math.sqrt(float(change @ change))
    now = recent[-1]
    if size == 0.0 or not np.isfinite(now.heading[0]):
        return 0.0
    since = [one for one in recent if (now.end_s - one.end_s) * size < COMPASS_RAD]
    seconds = now.end_s - since[0].end_s
    readings = np.array([one.heading for one in since])
    if len(readings) < 3 or not np.isfinite(readings).all():
        return 0.0
    second_differences = readings[2:] - 2.0 * readings[1:-1] + readings[:-2]
    noise = math.sqrt(2.0 * float((second_differences**2).sum(1).mean()) / 6.0)
    start, moved = readings[0], readings[-1] - readings[0]
    # The field turns against the body; a yaw has no third component, and its sense depends on the axes.
    axis, senses = (np.array([0.0, 0.0, 1.0]), (1.0, -1.0)) if start[2] == 0.0 else (change / size, (-1.0,))
    turned = [rotated(start, axis, sense * size * seconds) - start for sense in senses]
    clear = float(np.linalg.norm(turned[0]))
    if not clear > COMPASS_CLEAR * noise or clear < 1e-9:
        return 0.0
    sd2 = noise * noise + (COMPASS_ERROR * clear) ** 2
    return float(min(((moved - one) ** 2).sum() for one in turned) - (moved**2).sum()) / (2.0 * sd2)


def first_was_turn(first: FloatArray, now: FloatArray) -> float:
    """Return the odds that the first mean, rad/s, (3,), had a turn in it, over that this one has.

    Of the biases of a gyro nobody knows the scale s: with a density of 1/s, a mean of size m is the bias
    with a density of 1/m³.
    """
    larger = (float(first @ first) + EARTH_RATE**2) / (float(now @ now) + EARTH_RATE**2)
    return BEGAN_TURNING * math.sqrt(larger) ** 3


def at_first(mean: FloatArray, up: FloatArray, share: float) -> FloatArray:
    """Return the rms of the turn about the vertical that may be in the first mean, rad/s, (3,).

    A share of recordings begins in a turn.  The other axes read their bias, and so say how large one may
    be: of biases of one scale, with a density of one over it, two of size L say of a third that it has
    Student's density with two degrees of freedom.

    Parameters
    ----------
    mean, up : array (3,)
        Up is the direction of the specific force; NaN without: then it is the axis that reads most.
    """
    up = up if np.isfinite(up).all() else np.eye(3)[int(np.abs(mean).argmax())]
    along = float(mean @ up)
    others2 = float(mean @ mean) - along**2 + EARTH_RATE**2
    turns = np.geomspace(TURNS[0], TURNS[1], 120)
    turns = np.concatenate([-turns[::-1], turns])
    likely = share / len(turns) * (others2 + (along - turns) ** 2) ** -1.5
    none = (1.0 - share) * (others2 + along**2) ** -1.5
    rms = math.sqrt(float(likely @ turns**2) / (none + float(likely.sum())))
    return np.asarray(rms * np.hypot(up, LEANING))


def rotated(vector: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Return a vector turned about a unit axis (Rodrigues)."""
    along = (vector @ axis) * axis
    across = vector - along
    return np.asarray(along + math.cos(angle) * across + math.sin(angle) * cross(axis, vector))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product, (3,): `numpy.cross` takes thirty times as long for one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
