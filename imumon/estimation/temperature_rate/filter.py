"""Multiple-model Kalman filter of temperature and rate: model, start, predict, correct, once a slot.

The state of each filter is x = (T, r, a, e): temperature, its rate, its acceleration, and the slow error of
the reading.  What a thermometer rounds to its steps is T + e + white noise.

Arrays have the state first, then the noise models and the jerk PSDs: x (4, k, m), P (4, 4, k, m), and mode
probabilities mu (k, m).  The jerk PSD of a temperature may change, so the filters of a noise model are an
IMM (interacting multiple models): their estimates are mixed.  A thermometer does not change its nature, so
noise models are an MMAE (static multiple models): they are only weighed.  Steps and names are those of
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 11.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.thermometer import FASTEST_RATE, UNSEEN_RATE, Slot, Thermometer

STATES = 4
TEMPERATURE, RATE, ACCELERATION, ERROR = range(STATES)
START_ACCELERATION = UNSEEN_RATE / 300.0
"""Standard deviation of the acceleration at the start, °C/s²: the rate of a warm-up comes about in 5 min."""
LONG_S = WALK_S = 900.0
"""s.  The variance of the acceleration at the start is at most what the jerk makes of it in this time.  And
the variance that a walk of the reading gains in this time is never known (times `SLOW_MEAN`²).  Ablation."""
SLOW_MEAN = 0.5
"""So many sigmas of a slow error always stay in the standard deviation of T.  Ablation."""
LEAST_PROBABILITY = 1e-14
"""Least probability of a filter, so that none is lost for ever.  Ablation."""
NoiseModel = tuple[float, float, float, float]
"""Variances of the white noise and of the slow error e, the correlation time τ of e, s, and the variance per
second of the random walk that is part of 1/f noise (of mean models: per slot).

A *code model* reads the code in which T + e + white noise is; its unit of variance is d², of the step d.  In
its white noise is how e, of variance V, moves within a slot, V (1 s)/(3 τ).  A *mean model* measures a
slot's mean; its unit is max(ρ, d²/12), with ρ the variance of this mean from slot to slot, and a share of
that is the slow error.
"""
WHITE_SDS = (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
"""Steps; a quarter apart where the ripple of a mean depends on it most."""
CODE_MODELS: tuple[NoiseModel, ...] = (
    *((sd**2, 0.0, 1e9, 0.0) for sd in WHITE_SDS),
    (0.014, 0.06, 5.0, 0.0),  # these four: white noise of 0.1 step, 0.1² + V/(3 τ)
    (0.034, 0.36, 5.0, 0.0),
    (0.013, 0.36, 40.0, 0.0),
    (0.028, 0.16, 3.0, 0.0016),
)
MEAN_MODELS: tuple[NoiseModel, ...] = (
    (1.0, 0.0, 1e9, 0.0),
    *((1.0 - share, share, slow_s, 0.0) for share in (0.3, 1.0) for slow_s in (5.0, 40.0)),
    *((1.0 - share, share, 3.0, walk) for share, walk in ((0.3, 0.01), (1.0, 0.01), (1.0, 0.05))),
)
NOISE: FloatArray = np.array([*CODE_MODELS, *MEAN_MODELS], np.float64).T[:, :, np.newaxis]
"""All models, (4, k, 1)."""
CODE, MEAN = slice(0, len(CODE_MODELS)), slice(len(CODE_MODELS), None)
"""Rows of the code and of the mean models."""
JERK_PSDS = 10.0 ** (-23.0 + 2.5 * np.arange(9.0))
"""Power spectral densities q of white jerk, °C²/s⁵, (m,).  The rate gains √(q t³/3) in a time t: with the
least, 0.17 °C/h in a day; with the largest, 1 °C/min in a second."""
CHANGE_PER_S = 2e-3
"""Probability per second that the jerk PSD changes to a neighbour's."""


class Correction(NamedTuple):
    """Evidence of a slot on the reading y = H x, (k, m)."""

    mean_change: FloatArray
    """Change of the mean of y, °C."""
    variance_change: FloatArray
    """Change of the variance of y, at most zero, °C²."""
    log_likelihood: FloatArray


