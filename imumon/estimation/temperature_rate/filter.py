"""Multiple-model Kalman filter of temperature and rate: predict, mix, correct, output, once a slot.

Arrays have the state first, then the kinds of noise and the smoothnesses: x (4, k, m), P (4, 4, k, m), and
mode probabilities mu (k, m).  The smoothness of a temperature may change, so smoothnesses are mixed within
each kind (IMM).  A thermometer does not change its nature, so kinds are only weighed (MMAE).  The steps are
those of Bar-Shalom et al. (2001), section 11.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.gate import Gate, Outcome, spans_a_fault
from imumon.estimation.temperature_rate.measurement import Evidence, Predicted, evaluate, predicted_reading
from imumon.estimation.temperature_rate.model import (
    ACCELERATION,
    ERROR,
    RATE,
    SLOT_S,
    STATES,
    TEMPERATURE,
    Params,
    dynamics,
    jerk_noise,
    smoothness_transition,
)
from imumon.estimation.temperature_rate.sensor import REVERSALS, Reading, Thermometer
from imumon.filters.multiple_models import mix, mixture, mode_probabilities
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION, UNSEEN_RATE

GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate, s."""
LATE_S, LATE_INTERVALS = 5.0, 3.0
"""Readings that are missing for so long, and so many usual intervals, leave the temperature unobserved, s."""
COARSER = 1.25
"""A step found to be so much larger is another: the readings were taken for finer than they are."""
WALK_S = 900.0
"""What a walk of the reading gains in this time is not known of the temperature, s."""
FROZEN_S, FROZEN_PER_S = 3600.0, 1.0 / 3600.0**2
"""A level unchanged for an hour may be frozen: the rate is known worse by 1 °C/h every hour."""
LEAST_LEFT = 1e-9
"""A correction leaves so much of a variance, or rounding would leave none."""


class Shown(NamedTuple):
    """Estimate from a time on: a parabola of the temperature, and a decaying offset of its rate."""

    time_s: float = 0.0
    temperature: float = math.nan
    rate: float = math.nan
    acceleration: float = math.nan
    """°C, °C/s, °C/s²."""
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    rate_offset: float = 0.0
    """Rate shown until `time_s` less the new rate, °C/s; it decays with `Params.glide_s`."""
    late_s: float = LATE_S
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
    unmixed_s: float = 0.0


@dataclass(slots=True, eq=False)
class State:
    """All that is known of one thermometer and its temperature."""

    thermometer: Thermometer
    gate: Gate = field(default_factory=Gate)
    filters: Filters | None = None
    """None without an estimate."""
    shown: Shown = field(default_factory=Shown)
    step: float = 0.0
    """The step that the filters take the readings to have, °C."""
    usual_s: float = 0.0
    """Time between the last two slots that were used."""

    @property
    def late_s(self) -> float:
        """Age of the last reading from which on the temperature is unobserved, s."""
        return max(LATE_S, LATE_INTERVALS * self.usual_s)

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.filters, self.shown, self.usual_s = None, Shown(), 0.0
        self.thermometer.begin()
        self.gate.begin()


def start(params: Params, thermometer: Thermometer, reading: Reading, kinds: FloatArray) -> Filters:
    """Return filters that begin at a slot's mean with any rate.

    `kinds` (k,) are the probabilities of the kinds of noise.
    """
    k, m = len(kinds), len(params.jerks)
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = reading.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.unit**2 + reading.variance
    p[RATE, RATE] = FASTEST_RATE**2
    # A smooth temperature has no more acceleration than its jerk makes in half an hour.
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, np.array(params.jerks) * 900.0)
    p[ERROR, ERROR] = slow_error(params, thermometer)[0]
    return Filters(x, p, np.repeat(kinds[:, np.newaxis] / m, m, axis=1), reading.time_s)


