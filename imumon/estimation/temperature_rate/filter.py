"""Multiple-model Kalman filter of temperature and rate: model, start, predict, correct, once a slot.

The state of each filter is x = (T, r, a, e), equation (1): temperature, its rate, its acceleration, and the
slow error of the thermometer; °C, °C/s, °C/s² and °C.  What a thermometer rounds to its steps is y and white
noise, with y = H x = T + e (3).  Numbers of equations are those of docs/temperature-rate.md.

Arrays have the state first, then the noise models and the jerk PSDs: x (4, k, m), P (4, 4, k, m), and mode
probabilities mu (k, m).  The jerk PSD of a temperature may change, so the filters of a noise model are an
IMM (interacting multiple models): their estimates are mixed.  A thermometer does not change its nature, so
noise models are an MMAE (static multiple models): they are only weighed.  Steps and names are those of
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 11.6.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray

from .thermometer import FASTEST_RATE, UNSEEN_RATE, Slot, Thermometer

STATES = 4
TEMPERATURE, RATE, ACCELERATION, ERROR = range(STATES)
START_ACCELERATION = UNSEEN_RATE / 300.0
"""Standard deviation of the acceleration at the start, °C/s²: the rate of a warm-up comes about in 5 min."""
LONG_S = WALK_S = 900.0
"""s.  The variance of the acceleration at the start is at most what the jerk makes of it in this time; what
a walk of the reading gains in it, times `SLOW_MEAN`², is never known.  Ablation: "no walk in the output"."""
SLOW_MEAN = 0.5  # sigmas of a slow error that stay in that of T.  Ablation: "mean of a slow error known".
LEAST_PROBABILITY = 1e-14  # least probability of a filter, so that none is lost for ever.  Ablation.
JERK_PSDS = 10.0 ** (-23.0 + 2.5 * np.arange(9.0))
"""Power spectral densities q of white jerk, °C²/s⁵, (m,).  The rate gains √(q t³/3) in a time t: with the
least, 0.17 °C/h in a day; with the largest, 1 °C/min in a second."""
CHANGE_PER_S, MOST_CHANGE = 2e-3, 0.4
"""Probability per second that the jerk PSD changes to a neighbour's, half of it to each (ablation: its rows),
and the most between two slots (assumed)."""


class NoiseModels(NamedTuple):
    """Noise of a thermometer, of each of k models, (k, 1).

    A *code model* reads the code in which y + white noise is; its unit of variance is d², of the step d.  Its
    white noise contains how e, of variance V, moves within a slot, V (1 s)/(3 τ).  A *mean model* measures a
    slot's mean; its unit of variance is max(ρ, d²/12), with ρ the variance of this mean from slot to slot.
    """

    white: FloatArray  # variance of the white noise, in that unit
    slow: FloatArray  # variance of the slow error e; of mean models its share of ρ, see `slow_error`
    tau_s: FloatArray  # correlation time τ of e, s
    walk: FloatArray  # variance of the random walk that is part of 1/f noise, per s; of mean models, per slot


WHITE_SDS = (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
"""Steps; a quarter apart where the ripple of a mean depends on it most."""
CODE_MODELS: tuple[tuple[float, ...], ...] = (
    *((sd**2, 0.0, 1e9, 0.0) for sd in WHITE_SDS),
    (0.014, 0.06, 5.0, 0.0),  # these four: white noise of 0.1 step, 0.1² + V/(3 τ)
    (0.034, 0.36, 5.0, 0.0),
    (0.013, 0.36, 40.0, 0.0),
    (0.028, 0.16, 3.0, 0.0016),
)
MEAN_MODELS: tuple[tuple[float, ...], ...] = (
    (1.0, 0.0, 1e9, 0.0),
    *((1.0 - slow, slow, tau_s, 0.0) for slow in (0.3, 1.0) for tau_s in (5.0, 40.0)),
    *((1.0 - slow, slow, 3.0, walk) for slow, walk in ((0.3, 0.01), (1.0, 0.01), (1.0, 0.05))),
)
NOISE = NoiseModels(*np.array([*CODE_MODELS, *MEAN_MODELS], np.float64).T[:, :, None])
CODE, MEAN = slice(0, len(CODE_MODELS)), slice(len(CODE_MODELS), None)
"""Rows of the code and of the mean models."""


class Correction(NamedTuple):
    """Evidence of a slot on y, of every filter, (k, m)."""

    mean_change: FloatArray  # of y, °C
    variance_change: FloatArray  # of y, at most zero, °C²
    log_likelihood: FloatArray


@dataclass(frozen=True, eq=False)
class Filters:
    """The filters of one thermometer, and the time that x refers to, s."""

    x: FloatArray
    p: FloatArray
    mu: FloatArray
    time_s: float

    @cached_property
    def y(self) -> tuple[FloatArray, FloatArray]:
        """H x and H P Hᵀ: mean and variance of y of every filter, °C and °C², (k, m)."""
        x, p = self.x, self.p
        variance = p[TEMPERATURE, TEMPERATURE] + 2.0 * p[TEMPERATURE, ERROR] + p[ERROR, ERROR]
        return x[TEMPERATURE] + x[ERROR], variance

    def mixture(self, mean: FloatArray, variance: FloatArray) -> tuple[float, float]:
        """Return mean and variance over all filters of what has mean and variance in each, (k, m)."""
        of_all = float(np.vdot(self.mu, mean))
        return of_all, float(np.vdot(self.mu, variance + (mean - of_all) ** 2))


def start(thermometer: Thermometer, slot: Slot) -> Filters:
    """Return filters that begin at a slot's mean with any rate."""
    k, m = len(NOISE.white), len(JERK_PSDS)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = slot.mean
    slow, _ = slow_error(thermometer)
    p[TEMPERATURE, TEMPERATURE] = thermometer.step**2 + thermometer.rho + slot.variance + slow
    p[TEMPERATURE, ERROR] = p[ERROR, TEMPERATURE] = -slow  # the mean is of y: T is off by -e
    p[ERROR, ERROR] = slow
    p[RATE, RATE] = FASTEST_RATE**2
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, JERK_PSDS * LONG_S)
    return Filters(x, p, np.full((k, m), 1.0 / (k * m)), slot.time_s)


