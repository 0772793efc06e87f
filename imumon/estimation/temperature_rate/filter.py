"""Multiple-model Kalman filter of temperature and rate: predict, mix, correct, output, once a slot.

Arrays have the state first, then the noise models and the jerk PSDs: x (4, k, m), P (4, 4, k, m), and mode
probabilities mu (k, m).  The jerk PSD of a temperature may change, so the filters of a noise model are mixed
(IMM).  A thermometer does not change its nature, so noise models are only weighed (MMAE).  The steps are
those of Bar-Shalom et al. (2001), section 11.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.gate import Gate, Outcome
from imumon.estimation.temperature_rate.measurement import Correction, Predicted, evaluate, predicted_reading
from imumon.estimation.temperature_rate.model import (
    ACCELERATION,
    ERROR,
    RATE,
    SLOT_S,
    STATES,
    TEMPERATURE,
    Params,
    dynamics,
)
from imumon.estimation.temperature_rate.thermometer import REVERSALS, Reading, Thermometer
from imumon.filters.multiple_models import mix, mixture, mode_probabilities
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION, UNSEEN_RATE

GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate, s.  Assumed:
in that time a board goes through half a warm-up."""
START_S = 900.0
"""At the start a smooth temperature has no more acceleration than its jerk makes in this time, s."""
WALK_S = 900.0
"""What a walk of the reading gains in this time is not known of the temperature, s."""
FROZEN_S = 3600.0
"""A code unchanged for this long may be frozen; from then on the sigma of the rate grows."""
FROZEN_RATE = 1.0 / 3600.0
"""It grows by this in every further `FROZEN_S`, °C/s: 1 °C/h."""
LEAST_LEFT = 1e-9
"""A correction leaves so much of a variance, or rounding would leave none."""


class Output(NamedTuple):
    """Estimate from a time on: a temperature of constant rate, and a rate of constant acceleration."""

    time_s: float = 0.0
    temperature: float = math.nan
    rate: float = math.nan
    acceleration: float = math.nan
    """°C, °C/s, °C/s²."""
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    rate_offset: float = 0.0
    """Rate of the output until `time_s` less the new rate, °C/s; it decays with `Params.output_lag_s`."""
    late_s: float = math.inf
    """Age from which on readings are missing, s."""
    reading_sd: float = math.nan
    """Standard deviation of a single reading, °C."""


@dataclass(slots=True, eq=False)
class Filters:
    """The filters of one thermometer."""

    x: FloatArray
    p: FloatArray
    mu: FloatArray
    time_s: float
    """What x refers to."""


@dataclass(slots=True, eq=False)
class State:
    """All that is known of one thermometer and its temperature."""

    thermometer: Thermometer
    gate: Gate = field(default_factory=Gate)
    filters: Filters | None = None
    """None without an estimate."""
    output: Output = field(default_factory=Output)

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.filters, self.output, self.gate = None, Output(), Gate()
        self.thermometer.begin()


def start(params: Params, thermometer: Thermometer, reading: Reading) -> Filters:
    """Return filters that begin at a slot's mean with any rate."""
    k, m = params.models.shape[1], len(params.jerk_psds)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = reading.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.noise_scale + reading.variance
    p[RATE, RATE] = FASTEST_RATE**2
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, np.array(params.jerk_psds) * START_S)
    p[ERROR, ERROR] = slow_error(params, thermometer)[0]
    return Filters(x, p, np.full((k, m), 1.0 / (k * m)), reading.time_s)


