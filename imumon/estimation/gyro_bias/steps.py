"""Predict and correct, for all filters of a bank: compiled, for in NumPy the calls cost more than the sums.

The states of a filter and what they are is in `bank`.  The filters are in one row, (n, states) and
(n, states, states), those of an axis side by side.  A filter's matrices are nearly empty, and only what is in
them is written out here:

    wander     x = F x + u, P = F P Fᵀ + Q     F diagonal, and the slope, which moves the walk
    integrate  the same                        F the identity but for the rows of rotation and velocity
    correct    x + K ν, P - K S Kᵀ             H = (0, 1, 0, ...): the velocity
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.compiled import inner, njit

ROTATION, VELOCITY, WALK, SLOPE, SENSITIVITY, STATES = 0, 1, 2, 6, 7, 10
TAUS_S = np.array([1.0, 30.0, 1000.0])
LEAST_WEIGHT = 1e-30
"""What no filter's weight falls below: a weight of zero could not be divided by."""
FASTER = 1.0 / math.log10(TAUS_S[1] / TAUS_S[0])
"""Variance of flicker in the decade below the first process, over that of a process: slots do not show it,
and the bias of a sample has it."""
AXES = 3
SLOPE_WALK = math.radians(0.02) / 3600.0
"""Random walk of the slope, rad/s/°C/sqrt(s)."""
CURVATURE_DEGC = 30.0
"""Temperature difference over which a slope changes by as much as itself."""


@njit
def wander(
    mean: FloatArray,
    covariance: FloatArray,
    filters: int,
    strength2: FloatArray,
    unit2: FloatArray,
    dt: float,
    warming: FloatArray,
    difference: FloatArray,
    growth: FloatArray,
) -> None:
    """Bring the biases `dt` seconds on, as of `bank.wander`.

    An axis has so many `filters`; `strength2` (3, wanders, 4) times `unit2` (3,) are K² and sd².
    """
    decay, fresh = np.empty(mean.shape[1]), np.empty(strength2.shape[2])
    for i in range(len(decay)):
        decay[i] = 1.0
    fresh[0] = dt
    for i in range(len(TAUS_S)):
        decay[WALK + 1 + i] = math.exp(-dt / TAUS_S[i])
        fresh[1 + i] = -math.expm1(-2.0 * dt / TAUS_S[i])
    for k in range(len(mean)):
        x, p, a, w = mean[k], covariance[k], k // filters % AXES, k % filters % strength2.shape[1]
        for i in range(len(x)):
            x[i] *= decay[i]
            for j in range(len(x)):
                p[i, j] *= decay[i] * decay[j]
        if k >= AXES * filters:
            _warm(x, p, dt, warming[a], difference[a])
        for i in range(len(fresh)):
            p[WALK + i, WALK + i] += strength2[a, w, i] * unit2[a] * fresh[i]
        p[WALK, WALK] += growth[a]


@inner
def _warm(x: FloatArray, p: FloatArray, dt: float, warming: float, difference: float) -> None:
    """Move the walk by the slope, and let the slope be another at another temperature."""
    walk = SLOPE_WALK**2 * dt
    square = x[SLOPE] ** 2 + p[SLOPE, SLOPE] + walk
    x[WALK] += warming * x[SLOPE]
    for j in range(len(x)):
        p[WALK, j] += warming * p[SLOPE, j]
    for j in range(len(x)):
        p[j, WALK] += warming * p[j, SLOPE]
    # The slope walks along the temperature: over what is passed at once (behind a gap) so does its integral.
    along = square / CURVATURE_DEGC
    passed = min(difference, abs(warming))
    p[SLOPE, SLOPE] += walk + along * difference
    p[WALK, WALK] += along * passed**3 / 3.0
    p[WALK, SLOPE] += along * math.copysign(passed**2 / 2.0, warming)
    p[SLOPE, WALK] = p[WALK, SLOPE]


@njit
def integrate(
    mean: FloatArray,
    covariance: FloatArray,
    row: FloatArray,
    filters: int,
    dt: float,
    rate: FloatArray,
    tilt: FloatArray,
    white2: FloatArray,
    share: FloatArray,
    tilt2: FloatArray,
) -> None:
    """Integrate rotation and velocity over a slot; as of `bank.AtRest`, `row` (states,) makes the bias."""
    half = 0.5 * dt * dt
    along = np.empty(len(row))
    for k in range(len(mean)):
        x, p, a = mean[k], covariance[k], k // filters % AXES
        white = white2[a] * share[k % filters % len(share)]
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
        p[ROTATION, ROTATION] += white * dt
        p[ROTATION, VELOCITY] += white * half
        p[VELOCITY, VELOCITY] += white * half * half / dt + tilt2[a] * dt
        p[VELOCITY, ROTATION] = p[ROTATION, VELOCITY]
        for j in range(WALK, len(x)):
            p[j, ROTATION], p[j, VELOCITY] = p[ROTATION, j], p[VELOCITY, j]


