"""Multiple-model Kalman filter of temperature and rate: start, predict, correct, once a slot.

Arrays have the state first, then the noise models and the jerk PSDs: x (4, k, m), P (4, 4, k, m), and mode
probabilities mu (k, m).  The jerk PSD of a temperature may change, so the filters of a noise model are mixed
(IMM).  A thermometer does not change its nature, so noise models are only weighed (MMAE).  The steps are
those of Bar-Shalom et al. (2001), section 11.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.measurement import Correction, Predicted
from imumon.estimation.temperature_rate.model import (
    ACCELERATION,
    ERROR,
    RATE,
    STATES,
    TEMPERATURE,
    Models,
    dynamics,
)
from imumon.estimation.temperature_rate.thermometer import Slot, Thermometer
from imumon.filters.multiple_models import mix, mixture, mode_probabilities
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION

LONG_S = 900.0
"""At the start a temperature has no more acceleration than its jerk makes in this time, s, and what a walk of
the reading gains in it is not known of the temperature.  Ablation."""
LEAST_PROBABILITY = 1e-14
"""Least probability of a filter, so that none is lost for ever.  Ablation."""


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


def start(models: Models, thermometer: Thermometer, slot: Slot) -> Filters:
    """Return filters that begin at a slot's mean with any rate."""
    k, m = models.noise.shape[1], len(models.jerk_psds)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = slot.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.step**2 + thermometer.rho + slot.variance
    p[RATE, RATE] = FASTEST_RATE**2
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, np.array(models.jerk_psds) * LONG_S)
    p[ERROR, ERROR] = slow_error(models, thermometer)[0]
    return Filters(x, p, np.full((k, m), 1.0 / (k * m)), slot.time_s)


def slow_error(models: Models, thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every noise model, (k, 1)."""
    _, slow, slow_s, walk_per_s = models.noise
    # Of the variance of e, second differences of slot means, ρ, show (1 - φ)(3 - φ)/3.
    keep = np.exp(-thermometer.spacing_s / slow_s)
    scale = thermometer.variance / ((1.0 - keep) * (3.0 - keep) / 3.0)
    walk_scale = np.full_like(slow_s, thermometer.variance / thermometer.spacing_s)
    scale[models.code] = walk_scale[models.code] = thermometer.step**2
    return slow * scale, walk_per_s * walk_scale


def predict(models: Models, thermometer: Thermometer, filters: Filters, time_s: float) -> Filters:
    """Mix the filters of each noise model (IMM) and advance all to a time: x = F x, P = F P Fᵀ + Q."""
    dt = round(max(time_s - filters.time_s, 0.0), 3)
    f, f_kron_f, decay, q, transition = dynamics(models, dt)
    x, p, mu = mix(filters.x, filters.p, filters.mu, transition)
    shape = x.shape
    x = (f @ x.reshape(STATES, -1)).reshape(shape) * decay
    p = (f_kron_f @ p.reshape(STATES**2, -1)).reshape(STATES, *shape)
    p *= decay[:, np.newaxis] * decay
    variance, walk = slow_error(models, thermometer)
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