def slow_error(params: Params, thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every kind, (k, 1)."""
    kinds = params.kinds
    unit = np.where(kinds.is_level, max(thermometer.step**2, thermometer.rho), thermometer.variance)
    return kinds.slow_variance * unit, kinds.walk * unit


def predict(params: Params, filters: Filters, time_s: float, thermometer: Thermometer, jerk: float) -> None:
    """Advance all filters to a time: x = F x, P = F P Fᵀ + Q; `jerk` is added to their densities of jerk."""
    dt = round(max(time_s - filters.time_s, 0.0), 3)
    step = dynamics(params, dt)
    shape = filters.x.shape
    filters.x = (step.f @ filters.x.reshape(STATES, -1)).reshape(shape) * step.decay
    p = (step.f_kron_f @ filters.p.reshape(STATES**2, -1)).reshape(STATES, *shape)
    p *= step.decay[:, np.newaxis] * step.decay
    variance, walk = slow_error(params, thermometer)
    p[:ERROR, :ERROR] += step.q
    if jerk:
        p[:ERROR, :ERROR] += jerk * jerk_noise(dt)[:, :, np.newaxis, np.newaxis]
    p[ERROR, ERROR] += variance * (1.0 - step.decay[ERROR] ** 2)
    p[TEMPERATURE, TEMPERATURE] += walk * dt
    filters.p, filters.time_s = p, max(time_s, filters.time_s)
    filters.unmixed_s += dt


def mix_smoothness(params: Params, filters: Filters) -> None:
    """Mix the smoothnesses within each kind once enough time has passed: the IMM's interaction."""
    if filters.unmixed_s < params.mix_s - 0.5 * SLOT_S:
        return
    transition = smoothness_transition(params, round(filters.unmixed_s))
    filters.x, filters.p, filters.mu = mix(filters.x, filters.p, filters.mu, transition)
    filters.unmixed_s = 0.0


def correct(params: Params, filters: Filters, y: Predicted, evidence: Evidence) -> None:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    mean_change, variance_change, log_likelihood = evidence.correction
    variance_change = np.maximum(variance_change, -y.variance * (1.0 - LEAST_LEFT))
    filters.x = filters.x + y.gain * mean_change
    filters.p = filters.p + y.gain[:, np.newaxis] * (y.gain * variance_change)
    filters.mu = mode_probabilities(filters.mu, log_likelihood, params.least)


class Merged(NamedTuple):
    """Moments of the mixture; variances in °C² and (°C/s)²."""

    temperature: float
    rate: float
    acceleration: float
    temperature_variance: float
    rate_variance: float


def merge(params: Params, filters: Filters, evidence: Evidence | None) -> Merged:
    """Return the moments of the mixture; a level that did not enter the states confines it here."""
    x, p, mu = filters.x, filters.p, filters.mu
    temperature, rate = x[TEMPERATURE], x[RATE]
    variance, rate_variance = p[TEMPERATURE, TEMPERATURE], p[RATE, RATE]
    if evidence is not None and evidence.level is not None:
        level, rows = evidence.level, slice(0, params.kinds.levels)
        held = ~level.enters
        gain = predicted_reading(x[:, rows], p[:, :, rows]).gain
        mean_change, variance_change, log_mass = (held * part for part in level.truncation)
        temperature, rate = temperature.copy(), rate.copy()
        variance, rate_variance, mu = variance.copy(), rate_variance.copy(), mu.copy()
        temperature[rows] += gain[TEMPERATURE] * mean_change
        rate[rows] += gain[RATE] * mean_change
        variance[rows] += gain[TEMPERATURE] ** 2 * variance_change
        rate_variance[rows] += gain[RATE] ** 2 * variance_change
        mu[rows] *= np.exp(log_mass)
    mu = mu / mu.sum()
    t, t_variance = mixture(mu, temperature, variance)
    r, r_variance = mixture(mu, rate, rate_variance)
    return Merged(t, r, float((mu * x[ACCELERATION]).sum()), t_variance, r_variance)


def step(params: Params, state: State, reading: Reading) -> Shown:
    """Take a slot; return what is shown from its end on."""
    thermometer, gate = state.thermometer, state.gate
    repeated = thermometer.repeats
    fresh = thermometer.learn(reading) if reading.count else None
    if state.filters is not None and reading.end_s - gate.last_valid_s(reading, thermometer) > GAP_S:
        state.filters, state.shown = None, Shown()
    if state.filters is None:
        dead = thermometer.is_dead(reading.time_s)
        if fresh is None or dead or gate.is_stuck(reading) or spans_a_fault(reading, thermometer):
            return state.shown
        return _restart(params, state, reading, params.kinds.prior)
    filters = state.filters
    time_s = reading.time_s if fresh is None else fresh.time_s
    unobserved = time_s - gate.used_s > state.late_s
    mix_smoothness(params, filters)
    predict(params, filters, time_s, thermometer, params.unobserved_jerk if unobserved else 0.0)
    y = predicted_reading(filters.x, filters.p)
    before_s = gate.used_s
    outcome = Outcome.PREDICT
    if fresh is not None:
        outcome = gate.decide(fresh, thermometer, *mixture(filters.mu, y.mean, y.variance))
    coarser = outcome is Outcome.USE and thermometer.step > COARSER * state.step > 0.0
    found_repeats = outcome is Outcome.PREDICT and thermometer.repeats and not repeated
    if fresh is not None and (coarser or found_repeats):
        # So far readings were taken for finer, or repeats for readings.
        return _restart(params, state, fresh, params.kinds.prior)
    if outcome is Outcome.RESTART:
        return _restart(params, state, fresh or reading, filters.mu.sum(axis=1))
    evidence = None
    if outcome is Outcome.USE and fresh is not None:
        square_rate = filters.x[RATE] ** 2 + filters.p[RATE, RATE]
        evidence = evaluate(params, thermometer, fresh, y, square_rate)
        correct(params, filters, y, evidence)
        state.usual_s = fresh.time_s - before_s
    state.step = thermometer.step
    state.shown = _show(params, state, filters, evidence, reading)
    return state.shown


def _restart(params: Params, state: State, reading: Reading, kinds: FloatArray) -> Shown:
    state.filters = start(params, state.thermometer, reading, kinds)
    state.gate.accept(reading)
    state.step = state.thermometer.step
    state.shown = Shown()
    state.shown = _show(params, state, state.filters, None, reading)
    return state.shown


def _show(
    params: Params, state: State, filters: Filters, evidence: Evidence | None, reading: Reading
) -> Shown:
    """Return temperature, rate and their standard deviations from the end of the slot on."""
    thermometer = state.thermometer
    merged = merge(params, filters, evidence)
    slow, walk = slow_error(params, thermometer)
    slow_variance = float((filters.mu * (slow + walk * WALK_S)).sum())
    edge = (params.edge if thermometer.reversals >= REVERSALS else params.sticky_edge) * thermometer.step
    variance = merged.temperature_variance + edge**2 + params.slow_mean**2 * slow_variance
    variance += (merged.rate * thermometer.repeat_s) ** 2 / 3.0
    other = state.gate.other_level(reading)
    if math.isfinite(other):
        variance += (other - merged.temperature) ** 2
    # A ramp r0 that begins at once hides for σ/r0, and then the rate is off by r0.
    hidden_s = math.sqrt(variance + thermometer.step**2 / 12.0) / params.onset_rate
    frozen_s = max(reading.end_s - thermometer.changed_s - FROZEN_S, 0.0)
    rate_variance = merged.rate_variance + params.onset_per_s * hidden_s * params.onset_rate**2
    rate_variance += min(FROZEN_PER_S * frozen_s, UNSEEN_RATE) ** 2
    ahead = reading.end_s - filters.time_s
    shown = Shown(
        reading.end_s,
        merged.temperature + ahead * merged.rate,
        merged.rate + ahead * merged.acceleration,
        merged.acceleration,
        math.sqrt(variance),
        math.sqrt(rate_variance),
        late_s=SLOT_S + state.late_s,
        reading_sd=thermometer.reading_sd,
    )
    before = state.shown
    if math.isnan(before.rate):
        return shown
    age = shown.time_s - before.time_s
    fading = math.exp(-age / params.glide_s) * before.rate_offset
    return shown._replace(rate_offset=before.rate + age * before.acceleration + fading - shown.rate)
