"""A steady rate that is not the nominal bias: a turn, or a changed bias?

Odds are of another explanation over a turn; log ratios are log likelihood ratios of a changed bias over a
turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.slots import Measurement
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

USUAL_CHANGE = 50.0 * DEG_PER_H
"""Changes of a bias are half-Cauchy of this scale, rad/s."""
TURNS = np.radians([0.01, 300.0])
"""Turns are as likely on a logarithmic scale between these, rad/s."""
OBLIQUE = 0.3
"""Share of a rate across the vertical from which on gravity is compared: no turntable leans so much (17°)."""
EXCLUDED_SIGMAS = 4.0
"""An oblique turn by more than so many sigmas of the tilt is excluded where the unit has tilted by less than
half as many, where the change is more about level axes than about the vertical."""
MOSTLY_LEVEL = 1.5
"""Least square of the level part of such a change over that of the vertical one: flicker moves all axes."""
COMPASS_ERROR = 0.15
"""Error of a change of heading over that change: hard and soft iron.  Assumed."""
COMPASS_NOISE = 0.01
"""rad, least standard deviation of a heading: a device gives its yaw in steps, and filters it."""
MOST_LOG_RATIO = 50.0
IMPOSSIBLE = 1e-9
"""Odds of a bias that has changed by more than it can, over a turn: other sensors may exclude the turn."""
LEAST_MEASUREMENTS = 3
"""Least number of measurements by which gravity is compared."""
BEGAN_TURNING = 0.05
"""Prior that the first rest of a recording was a turn, where two steady means cannot both be the bias."""


def probability_of_turn(
    change: FloatArray, log_ratio: float, others: float, largest: float, changes: int
) -> float:
    """Return the probability that a mean which differs from the bias by `change`, rad/s, (3,), is a turn.

    With equal priors, a log-uniform density of turns and a half-Cauchy one of changes of the bias, u in units
    of `USUAL_CHANGE`, the odds are π/(2 ln(300/0.01)) (u + 1/u) (1 + changes): of as many changes as there
    were one may be of the bias.  No bias changes by more than `largest`.  `log_ratio` is by other sensors,
    and `others` are the odds of other explanations: `nominal_odds`, `first_turn_odds`.
    """
    size = math.sqrt(float(change @ change))
    u = max(size, TURNS[0]) / USUAL_CHANGE  # below the slowest turn the odds stay
    changed = 2.0 * math.log(TURNS[1] / TURNS[0]) / (math.pi * (u + 1.0 / u) * (1.0 + changes))
    no_turn = (changed if size <= largest else IMPOSSIBLE) + others
    return 1.0 / (1.0 + no_turn * math.exp(max(min(log_ratio, MOST_LOG_RATIO), -MOST_LOG_RATIO)))


def nominal_odds(change: FloatArray, variance: FloatArray) -> float:
    """Return the odds of the nominal bias, high where its prediction is vague; rad/s, (rad/s)², (3,) each."""
    tiny = 1e-24
    size2 = float(change @ change) + tiny
    along = (float(change**2 @ variance) + tiny * float(variance.max())) / size2
    density = 2.0 * math.exp(-0.5 * size2 / along) / math.sqrt(2.0 * math.pi * along)
    slow = 1.0 + float(TURNS[0]) ** 2 / size2  # slower turns are unlikely
    return slow * density * math.sqrt(size2) * math.log(float(TURNS[1] / TURNS[0]))


def gravity_log_ratio(
    measurements: Sequence[Measurement],
    bias: FloatArray,
    change: FloatArray,
    variance: float,
    noise: float,
    drift: float,
) -> float:
    """Return the log ratio by how gravity moved over some measurements of one rest.

    A turn is about the vertical, or oblique.  An oblique one tilts the unit by the angle turned, a change of
    the bias does not.

    The rate differs by `change` from the bias, rad/s, (3,), which has a `variance` of an axis, (rad/s)².
    `noise` is the variance of the force of a measurement, (m/s²)², and `drift` that of accelerometers, m/s³.
    """
    force = measurements[-1].force
    gravity = math.sqrt(float(force @ force))
    if len(measurements) < LEAST_MEASUREMENTS or not gravity > 0.5 * STANDARD_GRAVITY:
        return 0.0
    up = force / gravity
    vertical2 = float(change @ up) ** 2
    level2 = float(change @ change) - vertical2
    if level2 < OBLIQUE**2 * (level2 + vertical2):
        return 0.0
    elapsed = sum(one.covered_s for one in measurements[1:])
    turn = _turned(measurements, bias)
    turn -= (turn @ up) * up
    tilt = np.cross(force, measurements[0].force) / gravity**2
    tilt_variance = ((math.sqrt(2.0 * noise) + drift * elapsed) / gravity) ** 2
    turn2, tilt2 = float(turn @ turn), float(tilt @ tilt)
    excluded = turn2 > EXCLUDED_SIGMAS**2 * tilt_variance > 4.0 * tilt2
    if excluded and level2 > MOSTLY_LEVEL * vertical2:
        return MOST_LOG_RATIO
    left = tilt - turn
    oblique = float(left @ left) / (tilt_variance + variance * elapsed**2) - tilt2 / tilt_variance
    return math.log(2.0) - float(np.logaddexp(-0.5 * oblique, 0.0))


def _turned(measurements: Sequence[Measurement], bias: FloatArray) -> FloatArray:
    """Return the angle turned since the first measurement, rad, (3,), if the bias is this, rad/s, (3,)."""
    return sum((one.covered_s * (one.rate - bias) for one in measurements[1:]), np.zeros(3))


def compass_log_ratio(measurements: Sequence[Measurement], bias: FloatArray) -> float:
    """Return the log ratio of no turn over one about the vertical by the rate less a bias, rad/s, (3,).

    Both hypotheses give the angle by which the heading has turned since the first measurement, with one
    variance; its sense is not compared, for not all devices count the yaw alike.
    """
    measurements = [one for one in measurements if np.isfinite(one.heading[0]) and one.force.any()]
    if len(measurements) < 4:
        return 0.0
    heading = np.array([one.heading for one in measurements])
    force = np.array([one.force for one in measurements])
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    angle = abs(float(_turned(measurements, bias) @ up[-1]))
    if not heading[:, 2].any():  # a yaw has two components
        up = np.array([[0.0, 0.0, 1.0]])
    north = heading - (heading * up).sum(1, keepdims=True) * up
    turned = np.unwrap(np.arctan2(north @ np.cross(up[-1], north[0]), north @ north[0]))
    by_compass, noise2 = abs(float(turned[-1])), float((np.diff(turned, 2) ** 2).mean()) / 3.0
    variance = noise2 + COMPASS_NOISE**2 + (COMPASS_ERROR * angle) ** 2
    return ((by_compass - angle) ** 2 - by_compass**2) / (2.0 * variance)


def first_turn_odds(first: FloatArray, now: FloatArray) -> float:
    """Return the odds that the first mean, rad/s, (3,), had a turn in it, over that this one has.

    Of the biases of a gyro nobody knows the scale s: with a density of 1/s, a mean of size m is the bias
    with a density of 1/m³.
    """
    larger = (float(first @ first) + EARTH_RATE**2) / (float(now @ now) + EARTH_RATE**2)
    return BEGAN_TURNING * math.sqrt(larger) ** 3
