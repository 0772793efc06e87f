"""Sequential tests of normalised innovations, slot by slot.

When the filter is right, an innovation over its standard deviation, v, is standard normal whatever came
before.  So for every regressor r that is known before v (a function of temperature, of time, or of earlier
innovations) the factor::

    e = exp(θ r v - θ |r| tolerance - θ² r² κ / 2)

has an expectation of at most one, given the past, as long as the mean of v is within tolerance |r| of zero
and its variance within κ.  A CUSUM of log e, max(0, m) + log e, is below the logarithm of the
Shiryaev-Roberts sum, which less the number of steps is a supermartingale: the mean number of steps until m
exceeds log(A) is A at least.  Of K such tests the limit log(K A) keeps that mean (the mean of K
Shiryaev-Roberts sums is one as well).  See Pollak 1985 for the sum, Shin, Ramdas and Rinaldo 2023
("E-detectors") for tests under a composite hypothesis.

Steps are blocks of `BLOCK` slots at rest; a θ of either sign is a test of its own.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner, njit, record

BLOCK, BLOCK_S = 10, 5.0
"""Slots of half a second at rest that make a step of the tests."""
LEARNING = 20
"""Slots after a start that do not count: the filter is still measuring the noise."""
CLIP = 4.0
"""An innovation counts as no more than this: a knock is no effect."""
TOLERANCE = 0.03
"""Mean of an innovation, per unit of a regressor, that is too small to matter."""
KAPPA = 1.1
"""Variance of an innovation that is still as claimed."""
THETAS = (0.12, 0.35, 1.0)
"""Means that are tested for, per unit of a regressor; the best test is at most 1.7 times off in between."""
LARGE = (0.1, 0.3)
"""Factors of v² in the tests of size; they are best for variances of 1.4 and 3."""
SCALE_S = 3600.0
"""A regressor is in units of its largest value; that is forgotten within about an hour."""

TEMPERATURE_S = (30.0, 300.0)
"""Time constants of the high-passes of the temperature."""
RATE_S = (30.0, 100.0, 300.0)
"""The same of its rate."""
WARM_UP_S = (300.0, 1500.0)
"""Time constants of a warm-up."""
PAST_S = (0.5, 10.0, 100.0)
"""Memory of the means of earlier innovations."""
LEAST_DEGC, LEAST_RATE = 0.2, 0.003
"""Smaller changes of the temperature, degC, and of its rate, degC/s, are not in units of themselves."""

_DRIVEN_S = np.array(TEMPERATURE_S + RATE_S)
_KEEP = np.exp(-0.5 / np.array(PAST_S)) * (np.array(PAST_S) > 0.5)
"""Share of the mean of earlier innovations that a new one leaves; by slots, for a pause holds none."""
_UNIT = 1.0 / (3.0 * np.sqrt((1.0 - _KEEP) / (1.0 + _KEEP)))
"""One over three standard deviations of these means."""

# Regressors, in order: temperature, rate, rate high-passed, constant, warm-up, past innovations.
TEMPERATURE, RATE, RATE_HIGH = 0, len(TEMPERATURE_S), len(TEMPERATURE_S) + 1
CONSTANT = RATE_HIGH + len(RATE_S)
WARM_UP = CONSTANT + 1
PAST = WARM_UP + len(WARM_UP_S)
REGRESSORS = PAST + len(PAST_S)
TESTS = 3 * (PAST * 2 * len(THETAS) + len(PAST_S) * len(THETAS) + len(LARGE))
"""Number of tests; a negative correlation with the past is none: it says that the filter expects too much."""

_LEAST = np.repeat([LEAST_DEGC, LEAST_RATE], [len(TEMPERATURE_S), 1 + len(RATE_S)])
_LARGE = np.array(LARGE)
_WARM_UP_S = np.array(WARM_UP_S)
_SIGNED = np.array([*THETAS, *(-theta for theta in THETAS)])
_TESTED = np.ones((REGRESSORS, len(_SIGNED)), np.bool_)
_TESTED[PAST:, len(THETAS) :] = False


class State:
    """All that is carried from slot to slot, per axis: a record (`imumon.compiled.record`)."""

    low: FloatArray
    """Low-passes of the temperature and its rate, (3, 5); NaN before the first value."""
    scale: FloatArray
    """Largest values of the regressors of temperature and rate, (3, 6)."""
    past: FloatArray
    """Means of earlier innovations, (3, 3)."""
    along: FloatArray
    absolute: FloatArray
    power: FloatArray
    """Sums of r v, abs(r) and r² over the block, (3, 12)."""
    square: FloatArray
    """Sum of v² over the block, (3,)."""
    tests: FloatArray
    """CUSUM of each regressor, for each θ, positive first, (3, 12, 6)."""
    sizes: FloatArray
    """CUSUM of each test of size, (3, 2)."""
    peaks: FloatArray
    """Largest value of the tests of each regressor, and of the size, since the start, (3, 13)."""
    at_alarm: FloatArray
    """The same when there was the alarm, (3, 13)."""
    first_s: float
    last_s: float
    """Time of the first slot and of the last, s."""
    slots: int
    alarm: int
    """Slots since the start, and whether there was an alarm."""


def begin() -> State:
    """Return the state before the first slot."""
    sums = dict.fromkeys(("along", "absolute", "power"), (3, REGRESSORS))
    peaks = dict.fromkeys(("peaks", "at_alarm"), (3, REGRESSORS + 1))
    tests = {"tests": (3, REGRESSORS, len(_SIGNED)), "sizes": (3, len(LARGE))}
    driven = {"low": (3, len(_DRIVEN_S)), "scale": (3, len(_LEAST)), "past": (3, len(PAST_S))}
    state = record(State, square=3, **driven, **sums, **tests, **peaks)
    state.low[:], state.scale[:] = np.nan, _LEAST
    return state


def limit(false_alarm_hours: float) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    return math.log(TESTS * max(false_alarm_hours * 3600.0 / BLOCK_S, 1.0))


def watch(
    state: State,
    seconds: FloatArray,
    innovation: FloatArray,
    temperature: FloatArray,
    rate: FloatArray,
    alarm_at: float,
) -> int:
    """Take slots of one segment; return the first row with an alarm that was not there before, or -1.

    Parameters
    ----------
    seconds : array (n,)
        Time, s.
    innovation : array (n, 3)
        Over its standard deviation.
    temperature, rate : array (n, 3)
        degC and degC/s of each gyro; NaN where unknown.
    alarm_at : float
        Limit of the tests.
    """
    found = -1
    for i, now_s in enumerate(seconds.tolist()):
        highest = step(state, now_s, innovation[i], temperature[i], rate[i])
        if highest >= alarm_at and not state.alarm:
            state.alarm, found = 1, i
            state.at_alarm[:] = state.peaks
    return found


def step(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> float:
    """Take a slot, (3,) each; at the end of a block return the highest of the tests, else 0."""
    counted = _regress(state, now_s, innovation, temperature, rate) - LEARNING
    return _end_block(state) if counted > 0 and counted % BLOCK == 0 else 0.0


@njit
def _regress(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> int:
    """Bring the regressors on, and add a slot to the sums of its block; return the number of slots."""
    if state.slots == 0:
        state.first_s = state.last_s = now_s
    dt, state.last_s = now_s - state.last_s, now_s
    state.slots += 1
    regressor = np.empty(REGRESSORS)
    regressor[CONSTANT] = 1.0
    for j in range(len(_WARM_UP_S)):
        regressor[WARM_UP + j] = math.exp((state.first_s - now_s) / _WARM_UP_S[j])
    for a in range(3):
        v = min(max(innovation[a], -CLIP), CLIP)
        _drive(state.low[a], state.scale[a], dt, temperature[a], rate[a], regressor)
        for j in range(len(_KEEP)):
            past = state.past[a, j]
            regressor[PAST + j] = min(max(past * _UNIT[j], -1.0), 1.0)
            state.past[a, j] = _KEEP[j] * past + (1.0 - _KEEP[j]) * v
        if state.slots > LEARNING:
            state.square[a] += v * v
            for j in range(REGRESSORS):
                state.along[a, j] += regressor[j] * v
                state.absolute[a, j] += abs(regressor[j])
                state.power[a, j] += regressor[j] * regressor[j]
    return state.slots


@inner
def _drive(
    low: FloatArray, scale: FloatArray, dt: float, temperature: float, rate: float, regressor: FloatArray
) -> None:
    """Fill in the regressors of temperature and rate, between -1 and 1; 0 where unknown."""
    forget = math.exp(-dt / SCALE_S)
    for j in range(len(scale)):
        # Of the rate itself, and then what passes the high-passes.
        k = j if j < RATE else j - 1
        value = temperature if j < RATE else rate
        driven = value
        if j != RATE:
            if not np.isfinite(low[k]):
                low[k] = value
            elif np.isfinite(value):
                low[k] += (1.0 - math.exp(-dt / _DRIVEN_S[k])) * (value - low[k])
            driven = value - low[k]
        regressor[j] = 0.0
        if np.isfinite(driven):
            scale[j] = max(abs(driven), forget * scale[j], _LEAST[j])
            regressor[j] = driven / scale[j]


def _end_block(state: State) -> float:
    """Bring every test on, and return the highest."""
    cost = TOLERANCE * state.absolute[..., np.newaxis] * np.abs(_SIGNED)
    cost = cost + 0.5 * KAPPA * state.power[..., np.newaxis] * _SIGNED**2
    gain = np.where(_TESTED, state.along[..., np.newaxis] * _SIGNED - cost, 0.0)
    state.tests[:] = np.maximum(state.tests, 0.0) + gain
    large = _LARGE * state.square[:, np.newaxis] + 0.5 * BLOCK * np.log(1.0 - 2.0 * _LARGE * KAPPA)
    state.sizes[:] = np.maximum(state.sizes, 0.0) + large
    now = np.concatenate([state.tests.max(-1), state.sizes.max(-1, keepdims=True)], axis=1)
    state.peaks[:] = np.maximum(state.peaks, now)
    for sums in (state.along, state.absolute, state.power, state.square):
        sums[:] = 0.0
    return float(state.peaks.max())
