"""Multiple-model Kalman filter of temperature and rate: model, start, predict, correct, once a slot.

The state of each filter is x = (T, r, a, e): temperature, its rate, its acceleration, and the slow error of
the reading.  What a thermometer rounds to its steps is T + e + white noise.

Arrays have the state first, then the noise models and the jerk PSDs: x (4, k, m), P (4, 4, k, m), and mode
probabilities mu (k, m).  The jerk PSD of a temperature may change, so the filters of a noise model are mixed
(IMM).  A thermometer does not change its nature, so noise models are only weighed (MMAE).  The steps are
those of Bar-Shalom et al. (2001), section 11.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.thermometer import SLOT_S, Slot, Thermometer
from imumon.filters.multiple_models import mix, mixture, mode_probabilities, mode_transition
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION

STATES = 4
TEMPERATURE, RATE, ACCELERATION, ERROR = range(STATES)
LONG_S = 900.0
"""At the start a temperature has no more acceleration than its jerk makes in this time, s, and what a walk of
the reading gains in it is not known of the temperature.  Ablation."""
LEAST_PROBABILITY = 1e-14
"""Least probability of a filter, so that none is lost for ever.  Ablation."""


class NoiseModel(NamedTuple):
    """One hypothesis of the sensor noise.

    A *code model* reads the code in which T + e + white noise is; its unit of variance is d², of the step d.
    A *mean model* measures a slot's mean; its unit is ρ, the variance of this mean from slot to slot.
    """

    white: float
    """Variance of the white noise, units."""
    slow: float = 0.0
    """Variance of the slow error e, units."""
    slow_s: float = 1e9
    """Correlation time τ of e, s."""
    walk_per_s: float = 0.0
    """Variance per second of the random walk that is part of 1/f noise, units/s."""


def code_model(white_sd: float, slow_sd: float = 0.0, slow_s: float = 1e9, walk: float = 0.0) -> NoiseModel:
    """Return a code model by standard deviations in steps; e also moves within a slot, by σ √(1 s/(3 τ))."""
    slow = slow_sd**2
    return NoiseModel(white_sd**2 + slow * SLOT_S / (3.0 * slow_s), slow, slow_s, walk * slow)


def mean_model(slow: float = 0.0, slow_s: float = 1e9, walk_per_s: float = 0.0) -> NoiseModel:
    """Return a mean model, a share of whose ρ is the slow error."""
    return NoiseModel(1.0 - slow, slow, slow_s, walk_per_s)


CODE_MODELS = (
    *(
        code_model(white_sd)
        for white_sd in (0.02, 0.035, 0.05, 0.065, 0.08, 0.1, 0.125, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5)
    ),
    code_model(0.1, 0.25, 5.0),
    code_model(0.1, 0.6, 5.0),
    code_model(0.1, 0.6, 40.0),
    code_model(0.1, 0.4, 3.0, 0.01),
)
"""White noise of 0.02 to 0.5 steps, a quarter apart where the ripple of a mean depends on it most, and slow
errors of seconds to a minute."""
MEAN_MODELS = (
    mean_model(),
    *(mean_model(share, slow_s) for share in (0.3, 1.0) for slow_s in (5.0, 40.0)),
    *(mean_model(share, 3.0, walk) for share, walk in ((0.3, 0.01), (1.0, 0.01), (1.0, 0.05))),
)


NOISE: FloatArray = np.array([*CODE_MODELS, *MEAN_MODELS], np.float64).T[:, :, np.newaxis]
"""The four fields of every `NoiseModel`, (4, k, 1)."""
CODE, MEAN = slice(0, len(CODE_MODELS)), slice(len(CODE_MODELS), None)
"""Rows of the code and of the mean models."""
JERK_PSDS = 10.0 ** (-23.0 + 2.5 * np.arange(9.0))
"""Power spectral densities q of white jerk, °C²/s⁵, (m,).  The rate gains √(q t³/3) in a time t: with the
least, 0.17 °C/h in a day; with the largest, 1 °C/min in a second."""
CHANGE_PER_S = 2e-3
"""Probability per second that the jerk PSD changes to a neighbour's."""


