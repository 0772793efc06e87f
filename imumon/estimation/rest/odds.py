"""Of a steady rate that is not the nominal bias: is it a turn, or has the bias changed?  The odds, and the
likelihood ratios by gravity and by a compass."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.slots import Second
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

USUAL_CHANGE = 50.0 * DEG_PER_H
"""Changes of a bias are half-Cauchy of this scale, rad/s."""
TURNS = np.radians([0.01, 300.0])
"""Turns are as likely on a logarithmic scale between these, rad/s."""
OBLIQUE = 0.3
"""Share of a rate across the vertical from which on gravity is compared: no turntable leans so much (17°)."""
EXCLUDED_SIGMAS = 6.0
"""An oblique turn by more than so many sigmas of the tilt is excluded where the unit has tilted by less than
half as many: a chamber on a cycle, measured, is rest for 95 % of its time without, and for 98 % with it."""
LEVEL_RATIO = 3.0
"""The level part of a change over the vertical one from which on that decides for the whole."""
COMPASS_ERROR = 0.15
"""Error of a change of heading over that change: hard and soft iron.  Assumed."""
COMPASS_NOISE = 0.01
"""rad, least standard deviation of a heading: a device gives its yaw in steps, and filters it."""
MOST_LOG_RATIO = 50.0
TINY = 1e-24
BEGAN_TURNING = 0.05
"""Prior that the first rest of a recording was a turn, where two steady means cannot both be the bias."""


def probability_of_turn(
    change: FloatArray, log_ratio: float, others: float, largest: float, changes: int
) -> float:
    """Return the probability that a mean which differs from the bias by `change`, rad/s, (3,), is a turn.

    With equal priors, a log-uniform density of turns and a half-Cauchy one of changes of the bias, u in units
    of `USUAL_CHANGE`, the odds are π/(2 ln(300/0.01)) (u + 1/u) (1 + changes): of as many changes as there
    were one may be of the bias.  No bias changes by more than `largest`.

    Parameters
    ----------
    log_ratio : float
        Log likelihood ratio of a changed bias over a turn, by other sensors.
    others : float
        Odds of other explanations over a turn: `as_predicted`, `first_was_turn`.
    """
    size = math.sqrt(float(change @ change))
    u = max(size, TURNS[0]) / USUAL_CHANGE  # below the slowest turn the odds stay
    changed = 2.0 * math.log(TURNS[1] / TURNS[0]) / (math.pi * (u + 1.0 / u) * (1.0 + changes))
    no_turn = (changed if size <= largest else 0.0) + others
    return 1.0 / (1.0 + no_turn * math.exp(max(min(log_ratio, MOST_LOG_RATIO), -MOST_LOG_RATIO)))


def as_predicted(difference: FloatArray, variance: FloatArray) -> float:
    """Return the odds of the nominal bias over a turn: high where its prediction is vague, (3,) each."""
    size2 = float(difference @ difference) + TINY
    along = (float(difference**2 @ variance) + TINY * float(variance.max())) / size2
    density = 2.0 * math.exp(-0.5 * size2 / along) / math.sqrt(2.0 * math.pi * along)
    return density * math.sqrt(size2) * math.log(float(TURNS[1] / TURNS[0]))


def by_gravity(
    seconds: Sequence[Second],
    bias: FloatArray,
    change: FloatArray,
    variance: float,
    noise: float,
    drift: float,
) -> float:
    """Return the log likelihood ratio of a changed bias over a turn by how gravity moved.

    A turn is about the vertical, or oblique.  An oblique one tilts the unit by the angle turned, a change of
    the bias does not.  In one about the vertical the level axes show the noise of the bias alone.

    Parameters
    ----------
    seconds : sequence of Second
        Up to 16 s of rest.
    bias, change : array (3,)
        The bias, and by how much the rate differs from it, rad/s; `variance` is that of an axis.
    noise, drift : float
        Variance of the mean force of each of the seconds, (m/s²)², and drift of the accelerometers, m/s³.
    """
    force = seconds[-1].force
    gravity = math.sqrt(float(force @ force))
    if len(seconds) < 3 or not gravity > 0.5 * STANDARD_GRAVITY:
        return 0.0
    up = force / gravity
    upright2 = float(change @ up) ** 2
    level2 = float(change @ change) - upright2
    if level2 < OBLIQUE**2 * (level2 + upright2):
        return 0.0
    later = seconds[1:]
    elapsed = sum(one.seconds for one in later)
    turn = sum((one.seconds * (one.rate - bias) for one in later), np.zeros(3))
    turn -= (turn @ up) * up
    tilt = np.cross(force, seconds[0].force) / gravity**2
    of_tilt = ((math.sqrt(2.0 * noise) + drift * elapsed) / gravity) ** 2
    turn2, tilt2 = float(turn @ turn), float(tilt @ tilt)
    excluded = turn2 > EXCLUDED_SIGMAS**2 * of_tilt > 4.0 * tilt2
    if excluded and level2 > LEVEL_RATIO**2 * upright2:
        return MOST_LOG_RATIO
    left = tilt - turn
    oblique = 0.5 * (float(left @ left) / (of_tilt + variance * elapsed**2) - tilt2 / of_tilt)
    # About the vertical: what the level axes show is noise of the bias, or a change of it.
    upright = 0.5 * level2 / variance + math.log(variance * USUAL_CHANGE / (USUAL_CHANGE**2 + level2) ** 1.5)
    return math.log(2.0) - float(np.logaddexp(-oblique, -max(upright, 0.0)))


def by_compass(seconds: Sequence[Second], bias: FloatArray) -> float:
    """Return the log likelihood ratio of no turn over one about the vertical by what the rate exceeds a
    bias, rad/s, (3,).

    Both hypotheses give the angle by which the heading has turned since the first of the seconds, with one
    variance; its sense is not compared, for not all devices count the yaw alike.
    """
    seconds = [one for one in seconds if np.isfinite(one.heading[0]) and one.force.any()]
    if len(seconds) < 4:
        return 0.0
    heading, force = (
        np.array(part) for part in zip(*((one.heading, one.force) for one in seconds), strict=True)
    )
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    angle = abs(float(sum(one.seconds * (one.rate - bias) for one in seconds[1:]) @ up[-1]))
    if not heading[:, 2].any():  # a yaw has two components
        up = np.array([[0.0, 0.0, 1.0]])
    north = heading - (heading * up).sum(1, keepdims=True) * up
    turned = np.unwrap(np.arctan2(north @ np.cross(up[-1], north[0]), north @ north[0]))
    found, noise2 = abs(float(turned[-1])), float((np.diff(turned, 2) ** 2).mean()) / 3.0
    variance = noise2 + COMPASS_NOISE**2 + (COMPASS_ERROR * angle) ** 2
    return ((found - angle) ** 2 - found**2) / (2.0 * variance)


def first_was_turn(first: FloatArray, now: FloatArray) -> float:
    """Return the odds that the first mean, rad/s, (3,), had a turn in it, over that this one has.

    Of the biases of a gyro nobody knows the scale s: with a density of 1/s, a mean of size m is the bias
    with a density of 1/m³.
    """
    larger = (float(first @ first) + EARTH_RATE**2) / (float(now @ now) + EARTH_RATE**2)
    return BEGAN_TURNING * math.sqrt(larger) ** 3
