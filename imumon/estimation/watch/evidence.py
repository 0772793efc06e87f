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
from functools import cache

import numpy as np

from imumon.blocks import FloatArray

SLOT_S, BLOCK = 1.0, 10
"""Length of a slot at rest, s, and how many make a step of the tests."""
LEARNING = 20
"""Slots after a start that do not count: the filter is still measuring the noise."""
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


class Trait(StrEnum):
    """What the innovations may do that they should not; effects name it in `suspected_by`."""

    TEMPERATURE = "temperature"
    RATE = "temperature rate"
    TIME = "time since start"
    PAST = "follow each other"
    SIZE = "exceed their standard deviation"


REGRESSORS = (
    *((Trait.TEMPERATURE, seconds) for seconds in (30.0, 300.0)),
    *((Trait.RATE, seconds) for seconds in (math.inf, 30.0, 100.0, 300.0)),
    *((Trait.TIME, seconds) for seconds in (math.inf, 300.0, 1500.0)),
    *((Trait.PAST, seconds) for seconds in (1.0, 10.0, 100.0)),
)
"""Temperature and its rate behind a high-pass, warm-up (infinite: constant), and mean of earlier innovations,
with their time constants, s."""
DRIVEN = [trait for trait, _ in REGRESSORS if trait in (Trait.TEMPERATURE, Trait.RATE)]
LEAST = {Trait.TEMPERATURE: 0.2, Trait.RATE: 0.003}
"""Smaller changes, degC and degC/s, are not in units of themselves: noise of the thermometer."""


@cache
def seconds_of(*traits: Trait) -> FloatArray:
    """Return the time constants of the regressors of some traits, s."""
    return np.array([seconds for trait, seconds in REGRESSORS if trait in traits])


@cache
def columns_of(trait: Trait) -> list[int]:
    """Return where the regressors of a trait stand among the peaks; behind all of them stands the size."""
    return [j for j, (of, _) in enumerate((*REGRESSORS, (Trait.SIZE, 0.0))) if of == trait]


class State:
    """All that is carried from slot to slot, by axis and regressor in their order."""

    def __init__(self) -> None:
        driven, regressors = len(DRIVEN), len(REGRESSORS)
        self.low = np.full((3, driven), np.nan)
        """Low-passes of temperature and rate."""
        self.scale = np.zeros((3, driven))
        """Their largest high-passed values."""
        self.past = np.zeros((3, len(columns_of(Trait.PAST))))
        """Means of earlier innovations."""
        self.along, self.absolute, self.power = (np.zeros((3, regressors)) for _ in range(3))
        """Sums of r v, |r| and r² over the block."""
        self.square = np.zeros(3)
        """Sum of v² over the block."""
        self.tests = np.zeros((3, regressors, len(THETAS)))
        self.sizes = np.zeros((3, len(LAMBDAS)))
        """CUSUM of each test."""
        self.peaks = np.zeros((3, regressors + 1))
        """Their largest values since the start, the size last."""
        self.first_s = self.last_s = 0.0
        """Time of the first and the last slot, s."""
        self.slots = 0
        self.alarm = False


def limit(false_alarm_hours: float) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    # A negative correlation with the past is not tested: it means that the filter expects too much.
    past = len(columns_of(Trait.PAST))
    tests = 3 * ((len(REGRESSORS) - past) * len(THETAS) + past * len(THETAS) // 2 + len(LAMBDAS))
    return math.log(tests * max(false_alarm_hours * 3600.0 / (BLOCK * SLOT_S), 1.0))


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
    v = np.clip(innovation, -CLIP, CLIP)
    r = np.hstack([_of_temperature(state, dt, temperature, rate), _of_time(state), _of_past(state, v)])
    counted = state.slots - LEARNING
    if counted > 0:
        state.along += r * v[:, np.newaxis]
        state.absolute += np.abs(r)
        state.power += r * r
        state.square += v * v
    return _end_block(state) if counted > 0 and counted % BLOCK == 0 else 0.0


def _of_temperature(state: State, dt: float, temperature: FloatArray, rate: FloatArray) -> FloatArray:
    """Return temperature and rate behind their high-passes, between -1 and 1; 0 where unknown."""
    value = np.column_stack([temperature if trait == Trait.TEMPERATURE else rate for trait in DRIVEN])
    seconds = seconds_of(Trait.TEMPERATURE, Trait.RATE)
    state.low = np.where(np.isnan(state.low), np.where(np.isinf(seconds), 0.0, value), state.low)
    change = np.where(np.isnan(value), 0.0, value - state.low)
    state.low += -np.expm1(-dt / seconds) * change
    driven = value - state.low
    least = [LEAST[trait] for trait in DRIVEN]
    largest = np.fmax(np.fmax(np.abs(driven), math.exp(-dt / SCALE_S) * state.scale), least)
    state.scale = np.where(np.isnan(driven), state.scale, largest)
    return np.where(np.isnan(driven), 0.0, driven / np.maximum(state.scale, least))


def _of_time(state: State) -> FloatArray:
    """Return a constant and what a warm-up leaves."""
    return np.tile(np.exp((state.first_s - state.last_s) / seconds_of(Trait.TIME)), (3, 1))


def _of_past(state: State, v: FloatArray) -> FloatArray:
    """Return means of earlier innovations over three of their standard deviations, and bring them on."""
    seconds = seconds_of(Trait.PAST)
    keep = np.where(seconds > SLOT_S, np.exp(-SLOT_S / seconds), 0.0)  # by slots: a pause holds none
    before = state.past / (3.0 * np.sqrt((1.0 - keep) / (1.0 + keep)))
    state.past = keep * state.past + (1.0 - keep) * v[:, np.newaxis]
    return np.clip(before, -1.0, 1.0)


def _end_block(state: State) -> float:
    """Bring every test on, and return the highest."""
    cost = TOLERANCE * state.absolute[..., np.newaxis] * np.abs(THETAS)
    cost = cost + 0.5 * KAPPA * state.power[..., np.newaxis] * THETAS**2
    gain = state.along[..., np.newaxis] * THETAS - cost
    gain[:, columns_of(Trait.PAST), len(THETAS) // 2 :] = 0.0
    state.tests = np.maximum(state.tests, 0.0) + gain
    large = LAMBDAS * state.square[:, np.newaxis] + 0.5 * BLOCK * np.log(1.0 - 2.0 * LAMBDAS * KAPPA)
    state.sizes = np.maximum(state.sizes, 0.0) + large
    now = np.hstack([state.tests.max(-1), state.sizes.max(-1, keepdims=True)])
    state.peaks = np.maximum(state.peaks, now)
    for sums in (state.along, state.absolute, state.power, state.square):
        sums[:] = 0.0
    return float(state.peaks.max())
