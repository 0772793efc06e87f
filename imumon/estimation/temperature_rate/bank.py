"""A bank of Kalman filters for temperature, rate, acceleration and the slow part of the sensor's noise.

The filters differ in how smooth the temperature is (`JERKS`: the density q of the white jerk that drives
T''', with T'' forgetting itself in `FORGETTING_S`) and in what the sensor's errors are like:

- level kinds: the reading is the level that the temperature, with a little white noise, is in; some have a
  slow error before the quantizer as well, a Gauss-Markov process, which is the fourth state;
- mean kinds: the reading is the temperature with white errors, quantization among them;
- slow kinds: the same with a slow error.

They are mixed as an interacting multiple model (Blom and Bar-Shalom 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.kalman import Estimate, predict

JERKS = 10.0 ** np.arange(-27.0, -3.5, 1.5)
"""Jerk densities, °C²/s⁵: from a rate that keeps to 0.001 °C/h for a day to a jump of 2 °C/min in 3 s."""
FORGETTING_S = 1800.0
WHITE_SIGMAS = np.array([0.0003, 0.01, 0.02, 0.035, 0.06, 0.1, 0.13, 0.16, 0.2, 0.25])
"""White noise of the level kinds in steps: beyond the last the steps are no sharper than the noise."""
SLOW_TIMES_S = np.array([5.0, 40.0])
"""Correlation times of slow errors; every one with every standard deviation."""
SLOW_LEVEL_SIGMAS, SLOW_LEVEL_WHITE = np.array([0.12, 0.25, 0.5, 1.0]), 0.06
"""Standard deviations in units of slow errors before the quantizer, and white noise beside them in steps."""
MEAN_FACTORS = np.array([0.7, 1.4, 2.8])
"""Variance of a slot's mean in the mean kinds, over that seen from slot to slot."""
SLOW_SIGMAS = np.array([0.5, 1.0, 2.0, 4.0])
"""Standard deviations in units of slow errors where the noise hides the steps."""


def _each_time(sigmas: FloatArray) -> FloatArray:
    return np.repeat(sigmas, len(SLOW_TIMES_S))


LEVEL_SIGMAS = np.concatenate([WHITE_SIGMAS, _each_time(0.0 * SLOW_LEVEL_SIGMAS + SLOW_LEVEL_WHITE)])
SLOW_SIGMA = np.concatenate(
    [0.0 * WHITE_SIGMAS, _each_time(SLOW_LEVEL_SIGMAS), 0.0 * MEAN_FACTORS, _each_time(SLOW_SIGMAS)]
)
"""Standard deviation of the slow error of every kind, in units."""
KINDS, LEVELS = len(SLOW_SIGMA), len(LEVEL_SIGMAS)
SLOW_TIME_S = np.concatenate(
    [
        1.0 + 0.0 * WHITE_SIGMAS,
        np.tile(SLOW_TIMES_S, len(SLOW_LEVEL_SIGMAS)),
        1.0 + 0.0 * MEAN_FACTORS,
        np.tile(SLOW_TIMES_S, len(SLOW_SIGMAS)),
    ]
)
LEVEL, MEAN = slice(0, LEVELS), slice(LEVELS, LEVELS + len(MEAN_FACTORS))
SLOW = slice(LEVELS + len(MEAN_FACTORS), KINDS)

CHANGE_PER_S, JUMP_PER_S = 1.0 / 3600.0, 1e-7
"""Probability per second that the smoothness changes to a neighbour's, and to any."""
MIX_S = 3.9
"""Filters are mixed so often; a fraction of the time in which any could take over."""
NATURE_PER_S = 1e-10
"""The same for the kind of the sensor's noise, to any."""
NEGLIGIBLE = 1e-4
"""A filter takes up no rougher one that would be less of it than this: it would lose what it knows."""
ROUGHER = np.tri(len(JERKS), k=-1, dtype=bool)
"""Whether the first is rougher than the second."""
START_RATE = 20.0 / 3600.0
START_ACCELERATION = START_RATE / 300.0
"""Standard deviations of rate and acceleration at the start, °C/s and °C/s²."""
TEMPERATURE, RATE, ACCELERATION, ERROR = range(4)


