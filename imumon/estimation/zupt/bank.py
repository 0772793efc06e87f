"""Rotation about one gyro axis at rest, its bias, and how much that bias wanders: a bank of Kalman filters.

States of a filter, for one axis of the body::

    0  rotation since the unit came to rest, rad: integrated rate less bias
    1  its integral less that of the reading of the tilt, rad s: the velocity over g of the textbook filter
    2  bias that walks at random (K), rad/s
    3  to 5  bias that comes and goes within 10, 100 and 1000 s: Gauss-Markov, together flicker noise
    6  slope over temperature, rad/s/degC; only in the bank that learns it

Zero velocity is a measurement of state 1.  A random walk alone is no flicker noise: it claims half the error
there is.  How strong either is, relative to the white noise, is not known beforehand: each filter of the
bank holds one answer, and an interacting multiple model (Blom and Bar-Shalom 1988) weighs them by their
innovations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from imumon.blocks import FloatArray

ROTATION, SWAY, WALK, FIRST_MARKOV, SLOPE = 0, 1, 2, 3, 6
STATES = 7
MARKOV_S = (10.0, 100.0, 1000.0)
FLOOR_PER_MARKOV = 0.776
"""Allan deviation's floor of the three processes together, over the standard deviation of one."""
FLOOR_PER_INSTABILITY = math.sqrt(2.0 * math.log(2.0) / math.pi)
FLICKER_BELOW = 0.015
"""Random walk (per sqrt(s)) that goes on as flicker does below 1/1000 s, over the sd of one of them."""

FLICKER_CORNERS_S = (640.0, 160.0, 40.0, 10.0)
"""Averaging times at which flicker noise overtakes the white noise, one filter each."""
WALK_CORNERS_S = (60.0, 12.0, 2.5)
"""The same for random walks: biases that follow an unknown temperature."""
PRIORS = (0.2, 0.2, 0.2, 0.2, 0.08, 0.07, 0.05)
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
"""Travel of the temperature over which a slope changes by as much as itself."""
SLOPE_WALK = math.radians(0.02) / 3600.0
"""Its random walk, rad/s/degC/sqrt(s)."""


class Family(NamedTuple):
    """What the filters of a bank assume of the bias.

    Parameters
    ----------
    markov : array (3, filters)
        Standard deviation of each of the three Gauss-Markov processes, per axis.
    walk : array (3, filters)
        Random walk per sqrt(s), per axis.
    prior : array (filters,)
        Weights before any measurement.
    relative : bool
        Whether `markov` and `walk` are in units of the axis' angular random walk, or in rad/s.
    """

    markov: FloatArray
    walk: FloatArray
    prior: FloatArray
    relative: bool


class Bank(NamedTuple):
    """The filters of three axes, first without, then (when it is learned) with slope.

    Parameters
    ----------
    x : array (rows, filters, 7)
        States; the rows are x, y, z without slope and x, y, z with.
    p : array (rows, filters, 7, 7)
        Covariances.
    weight : array (rows, filters)
        Probabilities.
    innovation, variance : array (rows, filters)
        Of the last zero-velocity measurement.
    likelihood : array (filters,)
    work : array (2, 7)
        Scratch; to allocate it for each slot would cost more than what it is for.
    """

    x: FloatArray
    p: FloatArray
    weight: FloatArray
    innovation: FloatArray
    variance: FloatArray
    likelihood: FloatArray
    work: FloatArray


def unknown_family() -> Family:
    """Return the filters for a gyro of which nothing is known."""
    flicker = 1.0 / (FLOOR_PER_MARKOV * np.sqrt(FLICKER_CORNERS_S))
    walks = math.sqrt(3.0) / np.array(WALK_CORNERS_S)
    markov = np.concatenate([flicker, np.full(len(walks), flicker[1])])
    walk = np.concatenate([FLICKER_BELOW * flicker, walks])
    return Family(np.tile(markov, (3, 1)), np.tile(walk, (3, 1)), np.array(PRIORS), True)


