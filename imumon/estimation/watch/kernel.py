"""Sequential tests of normalised innovations: the compiled path of the watch.

When the filter is right, an innovation over its standard deviation, v, is standard normal whatever came
before.  So for every regressor r that is known before v (a function of temperature, of time, or of earlier
innovations) the factor::

    e = exp(θ r v - θ |r| tolerance - θ² r² κ / 2)

has an expectation of at most one, given the past, as long as the mean of v is within tolerance |r| of nought
and its variance within κ.  A CUSUM of log e, max(0, m) + log e, is below the logarithm of the
Shiryaev-Roberts sum, which less the number of steps is a supermartingale: the mean number of steps until m
exceeds log(A) is A at least.  Of K such tests the limit log(K A) keeps that mean (the mean of K
Shiryaev-Roberts sums is one as well).  See Pollak 1985 for the sum, Shin, Ramdas and Rinaldo 2023
("E-detectors") for tests under a composite hypothesis.

Steps are blocks of `BLOCK` slots at rest; a θ of either sign is a test of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit

BLOCK = 10
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
SIGNED = 2 * len(THETAS)
TESTS = 3 * (PAST * SIGNED + len(PAST_S) * len(THETAS) + len(LARGE))
"""Number of tests; a negative correlation with the past is none: it says that the filter expects too much."""

# State.number: time of the last slot and of the first, s.
LAST, FIRST = range(2)
# State.counts: slots since the start, whether there was an alarm.
SLOTS, ALARM = range(2)


class State(NamedTuple):
    """All that is carried from slot to slot, per axis.

    Parameters
    ----------
    low : array (3, 5)
        Low-passes of the temperature and its rate; NaN before the first value.
    scale : array (3, 6)
        Largest values of the regressors of temperature and rate.
    past : array (3, 3)
        Means of earlier innovations.
    sums : array (3, 12, 3)
        Of r v, abs(r) and r² over the block.
    square : array (3,)
        Sum of v² over the block.
    tests : array (3, 12, 6)
        CUSUM of each regressor, for each θ, positive first.
    sizes : array (3, 2)
        CUSUM of each test of size.
    peaks : array (3, 13)
        Largest value of the tests of each regressor, and of the size, since the start.
    at_alarm : array (3, 13)
        The same when there was the alarm.
    number, counts : array
    """

    low: FloatArray
    scale: FloatArray
    past: FloatArray
    sums: FloatArray
    square: FloatArray
    tests: FloatArray
    sizes: FloatArray
    peaks: FloatArray
    at_alarm: FloatArray
    number: FloatArray
    counts: IntArray


def empty_state() -> State:
    """Return a state that has seen nothing."""
    state = State(
        np.zeros((3, len(TEMPERATURE_S) + len(RATE_S))),
        np.zeros((3, CONSTANT)),
        np.zeros((3, len(PAST_S))),
        np.zeros((3, REGRESSORS, 3)),
        np.zeros(3),
        np.zeros((3, REGRESSORS, SIGNED)),
        np.zeros((3, len(LARGE))),
        np.zeros((3, REGRESSORS + 1)),
        np.zeros((3, REGRESSORS + 1)),
        np.zeros(2),
        np.zeros(2, np.int64),
    )
    restart(state)
    return state


def limit(false_alarm_hours: float, slot_s: float = 0.5) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    return math.log(TESTS * max(false_alarm_hours * 3600.0 / (BLOCK * slot_s), 1.0))


@njit
def restart(state: State) -> None:
    """Forget all, as after a restart of the device."""
    state.low[:] = np.nan
    state.scale[:, :RATE] = LEAST_DEGC
    state.scale[:, RATE:] = LEAST_RATE
    for part in (state.past, state.sizes, state.peaks, state.at_alarm):
        part[:] = 0.0
    state.sums[:] = 0.0
    state.square[:] = 0.0
    state.tests[:] = 0.0
    state.number[:] = 0.0
    state.counts[:] = 0


@njit
def watch(
    seconds: FloatArray,
    innovation: FloatArray,
    temperature: FloatArray,
    rate: FloatArray,
    alarm_at: float,
    state: State,
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
    count, number = state.counts, state.number
    regressor = np.zeros(REGRESSORS)
    found = -1
    for i in range(len(seconds)):
        if count[SLOTS] == 0:
            number[FIRST] = number[LAST] = seconds[i]
        dt = seconds[i] - number[LAST]
        fade = math.exp(-dt / SCALE_S)
        follow = 1.0 - np.exp(-dt / _DRIVEN_S)
        for k in range(len(WARM_UP_S)):
            regressor[WARM_UP + k] = math.exp((number[FIRST] - seconds[i]) / WARM_UP_S[k])
        for axis in range(3):
            _drive(regressor, axis, temperature[i, axis], rate[i, axis], follow, fade, state)
            v = min(max(innovation[i, axis], -CLIP), CLIP)
            past = state.past[axis]
            for k in range(len(PAST_S)):
                regressor[PAST + k] = min(max(past[k] * _UNIT[k], -1.0), 1.0)
                past[k] = _KEEP[k] * past[k] + (1.0 - _KEEP[k]) * v
            if count[SLOTS] >= LEARNING:
                _add(regressor, axis, v, state)
        number[LAST] = seconds[i]
        count[SLOTS] += 1
        if count[SLOTS] > LEARNING and (count[SLOTS] - LEARNING) % BLOCK == 0:
            highest = _step(state)
            if highest >= alarm_at and not count[ALARM]:
                count[ALARM], found = 1, i
                state.at_alarm[:] = state.peaks
    return found


@njit
def _drive(
    regressor: FloatArray,
    axis: int,
    temperature: float,
    rate: float,
    follow: FloatArray,
    fade: float,
    state: State,
) -> None:
    """Fill the regressors of temperature and rate, between -1 and 1, and the constant; 0 where unknown."""
    low, scale, warm = state.low[axis], state.scale[axis], len(TEMPERATURE_S)
    for k in range(warm):
        regressor[TEMPERATURE + k] = _high_pass(low, k, temperature, follow[k])
    regressor[RATE] = rate
    for k in range(len(RATE_S)):
        regressor[RATE_HIGH + k] = _high_pass(low, warm + k, rate, follow[warm + k])
    for k in range(CONSTANT):
        if math.isfinite(regressor[k]):
            least = LEAST_DEGC if k < RATE else LEAST_RATE
            scale[k] = max(abs(regressor[k]), fade * scale[k], least)
            regressor[k] /= scale[k]
        else:
            regressor[k] = 0.0
    regressor[CONSTANT] = 1.0


@njit
def _high_pass(low: FloatArray, k: int, value: float, follow: float) -> float:
    """Return what is left of a value by a low-pass that has taken it in."""
    if not math.isfinite(value):
        return math.nan
    if math.isfinite(low[k]):
        low[k] += follow * (value - low[k])
    else:
        low[k] = value
    high: float = value - low[k]
    return high


@njit
def _add(regressor: FloatArray, axis: int, v: float, state: State) -> None:
    """Add an innovation to the block."""
    sums = state.sums[axis]
    for k in range(REGRESSORS):
        sums[k, 0] += regressor[k] * v
        sums[k, 1] += abs(regressor[k])
        sums[k, 2] += regressor[k] * regressor[k]
    state.square[axis] += v * v


@njit
def _step(state: State) -> float:
    """End a block: bring every test on, and return the highest."""
    highest = 0.0
    for axis in range(3):
        peaks, slots = state.peaks[axis], state.sums[axis, CONSTANT, 1]
        for k in range(REGRESSORS):
            along, size, power = state.sums[axis, k, 0], state.sums[axis, k, 1], state.sums[axis, k, 2]
            for s in range(SIGNED if k < PAST else len(THETAS)):
                theta = THETAS[s % len(THETAS)]
                sign = 1.0 if s < len(THETAS) else -1.0
                gain = theta * (sign * along - TOLERANCE * size - 0.5 * theta * KAPPA * power)
                state.tests[axis, k, s] = max(state.tests[axis, k, s], 0.0) + gain
                peaks[k] = max(peaks[k], state.tests[axis, k, s])
        for k in range(len(LARGE)):
            gain = LARGE[k] * state.square[axis] + 0.5 * slots * math.log(1.0 - 2.0 * LARGE[k] * KAPPA)
            state.sizes[axis, k] = max(state.sizes[axis, k], 0.0) + gain
            peaks[REGRESSORS] = max(peaks[REGRESSORS], state.sizes[axis, k])
        highest = max(highest, peaks.max())
    state.sums[:] = 0.0
    state.square[:] = 0.0
    return highest
