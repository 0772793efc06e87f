"""Disturbances of a unit that should stand still, slot by slot of a quarter of a second.

The noise is learnt from the unit itself: of samples about the mean of their slot, and of the means.  A slot
is disturbed when samples scatter far more, when a gyro's mean leaves its level (the unit turns), or when an
accelerometer's mean steps.  The level of an accelerometer may drift: that is its warm-up.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.compiled import njit
from imumon.estimation.alignment.state import (
    BASE,
    CHANNELS,
    COUNT,
    INNER,
    LEARNED,
    MEAN_VAR,
    PREVIOUS,
    REFERENCE,
    SAMPLE_VAR,
    SLOTS,
    SQUARES,
    SUM,
    State,
)

FINEST = (2e-8, 2e-8, 2e-8, 2e-4, 2e-4, 2e-4)
"""Noise of a mean is never taken for less, rad/s and m/s²."""
LIMIT, LIMIT_AT_FIRST = 7.0, 140.0
"""Standard deviations: LIMIT + LIMIT_AT_FIRST / slots, as the noise is not well known at first."""
BASE_SLOTS, NOISE_SLOTS = 40, 2000
"""Slots over which the level of a gyro and the noise are averaged."""
INDEPENDENT = 0.25
"""Share of independent samples: filters within sensors make neighbours alike."""
SCATTER, ROTATION, STEP, UNREST, GAP = 1, 2, 3, 4, 5
"""What disturbed."""


@njit(**INNER)
def begin_slot(state: State) -> None:
    """Forget the samples of a slot; the next one is gathered about the last mean."""
    watch = state.watch
    for i in range(CHANNELS):
        watch[REFERENCE, i] = watch[PREVIOUS, i]
        watch[SUM, i] = watch[SQUARES, i] = 0.0
    state.flag[COUNT] = 0


@njit(**INNER)
def forget_noise(state: State) -> None:
    """Learn the noise anew, as of a unit never seen."""
    state.flag[SLOTS] = 0
    state.watch[:] = 0.0


@njit(**INNER)
def judge_slot(state: State) -> int:
    """Return what disturbed the slot that is complete, 0 for nothing, -1 while the noise is being learnt."""
    watch, flag = state.watch, state.flag
    count = flag[COUNT]
    mean, variance = np.empty(CHANNELS), np.empty(CHANNELS)
    for i in range(CHANNELS):
        mean[i] = watch[REFERENCE, i] + watch[SUM, i] / count
        variance[i] = math.nan
        if count > 1:
            variance[i] = max(watch[SQUARES, i] - watch[SUM, i] ** 2 / count, 0.0) / (count - 1)
    if flag[SLOTS] < LEARNED:
        _learn(state, mean, variance)
        return -1
    cause = 0
    limit = LIMIT + LIMIT_AT_FIRST / flag[SLOTS]
    free = max(INDEPENDENT * (count - 1), 1.0)
    scatter = (1.0 - 2.0 / (9.0 * free) + limit * math.sqrt(2.0 / (9.0 * free))) ** 3
    for i in range(CHANNELS):
        noise = math.sqrt(watch[MEAN_VAR, i]) + FINEST[i]
        if variance[i] > scatter * (watch[SAMPLE_VAR, i] + FINEST[i] ** 2):
            cause = SCATTER
        elif i < 3 and abs(mean[i] - watch[BASE, i]) > limit * noise:
            cause = ROTATION
        elif i >= 3 and abs(mean[i] - watch[PREVIOUS, i]) > 1.5 * limit * noise:
            cause = STEP
    if cause == 0:
        _update(state, mean, variance)
    for i in range(CHANNELS):
        watch[PREVIOUS, i] = mean[i]
    return cause


@njit(**INNER)
def _learn(state: State, mean: np.ndarray, variance: np.ndarray) -> None:
    """Keep the first slots; medians of them are the first level and noise."""
    flag, watch, learning = state.flag, state.watch, state.learning
    for i in range(CHANNELS):
        learning[flag[SLOTS], i], learning[flag[SLOTS], CHANNELS + i] = mean[i], variance[i]
        watch[PREVIOUS, i] = mean[i]
    flag[SLOTS] += 1
    if flag[SLOTS] < LEARNED:
        return
    values, scatter, steps = np.empty(LEARNED), np.empty(LEARNED), np.empty(LEARNED - 1)
    for i in range(CHANNELS):
        for k in range(LEARNED):
            values[k], scatter[k] = learning[k, i], learning[k, CHANNELS + i]
            if k > 0:
                steps[k - 1] = (learning[k, i] - learning[k - 1, i]) ** 2
        watch[BASE, i] = median(values)
        # A single sample per slot has no scatter to judge by.
        watch[SAMPLE_VAR, i] = median(scatter) if flag[COUNT] > 1 else math.inf
        # The median of a squared normal value is 0.455 of its variance.
        watch[MEAN_VAR, i] = 0.5 * median(steps) / 0.455


@njit(**INNER)
def median(values: np.ndarray) -> float:
    """Return the median of a few values, (n,), which are sorted in place; NaNs count as the largest."""
    n = len(values)
    for i in range(1, n):
        value, k = values[i], i
        while k > 0 and (math.isnan(values[k - 1]) or values[k - 1] > value):
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))


@njit(**INNER)
def _update(state: State, mean: np.ndarray, variance: np.ndarray) -> None:
    watch, flag = state.watch, state.flag
    flag[SLOTS] += 1
    level = 1.0 / min(flag[SLOTS], BASE_SLOTS)
    noise = 1.0 / min(flag[SLOTS], NOISE_SLOTS)
    for i in range(CHANNELS):
        watch[BASE, i] += level * (mean[i] - watch[BASE, i])
        watch[MEAN_VAR, i] += noise * (0.5 * (mean[i] - watch[PREVIOUS, i]) ** 2 - watch[MEAN_VAR, i])
        if not math.isnan(variance[i]) and math.isfinite(watch[SAMPLE_VAR, i]):
            watch[SAMPLE_VAR, i] += noise * (variance[i] - watch[SAMPLE_VAR, i])