def known_family(bias_instability: FloatArray, rate_random_walk: FloatArray) -> Family:
    """Return the one filter for a gyro whose B and K are known, (3,) each, rad/s and rad/s/sqrt(s)."""
    markov = bias_instability * (FLOOR_PER_INSTABILITY / FLOOR_PER_MARKOV)
    return Family(markov[:, np.newaxis], rate_random_walk[:, np.newaxis], np.ones(1), False)


def empty_bank(rows: int, filters: int) -> Bank:
    """Return a bank to be started."""
    return Bank(
        np.zeros((rows, filters, STATES)),
        np.zeros((rows, filters, STATES, STATES)),
        np.zeros((rows, filters)),
        np.zeros((rows, filters)),
        np.ones((rows, filters)),
        np.zeros(filters),
        np.zeros((2, STATES)),
    )


@njit(cache=True, nogil=True)
def start(bank: Bank, family: Family, noise: FloatArray) -> None:
    """Forget all; `noise` (3,) is the angular random walk, rad/sqrt(s)."""
    bank.x[:] = 0.0
    bank.p[:] = 0.0
    for row in range(bank.x.shape[0]):
        axis = row % 3
        unit = noise[axis] if family.relative else 1.0
        for h in range(bank.x.shape[1]):
            p = bank.p[row, h]
            p[WALK, WALK] = UNKNOWN_BIAS**2
            for i in range(3):
                p[FIRST_MARKOV + i, FIRST_MARKOV + i] = (unit * family.markov[axis, h]) ** 2
            if row >= 3:
                p[SLOPE, SLOPE] = (SLOPE_PER_NOISE * noise[axis]) ** 2
            bank.weight[row, h] = family.prior[h]


@njit(cache=True, nogil=True)
def come_to_rest(bank: Bank, flat: FloatArray) -> None:
    """Forget rotation and velocity; the bias stays.

    `flat` (3,) is the share of each axis in which gravity shows the rotation; the rest is heading, which has
    not changed at the start of a rest.
    """
    for row in range(bank.x.shape[0]):
        for h in range(bank.x.shape[1]):
            x, p = bank.x[row, h], bank.p[row, h]
            for i in (ROTATION, SWAY):
                x[i] = 0.0
                for j in range(STATES):
                    p[i, j] = p[j, i] = 0.0
            p[ROTATION, ROTATION] = flat[row % 3] * UNKNOWN_ROTATION**2


@njit(cache=True, nogil=True)
def wander(
    bank: Bank,
    row: int,
    family: Family,
    dt: float,
    noise: float,
    warming: float,
    travel: float,
    growth: float,
) -> None:
    """Bring the biases of a row `dt` seconds on.

    Parameters
    ----------
    noise : float
        Angular random walk of the axis, rad/sqrt(s).
    warming : float
        Change of the temperature, °C, for the bank that learns its slope.
    travel : float
        The same without the noise, as a distance: the slope is another at another temperature.
    growth : float
        What an unknown or doubtful temperature adds to the variance of the bias, (rad/s)^2.
    """
    n = STATES if row >= 3 else SLOPE
    unit = noise if family.relative else 1.0
    x, p, decay = bank.x, bank.p, bank.work[0]
    decay[:] = 1.0
    for i in range(3):
        decay[FIRST_MARKOV + i] = math.exp(-dt / MARKOV_S[i])
    for h in range(bank.x.shape[1]):
        if n > SLOPE:
            x[row, h, WALK] += warming * x[row, h, SLOPE]
            for j in range(n):
                p[row, h, WALK, j] += warming * p[row, h, SLOPE, j]
            for j in range(n):
                p[row, h, j, WALK] += warming * p[row, h, j, SLOPE]
            p[row, h, SLOPE, SLOPE] += SLOPE_WALK**2 * dt
            square = x[row, h, SLOPE] ** 2 + p[row, h, SLOPE, SLOPE]
            p[row, h, SLOPE, SLOPE] += square * travel / CURVATURE_DEGC
        for i in range(FIRST_MARKOV, SLOPE):
            x[row, h, i] *= decay[i]
        for j in range(FIRST_MARKOV, SLOPE):
            for i in range(n):
                p[row, h, i, j] *= decay[j]
                p[row, h, j, i] *= decay[j]
        p[row, h, WALK, WALK] += (unit * family.walk[row % 3, h]) ** 2 * dt + growth
        for i in range(FIRST_MARKOV, SLOPE):
            p[row, h, i, i] += (unit * family.markov[row % 3, h]) ** 2 * (1.0 - decay[i] * decay[i])


