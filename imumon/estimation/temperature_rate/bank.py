"""A bank of Kalman filters for temperature, rate and acceleration that differ in how smooth the truth is.

Each hypothesis has a density q of the white jerk, °C²/s⁵, that drives T''' (with T'' forgetting itself in
`FORGETTING_S`), and a level of the sensor's noise.  They are mixed as an interacting multiple model: every
hypothesis passes a little of its weight, and its state with it, to its neighbours.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit

JERKS = 10.0 ** np.arange(-27.0, -6.0, 1.5)
"""Jerk densities, °C²/s⁵: from a rate that keeps to 0.001 °C/h for a day to chambers at full power."""
NOISES = np.array([0.0001, 0.001, 0.01, 0.015, 0.023, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4])
"""Standard deviations of the sensor's noise in quantization steps."""
NOISE_FACTORS = 2.0 ** np.arange(13)
"""The same hypotheses where the noise hides the steps: variance of a slot's mean over that of white noise."""
FORGETTING_S = 1800.0
CHANGE_PER_S = 1.0 / 3600.0
"""Probability per second that the smoothness changes to a neighbouring value, either side together."""
NOISE_CHANGE_PER_S = 1.0 / 3600.0
"""The same for the noise."""
NEGLIGIBLE = 1e-7
"""Hypotheses below this weight are not carried on; they come back as copies of their neighbours."""
START_RATE = 20.0 / 3600.0
START_ACCELERATION = START_RATE / 300.0
"""Standard deviations of rate and acceleration at the start, °C/s and °C/s²."""

# Columns of the bank: weight, T, r, a, and the upper triangle of their covariance.
WEIGHT, T, R, A, TT, TR, TA, RR, RA, AA = range(10)


def empty_bank() -> FloatArray:
    """Return the table of hypotheses, (15 · 13, 10), smoothness slowest."""
    return np.zeros((len(JERKS) * len(NOISES), 10))


@njit
def restart(bank: FloatArray, temperature: float, sd: float, rate: float, keep_noise: bool) -> None:
    """Let all hypotheses begin at a temperature and a rough rate; the weights of the noise may be kept."""
    n, m = JERKS.size, NOISES.size
    weights = np.full(m, 1.0 / m)
    if keep_noise:
        for j in range(m):
            weights[j] = 0.0
            for i in range(n):
                weights[j] += bank[i * m + j, WEIGHT]
    bank[:] = 0.0
    for i in range(n):
        for j in range(m):
            k = i * m + j
            bank[k, WEIGHT] = weights[j] / n
            bank[k, T] = temperature
            bank[k, TT] = sd * sd
            bank[k, R] = rate
            bank[k, RR] = (START_RATE + 0.5 * abs(rate)) ** 2
            bank[k, AA] = min(START_ACCELERATION**2, JERKS[i] * FORGETTING_S / 2.0)


@njit
def mix(bank: FloatArray, work: FloatArray, dt: float) -> None:
    """Pass weight and state between neighbours, over dt seconds."""
    n, m = JERKS.size, NOISES.size
    step = (0.5 * min(dt * CHANGE_PER_S, 0.4), 0.5 * min(dt * NOISE_CHANGE_PER_S, 0.4))
    share = np.empty(5)
    source = np.empty(5, np.int64)
    work[:] = bank
    for i in range(n):
        for j in range(m):
            k = i * m + j
            count, total, stay = 0, 0.0, 1.0
            for along, at, length, stride in ((step[0], i, n, m), (step[1], j, m, 1)):
                if at > 0:
                    source[count], share[count] = k - stride, along * work[k - stride, WEIGHT]
                    count += 1
                    stay -= along
                if at < length - 1:
                    source[count], share[count] = k + stride, along * work[k + stride, WEIGHT]
                    count += 1
                    stay -= along
            source[count], share[count] = k, stay * work[k, WEIGHT]
            count += 1
            for c in range(count):
                total += share[c]
            # The state of a negligible hypothesis is not carried on: none of its weight may be, either.
            bank[k, WEIGHT] = total if total > NEGLIGIBLE else 0.0
            if total > NEGLIGIBLE:
                _merge(bank[k], work, source[:count], share[:count], total)