@dataclass(slots=True, eq=False)
class Bank:
    """Weight (q, k), mean (q, k, 4) and covariance (q, k, 4, 4) of every filter: q smoothnesses, k kinds.

    The states are temperature, rate, acceleration and the slow error of the reading: °C, °C/s, °C/s², °C.
    By `growth`, (q, k), °C², the variance of the reading grew since the last slot; the filters were
    last mixed `unmixed_s` ago.
    """

    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray
    growth: FloatArray
    unmixed_s: float = 0.0

    @property
    def reading(self) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of what a sensor without steps would read: temperature and slow error."""
        mean, cov = self.mean, self.covariance
        variance = cov[..., 0, 0] + 2.0 * cov[..., 0, ERROR] + cov[..., ERROR, ERROR]
        return mean[..., 0] + mean[..., ERROR], variance


def started(
    temperature: tuple[float, float],
    rate: tuple[float, float],
    unit: float,
    kinds: FloatArray | None = None,
) -> Bank:
    """Return a bank that begins at a temperature and a rough rate.

    Parameters
    ----------
    temperature, rate : (float, float)
        And their standard deviations, to which what any rate has is added: °C, °C/s.
    unit : float
        Of the slow errors, °C.
    kinds : array (k,), optional
        Weights of the kinds of noise, where they are known.
    """
    shape = (len(JERKS), KINDS)
    weight = np.broadcast_to(np.full(KINDS, 1.0 / KINDS) if kinds is None else kinds, shape) / len(JERKS)
    mean = np.zeros((*shape, 4))
    mean[..., TEMPERATURE], mean[..., RATE] = temperature[0], rate[0]
    covariance = np.zeros((*shape, 4, 4))
    covariance[..., 0, 0] = temperature[1] ** 2
    covariance[..., 1, 1] = (START_RATE + rate[1]) ** 2
    covariance[..., 2, 2] = np.minimum(START_ACCELERATION**2, JERKS * FORGETTING_S / 2.0)[:, np.newaxis]
    covariance[..., 3, 3] = (unit * SLOW_SIGMA) ** 2
    return Bank(weight.copy(), mean, covariance, np.zeros(shape))


def motion(dt: float, unit: float, least_jerk: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return transition (k, 4, 4) and noise (q, k, 4, 4) over dt seconds."""
    keep = np.exp(-dt / FORGETTING_S)
    g = FORGETTING_S * (1.0 - keep)
    transition = np.zeros((KINDS, 4, 4))
    transition[:, :3, :3] = [[1.0, dt, FORGETTING_S * (dt - g)], [0.0, 1.0, g], [0.0, 0.0, keep]]
    fading = np.exp(-dt / SLOW_TIME_S)
    transition[:, ERROR, ERROR] = fading
    jerk = np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    noise = np.zeros((len(JERKS), KINDS, 4, 4))
    noise[..., :3, :3] = (np.maximum(JERKS, least_jerk)[:, np.newaxis, np.newaxis] * jerk)[:, np.newaxis]
    noise[..., ERROR, ERROR] = (unit * SLOW_SIGMA) ** 2 * (1.0 - fading**2)
    return transition, noise


def advance(bank: Bank, dt: float, unit: float, least_jerk: float = 0.0) -> Bank:
    """Mix the filters and move them on by dt seconds."""
    unmixed_s = bank.unmixed_s + dt
    if unmixed_s >= MIX_S:
        bank, unmixed_s = mixed(bank, unmixed_s, unit), 0.0
    transition, noise = motion(dt, unit, least_jerk)
    moved = predict(Estimate(bank.mean, bank.covariance), transition, noise)
    after = Bank(bank.weight, moved.mean, moved.covariance, bank.growth, unmixed_s)
    after.growth = after.reading[1] - bank.reading[1]
    return after


