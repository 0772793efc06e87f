"""Bias drift with a standard deviation that is true: a local level with flicker, its noise learnt on the way.

Means of a second are z = level + Σ f_i + white noise.  The level is a random walk; the f_i are Gauss-Markov
processes of equal variance, one per decade of correlation time, whose sum is flicker (1/f) noise.  A plain
local-level filter takes the fast part of flicker for white noise, and its sigma is then a third too small.

Nobody knows the ratios of drift to white noise beforehand, and minutes of data hardly tell.  So there is a
bank of Kalman filters over both ratios.  The white noise itself is the common scale: its variance is
integrated out, so each filter's weight is the Student-t likelihood of its innovations, and the result is the
mean over all, with the variance within and between them.  With given noise there is one filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.random_error.parameters import GyroNoise
from imumon.estimation.random_error.slots import Slots

TAUS_S = np.array([1.0, 10.0, 100.0, 1e3, 1e4])
"""Correlation times of the processes that make up flicker."""
STATES = 1 + len(TAUS_S)
FLICKERS = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1)
WALKS = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
"""Ratios that are tried: variance of flicker per decade (1/s), and of the walk per second (1/s²), to the
white noise's density.  The first with the first, no drift at all, is none of them."""
USUAL_FLICKER, DECADES = 1e-2, 0.7
"""MEMS gyros have 1e-3 to 1e-1, say their data sheets; a normal distribution over the logarithm."""
NO_FLICKER = 1e-5
"""None at all is as likely as this ratio would be."""
TO_INSTABILITY = math.sqrt(math.pi / math.log(10.0))
"""Bias instability B (IEEE Std 952: the Allan floor is 0.664 B) of flicker with unit variance per decade."""

LEAST_INNOVATIONS = 5
"""So many are needed before the variance of the white noise is finite and known to a factor."""
MEMORY_SLOTS = 7200.0
"""What was learnt fades over so many seconds at rest, so that a change of the noise is followed."""
GATE = 8.0
GATE_SLOTS = 60
"""A mean off by so many deviations is no drift and passed over; so many in a row are a new level."""
JUDGED, CONTRADICTION = 120, 1.5
"""After so many means, innovations that are off by this factor contradict the given noise."""
FLOOR = 1e-24
"""(rad/s)² s: white noise below 1e-12 rad/s/√Hz is none; keeps a constant reading from dividing by nought."""

# Columns of the bank: logarithm of the weight, scale, mean of the states, covariance.
WEIGHT, SCALE, MEAN = range(3)
COVARIANCE = MEAN + STATES
WIDTH = COVARIANCE + STATES * STATES
# Numbers of the state: degrees of freedom of the scale.
FREEDOM = 0
# Integers of the state.
STARTED, OUTLIERS, RESTARTS, PASSED = range(4)


def ratios(noise: GyroNoise) -> tuple[float, float]:
    """Return the variance of flicker per decade and of the walk per second, to the white noise's density."""
    white = noise.angle_random_walk**2
    flicker = ((noise.bias_instability or 0.0) / TO_INSTABILITY) ** 2
    return flicker / white, (noise.rate_random_walk or 0.0) ** 2 / white


def equivalent_walk(flicker: float, walk: float) -> float:
    """Return the walk with which a plain local level has the least error, all in units of the white noise.

    A mean over T has the error 1/(2T) + h ln T + walk T/2 and a constant, h the flicker per e-fold; its least
    is at 1/T = h + √(h² + walk), and the filter that averages over T has the walk 1/T².
    """
    h = flicker / math.log(10.0)
    return (h + math.sqrt(h * h + walk)) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class DriftEstimate:
    """What is known after each slot, arrays of shape (m,); NaN where nothing is.

    Parameters
    ----------
    estimate, sd : array
        Level with flicker at the end of the slot, and its standard deviation, rad/s.
    white, walk : array
        Density of the white noise, (rad/s)² s, and of the random walk of a plain local level that fits
        best, (rad/s)²/s: R Δt and q/Δt of such a filter.
    """

    estimate: FloatArray
    sd: FloatArray
    white: FloatArray
    walk: FloatArray