def slow_error(thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance σe² of e in °C² and w of its walk in °C²/s, of every noise model, (k, 1)."""
    # Of the variance of e, second differences of slot means, ρ, show (1 - φ)(3 - φ)/3.
    phi = np.exp(-thermometer.spacing_s / NOISE.tau_s)
    unit = thermometer.mean_variance / ((1.0 - phi) * (3.0 - phi) / 3.0)
    unit_per_s = np.full_like(unit, thermometer.mean_variance / thermometer.spacing_s)
    unit[CODE] = unit_per_s[CODE] = thermometer.step**2
    return NOISE.slow * unit, NOISE.walk * unit_per_s


def mix(filters: Filters, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mixed initial conditions x and P of each jerk PSD, and the predicted mode probabilities c̄.

    With the transition matrix M and the mixing probabilities ω_ij = M_ij μ_i / c̄_j, mode j begins with
    x_0j = Σ_i ω_ij x_i and the covariance Σ_i ω_ij (P_i + d_i d_iᵀ), d_i = x_i - x_0j.  Sums are of
    differences from one of the modes, so that a large mean costs no digits.
    """
    x, mu = filters.x, filters.mu
    modes = mu.shape[1]
    transition = np.eye(modes) + min(dt * CHANGE_PER_S, MOST_CHANGE) * _generator(modes)
    predicted = mu @ transition
    off = x - x[..., :1]
    mixed = (mu * off) @ transition / predicted
    second = (mu * (filters.p + off[:, None] * off)) @ transition / predicted
    return x[..., :1] + mixed, second - mixed[:, None] * mixed, predicted


@cache
def _generator(modes: int) -> FloatArray:
    """Return the generator of the Markov chain of modes, half a change to each neighbour, (m, m)."""
    differences = np.diff(np.eye(modes), axis=0)
    return -0.5 * differences.T @ differences


def predict(thermometer: Thermometer, filters: Filters, time_s: float) -> Filters:
    """Mix the filters of each noise model and advance all to a time: x = F x, P = F P Fᵀ + Q, (2), (4), (5).

    T, r and a move with white jerk; e decays by φ = exp(-dt/τ).  A walk of the reading has no state of its
    own: it is process noise of T, and what it gains in a long time is added in the output.
    """
    dt = max(time_s - filters.time_s, 0.0)
    x, p, mu = mix(filters, dt)
    half = dt**2 / 2.0
    f = np.array([[1.0, dt, half, 0.0], [0.0, 1.0, dt, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    q = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, half], [dt**3 / 6, half, dt]])
    x, p = _times(f, x), _times(f, _times(f, p).swapaxes(0, 1))
    p = 0.5 * (p + p.swapaxes(0, 1))  # else what rounding leaves unsymmetric grows with each step
    p[:ERROR, :ERROR] += q[:, :, None, None] * JERK_PSDS
    slow, walk_per_s = slow_error(thermometer)
    phi = np.exp(-dt / NOISE.tau_s)  # depends on the noise model, so F has 1 in its place
    x[ERROR] *= phi
    p[ERROR] *= phi
    p[:, ERROR] *= phi
    p[ERROR, ERROR] += slow * (1.0 - phi**2)
    p[TEMPERATURE, TEMPERATURE] += walk_per_s * dt
    return Filters(x, p, mu, filters.time_s + dt)


def _times(f: FloatArray, values: FloatArray) -> FloatArray:
    """Return a matrix (4, 4) times values whose first axis is the state, (4, ...)."""
    return (f @ values.reshape(STATES, -1)).reshape(values.shape)


def correct(filters: Filters, correction: Correction) -> Filters:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    p = filters.p
    gain = (p[:, TEMPERATURE] + p[:, ERROR]) / filters.y[1]  # P Hᵀ / (H P Hᵀ): how the state follows y
    x = filters.x + gain * correction.mean_change
    p = p + gain[:, None] * (gain * correction.variance_change)
    mu = filters.mu * np.exp(correction.log_likelihood - correction.log_likelihood.max())
    return Filters(x, p, np.maximum(mu / mu.sum(), LEAST_PROBABILITY), filters.time_s)


def estimate(thermometer: Thermometer, filters: Filters) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return mean and variance over all filters of T, °C and °C², and of r, °C/s and (°C/s)².

    To the variance of T is added what of a slow error and of a walk is never known.
    """
    x, p, (slow, walk_per_s) = filters.x, filters.p, slow_error(thermometer)
    never_known = SLOW_MEAN**2 * (slow + walk_per_s * WALK_S)
    temperature = filters.mixture(x[TEMPERATURE], p[TEMPERATURE, TEMPERATURE] + never_known)
    return temperature, filters.mixture(x[RATE], p[RATE, RATE])