@njit(cache=True, nogil=True)
def rotate(
    bank: Bank, row: int, dt: float, rate: float, tilt: float, noise2: float, tilt2: float, sway2: float
) -> None:
    """Bring rotation and velocity of a row `dt` seconds on, and look at the zero velocity.

    Parameters
    ----------
    rate, tilt : float
        Mean over these seconds of the gyro, rad/s, and of the tilt by the accelerometers, rad.
    noise2, tilt2 : float
        Densities of their white noises, rad^2/s and rad^2 s.
    sway2 : float
        Variance of the velocity over g at rest, (rad s)^2.
    """
    n = STATES if row >= 3 else SLOPE
    half = 0.5 * dt * dt
    x, p, joint = bank.x, bank.p, bank.work[0]
    for h in range(bank.x.shape[1]):
        net = rate
        for i in range(WALK, SLOPE):
            net -= x[row, h, i]
        x[row, h, SWAY] += dt * (x[row, h, ROTATION] - tilt) + half * net
        x[row, h, ROTATION] += dt * net
        total = 0.0
        for j in range(n):
            joint[j] = p[row, h, WALK, j] + p[row, h, 3, j] + p[row, h, 4, j] + p[row, h, 5, j]
            if WALK <= j < SLOPE:
                total += joint[j]
        with_rotation, with_sway = joint[ROTATION], joint[SWAY]
        rr, rs = p[row, h, ROTATION, ROTATION], p[row, h, ROTATION, SWAY]
        p[row, h, SWAY, SWAY] += (
            dt * (2.0 * rs + dt * (rr - with_sway) - dt * dt * with_rotation)
            + half * half * total
            + (half * half / dt * noise2 + dt * tilt2)
        )
        p[row, h, ROTATION, SWAY] += dt * (rr - with_sway) - 3.0 * half * with_rotation + dt * half * total
        p[row, h, ROTATION, SWAY] += half * noise2
        p[row, h, ROTATION, ROTATION] += dt * (dt * total - 2.0 * with_rotation + noise2)
        p[row, h, SWAY, ROTATION] = p[row, h, ROTATION, SWAY]
        for j in range(WALK, n):
            p[row, h, SWAY, j] += dt * p[row, h, ROTATION, j] - half * joint[j]
            p[row, h, ROTATION, j] -= dt * joint[j]
            p[row, h, j, SWAY], p[row, h, j, ROTATION] = p[row, h, SWAY, j], p[row, h, ROTATION, j]
        bank.innovation[row, h] = -x[row, h, SWAY]
        bank.variance[row, h] = p[row, h, SWAY, SWAY] + sway2


@njit(cache=True, nogil=True)
def surprise(bank: Bank, row: int) -> float:
    """Return the least squared normalised innovation of a row: that of the most tolerant filter."""
    least = np.inf
    for h in range(bank.x.shape[1]):
        least = min(least, bank.innovation[row, h] ** 2 / bank.variance[row, h])
    return float(least)


@njit(cache=True, nogil=True)
def innovation(bank: Bank, row: int) -> float:
    """Return the innovation of the whole row over its standard deviation; its sign is that of the bias."""
    mean, square = 0.0, 0.0
    for h in range(bank.x.shape[1]):
        mean += bank.weight[row, h] * bank.innovation[row, h]
        square += bank.weight[row, h] * (bank.variance[row, h] + bank.innovation[row, h] ** 2)
    return -mean / math.sqrt(square - mean * mean)