@dataclass(frozen=True, eq=False)
class Filters:
    """The filters of one thermometer, and the time that x refers to, s.

    The reading before its white noise and steps is y = H x with H = [1, 0, 0, 1].
    """

    x: FloatArray
    p: FloatArray
    mu: FloatArray
    time_s: float
    slow: tuple[FloatArray, FloatArray]
    """What `slow_error` returned when x was predicted."""

    @cached_property
    def reading(self) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of y of every filter, °C and °C², (k, m)."""
        x, p = self.x, self.p
        variance = p[TEMPERATURE, TEMPERATURE] + 2.0 * p[TEMPERATURE, ERROR] + p[ERROR, ERROR]
        return x[TEMPERATURE] + x[ERROR], variance

    def mixture(self, mean: FloatArray, variance: FloatArray) -> tuple[float, float]:
        """Return mean and variance over all filters of what they give with mean and variance, (k, m)."""
        of_all = float(np.vdot(self.mu, mean))
        return of_all, float(np.vdot(self.mu, variance + (mean - of_all) ** 2))

    @property
    def temperature_and_rate(self) -> tuple[float, float, float, float]:
        """Mean and variance over all filters of the temperature, °C and °C², and of its rate.

        To the variance of the temperature is added what of a slow error and of a walk is never known.
        """
        x, p, (slow, walk_per_s) = self.x, self.p, self.slow
        unknown = SLOW_MEAN**2 * (slow + walk_per_s * WALK_S)
        temperature = self.mixture(x[TEMPERATURE], p[TEMPERATURE, TEMPERATURE] + unknown)
        return *temperature, *self.mixture(x[RATE], p[RATE, RATE])


def start(thermometer: Thermometer, slot: Slot) -> Filters:
    """Return filters that begin at a slot's mean with any rate."""
    k, m = NOISE.shape[1], len(JERK_PSDS)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = slot.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.step**2 + thermometer.rho + slot.variance
    p[RATE, RATE] = FASTEST_RATE**2
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, JERK_PSDS * LONG_S)
    variance, _ = slow = slow_error(thermometer)  # the mean is of T + e: T is off by -e
    p[TEMPERATURE, TEMPERATURE] += variance
    p[ERROR, ERROR] = variance
    p[TEMPERATURE, ERROR] = p[ERROR, TEMPERATURE] = -variance
    return Filters(x, p, np.full((k, m), 1.0 / (k * m)), slot.time_s, slow)


def slow_error(thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every noise model, (k, 1)."""
    _, slow, slow_s, walk_per_s = NOISE
    # Of the variance of e, second differences of slot means, ρ, show (1 - φ)(3 - φ)/3.
    keep = np.exp(-thermometer.spacing_s / slow_s)
    scale = thermometer.mean_variance / ((1.0 - keep) * (3.0 - keep) / 3.0)
    walk_scale = np.full_like(slow_s, thermometer.mean_variance / thermometer.spacing_s)
    scale[CODE] = walk_scale[CODE] = thermometer.step**2
    return slow * scale, walk_per_s * walk_scale


@cache
def generator(modes: int) -> FloatArray:
    """Return G of M = I + p G, (m, m): each mode changes to its neighbours with the probability p."""
    steps = np.diff(np.eye(modes), axis=0)
    return np.asarray(-0.5 * steps.T @ steps)


def mix(filters: Filters, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mixed initial conditions x and P of each jerk PSD, and the predicted mode probabilities c̄.

    With the transition matrix M and the mixing probabilities ω_ij = M_ij μ_i / c̄_j, mode j begins with
    x_0j = Σ_i ω_ij x_i and the covariance Σ_i ω_ij (P_i + d_i d_iᵀ), d_i = x_i - x_0j.  Sums are of
    differences from one of the modes, so that a large mean costs no digits.
    """
    x, mu = filters.x, filters.mu
    transition = np.eye(mu.shape[1]) + min(dt * CHANGE_PER_S, 0.4) * generator(mu.shape[1])
    predicted = mu @ transition
    one = x[..., :1]
    off = x - one
    mixed = (mu * off) @ transition / predicted
    second = (mu * (filters.p + off[:, np.newaxis] * off)) @ transition / predicted
    return mixed + one, second - mixed[:, np.newaxis] * mixed, predicted


def predict(thermometer: Thermometer, filters: Filters, time_s: float) -> Filters:
    """Mix the filters of each noise model and advance all to a time: x = F x, P = F P Fᵀ + Q.

    T, r and a move with white jerk; e decays by φ = exp(-dt/τ).  A walk of the reading has no state of its
    own: it is process noise of T, and what it gains in `WALK_S` is added in the output.
    """
    dt = max(time_s - filters.time_s, 0.0)
    x, p, mu = mix(filters, dt)
    half = dt**2 / 2.0
    f = np.array([[1.0, dt, half, 0.0], [0.0, 1.0, dt, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    q = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, half], [dt**3 / 6, half, dt]])
    x, p = _times(f, x), _times(f, _times(f, p).swapaxes(0, 1))
    p[:ERROR, :ERROR] += q[:, :, np.newaxis, np.newaxis] * JERK_PSDS
    variance, walk_per_s = slow = slow_error(thermometer)
    phi = np.exp(-dt / NOISE[2])  # depends on the noise model, so F has 1 in its place
    x[ERROR] *= phi
    p[ERROR] *= phi
    p[:, ERROR] *= phi
    p[ERROR, ERROR] += variance * (1.0 - phi**2)
    p[TEMPERATURE, TEMPERATURE] += walk_per_s * dt
    return Filters(x, p, mu, max(time_s, filters.time_s), slow)


def _times(f: FloatArray, values: FloatArray) -> FloatArray:
    """Return a matrix (4, 4) times values whose first axis is the state, (4, ...)."""
    return (f @ values.reshape(STATES, -1)).reshape(values.shape)


def correct(filters: Filters, correction: Correction) -> Filters:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    p = filters.p
    gain = (p[:, TEMPERATURE] + p[:, ERROR]) / filters.reading[1]  # P Hᵀ / (H P Hᵀ): how the state follows y
    x = filters.x + gain * correction.mean_change
    p = p + gain[:, np.newaxis] * (gain * correction.variance_change)
    mu = filters.mu * np.exp(correction.log_likelihood - correction.log_likelihood.max())
    return Filters(x, p, np.maximum(mu / mu.sum(), LEAST_PROBABILITY), filters.time_s, filters.slow)