def slow_error(params: Params, thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every noise model, (k, 1)."""
    _, slow_variance, slow_s, walk_per_s = params.models
    # Of the variance of e, second differences of slot means, ρ, show (1 - φ)(3 - φ)/3.
    keep = np.exp(-thermometer.spacing_s / slow_s)
    scale = thermometer.variance / ((1.0 - keep) * (3.0 - keep) / 3.0)
    walk_scale = np.full_like(slow_s, thermometer.variance / thermometer.spacing_s)
    codes = len(params.code_models)
    scale[:codes] = walk_scale[:codes] = thermometer.noise_scale
    return slow_variance * scale, walk_per_s * walk_scale


def predict(params: Params, filters: Filters, time_s: float, thermometer: Thermometer) -> None:
    """Mix the filters of each noise model (IMM) and advance all to a time: x = F x, P = F P Fᵀ + Q."""
    dt = round(max(time_s - filters.time_s, 0.0), 3)
    step = dynamics(params, dt)
    x, p, filters.mu = mix(filters.x, filters.p, filters.mu, step.transition)
    shape = x.shape
    filters.x = (step.f @ x.reshape(STATES, -1)).reshape(shape) * step.decay
    p = (step.f_kron_f @ p.reshape(STATES**2, -1)).reshape(STATES, *shape)
    p *= step.decay[:, np.newaxis] * step.decay
    variance, walk = slow_error(params, thermometer)
    p[:ERROR, :ERROR] += step.q
    p[ERROR, ERROR] += variance * (1.0 - step.decay[ERROR] ** 2)
    p[TEMPERATURE, TEMPERATURE] += walk * dt
    filters.p, filters.time_s = p, max(time_s, filters.time_s)


def correct(params: Params, filters: Filters, y: Predicted, correction: Correction) -> None:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    mean_change, variance_change, log_likelihood = correction
    variance_change = np.maximum(variance_change, -y.variance * (1.0 - LEAST_LEFT))
    filters.x = filters.x + y.gain * mean_change
    filters.p = filters.p + y.gain[:, np.newaxis] * (y.gain * variance_change)
    filters.mu = mode_probabilities(filters.mu, log_likelihood, params.probability_floor)


def step(params: Params, state: State, reading: Reading) -> Output:
    """Take a slot; return the output from its end on."""
    thermometer, gate = state.thermometer, state.gate
    repeated = thermometer.repeat_s > 0.0
    fresh = thermometer.learn(reading) if reading.count else None
    if reading.end_s - gate.used_s > GAP_S:
        state.filters, state.output = None, Output()
    filters, expected = state.filters, None
    if filters is not None:
        predict(params, filters, reading.time_s if fresh is None else fresh.time_s, thermometer)
        y = predicted_reading(filters.x, filters.p)
        expected = mixture(filters.mu, y.mean, y.variance)
    outcome, output_only = Outcome.PREDICT, None
    if fresh is not None:
        outcome = gate.decide(fresh, thermometer, expected)
        if expected and outcome is Outcome.PREDICT and thermometer.repeat_s > 0.0 and not repeated:
            outcome = Outcome.RESTART  # repeated readings were taken for new ones
        if outcome is Outcome.RESTART:
            gate.accept(fresh)
            filters, state.output = start(params, thermometer, fresh), Output()
    if filters is None:
        return state.output
    y = predicted_reading(filters.x, filters.p)
    if fresh is not None and outcome is Outcome.USE:
        square_rate = filters.x[RATE] ** 2 + filters.p[RATE, RATE]
        correction, output_only = evaluate(params, thermometer, fresh, y, square_rate)
        correct(params, filters, y, correction)
    state.filters, state.output = filters, _output(params, state, filters, y, output_only, reading.end_s)
    return state.output


def _output(
    params: Params, state: State, filters: Filters, y: Predicted, output_only: Correction | None, end_s: float
) -> Output:
    """Return mean and standard deviation of the mixture from the end of the slot on."""
    mu, x = filters.mu, filters.x
    variances = np.stack([filters.p[TEMPERATURE, TEMPERATURE], filters.p[RATE, RATE]])
    if output_only is not None:
        x = x + y.gain * output_only.mean_change
        variances = variances + y.gain[: RATE + 1] ** 2 * output_only.variance_change
        mu = mu * np.exp(output_only.log_likelihood)
        mu = mu / mu.sum()
    temperature, variance = mixture(mu, x[TEMPERATURE], variances[TEMPERATURE])
    rate, rate_variance = mixture(mu, x[RATE], variances[RATE])
    acceleration = float((mu * x[ACCELERATION]).sum())
    more, more_of_rate = _beyond_the_models(params, state.thermometer, filters, rate, end_s, variance)
    ahead, before = end_s - filters.time_s, state.output
    rate += ahead * acceleration
    age = end_s - before.time_s
    fading = math.exp(-age / params.output_lag_s) * before.rate_offset
    offset = before.rate + age * before.acceleration + fading - rate
    return Output(
        end_s,
        temperature + ahead * (rate - ahead * acceleration),
        rate,
        acceleration,
        math.sqrt(variance + more),
        math.sqrt(rate_variance + more_of_rate),
        0.0 if math.isnan(before.rate) else offset,
        SLOT_S + state.gate.neighbour_s,
        state.thermometer.reading_sd,
    )


def _beyond_the_models(
    params: Params, thermometer: Thermometer, filters: Filters, rate: float, end_s: float, variance: float
) -> tuple[float, float]:
    """Return what no model has of the variances of temperature and rate, °C² and (°C/s)²."""
    slow, walk = slow_error(params, thermometer)
    edge_sd = params.edge_sd if thermometer.reversals >= REVERSALS else params.hysteresis_sd
    more = params.slow_mean**2 * float((filters.mu * (slow + walk * WALK_S)).sum())
    more += (edge_sd * thermometer.step) ** 2 + (rate * thermometer.repeat_s) ** 2 / 3.0
    # A ramp that has just begun is hidden by the temperature's sigma and the step.
    hidden = (variance + more + thermometer.step**2 / 12.0) / params.memory_s**2
    frozen = max(end_s - thermometer.changed_s - FROZEN_S, 0.0) / FROZEN_S
    return more, hidden + min(frozen * FROZEN_RATE, UNSEEN_RATE) ** 2
