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

from imumon.blocks import NO_INT, FloatArray

SLOT_S, BLOCK = 1.0, 10
"""Length of a slot at rest, s, and how many make a step of the tests."""
LEARNING = 20
"""Slots after a start that do not count: the filter is still estimating the noise."""
CLIP = 4.0
"""An innovation counts as no more than this many standard deviations: a knock is no effect."""
TOLERANCE, KAPPA = 0.03, 1.1
"""Mean of an innovation per unit of a regressor, and variance, that are still as the filter expects."""
THETAS = (0.12, 0.35, 1.0, -0.12, -0.35, -1.0)
"""Means that are tested for, per unit of a regressor; the best is at most 1.7 times off in between."""
LAMBDAS = np.array([0.1, 0.3])
"""Of (2): best for variances of 1.4 and 3."""


class Pattern(StrEnum):
    """What innovations that are not white may follow; effects name it in `suspected_by`."""

    TEMPERATURE = "temperature"
    RATE = "temperature rate"
    TIME = "time since start"
    AUTOCORRELATION = "follow each other"
    VARIANCE = "exceed their standard deviation"


REGRESSORS = (
    Pattern.TEMPERATURE, Pattern.RATE, Pattern.RATE, Pattern.TIME, Pattern.TIME,
    Pattern.AUTOCORRELATION, Pattern.AUTOCORRELATION,
)  # fmt: skip
"""r: the temperature and twice its rate behind high-passes, `DECAYS_S`, and means of earlier innovations."""
HIGH_PASS_S = np.array([300.0, math.inf, 100.0])
LEAST_CHANGE = np.array([0.2, 0.003, 0.003])
"""Time constants of the high-passes, s, and the least changes that are not noise of the thermometer, °C and
°C/s."""
SCALE_S = 3600.0
"""These regressors are in units of their largest value, which is forgotten within about an hour."""
DECAYS_S = np.array([math.inf, 600.0])
"""A constant and a warm-up: their time constants."""
KEPT = np.array([0.0, math.exp(-SLOT_S / 10.0)])
"""What a slot leaves of the means of earlier innovations: the last one, and those of about 10 s."""
PAST_SCALE = 3.0 * np.sqrt((1.0 - KEPT) / (1.0 + KEPT))
"""Three of their standard deviations."""

_TESTS = [
    (row, theta, pattern)
    for row, pattern in enumerate(REGRESSORS)
    for theta in THETAS
    # A negative correlation with the past is no fault: the filter's sigma is too large.
    if theta > 0.0 or pattern is not Pattern.AUTOCORRELATION
]
_ROWS = [row for row, _, _ in _TESTS]
_THETA = np.array([theta for _, theta, _ in _TESTS])
PATTERNS = np.array([pattern for _, _, pattern in _TESTS] + [Pattern.VARIANCE] * len(LAMBDAS))
"""Of each test, those of (1) and then those of (2), (t,)."""


class State:
    """All that is carried from slot to slot, by axis."""

    def __init__(self) -> None:
        self.low = np.full((3, len(HIGH_PASS_S)), np.nan)
        """Low-passes of temperature and rate, °C and °C/s."""
        self.scale = np.zeros((3, len(HIGH_PASS_S)))
        """Their largest high-passed values."""
        self.past = np.zeros((3, len(KEPT)))
        """Means of earlier innovations."""
        self.gain, self.cusum, self.peaks = np.zeros((3, 3, len(PATTERNS)))
        """Of each test: the sum of log e over the block, the CUSUM, and its largest value since the start."""
        self.slots = 0
        self.first_ns, self.last_s = NO_INT, 0.0
        """Time of the first slot, ns, and of the last one since then, s."""
        self.suspect_segment = NO_INT
        """Segment in which the filter was caught at being wrong."""


def limit(false_alarm_hours: float) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    return math.log(3 * len(PATTERNS) * false_alarm_hours * 3600.0 / (BLOCK * SLOT_S))


def step(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> float:
    """Take a slot; at the end of a block return the highest of the tests, else 0.

    Parameters
    ----------
    now_s : float
        Time since the first slot, s.
    innovation : array (3,)
        Over its standard deviation.
    temperature, rate : array (3,)
        degC and degC/s of each gyro; NaN where unknown.
    """
    dt, state.last_s = now_s - state.last_s, now_s
    state.slots += 1
    v = np.clip(innovation, -CLIP, CLIP)[:, np.newaxis]
    thermal = _high_pass(state, dt, np.column_stack([temperature, rate, rate]))
    decay = np.tile(np.exp(-now_s / DECAYS_S), (3, 1))
    past = np.clip(state.past / PAST_SCALE, -1.0, 1.0)
    state.past = KEPT * state.past + (1.0 - KEPT) * v
    counted = state.slots - LEARNING
    if counted <= 0:
        return 0.0
    theta_r = _THETA * np.hstack([thermal, decay, past])[:, _ROWS]
    state.gain += np.hstack(
        [
            theta_r * v - TOLERANCE * np.abs(theta_r) - 0.5 * KAPPA * theta_r**2,
            LAMBDAS * v**2 + 0.5 * np.log(1.0 - 2.0 * LAMBDAS * KAPPA),
        ]
    )
    if counted % BLOCK:
        return 0.0
    state.cusum = np.maximum(state.cusum, 0.0) + state.gain
    state.gain[:] = 0.0
    state.peaks = np.maximum(state.peaks, state.cusum)
    return float(state.peaks.max())


def _high_pass(state: State, dt: float, value: FloatArray) -> FloatArray:
    """Return temperature and rates behind their high-passes, between -1 and 1, (3, 3); 0 where unknown."""
    state.low = np.where(np.isnan(state.low), np.where(np.isinf(HIGH_PASS_S), 0.0, value), state.low)
    state.low += -np.expm1(-dt / HIGH_PASS_S) * np.nan_to_num(value - state.low)
    change = value - state.low
    largest = np.fmax(np.fmax(np.abs(change), math.exp(-dt / SCALE_S) * state.scale), LEAST_CHANGE)
    state.scale = np.where(np.isnan(change), state.scale, largest)
    return np.asarray(np.nan_to_num(change / np.maximum(state.scale, LEAST_CHANGE)))