@njit
def correct(
    mean: FloatArray, covariance: FloatArray, filters: int, still2: FloatArray, likelihood: FloatArray
) -> None:
    """Correct with a velocity of zero; fill in the logarithms of the densities of the innovations, (n,)."""
    gain = np.empty(mean.shape[1])
    for k in range(len(mean)):
        x, p = mean[k], covariance[k]
        innovation, variance = -x[VELOCITY], p[VELOCITY, VELOCITY] + still2[k // filters % AXES]
        for i in range(len(x)):
            gain[i] = p[i, VELOCITY] / variance
        for i in range(len(x)):
            x[i] += gain[i] * innovation
            for j in range(len(x)):
                p[i, j] -= gain[i] * gain[j] * variance
        likelihood[k] = -0.5 * (innovation * innovation / variance + math.log(2.0 * math.pi * variance))


@njit
def look(
    mean: FloatArray,
    covariance: FloatArray,
    weight: FloatArray,
    settled: FloatArray,
    still2: FloatArray,
    whole: FloatArray,
    surprise: FloatArray,
) -> None:
    """Fill in what `bank.look` returns, (rows,) each; `weight` and `settled` are (rows, filters)."""
    rows, filters = weight.shape
    for r in range(rows):
        first = second = expected = 0.0
        for h in range(filters):
            k = r * filters + h
            velocity, variance = mean[k, VELOCITY], covariance[k, VELOCITY, VELOCITY] + still2[r % AXES]
            first += weight[r, h] * velocity
            second += weight[r, h] * (velocity * velocity + variance)
            expected += settled[r, h] * math.exp(-0.5 * velocity * velocity / variance)
        whole[r] = first / math.sqrt(second - first * first)
        surprise[r] = -2.0 * math.log(expected) if expected > 0.0 else np.inf


@njit
def weigh(
    likelihood: FloatArray, weight: FloatArray, share: FloatArray, common: FloatArray, total: FloatArray
) -> None:
    """Weigh the filters by the logarithms of their likelihoods, (rows, groups, wanders) as the weights are.

    `total` (rows,) is filled with those of the whole; `share` (rows, groups) and `common` (groups,) are room
    to work in.
    """
    rows, groups, wanders = weight.shape
    for r in range(rows):
        most, whole = -np.inf, 0.0
        for g in range(groups):
            for w in range(wanders):
                most = max(most, likelihood[r, g, w])
        for g in range(groups):
            before = after = 0.0
            for w in range(wanders):
                before += weight[r, g, w]
                weight[r, g, w] *= math.exp(likelihood[r, g, w] - most)
                after += weight[r, g, w]
            share[r, g] = max(after, LEAST_WEIGHT)
            whole += share[r, g]
            common[g] = math.log(share[r, g] / before) + (math.log(before) if r % AXES == 0 else common[g])
        total[r] = most + math.log(whole)
        if r % AXES == AXES - 1:
            _make_common(r - AXES + 1, weight, share, common)


@inner
def _make_common(first: int, weight: FloatArray, share: FloatArray, common: FloatArray) -> None:
    """Give the groups of three axes, from row `first` on, their probabilities: `common` are the logs."""
    highest, whole = -np.inf, 0.0
    for g in range(len(common)):
        highest = max(highest, common[g])
    for g in range(len(common)):
        common[g] = math.exp(common[g] - highest)
        whole += common[g]
    for r in range(first, first + AXES):
        for g in range(len(common)):
            factor = max(common[g] / whole, LEAST_WEIGHT) / share[r, g]
            for w in range(weight.shape[2]):
                weight[r, g, w] = max(weight[r, g, w] * factor, LEAST_WEIGHT)


@njit
def law(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, strength2: FloatArray, unit2: FloatArray,
    ahead_s: float, unseen2: float, value: FloatArray, known: FloatArray,
) -> None:  # fmt: skip
    """Fill in what `bank.law` returns, (rows, terms) and (rows, terms, terms), of zeros.

    The first term sums the walk and the processes, the others are the states behind these; `unseen2` is the
    variance of those that there are not yet.  The noise is that of `wander`.
    """
    rows, filters = weight.shape
    states, terms = mean.shape[1], value.shape[1]
    seen = states - SLOPE + 1
    of_one, part = np.empty((filters, seen)), np.empty((seen, states))
    d, e, f = math.exp(-ahead_s / TAUS_S[0]), math.exp(-ahead_s / TAUS_S[1]), math.exp(-ahead_s / TAUS_S[2])
    fresh = (ahead_s, 1.0 - d * d + FASTER, 1.0 - e * e, 1.0 - f * f)
    for r in range(rows):
        value[r] = 0.0
        for h in range(filters):
            x = mean[r * filters + h]
            of_one[h, 0] = x[WALK] + d * x[WALK + 1] + e * x[WALK + 2] + f * x[WALK + 3]
            for m in range(1, seen):
                of_one[h, m] = x[SLOPE - 1 + m]
            for m in range(seen):
                value[r, m] += weight[r, h] * of_one[h, m]
        for h in range(filters):
            p = covariance[r * filters + h]
            for j in range(WALK, states):
                part[0, j] = p[WALK, j] + d * p[WALK + 1, j] + e * p[WALK + 2, j] + f * p[WALK + 3, j]
                for m in range(1, seen):
                    part[m, j] = p[SLOPE - 1 + m, j]
            for m in range(seen):
                off = of_one[h, m] - value[r, m]
                summed = d * part[m, WALK + 1] + e * part[m, WALK + 2] + f * part[m, WALK + 3]
                known[r, m, 0] += weight[r, h] * (part[m, WALK] + summed + off * (of_one[h, 0] - value[r, 0]))
                for n in range(1, seen):
                    spread = off * (of_one[h, n] - value[r, n])
                    known[r, m, n] += weight[r, h] * (part[m, SLOPE - 1 + n] + spread)
            added = 0.0
            for i in range(len(fresh)):
                added += strength2[r % AXES, h % strength2.shape[1], i] * fresh[i]
            known[r, 0, 0] += weight[r, h] * unit2[r % AXES] * added
        for m in range(seen, terms):
            known[r, m, m] = unseen2


@njit
def mix_variants(value: FloatArray, known: FloatArray, chosen: BoolArray, evidence: FloatArray) -> None:
    """Put into the first variant's law the terms of the one that is chosen, and the covariance of both.

    Laws are those of `bank.law`; `evidence` (3,) is the logarithm of the odds of the second variant.
    """
    terms = value.shape[2]
    for a in range(AXES):
        own, other = (1, 0) if chosen[a] else (0, 1)
        share = 0.5 + 0.5 * math.tanh(0.5 * (-evidence[a] if chosen[a] else evidence[a]))
        off = value[other, a] - value[own, a]
        for m in range(terms):
            for n in range(terms):
                spread = known[other, a, m, n] - known[own, a, m, n] + off[m] * off[n]
                known[0, a, m, n] = known[own, a, m, n] + share * spread
            value[0, a, m] = value[own, a, m]


@njit
def mix(
    mean: FloatArray,
    covariance: FloatArray,
    weight: FloatArray,
    arriving: FloatArray,
    stay: float,
    common: FloatArray,
    cover: FloatArray,
) -> None:
    """Mix the filters of each group, as of `bank.mix`: `arriving` (wanders,) go over to each, `stay` stay.

    `common` (states,) and `cover` (states, states) are room to work in.
    """
    states = len(common)
    for first in range(0, len(mean), len(arriving)):
        group = 0.0
        for h in range(first, first + len(arriving)):
            group += weight[h]
        for i in range(states):
            common[i] = 0.0
            for j in range(states):
                cover[i, j] = 0.0
        for h in range(first, first + len(arriving)):
            share = weight[h] / group
            for i in range(states):
                common[i] += share * mean[h, i]
        for h in range(first, first + len(arriving)):
            share = weight[h] / group
            for i in range(states):
                for j in range(states):
                    spread = (mean[h, i] - common[i]) * (mean[h, j] - common[j])
                    cover[i, j] += share * (covariance[h, i, j] + spread)
        for h in range(first, first + len(arriving)):
            after = stay * weight[h] / group + arriving[h - first]
            weight[h] = group * after
            taken = arriving[h - first] / after
            for i in range(states):
                for j in range(states):
                    spread = (mean[h, i] - common[i]) * (mean[h, j] - common[j])
                    covariance[h, i, j] += taken * (
                        cover[i, j] - covariance[h, i, j] + (1.0 - taken) * spread
                    )
            for i in range(states):
                mean[h, i] -= taken * (mean[h, i] - common[i])
