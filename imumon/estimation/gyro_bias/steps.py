"""Predict and correct, for all filters of a bank: compiled, for in NumPy the calls cost more than the sums.

The states of a filter and what they are is in `bank`.  All arrays have the leading axes (variant, axis,
filter).  A filter's matrices are nearly empty, and only what is in them is written out here:

    wander     x = F x + u, P = F P Fᵀ + Q     F diagonal, and the slope, which moves the walk
    integrate  the same                        F the identity but for the rows of rotation and velocity
    take       x + K ν, P - K S Kᵀ             H = (0, 1, 0, ...): the velocity
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit

ROTATION, VELOCITY, WALK, SLOPE, SENSITIVITY, STATES = 0, 1, 2, 6, 7, 10
TAUS_S = np.array([10.0, 100.0, 1000.0])
SLOPE_WALK = math.radians(0.02) / 3600.0
"""Random walk of the slope, rad/s/°C/sqrt(s)."""
CURVATURE_DEGC = 30.0
"""Temperature difference over which a slope changes by as much as itself."""
LEAST_WEIGHT = 1e-30
"""What no filter's weight falls below: a weight of zero could not be divided by."""


@njit
def wander(
    mean: FloatArray,
    covariance: FloatArray,
    strength2: FloatArray,
    unit2: FloatArray,
    dt: float,
    warming: FloatArray,
    travel: FloatArray,
    growth: FloatArray,
) -> None:
    """Bring the biases `dt` seconds on, as of `bank.wander`; `strength2` (3, wanders, 4) times `unit2` (3,)
    are K² and sd²."""
    variants, axes, filters = mean.shape[:3]
    wanders = strength2.shape[1]
    decay, fresh = np.ones(mean.shape[-1]), np.full(len(TAUS_S) + 1, dt)
    for i in range(len(TAUS_S)):
        decay[WALK + 1 + i] = math.exp(-dt / TAUS_S[i])
        fresh[1 + i] = -math.expm1(-2.0 * dt / TAUS_S[i])
    for v in range(variants):
        for a in range(axes):
            for h in range(filters):
                x, p = mean[v, a, h], covariance[v, a, h]
                for i in range(len(x)):
                    x[i] *= decay[i]
                    for j in range(len(x)):
                        p[i, j] *= decay[i] * decay[j]
                if v == 1:
                    _warm(x, p, dt, warming[a], travel[a])
                for i in range(len(fresh)):
                    p[WALK + i, WALK + i] += strength2[a, h % wanders, i] * unit2[a] * fresh[i]
                p[WALK, WALK] += growth[a]


@njit
def _warm(x: FloatArray, p: FloatArray, dt: float, warming: float, travel: float) -> None:
    """Move the walk by the slope, and let the slope be another at another temperature."""
    walk = SLOPE_WALK**2 * dt
    square = x[SLOPE] ** 2 + p[SLOPE, SLOPE] + walk
    x[WALK] += warming * x[SLOPE]
    for j in range(len(x)):
        p[WALK, j] += warming * p[SLOPE, j]
    for j in range(len(x)):
        p[j, WALK] += warming * p[j, SLOPE]
    p[SLOPE, SLOPE] += walk + square * travel / CURVATURE_DEGC


@njit
def integrate(
    mean: FloatArray,
    covariance: FloatArray,
    row: FloatArray,
    dt: float,
    rate: FloatArray,
    tilt: FloatArray,
    white2: FloatArray,
    tilt2: FloatArray,
) -> None:
    """Integrate rotation and velocity over a slot; as of `bank.AtRest`, `row` (10,) makes the bias."""
    variants, axes, filters = mean.shape[:3]
    half = 0.5 * dt * dt
    along = np.empty(mean.shape[-1])
    for v in range(variants):
        for a in range(axes):
            for h in range(filters):
                x, p = mean[v, a, h], covariance[v, a, h]
                off = rate[a]
                for j in range(len(x)):
                    off -= row[j] * x[j]
                    along[j] = 0.0
                    for i in range(WALK, len(x)):
                        along[j] += row[i] * p[i, j]
                x[VELOCITY] += dt * (x[ROTATION] - tilt[a]) + half * off
                x[ROTATION] += dt * off
                # Rows of F P, of which the last two terms of F P Fᵀ are made.
                first = second = 0.0
                for j in range(len(x)):
                    p[VELOCITY, j] += dt * p[ROTATION, j] - half * along[j]
                    p[ROTATION, j] -= dt * along[j]
                    first += row[j] * p[ROTATION, j]
                    second += row[j] * p[VELOCITY, j]
                p[VELOCITY, VELOCITY] += dt * p[VELOCITY, ROTATION] - half * second
                p[ROTATION, VELOCITY] += dt * p[ROTATION, ROTATION] - half * first
                p[ROTATION, ROTATION] -= dt * first
                p[ROTATION, ROTATION] += white2[a] * dt
                p[ROTATION, VELOCITY] += white2[a] * half
                p[VELOCITY, VELOCITY] += white2[a] * half * half / dt + tilt2[a] * dt
                p[VELOCITY, ROTATION] = p[ROTATION, VELOCITY]
                for j in range(WALK, len(x)):
                    p[j, ROTATION], p[j, VELOCITY] = p[ROTATION, j], p[VELOCITY, j]


