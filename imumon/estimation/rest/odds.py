"""P(turn): is a steady rate a turn, or the bias?  A Bayesian test of one hypothesis against three others.

The present bias differs by the vector d from the nominal bias, which is predicted as if nothing had changed
(see `imumon.estimation.rest`).  Here |d| and σ, its standard deviation along d, are in °/h.  n is how often
the rate had changed before, since a measurement fitted the nominal bias (`Hypotheses.changes` less one).
Turns are log-uniform from 36 °/h (0.01 °/s) to 300 °/s: the density of their size is 1/(D |d|), D = ln 30000.
Slower ones are rare: c = 1 + (36/|d|)² divides it.

All ratios in this *odds table* are those of no turn over a turn: o by the prior and the gyros, each for one
explanation of d, Λ by another sensor, and Λ0 the plain likelihood ratio of that sensor::

    P(turn) = 1 / (1 + Λ_gravity Λ_heading (o_changed + o_nominal + o_first))

    o_changed = 2 D c / (π (|d|/50 + 50/|d|) (1 + n))       the bias has changed: half-Cauchy of 50 °/h, and
                                                            prior odds of 1 : 1 + n, as a hand changes its
                                                            rate more often than a bias
    o_nominal = 2 N(|d|; 0, σ²) |d| D c                     nothing has changed: the nominal bias was vague
    o_first   = 0.05 (size of the first rate / of this)³    the first rest was a turn, and this is the bias;
                                                            0 till 4 s after a change, or in a new pose

    Λ_gravity = 2 / (1 + 1/Λ0)                              an oblique turn tilts the unit by its angle
    Λ_heading = 1 / (0.95/Λ0 + 0.05)                        a turn turns magnetometer or yaw by its angle,
                                                            unless one is stuck or iron is near
"""

import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import cross_matrix
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

from .slots import Measurement

USUAL_CHANGE = 50.0 * DEG_PER_H  # rad/s, scale of half-Cauchy changes of a bias: MEMS gyros.  Assumed.
SLOWEST_TURN, FASTEST_TURN = math.radians(0.01), math.radians(300.0)  # rad/s, of log-uniform turns.  Assumed.
LOG_RANGE = math.log(FASTEST_TURN / SLOWEST_TURN)  # D of the odds table, a natural logarithm
OBLIQUE = 0.3  # share of a rate across the vertical from which gravity is compared: no turntable leans by 17°
# A turn is excluded if gyros show more than `EXCLUDED_SIGMAS` of tilt, gravity less than half as many, and
# more than `MOSTLY_LEVEL` of |d|² is about level axes: it is 2/3 if a bias changes alike in all axes, and
# sin² 50° = 0.59 if a turn is about an axis that leans by 50° from the vertical.  Assumed.
EXCLUDED_SIGMAS = 4.0
MOSTLY_LEVEL = 0.6
HEADING_ERROR = 0.15  # error of a change of heading over that change: hard and soft iron.  Assumed.
HEADING_NOISE = 0.01  # rad, least sd of a heading: a device gives its yaw in steps, and filters it.  Assumed.
STUCK_HEADING = 0.05  # prior probability that a heading does not follow: stuck, or iron does.  Assumed.
EXCLUDED_LOG_RATIO = 50.0  # ln Λ of an excluded turn; beyond ± this ln(Λ_gravity Λ_heading) changes nothing
EVIDENT_LOG_RATIO = -2.0  # ln(Λ_gravity Λ_heading) below which a turn is evident, however long.  Assumed.
LEAST_MEASUREMENTS = 3  # by which gravity is compared; the noise of the heading needs one more
BEGAN_TURNING = 0.05  # prior odds that the first rest was a turn, if two means cannot both be bias.  Assumed.
# Standard deviation of a turn in the first moment of the first rest, rad/s, as steps of up to 0.09 °/s are
# always quiet (`QUIET_SD`); and the time, s, in which it falls by e: no hand stays steady for long.  Assumed.
UNSEEN_TURN, UNSEEN_S = math.radians(0.1), 2.0


def of_changed_bias(size: float, changes: int, largest: float) -> float:
    """Return the odds that the bias has changed, by |d| and n; none changes by more than `largest`, rad/s."""
    if size > largest:
        return 1e-9  # and not 0: gravity and heading may still exclude a turn
    u, rarity = size / USUAL_CHANGE, 1.0 + (SLOWEST_TURN / size) ** 2
    return 2.0 * LOG_RANGE * rarity / (math.pi * (u + 1.0 / u) * (1.0 + changes))