def mixed(bank: Bank, dt: float, unit: float) -> Bank:
    """Pass weight, and with it states, between the filters, as over dt seconds.

    The moments are summed about the mean of all, so that merging costs no digits.
    """
    q = len(JERKS)
    near, far = min(dt * CHANGE_PER_S, 0.4), min(dt * JUMP_PER_S, 0.4)
    stay = np.eye(q) + 0.5 * near * (np.eye(q, k=1) + np.eye(q, k=-1)) + far / q
    stay /= stay.sum(1, keepdims=True)
    centre = bank.weight.ravel() @ bank.mean.reshape(-1, 4)
    centre[ERROR] = 0.0
    offset = bank.mean - centre
    moments = np.empty((q, KINDS, 21))
    moments[..., 0] = bank.weight
    moments[..., 1:5] = bank.weight[..., np.newaxis] * offset
    second = bank.covariance + offset[..., :, np.newaxis] * offset[..., np.newaxis, :]
    moments[..., 5:] = (bank.weight[..., np.newaxis, np.newaxis] * second).reshape(q, KINDS, 16)
    share = stay[:, :, np.newaxis] * bank.weight[:, np.newaxis] / (stay.T @ bank.weight)
    flow = np.where((share < NEGLIGIBLE) & ROUGHER[:, :, np.newaxis], 0.0, stay[:, :, np.newaxis])
    moments = (flow.transpose(2, 1, 0) @ moments.transpose(1, 0, 2)).transpose(1, 0, 2)
    # From one kind of noise to another the slow error begins anew.
    change = min(dt * NATURE_PER_S, 0.4)
    others = np.broadcast_to(moments.sum(1, keepdims=True) * (change / KINDS), moments.shape).copy()
    others[..., [4, 8, 12, 16, 17, 18, 19]] = 0.0
    others[..., 20] = others[..., 0] * (unit * SLOW_SIGMA) ** 2
    moments = (1.0 - change) * moments + others
    weight = moments[..., 0]
    offset = moments[..., 1:5] / weight[..., np.newaxis]
    second = (moments[..., 5:] / weight[..., np.newaxis]).reshape(q, KINDS, 4, 4)
    return Bank(
        weight / weight.sum(),
        centre + offset,
        second - offset[..., :, np.newaxis] * offset[..., np.newaxis, :],
        bank.growth,
    )


def conditioned(bank: Bank, mean: FloatArray, variance: FloatArray) -> Bank:
    """Give what a sensor without steps would read these moments, and the states what follows from them."""
    before, spread = bank.reading
    gain = (bank.covariance[..., 0] + bank.covariance[..., ERROR]) / spread[..., np.newaxis]
    change = (variance - spread)[..., np.newaxis, np.newaxis]
    return Bank(
        bank.weight,
        bank.mean + gain * (mean - before)[..., np.newaxis],
        bank.covariance + gain[..., :, np.newaxis] * gain[..., np.newaxis, :] * change,
        bank.growth,
        bank.unmixed_s,
    )


def reweighed(weight: FloatArray, log_evidence: FloatArray) -> FloatArray:
    """Return weights times evidence, normalized."""
    product = weight * np.exp(np.maximum(log_evidence - log_evidence.max(), -60.0))
    return np.asarray(product / product.sum())


def merged(weight: FloatArray, mean: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance (...) of a mixture of (q, k) filters, each with (q, k, ...)."""
    shares = weight.ravel()
    centre = shares @ mean.reshape(len(shares), -1)
    spread = shares @ (variance + (mean - centre.reshape(mean.shape[2:])) ** 2).reshape(len(shares), -1)
    return centre.reshape(mean.shape[2:]), spread.reshape(mean.shape[2:])