@njit
def look(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, still2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the innovation of the whole over its standard deviation, and the least squared one of a filter
    over its variance, (variants, 3) each."""
    variants, axes, filters = weight.shape
    whole, least = np.empty((variants, axes)), np.full((variants, axes), np.inf)
    for v in range(variants):
        for a in range(axes):
            first = second = 0.0
            for h in range(filters):
                velocity = mean[v, a, h, VELOCITY]
                variance = covariance[v, a, h, VELOCITY, VELOCITY] + still2[a]
                first += weight[v, a, h] * velocity
                second += weight[v, a, h] * (velocity * velocity + variance)
                least[v, a] = min(least[v, a], velocity * velocity / variance)
            whole[v, a] = first / math.sqrt(second - first * first)
    return whole, least


@njit
def take(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, still2: FloatArray, groups: int
) -> FloatArray:
    """Correct with a velocity of zero and weigh the filters; return the log-likelihoods, (variants, 3)."""
    variants, axes, filters = weight.shape
    wanders = filters // groups
    total, gain = np.zeros((variants, axes)), np.empty(mean.shape[-1])
    common, share = np.empty(groups), np.empty((axes, groups))
    for v in range(variants):
        common[:] = 0.0
        for a in range(axes):
            most = -np.inf
            likelihood = np.empty(filters)
            for h in range(filters):
                likelihood[h] = _correct(mean[v, a, h], covariance[v, a, h], still2[a], gain)
                most = max(most, likelihood[h])
            for g in range(groups):
                before = after = 0.0
                for h in range(g * wanders, (g + 1) * wanders):
                    before += weight[v, a, h]
                    weight[v, a, h] *= math.exp(likelihood[h] - most)
                    after += weight[v, a, h]
                share[a, g] = max(after, LEAST_WEIGHT)
                total[v, a] += share[a, g]
                common[g] += math.log(share[a, g] / before) + (math.log(before) if a == 0 else 0.0)
            total[v, a] = most + math.log(total[v, a])
        highest = common.max()
        whole = 0.0
        for g in range(groups):
            common[g] = math.exp(common[g] - highest)
            whole += common[g]
        for a in range(axes):
            for h in range(filters):
                g = h // wanders
                factor = max(common[g] / whole, LEAST_WEIGHT) / share[a, g]
                weight[v, a, h] = max(weight[v, a, h] * factor, LEAST_WEIGHT)
    return total


@njit
def _correct(x: FloatArray, p: FloatArray, still2: float, gain: FloatArray) -> float:
    """Correct one filter; return the logarithm of the density of its innovation."""
    innovation, variance = -x[VELOCITY], p[VELOCITY, VELOCITY] + still2
    for i in range(len(x)):
        gain[i] = p[i, VELOCITY] / variance
    for i in range(len(x)):
        x[i] += gain[i] * innovation
        for j in range(len(x)):
            p[i, j] -= gain[i] * gain[j] * variance
    return float(-0.5 * (innovation * innovation / variance + math.log(2.0 * math.pi * variance)))


@njit
def mix(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, arriving: FloatArray, stay: float
) -> None:
    """Mix the filters of each group, as of `bank.mix`: `arriving` (wanders,) go over to each, `stay` stay."""
    variants, axes, filters = weight.shape
    wanders, states = len(arriving), mean.shape[-1]
    common, cover = np.empty(states), np.empty((states, states))
    for v in range(variants):
        for a in range(axes):
            for first in range(0, filters, wanders):
                group = 0.0
                for h in range(first, first + wanders):
                    group += weight[v, a, h]
                common[:], cover[:] = 0.0, 0.0
                for h in range(first, first + wanders):
                    share = weight[v, a, h] / group
                    for i in range(states):
                        common[i] += share * mean[v, a, h, i]
                for h in range(first, first + wanders):
                    share, x = weight[v, a, h] / group, mean[v, a, h]
                    for i in range(states):
                        for j in range(states):
                            spread = (x[i] - common[i]) * (x[j] - common[j])
                            cover[i, j] += share * (covariance[v, a, h, i, j] + spread)
                for h in range(first, first + wanders):
                    after = stay * weight[v, a, h] / group + arriving[h - first]
                    weight[v, a, h] = group * after
                    taken, x, p = arriving[h - first] / after, mean[v, a, h], covariance[v, a, h]
                    for i in range(states):
                        for j in range(states):
                            spread = (x[i] - common[i]) * (x[j] - common[j])
                            p[i, j] += taken * (cover[i, j] - p[i, j] + (1.0 - taken) * spread)
                    for i in range(states):
                        x[i] -= taken * (x[i] - common[i])