def of_nominal_bias(size: float, variance: float) -> float:
    """Return the odds that nothing has changed, by |d| and σ², rad/s; high where the prediction is vague."""
    sigma = math.sqrt(variance + 1e-24)  # not 0: it divides
    density = 2.0 * math.exp(-0.5 * (size / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
    return density * size * LOG_RANGE * (1.0 + (SLOWEST_TURN / size) ** 2)


def of_first_turn(first: FloatArray, now: FloatArray) -> float:
    """Return the odds that the first mean had a turn in it, and the present one has none; rad/s, (3,).

    The turn's size |d| is the same if the first or if this mean is the bias, so its density cancels.  Of the
    scale of biases nothing is known (density 1/scale), so that a bias of size m has the density 1/m³.  Both
    means may contain the earth rate: its square is added to both squares.
    """
    larger = (first @ first + EARTH_RATE**2) / (now @ now + EARTH_RATE**2)
    return BEGAN_TURNING * math.sqrt(larger) ** 3


def hidden_turn(measurements: Sequence[Measurement], force_variance: float) -> FloatArray:
    """Return the variance of a turn that may hide in the first rest, (rad/s)², (3,).

    The turn is contradicted by none of the measurements, of T seconds (15 at most: `RECENT`).  About the
    vertical it shows in no other sensor; across it gravity shows the tilt t, rad, with a variance v, rad²; an
    axis that leans has its share of both::

        about the vertical:  u² = (UNSEEN_TURN exp(-T / UNSEEN_S))²
        across it:           min(u², v / T²) + (t / T)²,    v = 2 force_variance / g², g in m/s²
    """
    first, last = measurements[0], measurements[-1]
    seconds, g = last.end_s - first.end_s, math.hypot(*last.force)
    unseen = (UNSEEN_TURN * math.exp(-seconds / UNSEEN_S)) ** 2
    if not (seconds > 0.0 and g > 0.5 * STANDARD_GRAVITY):
        return np.full(3, unseen)
    shown = min(unseen, 2.0 * force_variance / (g * seconds) ** 2)
    tilt = cross_matrix(last.force) @ first.force / g**2
    return shown + (unseen - shown) * (last.force / g) ** 2 + (tilt / seconds) ** 2


def log_ratio_by_gravity(
    measurements: Sequence[Measurement],
    bias: FloatArray,
    variance: FloatArray,
    change: FloatArray,
    force_variance: float,
    drift: float,
) -> float:
    """Return ln Λ_gravity, by how the unit has tilted.

    The nominal bias, its variance, and the `change` d from it are in rad/s, (3,); `force_variance` is that of
    a measurement, (m/s²)² or ∞; `drift` is the fastest of accelerometers, m/s³.  From the first measurement
    to the last, T seconds, the unit tilts by t, and gyros less bias turn by phi, rad, across the vertical.
    Of a turn about the vertical d is oblique, too, if level axes flicker: so each has a prior of 1/2::

        no turn, or about the vertical:  t ~ N(0, v),           v = (noise and drift of the force)² / g², rad²
        oblique turn:                    t ~ N(phi, v + s² T²), s² = variance of the bias, its largest axis
        L(turn) = (L(oblique) + L(no turn)) / 2

    Densities are taken without their norms, which make a turn less likely the longer it lasts.
    """
    first, last = measurements[0].force, measurements[-1].force
    g = math.hypot(*last)
    if len(measurements) < LEAST_MEASUREMENTS or not (g > 0.5 * STANDARD_GRAVITY and force_variance < np.inf):
        return 0.0
    across = np.eye(3) - np.outer(last, last) / g**2
    level, size = math.hypot(*(across @ change)), math.hypot(*change)
    if level <= OBLIQUE * size:
        return 0.0
    seconds = measurements[-1].end_s - measurements[0].end_s
    phi = across @ _turned(measurements, bias)
    tilt = cross_matrix(last) @ first / g**2  # a turn by phi moves f by -phi x f, so that this is phi
    still_sd = (math.sqrt(2.0 * force_variance) + drift * seconds) / g
    turn_variance = still_sd**2 + variance.max() * seconds**2
    phi_sigmas = math.hypot(*phi) / still_sd
    tilt_sigmas = math.hypot(*tilt) / still_sd
    mostly_level = level**2 > MOSTLY_LEVEL * size**2
    if mostly_level and phi_sigmas > EXCLUDED_SIGMAS and tilt_sigmas < 0.5 * EXCLUDED_SIGMAS:
        return EXCLUDED_LOG_RATIO
    log_oblique = -0.5 * ((tilt - phi) @ (tilt - phi)) / turn_variance
    log_still = -0.5 * tilt_sigmas**2
    # Λ_gravity = 2 / (1 + 1/Λ0), Λ0 = L(no turn) / L(oblique)
    return math.log(2.0) - float(np.logaddexp(log_oblique - log_still, 0.0))


def log_ratio_by_heading(measurements: Sequence[Measurement], biases: FloatArray) -> FloatArray:
    """Return ln Λ_heading, (n,), by how that has turned, for n biases, rad/s, (n, 3); 0 without a heading.

    Each hypothesis predicts the angle since the first measurement, with one variance; the sense of the angle
    is not compared, for not all devices count the yaw alike.
    """
    measurements = [one for one in measurements if np.isfinite(one.heading).all() and any(one.force)]
    if len(measurements) <= LEAST_MEASUREMENTS:
        return np.zeros(len(biases))
    vectors = np.array([one.heading for one in measurements])
    force = np.array([one.force for one in measurements])
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    angle = np.abs(_turned(measurements, biases) @ up[-1])
    is_yaw = not vectors[:, 2].any()  # `heading_of` has zero there, and a magnetic field never
    axis = np.array([[0.0, 0.0, 1.0]]) if is_yaw else up  # about which the heading turns
    north = vectors - (vectors * axis).sum(1, keepdims=True) * axis
    west = cross_matrix(axis[-1]) @ north[0]
    turned = np.unwrap(np.arctan2(north @ west, north @ north[0]))
    measured = abs(float(turned[-1]))
    # If even in time, a second difference has 6 times the variance of a heading, and the change has it twice.
    noise_variance = (np.diff(turned, 2) ** 2).mean() / 3.0
    variance = noise_variance + HEADING_NOISE**2 + (HEADING_ERROR * angle) ** 2
    follows = (measured**2 - (measured - angle) ** 2) / (2.0 * variance)  # -ln Λ0, Λ0 = L(no turn) / L(turn)
    return -np.asarray(np.logaddexp(math.log(1.0 - STUCK_HEADING) + follows, math.log(STUCK_HEADING)))


def _turned(measurements: Sequence[Measurement], bias: FloatArray) -> FloatArray:
    """Return the angle turned since the first measurement, rad, for one bias or n, rad/s, (..., 3)."""
    seconds = np.diff([one.end_s for one in measurements])
    return np.asarray(seconds @ np.array([one.rate for one in measurements[1:]]) - seconds.sum() * bias)