@njit(cache=True, nogil=True)
def correct(bank: Bank, row: int) -> float:
    """Take in the zero velocity, in Joseph's form, and weigh the filters; return the log-likelihood."""
    n = STATES if row >= 3 else SLOPE
    filters = bank.x.shape[1]
    x, p, gain, sway, likelihood = bank.x, bank.p, bank.work[0], bank.work[1], bank.likelihood
    for h in range(filters):
        s, nu = bank.variance[row, h], bank.innovation[row, h]
        likelihood[h] = -0.5 * (nu * nu / s + math.log(2.0 * math.pi * s))
        for i in range(n):
            sway[i] = p[row, h, SWAY, i]
            gain[i] = sway[i] / s
        for i in range(n):
            x[row, h, i] += gain[i] * nu
            for j in range(i, n):
                p[row, h, i, j] += gain[i] * gain[j] * s - gain[i] * sway[j] - sway[i] * gain[j]
                p[row, h, j, i] = p[row, h, i, j]
    total, most = 0.0, likelihood[0]
    for h in range(1, filters):
        most = max(most, likelihood[h])
    for h in range(filters):
        bank.weight[row, h] *= math.exp(likelihood[h] - most)
        total += bank.weight[row, h]
    for h in range(filters):
        bank.weight[row, h] /= total
    return float(most + math.log(total))


@njit(cache=True, nogil=True)
def mix(bank: Bank, row: int, family: Family, dt: float) -> None:
    """Let each filter take over, after `dt` seconds, its share of what the others know (mixing of the IMM).

    A filter stays with probability exp(-dt / DWELL_S), and goes over to any by its prior otherwise: so all
    receive the same mean of the whole.
    """
    filters = bank.x.shape[1]
    if filters == 1:
        return
    n = STATES if row >= 3 else SLOPE
    mean, cover = np.zeros(STATES), np.zeros((STATES, STATES))
    for h in range(filters):
        for i in range(n):
            mean[i] += bank.weight[row, h] * bank.x[row, h, i]
    for h in range(filters):
        weight, x, p = bank.weight[row, h], bank.x[row, h], bank.p[row, h]
        for i in range(n):
            for j in range(n):
                cover[i, j] += weight * (p[i, j] + (x[i] - mean[i]) * (x[j] - mean[j]))
    leave = 1.0 - math.exp(-dt / DWELL_S)
    off = np.empty(STATES)
    for h in range(filters):
        x, p = bank.x[row, h], bank.p[row, h]
        arriving = leave * family.prior[h]
        bank.weight[row, h] = (1.0 - leave) * bank.weight[row, h] + arriving
        taken = arriving / bank.weight[row, h]
        for i in range(n):
            off[i] = x[i] - mean[i]
            x[i] -= taken * off[i]
        for i in range(n):
            for j in range(n):
                spread = (1.0 - taken) * off[i] * off[j]
                p[i, j] += taken * (cover[i, j] - p[i, j] + spread)


@njit(cache=True, nogil=True)
def bias(bank: Bank, row: int) -> tuple[float, float]:
    """Return the bias of a row and its variance, rad/s."""
    mean, square = 0.0, 0.0
    centre = 0.0
    for i in range(WALK, SLOPE):
        centre += bank.x[row, 0, i]
    for h in range(bank.x.shape[1]):
        value, variance = -centre, 0.0
        for i in range(WALK, SLOPE):
            value += bank.x[row, h, i]
            for j in range(WALK, SLOPE):
                variance += bank.p[row, h, i, j]
        mean += bank.weight[row, h] * value
        square += bank.weight[row, h] * (variance + value * value)
    return mean + centre, max(square - mean * mean, 0.0)


@njit(cache=True, nogil=True)
def slope(bank: Bank, row: int) -> tuple[float, float]:
    """Return the slope over temperature of a row that learns it, rad/s/degC, and its variance."""
    mean, square = 0.0, 0.0
    for h in range(bank.x.shape[1]):
        value = bank.x[row, h, SLOPE]
        mean += bank.weight[row, h] * value
        square += bank.weight[row, h] * (bank.p[row, h, SLOPE, SLOPE] + value * value)
    return mean, max(square - mean * mean, 0.0)