@lru_cache(maxsize=64)
def dynamics(dt: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return F, F ⊗ F, the decay of e, Q and the transitions of dt seconds: acceleration with white jerk.

    F is (4, 4) and has 1 in place of φ = exp(-dt/τ) of e, which depends on the noise model: the decay,
    (4, k, 1), is φ for e, and 1 for the other states.  F ⊗ F, (16, 16), is for vec(F P Fᵀ) = (F ⊗ F) vec P.
    Q of T, r and a is (3, 3, 1, m), the transition matrix of the jerk PSDs (m, m).
    """
    f: FloatArray = np.eye(STATES)
    f[TEMPERATURE, RATE] = f[RATE, ACCELERATION] = dt
    f[TEMPERATURE, ACCELERATION] = 0.5 * dt**2
    decay = np.ones((STATES, NOISE.shape[1], 1))
    decay[ERROR] = np.exp(-dt / NOISE[2])
    by_jerk = np.array([[dt**2 / 2.0], [dt], [1.0]])  # Q is the integral of (t²/2, t, 1) times its transpose
    q = dt * by_jerk * by_jerk.T / np.array([[5.0, 4.0, 3.0], [4.0, 3.0, 2.0], [3.0, 2.0, 1.0]])
    transition = mode_transition(len(JERK_PSDS), min(dt * CHANGE_PER_S, 0.4))
    return f, np.asarray(np.kron(f, f), np.float64), decay, q[:, :, None, None] * JERK_PSDS, transition


class Predicted(NamedTuple):
    """The reading y = H x, H = [1, 0, 0, 1], before its white noise and steps, of every filter, (k, m)."""

    mean: FloatArray
    variance: FloatArray
    gain: FloatArray
    """P Hᵀ / (H P Hᵀ), (4, k, m): how the state follows y."""
    square_rate: FloatArray
    """Mean square of the rate, r² + P_rr, (°C/s)²."""


class Correction(NamedTuple):
    """Evidence of a slot on y, (k, m)."""

    mean_change: FloatArray
    """Change of the mean of y, °C."""
    variance_change: FloatArray
    """Change of the variance of y, at most zero, °C²."""
    log_likelihood: FloatArray


@dataclass(frozen=True, eq=False)
class Filters:
    """The filters of one thermometer: x, P, mu, and the time that x refers to, s."""

    x: FloatArray
    p: FloatArray
    mu: FloatArray
    time_s: float

    @cached_property
    def reading(self) -> Predicted:
        """The reading y = H x, H = [1, 0, 0, 1], before its white noise and steps."""
        x, p = self.x, self.p
        cross = p[:, TEMPERATURE] + p[:, ERROR]
        variance = cross[TEMPERATURE] + cross[ERROR]
        return Predicted(x[TEMPERATURE] + x[ERROR], variance, cross / variance, x[RATE] ** 2 + p[RATE, RATE])

    @property
    def expected(self) -> tuple[float, float]:
        """Mean and variance of y over all filters, °C and °C²."""
        return mixture(self.mu, self.reading.mean, self.reading.variance)


def start(thermometer: Thermometer, slot: Slot) -> Filters:
    """Return filters that begin at a slot's mean with any rate."""
    k, m = NOISE.shape[1], len(JERK_PSDS)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = slot.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.step**2 + thermometer.rho + slot.variance
    p[RATE, RATE] = FASTEST_RATE**2
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, JERK_PSDS * LONG_S)
    p[ERROR, ERROR] = slow_error(thermometer)[0]
    return Filters(x, p, np.full((k, m), 1.0 / (k * m)), slot.time_s)


def slow_error(thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every noise model, (k, 1)."""
    _, slow, slow_s, walk_per_s = NOISE
    # Of the variance of e, second differences of slot means, ρ, show (1 - φ)(3 - φ)/3.
    keep = np.exp(-thermometer.spacing_s / slow_s)
    scale = thermometer.variance / ((1.0 - keep) * (3.0 - keep) / 3.0)
    walk_scale = np.full_like(slow_s, thermometer.variance / thermometer.spacing_s)
    scale[CODE] = walk_scale[CODE] = thermometer.step**2
    return slow * scale, walk_per_s * walk_scale


def predict(thermometer: Thermometer, filters: Filters, time_s: float) -> Filters:
    """Mix the filters of each noise model (IMM) and advance all to a time: x = F x, P = F P Fᵀ + Q."""
    dt = round(max(time_s - filters.time_s, 0.0), 3)
    f, f_kron_f, decay, q, transition = dynamics(dt)
    x, p, mu = mix(filters.x, filters.p, filters.mu, transition)
    shape = x.shape
    x = (f @ x.reshape(STATES, -1)).reshape(shape) * decay
    p = (f_kron_f @ p.reshape(STATES**2, -1)).reshape(STATES, *shape)
    p *= decay[:, np.newaxis] * decay
    variance, walk = slow_error(thermometer)
    p[:ERROR, :ERROR] += q
    p[ERROR, ERROR] += variance * (1.0 - decay[ERROR] ** 2)
    p[TEMPERATURE, TEMPERATURE] += walk * dt
    return Filters(x, p, mu, max(time_s, filters.time_s))


def correct(filters: Filters, correction: Correction) -> Filters:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    mean_change, variance_change, log_likelihood = correction
    gain = filters.reading.gain
    x = filters.x + gain * mean_change
    p = filters.p + gain[:, np.newaxis] * (gain * variance_change)
    mu = mode_probabilities(filters.mu, log_likelihood, LEAST_PROBABILITY)
    return Filters(x, p, mu, filters.time_s)
