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
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray

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
TESTS = 3 * (PAST * 2 * len(THETAS) + len(PAST_S) * len(THETAS) + len(LARGE))
"""Number of tests; a negative correlation with the past is none: it says that the filter expects too much."""

_LEAST = np.repeat([LEAST_DEGC, LEAST_RATE], [len(TEMPERATURE_S), 1 + len(RATE_S)])
_LARGE = np.array(LARGE)
_SIGNED = np.array([*THETAS, *(-theta for theta in THETAS)])
_TESTED = np.ones((REGRESSORS, len(_SIGNED)), np.bool_)
_TESTED[PAST:, len(THETAS) :] = False


@dataclass
class State:
    """All that is carried from slot to slot, per axis.

    Parameters
    ----------
    low : array (3, 5)
        Low-passes of the temperature and its rate; NaN before the first value.
    scale : array (3, 6)
        Largest values of the regressors of temperature and rate.
    past : array (3, 3)
        Means of earlier innovations.
    along, size, power : array (3, 12)
        Sums of r v, abs(r) and r² over the block.
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
    first_s, last_s : float
        Time of the first slot and of the last, s.
    slots : int
        Since the start.
    alarm : bool
        Whether there was one.
    """

    low: FloatArray = field(default_factory=lambda: np.full((3, len(_DRIVEN_S)), np.nan))
    scale: FloatArray = field(default_factory=lambda: np.tile(_LEAST, (3, 1)))
    past: FloatArray = field(default_factory=lambda: np.zeros((3, len(PAST_S))))
    along: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS)))
    size: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS)))
    power: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS)))
    square: FloatArray = field(default_factory=lambda: np.zeros((3,)))
    tests: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS, len(_SIGNED))))
    sizes: FloatArray = field(default_factory=lambda: np.zeros((3, len(LARGE))))
    peaks: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS + 1)))
    at_alarm: FloatArray = field(default_factory=lambda: np.zeros((3, REGRESSORS + 1)))
    first_s: float = 0.0
    last_s: float = 0.0
    slots: int = 0
    alarm: bool = False


def limit(false_alarm_hours: float, slot_s: float = 0.5) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    return math.log(TESTS * max(false_alarm_hours * 3600.0 / (BLOCK * slot_s), 1.0))


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
            state.alarm, found = True, i
            state.at_alarm = state.peaks.copy()
    return found


def step(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> float:
    """Take a slot, (3,) each; at the end of a block return the highest of the tests, else 0."""
    if state.slots == 0:
        state.first_s = state.last_s = now_s
    v = np.clip(innovation, -CLIP, CLIP)
    driven = _drive(state, now_s - state.last_s, temperature, rate)
    warm = np.broadcast_to(np.exp((state.first_s - now_s) / np.array(WARM_UP_S)), (3, len(WARM_UP_S)))
    past = np.clip(state.past * _UNIT, -1.0, 1.0)
    state.past = _KEEP * state.past + (1.0 - _KEEP) * v[:, np.newaxis]
    state.last_s = now_s
    state.slots += 1
    if state.slots <= LEARNING:
        return 0.0
    regressor = np.concatenate([driven, np.ones((3, 1)), warm, past], axis=1)
    state.along = state.along + regressor * v[:, np.newaxis]
    state.size = state.size + np.abs(regressor)
    state.power = state.power + regressor**2
    state.square = state.square + v**2
    return _end_block(state) if (state.slots - LEARNING) % BLOCK == 0 else 0.0


def _drive(state: State, dt: float, temperature: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the regressors of temperature and rate, between -1 and 1, (3, 6); 0 where unknown."""
    value = np.repeat(np.column_stack([temperature, rate]), [len(TEMPERATURE_S), len(RATE_S)], axis=1)
    low = state.low + (1.0 - np.exp(-dt / _DRIVEN_S)) * (value - state.low)
    low = np.where(np.isfinite(state.low), low, value)
    state.low = np.where(np.isfinite(value), low, state.low)
    high = value - low
    driven = np.concatenate([high[:, :RATE], rate[:, np.newaxis], high[:, RATE:]], axis=1)
    scale = np.maximum(np.maximum(np.abs(driven), math.exp(-dt / SCALE_S) * state.scale), _LEAST)
    known = np.isfinite(driven)
    state.scale = np.where(known, scale, state.scale)
    return np.where(known, driven / state.scale, 0.0)


def _end_block(state: State) -> float:
    """Bring every test on, and return the highest."""
    cost = TOLERANCE * state.size[..., np.newaxis] * np.abs(_SIGNED)
    cost = cost + 0.5 * KAPPA * state.power[..., np.newaxis] * _SIGNED**2
    gain = np.where(_TESTED, state.along[..., np.newaxis] * _SIGNED - cost, 0.0)
    state.tests = np.maximum(state.tests, 0.0) + gain
    large = _LARGE * state.square[:, np.newaxis] + 0.5 * BLOCK * np.log(1.0 - 2.0 * _LARGE * KAPPA)
    state.sizes = np.maximum(state.sizes, 0.0) + large
    now = np.concatenate([state.tests.max(-1), state.sizes.max(-1, keepdims=True)], axis=1)
    state.peaks = np.maximum(state.peaks, now)
    state.along, state.size, state.power = (np.zeros((3, REGRESSORS)) for _ in range(3))
    state.square = np.zeros(3)
    return float(state.peaks.max())
