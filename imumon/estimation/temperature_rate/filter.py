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
    smoothness_transition,
)
from imumon.estimation.temperature_rate.thermometer import NEIGHBOUR_S, REVERSALS, Reading, Thermometer
from imumon.filters.multiple_models import mix, mixture, mode_probabilities
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION, UNSEEN_RATE

GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate, s."""
LATE_INTERVALS = 3.0
"""After so many usual intervals, and `NEIGHBOUR_S`, the next reading is not extrapolated to."""
WALK_S = 900.0
"""What a walk of the reading gains in this time is not known of the temperature, s."""
FROZEN_S = 3600.0
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
    unmixed_s: float = 0.0


@dataclass(slots=True, eq=False)
class State:
    """All that is known of one thermometer and its temperature."""

    thermometer: Thermometer
    gate: Gate = field(default_factory=Gate)
    filters: Filters | None = None
    """None without an estimate."""
    shown: Shown = field(default_factory=Shown)

    def begin(self) -> None:
        """Begin a segment; what is known of the sensor stays."""
        self.filters, self.shown, self.gate = None, Shown(), Gate()
        self.thermometer.begin()


def start(params: Params, thermometer: Thermometer, reading: Reading, kinds: FloatArray | None) -> Filters:
    """Return filters that begin at a slot's mean with any rate.

    `kinds` (k,) are the probabilities of the kinds of noise; None if nothing is known of them.
    """
    k, m = len(params.kinds.white), len(params.jerks)
    kinds = np.full(k, 1.0 / k) if kinds is None else kinds
    x, p = np.zeros((STATES, k, m)), np.zeros((STATES, STATES, k, m))
    x[TEMPERATURE] = reading.mean
    p[TEMPERATURE, TEMPERATURE] = thermometer.unit + reading.variance
    p[RATE, RATE] = FASTEST_RATE**2
    # A smooth temperature has no more acceleration than its jerk makes in half an hour.
    p[ACCELERATION, ACCELERATION] = np.minimum(START_ACCELERATION**2, np.array(params.jerks) * 900.0)
    p[ERROR, ERROR] = slow_error(params, thermometer)[0]
    return Filters(x, p, np.repeat(kinds[:, np.newaxis] / m, m, axis=1), reading.time_s)


def slow_error(params: Params, thermometer: Thermometer) -> tuple[FloatArray, FloatArray]:
    """Return the variance of e in °C² and of its walk in °C²/s, of every kind, (k, 1)."""
    kinds = params.kinds
    unit = np.full_like(kinds.walk, thermometer.variance)
    unit[: kinds.levels] = thermometer.unit
    return kinds.slow_variance * unit, kinds.walk * unit


def predict(params: Params, filters: Filters, time_s: float, thermometer: Thermometer) -> None:
    """Advance all filters to a time: x = F x, P = F P Fᵀ + Q."""
    dt = round(max(time_s - filters.time_s, 0.0), 3)
    step = dynamics(params, dt)
    shape = filters.x.shape
    filters.x = (step.f @ filters.x.reshape(STATES, -1)).reshape(shape) * step.decay
    p = (step.f_kron_f @ filters.p.reshape(STATES**2, -1)).reshape(STATES, *shape)
    p *= step.decay[:, np.newaxis] * step.decay
    variance, walk = slow_error(params, thermometer)
    p[:ERROR, :ERROR] += step.q
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


def correct(params: Params, filters: Filters, y: Predicted, correction: Correction) -> None:
    """Correct all filters by the evidence of a slot on y, and their probabilities by its likelihood."""
    mean_change, variance_change, log_likelihood = correction
    variance_change = np.maximum(variance_change, -y.variance * (1.0 - LEAST_LEFT))
    filters.x = filters.x + y.gain * mean_change
    filters.p = filters.p + y.gain[:, np.newaxis] * (y.gain * variance_change)
    filters.mu = mode_probabilities(filters.mu, log_likelihood, params.least)


def step(params: Params, state: State, reading: Reading) -> Shown:
    """Take a slot; return what is shown from its end on."""
    thermometer, gate = state.thermometer, state.gate
    repeated = thermometer.repeat_s
    fresh = thermometer.learn(reading) if reading.count else None
    if reading.end_s - gate.used_s > GAP_S:
        state.filters, state.shown = None, Shown()
    filters = state.filters
    if filters is None:
        dead = thermometer.is_dead(reading.time_s)
        if fresh is None or dead or gate.is_stuck(reading) or spans_a_fault(reading, thermometer):
            return state.shown
        return _restart(params, state, reading)
    mix_smoothness(params, filters)
    predict(params, filters, reading.time_s if fresh is None else fresh.time_s, thermometer)
    y = predicted_reading(filters.x, filters.p)
    confines = None
    if fresh is not None:
        outcome = gate.decide(fresh, thermometer, *mixture(filters.mu, y.mean, y.variance))
        if outcome is Outcome.RESTART:
            return _restart(params, state, fresh, filters.mu.sum(axis=1))
        if outcome is Outcome.PREDICT and thermometer.repeat_s > repeated == 0.0:
            # So far repeats were taken for readings.
            return _restart(params, state, fresh)
        if outcome is Outcome.USE:
            square_rate = filters.x[RATE] ** 2 + filters.p[RATE, RATE]
            correction, confines = evaluate(params, thermometer, fresh, y, square_rate)
            correct(params, filters, y, correction)
    state.shown = _show(params, state, filters, y, confines, reading)
    return state.shown


def _restart(params: Params, state: State, reading: Reading, kinds: FloatArray | None = None) -> Shown:
    state.filters = filters = start(params, state.thermometer, reading, kinds)
    state.gate.accept(reading)
    state.shown = Shown()
    y = predicted_reading(filters.x, filters.p)
    state.shown = _show(params, state, filters, y, None, reading)
    return state.shown


def _show(
    params: Params,
    state: State,
    filters: Filters,
    y: Predicted,
    confines: Correction | None,
    reading: Reading,
) -> Shown:
    """Return temperature, rate and their standard deviations from the end of the slot on."""
    thermometer, mu = state.thermometer, filters.mu
    x, variances = filters.x, np.stack([filters.p[TEMPERATURE, TEMPERATURE], filters.p[RATE, RATE]])
    if confines is not None:
        # A level that did not enter the states confines what is shown.
        x = x + y.gain * confines.mean_change
        variances = variances + y.gain[: RATE + 1] ** 2 * confines.variance_change
        mu = mu * np.exp(confines.log_likelihood)
        mu = mu / mu.sum()
    temperature, variance = mixture(mu, x[TEMPERATURE], variances[TEMPERATURE])
    rate, rate_variance = mixture(mu, x[RATE], variances[RATE])
    acceleration = float((mu * x[ACCELERATION]).sum())
    slow, walk = slow_error(params, thermometer)
    variance += params.slow_mean**2 * float((filters.mu * (slow + walk * WALK_S)).sum())
    edge = params.edge if thermometer.reversals >= REVERSALS else params.sticky_edge
    variance += (edge * thermometer.step) ** 2
    variance += (rate * thermometer.repeat_s) ** 2 / 3.0
    # A ramp r0 that begins at once hides for σ/r0, and then the rate is off by r0.
    hidden_s = math.sqrt(variance + thermometer.step**2 / 12.0) / params.onset_rate
    frozen_s = max(reading.end_s - thermometer.changed_s - FROZEN_S, 0.0)
    rate_variance += params.onset_per_s * hidden_s * params.onset_rate**2
    rate_variance += min(frozen_s / FROZEN_S**2, UNSEEN_RATE) ** 2
    ahead = reading.end_s - filters.time_s
    shown = Shown(
        reading.end_s,
        temperature + ahead * rate,
        rate + ahead * acceleration,
        acceleration,
        math.sqrt(variance),
        math.sqrt(rate_variance),
        late_s=SLOT_S + max(NEIGHBOUR_S, LATE_INTERVALS * state.gate.interval_s),
        reading_sd=thermometer.reading_sd,
    )
    before = state.shown
    if math.isnan(before.rate):
        return shown
    age = shown.time_s - before.time_s
    fading = math.exp(-age / params.glide_s) * before.rate_offset
    return shown._replace(rate_offset=before.rate + age * before.acceleration + fading - shown.rate)