class DriftFilter:
    """Drift of one axis from slots.

    Parameters
    ----------
    noise : GyroNoise, optional
        What is known of the axis; by default it is learnt.
    """

    def __init__(self, noise: GyroNoise | None = None) -> None:
        if noise is None:
            pairs = [pair for pair in product(FLICKERS, WALKS) if any(pair)]
            self._known = 0.0
        else:
            pairs, self._known = [ratios(noise)], noise.angle_random_walk**2
        self._ratios = np.array([(*pair, log_prior(pair[0])) for pair in pairs], np.float64)
        self._bank = np.zeros((len(pairs), WIDTH))
        self._numbers = np.zeros(1)
        self._integers: IntArray = np.zeros(4, np.int64)

    @property
    def restarts(self) -> int:
        """How often a level that jumped was taken for the new one."""
        return int(self._integers[RESTARTS])

    @property
    def passed_over(self) -> int:
        """Slots too far off to be drift."""
        return int(self._integers[PASSED])

    @property
    def contradiction(self) -> float | None:
        """By what factor the innovations exceed what the given noise says, None when they are not far off."""
        if not self._known or self._numbers[FREEDOM] < JUDGED:
            return None
        factor = math.sqrt(self._bank[0, SCALE] / self._numbers[FREEDOM] / self._known)
        return None if 1.0 / CONTRADICTION < factor < CONTRADICTION else factor

    def process(self, slots: Slots) -> DriftEstimate:
        """Return the estimates after slots that follow those of the last call."""
        m = len(slots)
        out = np.full((4, m), np.nan)
        _filter(
            slots.begins,
            slots.elapsed_s,
            slots.covered_s,
            slots.mean,
            self._ratios,
            self._known,
            self._bank,
            self._numbers,
            self._integers,
            out,
        )
        if self._known:
            out[3] = np.where(
                np.isfinite(out[0]), self._known * equivalent_walk(*self._ratios[0, :2]), np.nan
            )
        return DriftEstimate(*out)


def log_prior(flicker: float) -> float:
    """Return how likely a ratio of flicker is before there are data, as a logarithm without its constant."""
    distance = math.log10(max(flicker, NO_FLICKER) / USUAL_FLICKER) / DECADES
    return -0.5 * distance**2


@njit(cache=True, nogil=True)
def _filter(
    begins: npt.NDArray[np.bool_],
    elapsed: FloatArray,
    covered: FloatArray,
    mean: FloatArray,
    ratios: FloatArray,
    known: float,
    bank: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
    out: FloatArray,
) -> None:
    decay = np.empty(STATES)
    decay[0] = 1.0
    for k in range(mean.size):
        if begins[k]:
            integers[STARTED] = 0
        if integers[STARTED] == 0:
            if covered[k] > 0.0:
                start(bank, ratios, mean[k], covered[k])
                integers[STARTED], integers[OUTLIERS] = 1, 0
        else:
            for i in range(1, STATES):
                decay[i] = math.exp(-elapsed[k] / TAUS_S[i - 1])
            for row in range(len(bank)):
                predict(bank[row], ratios[row], decay, elapsed[k])
            if covered[k] > 0.0:
                _take(mean[k], covered[k], ratios, known, bank, numbers, integers)
        if integers[STARTED] and (known > 0.0 or numbers[FREEDOM] >= LEAST_INNOVATIONS):
            _show(ratios, known, bank, numbers, out, k)


@njit(cache=True, nogil=True)
def start(bank: FloatArray, ratios: FloatArray, mean: float, covered: float) -> None:
    """Begin with a mean: the sum is known as well as the mean, its parts are not."""
    for row in range(len(bank)):
        one, flicker = bank[row], ratios[row, 0]
        for i in range(STATES):
            one[MEAN + i] = mean if i == 0 else 0.0
            for j in range(STATES):
                value = 0.0
                if i == j:
                    value = flicker if i > 0 else 1.0 / covered + (STATES - 1) * flicker
                elif i == 0 or j == 0:
                    value = -flicker
                one[COVARIANCE + STATES * i + j] = value


@njit(cache=True, nogil=True)
def predict(one: FloatArray, ratio: FloatArray, decay: FloatArray, elapsed: float) -> None:
    """Let time pass: the level walks, the flicker forgets."""
    flicker = ratio[0]
    for i in range(STATES):
        one[MEAN + i] *= decay[i]
        for j in range(STATES):
            one[COVARIANCE + STATES * i + j] *= decay[i] * decay[j]
        if i > 0:
            one[COVARIANCE + (STATES + 1) * i] += flicker * (1.0 - decay[i] * decay[i])
    one[COVARIANCE] += ratio[1] * elapsed


