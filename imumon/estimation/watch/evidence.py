"""Sequential tests of normalised innovations, slot by slot.

When the filter is right, an innovation over its standard deviation, v, is standard normal whatever came
before.  So for every regressor r that is known before v the factor::

    e = exp(theta r v - theta |r| tolerance - theta² r² kappa / 2)                  (1)

has an expectation of at most one, given the past, as long as the mean of v is within tolerance |r| of zero
and its variance within kappa.  A CUSUM of log e, max(0, m) + log e, is below the logarithm of the
Shiryaev-Roberts sum, which less the number of steps is a supermartingale: the mean number of steps until m
exceeds log A is A at least.  Of K such tests the limit log(K A) keeps that mean.  See Pollak 1985 for the
sum, Shin, Ramdas and Rinaldo 2023 ("E-detectors") for tests under a composite hypothesis.  The variance of v
has tests of its own, with::

    e = exp(lambda v²) sqrt(1 - 2 lambda kappa)                                     (2)
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from imumon.blocks import BoolArray, FloatArray

SLOT_S, BLOCK = 1.0, 10
"""Length of a slot at rest, s, and how many make a step of the tests."""
LEARNING = 20
"""Slots after a start that do not count: the filter is still estimating the noise."""
CLIP = 4.0
"""An innovation counts as no more than this many standard deviations: a knock is no effect."""
TOLERANCE, KAPPA = 0.03, 1.1
"""Mean of an innovation per unit of a regressor, and variance, that are still as the filter expects."""
THETAS = np.array([0.12, 0.35, 1.0, -0.12, -0.35, -1.0])
"""Means that are tested for, per unit of a regressor; the best is at most 1.7 times off in between."""
LAMBDAS = np.array([0.1, 0.3])
"""Of (2): best for variances of 1.4 and 3."""
SCALE_S = 3600.0
"""A regressor is in units of its largest value, which is forgotten within about an hour."""


class Pattern(StrEnum):
    """What innovations that are not white may follow; effects name it in `suspected_by`."""

    TEMPERATURE = "temperature"
    RATE = "temperature rate"
    TIME = "time since start"
    AUTOCORRELATION = "follow each other"
    VARIANCE = "exceed their standard deviation"


THERMAL = (
    (Pattern.TEMPERATURE, 300.0, 0.2),
    (Pattern.RATE, math.inf, 0.003),
    (Pattern.RATE, 100.0, 0.003),
)
"""Temperature and its rate: time constant of a high-pass, s, and the least change that is not noise of the
thermometer, °C and °C/s."""
DECAYS_S = np.array([math.inf, 600.0])
"""A constant and a warm-up: their time constants."""
PAST_S = np.array([1.0, 10.0])
"""Means of earlier innovations: their time constants, s."""
PATTERNS = np.array(
    [pattern for pattern, *_ in THERMAL]
    + [Pattern.TIME] * len(DECAYS_S)
    + [Pattern.AUTOCORRELATION] * len(PAST_S)
    + [Pattern.VARIANCE]
)
"""Of each regressor in their order, and of (2) at the end."""
_SECONDS, _LEAST = np.array([each[1:] for each in THERMAL]).T
_OF_RATE: BoolArray = PATTERNS[: len(THERMAL)] == Pattern.RATE
_KEEP = np.where(PAST_S > SLOT_S, np.exp(-SLOT_S / PAST_S), 0.0)  # by slots: a pause holds none


class State:
    """All that is carried from slot to slot, by axis and regressor."""

    def __init__(self) -> None:
        thermal, regressors = len(THERMAL), len(PATTERNS) - 1
        self.low = np.full((3, thermal), np.nan)
        """Low-passes of temperature and rate."""
        self.scale = np.zeros((3, thermal))
        """Their largest high-passed values."""
        self.past = np.zeros((3, len(PAST_S)))
        """Means of earlier innovations."""
        self.product, self.absolute, self.power = np.zeros((3, 3, regressors))
        """Sums of r v, |r| and r² over the block."""
        self.square = np.zeros((3, 1))
        """Sum of v² over the block."""
        self.tests, self.sizes = np.zeros((3, regressors, len(THETAS))), np.zeros((3, len(LAMBDAS)))
        """CUSUM of each test."""
        self.peaks = np.zeros((3, len(PATTERNS)))
        """Their largest values since the start."""
        self.first_s = self.last_s = 0.0
        """Time of the first and the last slot, s."""
        self.slots = 0
        self.alarm = False


def limit(false_alarm_hours: float) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    tests = 3 * ((len(PATTERNS) - 1) * len(THETAS) + len(LAMBDAS))
    return math.log(tests * false_alarm_hours * 3600.0 / (BLOCK * SLOT_S))


def step(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> float:
    """Take a slot; at the end of a block return the highest of the tests, else 0.

    Parameters
    ----------
    now_s : float
        Time, s.
    innovation : array (3,)
        Over its standard deviation.
    temperature, rate : array (3,)
        degC and degC/s of each gyro; NaN where unknown.
    """
    if state.slots == 0:
        state.first_s = state.last_s = now_s
    dt, state.last_s = now_s - state.last_s, now_s
    state.slots += 1
    v = np.clip(innovation, -CLIP, CLIP)[:, np.newaxis]
    decay = np.tile(np.exp((state.first_s - now_s) / DECAYS_S), (3, 1))
    # Over three of their standard deviations.
    past = np.clip(state.past / (3.0 * np.sqrt((1.0 - _KEEP) / (1.0 + _KEEP))), -1.0, 1.0)
    state.past = _KEEP * state.past + (1.0 - _KEEP) * v
    r = np.hstack([_thermal(state, dt, temperature, rate), decay, past])
    counted = state.slots - LEARNING
    if counted <= 0:
        return 0.0
    state.product += r * v
    state.absolute += np.abs(r)
    state.power += r * r
    state.square += v * v
    return _end_block(state) if counted % BLOCK == 0 else 0.0


def _thermal(state: State, dt: float, temperature: FloatArray, rate: FloatArray) -> FloatArray:
    """Return temperature and rate behind their high-passes, between -1 and 1; 0 where unknown."""
    value = np.where(_OF_RATE, rate[:, np.newaxis], temperature[:, np.newaxis])
    state.low = np.where(np.isnan(state.low), np.where(np.isinf(_SECONDS), 0.0, value), state.low)
    state.low += -np.expm1(-dt / _SECONDS) * np.nan_to_num(value - state.low)
    change = value - state.low
    largest = np.fmax(np.fmax(np.abs(change), math.exp(-dt / SCALE_S) * state.scale), _LEAST)
    state.scale = np.where(np.isnan(change), state.scale, largest)
    return np.asarray(np.nan_to_num(change / np.maximum(state.scale, _LEAST)))


def _end_block(state: State) -> float:
    """Bring every test on, and return the highest."""
    cost = TOLERANCE * state.absolute[..., np.newaxis] * np.abs(THETAS)
    cost = cost + 0.5 * KAPPA * state.power[..., np.newaxis] * THETAS**2
    gain = state.product[..., np.newaxis] * THETAS - cost
    # A negative correlation with the past is no fault: the filter's sigma is too large.  These 18 of 132
    # tests count in the limit, which they raise by 0.15.
    gain[:, PATTERNS[:-1] == Pattern.AUTOCORRELATION, len(THETAS) // 2 :] = 0.0
    state.tests = np.maximum(state.tests, 0.0) + gain
    large = LAMBDAS * state.square + 0.5 * BLOCK * np.log(1.0 - 2.0 * LAMBDAS * KAPPA)
    state.sizes = np.maximum(state.sizes, 0.0) + large
    now = np.hstack([state.tests.max(-1), state.sizes.max(-1, keepdims=True)])
    state.peaks = np.maximum(state.peaks, now)
    for sums in (state.product, state.absolute, state.power, state.square):
        sums[:] = 0.0
    return float(state.peaks.max())