@njit
def _merge(row: FloatArray, work: FloatArray, source: IntArray, share: FloatArray, total: float) -> None:
    """Write mean and covariance of a mixture of rows."""
    row[T:] = 0.0
    for c in range(source.size):
        w = share[c] / total
        for p in range(T, A + 1):
            row[p] += w * work[source[c], p]
    for c in range(source.size):
        w, other = share[c] / total, work[source[c]]
        d, e, f = other[T] - row[T], other[R] - row[R], other[A] - row[A]
        row[TT] += w * (other[TT] + d * d)
        row[TR] += w * (other[TR] + d * e)
        row[TA] += w * (other[TA] + d * f)
        row[RR] += w * (other[RR] + e * e)
        row[RA] += w * (other[RA] + e * f)
        row[AA] += w * (other[AA] + f * f)


@njit
def motion_over(dt: float) -> FloatArray:
    """Return what `predict` needs of a time in s, (9,): dt, f, g, keep, and covariance per jerk density."""
    keep = math.exp(-dt / FORGETTING_S)
    g = FORGETTING_S * (1.0 - keep)
    f = FORGETTING_S * (dt - g)
    terms = (dt, f, g, keep, dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0, dt**3 / 3.0, dt**2 / 2.0)
    return np.array(terms)


@njit
def predict(row: FloatArray, motion: FloatArray, jerk: float) -> None:
    """Move one hypothesis on."""
    dt, f, g, keep = motion[0], motion[1], motion[2], motion[3]
    row[T] += dt * row[R] + f * row[A]
    row[R] += g * row[A]
    row[A] *= keep
    tt, tr, ta, rr, ra, aa = row[TT], row[TR], row[TA], row[RR], row[RA], row[AA]
    # F P with F = [[1, dt, f], [0, 1, g], [0, 0, keep]], then times Fᵀ.
    a, b, c = tt + dt * tr + f * ta, tr + dt * rr + f * ra, ta + dt * ra + f * aa
    d, e = rr + g * ra, ra + g * aa
    row[TT] = a + dt * b + f * c + jerk * motion[4]
    row[TR] = b + g * c + jerk * motion[5]
    row[TA] = keep * c + jerk * motion[6]
    row[RR] = d + g * e + jerk * motion[7]
    row[RA] = keep * e + jerk * motion[8]
    row[AA] = keep * keep * aa + jerk * dt


@njit
def condition(row: FloatArray, mean: float, variance: float) -> None:
    """Give the temperature of one hypothesis these moments, and the rest what follows from them."""
    g, h = row[TR] / row[TT], row[TA] / row[TT]
    change, more = mean - row[T], variance - row[TT]
    row[T] = mean
    row[R] += g * change
    row[A] += h * change
    row[RR] += g * g * more
    row[RA] += g * h * more
    row[AA] += h * h * more
    row[TT] = variance
    row[TR] = g * variance
    row[TA] = h * variance


@njit
def reweigh(bank: FloatArray, log_evidence: FloatArray) -> None:
    """Multiply the weights by the evidence and normalize; what is negligible goes."""
    best = -np.inf
    for k in range(len(bank)):
        if bank[k, WEIGHT] > NEGLIGIBLE:
            best = max(best, log_evidence[k])
    total = 0.0
    for k in range(len(bank)):
        if bank[k, WEIGHT] > NEGLIGIBLE:
            bank[k, WEIGHT] *= math.exp(max(log_evidence[k] - best, -60.0))
            total += bank[k, WEIGHT]
        else:
            bank[k, WEIGHT] = 0.0
    for k in range(len(bank)):
        bank[k, WEIGHT] /= total