@njit(cache=True, nogil=True)
def sums(one: FloatArray, column: FloatArray) -> tuple[float, float]:
    """Return mean and variance (per white noise) of the sum of the states; fill its covariances."""
    mean, variance = 0.0, 0.0
    for i in range(STATES):
        mean += one[MEAN + i]
        total = 0.0
        for j in range(STATES):
            total += one[COVARIANCE + STATES * i + j]
        column[i] = total
        variance += total
    return mean, max(variance, 0.0)


@njit(cache=True, nogil=True)
def update(one: FloatArray, mean: float, covered: float, column: FloatArray) -> float:
    """Take in a mean; return its likelihood's variance in units of the white noise."""
    predicted, variance = sums(one, column)
    total = variance + 1.0 / covered
    residual = mean - predicted
    for i in range(STATES):
        gain = column[i] / total
        one[MEAN + i] += gain * residual
        for j in range(STATES):
            one[COVARIANCE + STATES * i + j] -= gain * column[j]
    return total


@njit(cache=True, nogil=True)
def _take(
    mean: float,
    covered: float,
    ratios: FloatArray,
    known: float,
    bank: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
) -> None:
    """Take a mean into all filters and weigh them, unless it is too far off."""
    column = np.empty(STATES)
    freedom = numbers[FREEDOM]
    if known > 0.0 or freedom >= LEAST_INNOVATIONS:
        estimate, variance, white = mixture(bank, ratios, known, freedom)
        if (mean - estimate) ** 2 > GATE**2 * (variance + white / covered):
            integers[OUTLIERS] += 1
            integers[PASSED] += 1
            if integers[OUTLIERS] >= GATE_SLOTS:
                start(bank, ratios, mean, covered)
                integers[OUTLIERS] = 0
                integers[RESTARTS] += 1
            return
    integers[OUTLIERS] = 0
    keep = 1.0 - 1.0 / MEMORY_SLOTS if freedom >= MEMORY_SLOTS else 1.0
    best = -np.inf
    for row in range(len(bank)):
        one = bank[row]
        predicted, _ = sums(one, column)
        total = update(one, mean, covered, column)
        square = (mean - predicted) ** 2 / total
        scale = one[SCALE] * keep + FLOOR
        one[SCALE] = scale + square
        if freedom > 0.0:
            one[WEIGHT] *= keep
            one[WEIGHT] -= 0.5 * (math.log(total * scale) + (freedom + 1.0) * math.log1p(square / scale))
        best = max(best, one[WEIGHT] + ratios[row, 2])
    for row in range(len(bank)):
        bank[row, WEIGHT] -= best
    numbers[FREEDOM] = freedom * keep + 1.0


@njit(cache=True, nogil=True)
def mixture(bank: FloatArray, ratios: FloatArray, known: float, freedom: float) -> tuple[float, float, float]:
    """Return mean and variance of the drift over all filters, and the white noise's density."""
    column = np.empty(STATES)
    weights, mean, square, white = 0.0, 0.0, 0.0, 0.0
    reference = 0.0
    for row in range(len(bank)):
        weight = math.exp(bank[row, WEIGHT] + ratios[row, 2])
        one_mean, variance = sums(bank[row], column)
        scale = known if known > 0.0 else bank[row, SCALE] / (freedom - 2.0)
        if row == 0:
            reference = one_mean
        # About the first mean, so that the spread of the others does not drown in its square.
        one_mean -= reference
        weights += weight
        mean += weight * one_mean
        square += weight * (variance * scale + one_mean * one_mean)
        white += weight * scale
    mean /= weights
    return reference + mean, max(square / weights - mean * mean, 0.0), white / weights


@njit(cache=True, nogil=True)
def _show(
    ratios: FloatArray, known: float, bank: FloatArray, numbers: FloatArray, out: FloatArray, k: int
) -> None:
    estimate, variance, white = mixture(bank, ratios, known, numbers[FREEDOM])
    out[0, k], out[1, k], out[2, k] = estimate, math.sqrt(variance), white
    weights, walk = 0.0, 0.0
    best = -np.inf
    for row in range(len(bank)):
        if ratios[row, 0] == 0.0:
            best = max(best, bank[row, WEIGHT])
    for row in range(len(bank)):
        if ratios[row, 0] == 0.0:
            weight = math.exp(bank[row, WEIGHT] - best)
            weights += weight
            walk += weight * math.log(ratios[row, 1])
    # Without a filter that has no flicker, the noise was given, and so is the walk.
    if weights > 0.0:
        out[3, k] = white * math.exp(walk / weights)
