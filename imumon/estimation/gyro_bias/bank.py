"""Rotation about one gyro axis at rest, its bias, and how much that bias wanders: a bank of Kalman filters.

States of a filter, for one axis of the body:

    rotation since the unit came to rest, rad: integrated rate less bias
    velocity over g, rad s: the integral of the rotation less that of the tilt by the accelerometers
    bias: what walks at random (K), and what comes and goes within 10, 100 and 1000 s, rad/s
    slope over temperature, rad/s/°C; only in the variant that learns it
    sensitivity to the specific force, rad/s per m/s², 3: a row of the matrix of `effects.g_sensitivity`

Zero velocity is a measurement of the second.  How strong the wander is, relative to the white noise, is not
known beforehand: filters side by side hold one answer each, and an interacting multiple model (Blom and
Bar-Shalom 1988) weighs them by their innovations.  All arrays have the leading axes (variant, axis, filter):
variants are without and with slope, filters are wanders for each sensitivity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.kalman import Correction, Estimate, correct, predict
from imumon.filters.noise import BiasNoise, flicker_sd

ROTATION, VELOCITY, WALK, SLOPE = 0, 1, 2, 6
WANDER, SENSITIVITY = slice(2, 6), slice(7, 10)
STATES = 10
TAUS_S = np.array([10.0, 100.0, 1000.0])
FLOOR_PER_MARKOV = 0.776
"""Floor of the Allan deviation of the three processes together, over the standard deviation of one."""
FLICKER_BELOW = 0.015
"""Random walk (per sqrt(s)) that goes on as flicker does below 1/1000 s, over the sd of one process."""
FLICKER_CORNERS_S = (640.0, 160.0, 40.0, 10.0)
"""Averaging times at which flicker noise overtakes the white noise, one filter each."""
WALK_CORNERS_S = (60.0, 12.0, 2.5)
"""The same for random walks: biases that follow an unknown temperature."""
PRIORS = (0.2, 0.2, 0.2, 0.2, 0.08, 0.07, 0.05)
LEAST_WEIGHT = 1e-30
"""What no filter's weight falls below: a weight of zero could not be divided by."""
DWELL_S = 3600.0
"""Mean time after which a bias begins to behave differently."""
UNKNOWN_BIAS = 1.0
"""Standard deviation of the bias before any measurement, rad/s."""
UNKNOWN_ROTATION = 0.01
"""The same of the rotation when the unit has come to rest, rad: how far the first reading may be off."""
SLOPE_PER_NOISE = 3.6
"""Standard deviation of a slope before any measurement, per °C and sqrt(s), over the angular random walk:
what is noisy drifts with temperature as well.  60 °/h/°C at 0.28 °/√h."""
CURVATURE_DEGC = 30.0
"""Temperature difference over which a slope changes by as much as itself."""
SLOPE_WALK = math.radians(0.02) / 3600.0
"""Random walk of the slope, rad/s/°C/sqrt(s)."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """What the filters of a bank assume of the bias.

    Parameters
    ----------
    noise : BiasNoise
        Flicker and walk of each axis and filter, (3, filters).
    prior : array (filters,)
        Weights before any measurement.
    relative : bool
        Whether the noise is in units of the axis' angular random walk, or in rad/s.
    sensitivity_sd : array (groups,)
        Standard deviations of the sensitivities to the specific force that are tried, rad/s per m/s².
    """

    noise: BiasNoise
    prior: FloatArray
    relative: bool
    sensitivity_sd: FloatArray

    @property
    def in_one_pose(self) -> Family:
        """The same without sensitivities."""
        return replace(self, sensitivity_sd=NO_SENSITIVITY)

    @property
    def filters(self) -> int:
        """Filters of an axis."""
        return len(self.prior) * len(self.sensitivity_sd)

    @property
    def prior_of_all(self) -> FloatArray:
        """Weights of all filters of an axis before any measurement, (filters,)."""
        return np.tile(self.prior, len(self.sensitivity_sd)) / len(self.sensitivity_sd)

    def scaled(self, white: FloatArray) -> BiasNoise:
        """Return the noise of all filters in rad/s; `white` (3,) is the angular random walk."""
        unit = white[:, np.newaxis] if self.relative else np.ones((3, 1))
        times = len(self.sensitivity_sd)
        markov = self.noise.markov_sd * unit[..., np.newaxis]
        walk = self.noise.walk * unit
        return BiasNoise(TAUS_S, np.concatenate([markov] * times, 1), np.concatenate([walk] * times, 1))


NO_SENSITIVITY = np.zeros(1)


def unknown_family(sensitivity_sd: FloatArray = NO_SENSITIVITY) -> Family:
    """Return the filters for a gyro of which nothing is known."""
    flicker = 1.0 / (FLOOR_PER_MARKOV * np.sqrt(FLICKER_CORNERS_S))
    walks = math.sqrt(3.0) / np.array(WALK_CORNERS_S)
    markov = np.concatenate([flicker, np.full(len(walks), flicker[1])])
    walk = np.concatenate([FLICKER_BELOW * flicker, walks])
    noise = BiasNoise(TAUS_S, np.tile(markov[:, np.newaxis], (3, 1, 3)), np.tile(walk, (3, 1)))
    return Family(noise, np.array(PRIORS), True, sensitivity_sd)


def known_family(
    bias_instability: FloatArray, rate_random_walk: FloatArray, sensitivity_sd: FloatArray = NO_SENSITIVITY
) -> Family:
    """Return the one filter for a gyro whose B and K are known, (3,) each, rad/s and rad/s/sqrt(s)."""
    markov = flicker_sd(bias_instability, TAUS_S)[:, np.newaxis]
    noise = BiasNoise(TAUS_S, markov, rate_random_walk[:, np.newaxis])
    return Family(noise, np.ones(1), False, sensitivity_sd)


@dataclass(slots=True, eq=False)
class Bank:
    """The filters of three axes, without and (when it is learned) with slope.

    Parameters
    ----------
    family : Family
    estimate : Estimate
        States and covariances, (variants, 3, filters, 10) and one axis more.
    weight : array (variants, 3, filters)
        Probabilities.
    """

    family: Family
    estimate: Estimate
    weight: FloatArray


def start(family: Family, variants: int, white: FloatArray) -> Bank:
    """Return a bank that knows nothing; `white` (3,) is the angular random walk, rad/sqrt(s)."""
    shape = (variants, 3, family.filters)
    p = np.zeros((*shape, STATES, STATES))
    markov = family.scaled(white).markov_sd
    p[..., WALK, WALK] = UNKNOWN_BIAS**2
    for i in range(len(TAUS_S)):
        p[..., WALK + 1 + i, WALK + 1 + i] = markov[..., i] ** 2
    p[1:, ..., SLOPE, SLOPE] = (SLOPE_PER_NOISE * white[:, np.newaxis]) ** 2
    sensitivity = np.repeat(family.sensitivity_sd, len(family.prior))
    for i in range(SENSITIVITY.start, SENSITIVITY.stop):
        p[..., i, i] = sensitivity**2
    weight = np.tile(family.prior_of_all, (variants, 3, 1))
    return Bank(family, Estimate(np.zeros((*shape, STATES)), p), weight)


def widen(bank: Bank, family: Family) -> None:
    """Let a bank that knew of no sensitivity to the specific force try those of a family.

    Until the pose changes all groups are the same: so it costs nothing to have one of them up to then.
    """
    times, wanders = len(family.sensitivity_sd), len(family.prior)
    x, p = (np.concatenate([part] * times, 2) for part in bank.estimate)
    sensitivity = np.repeat(family.sensitivity_sd, wanders)
    for i in range(SENSITIVITY.start, SENSITIVITY.stop):
        p[..., i, i] = sensitivity**2
    bank.family, bank.estimate = family, Estimate(x, p)
    bank.weight = np.concatenate([bank.weight] * times, 2) / times


def come_to_rest(bank: Bank, flat: FloatArray, arrival: FloatArray | float = 0.0) -> None:
    """Forget rotation and velocity; the bias stays.

    Parameters
    ----------
    flat : array (3,)
        Share of each axis in which gravity shows the rotation; the rest is heading, which has not changed at
        the start of a rest.
    arrival : array (3,)
        What another attitude adds to the variance of the bias, (rad/s)².
    """
    x, p = bank.estimate.mean.copy(), bank.estimate.covariance.copy()
    x[..., :WALK] = 0.0
    p[..., :WALK, :] = 0.0
    p[..., :, :WALK] = 0.0
    p[..., ROTATION, ROTATION] = flat[:, np.newaxis] * UNKNOWN_ROTATION**2
    p[..., WALK, WALK] += np.broadcast_to(arrival, 3)[:, np.newaxis]
    bank.estimate = Estimate(x, p)


def wander(
    bank: Bank,
    white: FloatArray,
    dt: float,
    warming: FloatArray,
    travel: FloatArray,
    growth: FloatArray,
) -> None:
    """Bring the biases `dt` seconds on.

    Parameters
    ----------
    white : array (3,)
        Angular random walk, rad/sqrt(s).
    warming : array (3,)
        Change of the temperature, °C, for the variant that learns its slope.
    travel : array (3,)
        The same without the noise, as a distance: the slope is another at another temperature.
    growth : array (3,)
        What an unknown or doubtful temperature adds to the variance of the bias, (rad/s)².
    """
    x, p = bank.estimate
    noise = bank.family.scaled(white)
    decay = np.ones(STATES)
    decay[WANDER] = noise.decay(dt)
    added = np.zeros(x.shape)
    added[..., WANDER] = noise.growth(dt)
    added[..., WALK] += growth[:, np.newaxis]
    # F is diagonal but for the slope, which moves the walk.
    x, p = x * decay, p * (decay[:, np.newaxis] * decay)
    if len(x) > 1:
        change = warming[:, np.newaxis]
        x[1, ..., WALK] += change * x[1, ..., SLOPE]
        p[1, ..., WALK, :] += change[..., np.newaxis] * p[1, ..., SLOPE, :]
        p[1, ..., :, WALK] += change[..., np.newaxis] * p[1, ..., :, SLOPE]
        walk = SLOPE_WALK**2 * dt
        square = x[1, ..., SLOPE] ** 2 + p[1, ..., SLOPE, SLOPE] + walk
        added[1, ..., SLOPE] = walk + square * travel[:, np.newaxis] / CURVATURE_DEGC
    i = np.arange(STATES)
    p[..., i, i] += added
    bank.estimate = Estimate(x, p)


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """A slot at rest, as the bank sees it.

    Parameters
    ----------
    dt : float
        Its length, s.
    rate, tilt : array (3,)
        Mean of the gyro, rad/s, and of the tilt by the accelerometers, rad.
    force : array (3,)
        Specific force less that of the first rest, m/s².
    white2, tilt2 : array (3,)
        Densities of the white noises of rate and tilt, rad²/s and rad² s.
    still2 : array (3,)
        Variance of the velocity over g at rest, (rad s)².
    """

    dt: float
    rate: FloatArray
    tilt: FloatArray
    force: FloatArray
    white2: FloatArray
    tilt2: FloatArray
    still2: FloatArray


def bias_row(force: FloatArray) -> FloatArray:
    """Return what makes the bias of the states, (10,)."""
    row = np.zeros(STATES)
    row[WANDER] = 1.0
    row[SENSITIVITY] = force
    return row


def look(bank: Bank, slot: AtRest) -> Correction:
    """Integrate the rotation over a slot, and return what the zero velocity at its end says.

    The bank is left before that measurement; `take` accepts it.
    """
    dt, half = slot.dt, 0.5 * slot.dt**2
    f = np.eye(STATES)
    f[VELOCITY, ROTATION] = dt
    f[:2] -= np.outer([dt, half], bias_row(slot.force))
    given = np.zeros((3, 1, STATES))
    given[:, 0, ROTATION] = dt * slot.rate
    given[:, 0, VELOCITY] = half * slot.rate - dt * slot.tilt
    q = np.zeros((3, 1, STATES, STATES))
    q[:, 0, :2, :2] = slot.white2[:, np.newaxis, np.newaxis] * np.outer([dt, half], [dt, half]) / dt
    q[:, 0, VELOCITY, VELOCITY] += slot.tilt2 * dt
    bank.estimate = predict(bank.estimate, f, q, given)
    h = np.zeros((1, STATES))
    h[0, VELOCITY] = 1.0
    still = slot.still2[:, np.newaxis, np.newaxis, np.newaxis]
    return correct(bank.estimate, np.zeros((*bank.weight.shape, 1)), h, still)


def surprise(found: Correction) -> FloatArray:
    """Return the least squared normalised innovation: that of the most tolerant filter, (variants, 3)."""
    return np.asarray((found.standardised[..., 0] ** 2).min(-1))


def disagreement(bank: Bank, slot: AtRest) -> FloatArray:
    """Return the least squared difference of rate and bias over its variance, (variants, 3)."""
    row = bias_row(slot.force)
    x, p = bank.estimate
    variance = p @ row @ row + (slot.white2 / slot.dt)[:, np.newaxis]
    return np.asarray(((slot.rate[:, np.newaxis] - x @ row) ** 2 / variance).min(-1))


def innovation(bank: Bank, found: Correction) -> FloatArray:
    """Return the innovation of the whole over its standard deviation; its sign is that of the bias."""
    value = found.innovation[..., 0]
    mean = (bank.weight * value).sum(-1)
    variance = (bank.weight * (found.innovation_covariance[..., 0, 0] + value**2)).sum(-1) - mean**2
    return np.asarray(-mean / np.sqrt(variance))


def take(bank: Bank, found: Correction) -> FloatArray:
    """Accept the measurement and weigh the filters; return the log-likelihoods, (variants, 3).

    How sensitive to the specific force a unit is holds for its three axes together: a group has one
    probability, to which the evidence of all axes is multiplied.
    """
    family, bank.estimate = bank.family, found.estimate
    shape = (*bank.weight.shape[:2], len(family.sensitivity_sd), len(family.prior))
    before = bank.weight.reshape(shape).sum(-1)
    most = found.log_likelihood.max(-1, keepdims=True)
    joint = (bank.weight * np.exp(found.log_likelihood - most)).reshape(shape)
    group = np.maximum(joint.sum(-1), LEAST_WEIGHT)
    log_common = np.log(before[:, 0]) + np.log(group / before).sum(1)
    common = np.exp(log_common - log_common.max(-1, keepdims=True))
    common = np.maximum(common / common.sum(-1, keepdims=True), LEAST_WEIGHT)
    weight = joint / group[..., np.newaxis] * common[:, np.newaxis, :, np.newaxis]
    bank.weight = np.maximum(weight, LEAST_WEIGHT).reshape(bank.weight.shape)
    return np.asarray(most[..., 0] + np.log(group.sum(-1)))


def mix(bank: Bank, dt: float) -> None:
    """Let each filter take over, after `dt` seconds, its share of what the others know (mixing of the IMM).

    A filter stays with probability exp(-dt / DWELL_S), and goes over to any of its group by its prior
    otherwise: so all of them receive the same mean of the whole.  A sensitivity to the specific force does
    not change, so that groups do not mix.
    """
    family = bank.family
    wanders = len(family.prior)
    if wanders == 1:
        return
    shape = (*bank.weight.shape[:2], len(family.sensitivity_sd), wanders)
    weight = bank.weight.reshape(shape)
    x = bank.estimate.mean.reshape(*shape, STATES)
    p = bank.estimate.covariance.reshape(*shape, STATES, STATES)
    group = weight.sum(-1, keepdims=True)
    share = weight / group
    mean = np.einsum("...h,...hi->...i", share, x)[..., np.newaxis, :]
    off = x - mean
    spread = off[..., :, np.newaxis] * off[..., np.newaxis, :]
    cover = np.einsum("...h,...hij->...ij", share, p + spread)[..., np.newaxis, :, :]
    arriving = -math.expm1(-dt / DWELL_S) * family.prior
    after = math.exp(-dt / DWELL_S) * share + arriving
    taken = (arriving / after)[..., np.newaxis]
    x = x - taken * off
    taken = taken[..., np.newaxis]
    p = p + taken * (cover - p + (1.0 - taken) * spread)
    bank.weight = (group * after).reshape(bank.weight.shape)
    bank.estimate = Estimate(x.reshape(bank.estimate.mean.shape), p.reshape(bank.estimate.covariance.shape))


def _mixture(weight: FloatArray, value: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance over the filters."""
    mean = (weight * value).sum(-1)
    spread = (weight * (variance + (value - mean[..., np.newaxis]) ** 2)).sum(-1)
    return np.asarray(mean), np.asarray(spread)


def bias(bank: Bank, force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the bias at a specific force (less that of the first rest) and its variance, (variants, 3)."""
    row = bias_row(force)
    x, p = bank.estimate
    return _mixture(bank.weight, x @ row, p @ row @ row)


def slope(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Return the slope over temperature, rad/s/°C, and its variance, (variants, 3)."""
    x, p = bank.estimate
    return _mixture(bank.weight, x[..., SLOPE], p[..., SLOPE, SLOPE])


def sensitivity(bank: Bank) -> FloatArray:
    """Return the matrix of the sensitivity to the specific force, rad/s per m/s², (variants, 3, 3)."""
    return np.asarray(np.einsum("...h,...hi->...i", bank.weight, bank.estimate.mean[..., SENSITIVITY]))
