"""Headings and their sigmas from the sums: five estimators, the bias of the gyro, true tilts, and a choice.

Every estimator averages the horizontal rate of the frame.  With the angle of the gyros θ and that of the
control α over the observed time T, the level has changed by Φ(T) - Φ(0) = α - θ, and

1. total average: α / T;
2. curve fit: slope of the least-squares line through α(t);
3. line and exponential: the same with an exponential whose time constant is found, too;
4. tilt-corrected: (α - (Φ(T) - Φ(0))) / T = θ / T;
5. known warm-up: α / T less the change of the level that the known warm-up makes.

An accelerometer that drifts is wrong in 1 to 3; a true tilt in 4.  Which of the two a change of the level is,
the gyros tell where they can: they see a tilt, but not a drift of an accelerometer.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.estimation.alignment.state import (
    ARW2,
    BETTER,
    BETTER_FOR,
    BIAS_SD,
    BIAS_VARIANCE,
    CHOSEN,
    CONSTANTS,
    CONTRADICTED,
    ESTIMATORS,
    FINE_AT,
    GRAVITY,
    INNER,
    LARGEST_DRIFT,
    LAST,
    LATITUDE,
    LEVEL_SD,
    OBSERVABLE,
    OBSERVED,
    OUTER,
    PAIRS,
    REAL_TILT,
    TICKS,
    TILT2,
    TIME,
    WARM_SD,
    WARM_TAU,
    WARM_TAU_SD,
    WARM_X,
    State,
)
from imumon.geodesy import EARTH_RATE
from imumon.published.fixed_gain_loop import azimuth

NO_IDEA = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad."""
TYPICAL_BIAS, TYPICAL_ARW, BIAS_POWER = 4.85e-5, 2.9e-5, 1.5
"""A gyro with the noise 0.1 deg/√h has a bias of about 10 deg/h; better gyros have less: the power 1.5."""
BIAS_SPREAD = 1.2
"""Standard deviation of the logarithm of that."""
TRUE_TILT, PARTLY = 1e-3, 1e-4
"""Prior probability that a change of the level is a true tilt, or any of nine mixtures."""
BETTER_BY, BETTER_S = 0.8, 5
"""Another estimator is chosen when its sigma is less by this factor for so many ticks."""
LEAST_PAIRS, LEAST_S = 12, 8.0
"""Nothing is estimated from less."""
MISFIT = 0.1
"""A cubic does not describe the level better than this."""


@njit(**INNER)
def evaluate(state: State, settings: FloatArray) -> None:
    """Renew headings, sigmas, the choice and whether the heading can be observed, after a tick."""
    number, result = state.number, state.result
    time = number[TIME]
    if state.flag[PAIRS] < LEAST_PAIRS or time < LEAST_S:
        return
    level = EARTH_RATE * math.cos(settings[LATITUDE])
    number[ARW2] = state.line[7] / state.flag[PAIRS]
    number[TILT2] = state.line[8] / (6.0 * state.flag[PAIRS])
    white = number[ARW2] / time
    rates = np.empty((ESTIMATORS, 2))
    _averages(state, time, rates)
    slope_level = _lines(state, rates)
    third = _line_exponential(state, time, rates)
    drifts = _tilt_shares(state, settings, time)
    steady = number[REAL_TILT] * rates[0] + (1.0 - number[REAL_TILT]) * rates[3]
    number[BIAS_VARIANCE] = _bias_variance(state, settings, steady, white, level)
    total, known = _drift(state)
    common = number[BIAS_VARIANCE] / level**2
    common += (settings[LEVEL_SD] * math.tan(settings[LATITUDE])) ** 2
    ahead, across = azimuth(state.attitude), np.empty(2)
    for k in range(ESTIMATORS):
        east, north = rates[k, 0], rates[k, 1] + state.reference[1]
        length = max(math.hypot(east, north), 1e-12)
        across[0], across[1] = north / length, -east / length
        noise = white
        if k == 1:
            noise *= 1.2
        if k == 2:
            noise = drifts[0] * white + (1.0 - drifts[0]) * number[ARW2] * third
        drift = drifts[0] * _along(across, total if k == 0 else slope_level) ** 2
        if k == 0:
            drift += drifts[1] * (_along(across, total) - _along(across, known)) ** 2
        if k == 2:
            # Its own variance holds for one time constant, and the fit is not linear in that: where the gyros
            # see no tilt, its error is known from what they see.
            drift = drifts[0] * (across[0] * (east - steady[0]) + across[1] * (rates[2, 1] - steady[1])) ** 2
        if k == 3:
            drift = drifts[1] * _along(across, known) ** 2
        if k == 4:
            drift = drifts[0] * _along(across, known) ** 2
        relative = (noise + drift) / level**2 + common
        result[k, 0] = (ahead - math.atan2(east, north)) % (2.0 * math.pi)
        result[k, 1] = min(math.sqrt(relative), NO_IDEA)
    if settings[WARM_TAU] <= 0.0:
        result[4, 0] = result[4, 1] = math.nan
    state.flag[OBSERVED] = number[BIAS_VARIANCE] < (settings[OBSERVABLE] * level) ** 2
    _choose(state)


@njit(**INNER)
def _along(direction: FloatArray, vector: FloatArray) -> float:
    return float(direction[0] * vector[0] + direction[1] * vector[1])


@njit(**INNER)
def _drift(state: State) -> tuple[FloatArray, FloatArray]:
    """Return the change of the level per second: all of it, and what the known warm-up does not explain."""
    total, time = state.total, state.number[TIME]
    drift, unknown = np.empty(2), np.empty(2)
    for axis in range(2):
        drift[axis] = (total[4 + axis] - total[1 + axis]) / time
        unknown[axis] = drift[axis] - total[6 + axis] / time
    return drift, unknown


@njit(**INNER)
def _averages(state: State, time: float, rates: FloatArray) -> None:
    """Fill estimators 1, 4 and 5, rates of the control alone (without that of the frame)."""
    total = state.total
    for axis in range(2):
        rates[0, axis] = total[4 + axis] / time
        rates[3, axis] = total[1 + axis] / time
        rates[4, axis] = (total[4 + axis] - total[6 + axis]) / time


@njit(**INNER)
def _lines(state: State, rates: FloatArray) -> FloatArray:
    """Fill estimator 2; return the slope of the line through the level."""
    line = state.line
    slope = np.empty(2)
    spread = line[0] * line[2] - line[1] * line[1]
    for axis in range(2):
        rates[1, axis] = (line[0] * line[5 + axis] - line[1] * line[3 + axis]) / spread
        sums = state.path_sums
        slope[axis] = (line[0] * sums[1, axis] - line[1] * sums[0, axis]) / spread
    return slope


@njit(**INNER)
def inverse(matrix: FloatArray, size: int) -> tuple[bool, FloatArray]:
    """Return whether the leading block of a symmetric matrix is positive definite, and its inverse."""
    scale = np.empty(size)
    for i in range(size):
        if not matrix[i, i] > 0.0:
            return False, np.zeros((size, size))
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
    work = np.zeros((size, 2 * size))
    for i in range(size):
        for j in range(size):
            work[i, j] = matrix[i, j] * scale[i] * scale[j]
        work[i, size + i] = 1.0
    for i in range(size):
        if not work[i, i] > 1e-12:
            return False, np.zeros((size, size))
        pivot = work[i, i]
        for k in range(2 * size):
            work[i, k] /= pivot
        for j in range(size):
            factor = work[j, i]
            for k in range(2 * size):
                if j != i:
                    work[j, k] -= factor * work[i, k]
    result = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            result[i, j] = work[i, size + j] * scale[i] * scale[j]
    return True, result


@njit(**INNER)
def _line_exponential(state: State, time: float, rates: FloatArray) -> float:
    """Fill estimator 3; return the variance of its slope over that of a random walk of 1 rad/√s."""
    white = state.number[TILT2] / (state.number[ARW2] + 1e-30)
    best, chosen, whole = math.inf, -1, state.normal.shape[1]
    for g in range(len(CONSTANTS)):
        good, inverted = inverse(state.normal[g], whole - 1)
        if not good:
            continue
        rest = 0.0
        for axis in range(2):
            rest += state.squares[axis]
            for i in range(3):
                for j in range(3):
                    rest -= state.right[g, i, axis] * inverted[i, j] * state.right[g, j, axis]
        if rest < best:
            best, chosen = rest, g
    rates[2, 0] = rates[2, 1] = math.nan
    if chosen < 0:
        return math.nan
    tau = CONSTANTS[chosen]
    good, inverted = inverse(state.normal[chosen], whole - 1)
    for axis in range(2):
        rates[2, axis] = 0.0
        for j in range(3):
            rates[2, axis] += (inverted[1, j] + inverted[2, j]) * state.right[chosen, j, axis] / tau
    good, inverted = inverse(state.normal[chosen], whole)
    if not good:
        return 1e6
    variance = 0.0
    for i in range(4):
        for j in range(4):
            weights = (inverted[1, i] + inverted[2, i] + inverted[3, i]) / tau
            weights *= (inverted[1, j] + inverted[2, j] + inverted[3, j]) / tau
            variance += weights * state.spread[chosen, i, j]
            if i > 0 and j > 0:  # white noise of the level, from the accelerometers
                variance += white * inverted[i, j] / (tau * tau)
    return float(max(variance, 1.0 / time))


@njit(**INNER)
def _bias_variance(state: State, settings: FloatArray, rate: FloatArray, white: float, level: float) -> float:
    """Return the variance of a horizontal gyro's bias, (rad/s)².

    Two residuals tell of it: the vertical rate less Ω sin L, and the horizontal rate less Ω cos L.  One that
    happens to be small is weak evidence, so a prior by the noise stands beside it.
    """
    upward = state.total[3] / state.number[TIME] - EARTH_RATE * math.sin(settings[LATITUDE])
    across = math.hypot(rate[0], rate[1] + state.reference[1]) - level
    squares = upward * upward + across * across
    declared = settings[BIAS_SD]
    if declared >= 0.0:
        expected = declared * declared + white
        # Two squares add up to 9.2 expected ones once in a hundred times, to 18.4 once in ten thousand.
        state.flag[CONTRADICTED] = squares > 18.4 * expected
        contrary = 0.5 * squares - white if squares > 18.4 * expected else 0.0
        return float(max(declared * declared, contrary))
    typical = TYPICAL_BIAS * (math.sqrt(state.number[ARW2]) / TYPICAL_ARW) ** BIAS_POWER
    return float(bias_posterior(typical, squares, white))


@njit(**OUTER)
def bias_posterior(typical: float, squares: float, white: float) -> float:
    """Return the mean variance of a bias whose standard deviation is log-normal about `typical`.

    Parameters
    ----------
    typical : float
        rad/s.
    squares : float
        Sum of the squares of two residuals, each with the variance of the bias plus `white`, (rad/s)².
    """
    largest, sum_0, sum_1 = -math.inf, 0.0, 0.0
    for i in range(-36, 49):
        step = 0.25 * i
        variance = (typical * math.exp(step)) ** 2
        total = variance + white + 1e-30
        log = -0.5 * (step / BIAS_SPREAD) ** 2 - math.log(total) - 0.5 * squares / total
        if log > largest:
            fade = math.exp(largest - log)
            sum_0, sum_1, largest = sum_0 * fade, sum_1 * fade, log
        weight = math.exp(log - largest)
        sum_0 += weight
        sum_1 += weight * variance
    return float(sum_1 / sum_0)


@njit(**INNER)
def _tilt_shares(state: State, settings: FloatArray, time: float) -> tuple[float, float]:
    """Return how much of a change of the level is drift and how much true tilt: mean squares of the shares.

    With the share s of true tilt, what the gyros see bends as s times what the level does: coefficients of
    t² and t³ of both are compared.  A tilt at a constant rate cannot be told so; the prior is against it.
    """
    number = state.number
    _, drift = _drift(state)
    if math.hypot(drift[0], drift[1]) * time > settings[LARGEST_DRIFT]:
        number[REAL_TILT] = 1.0
        return 0.0, 1.0
    logs = np.zeros(11)
    if state.flag[TICKS] >= 12:
        _compare_bends(state, time, logs)
    unlikely = _not_warm_up(state, settings, drift, time)
    largest = -math.inf
    for i in range(11):
        logs[i] -= unlikely * (1.0 - 0.1 * i) ** 2
        prior = TRUE_TILT if i == 10 else 1.0 if i == 0 else PARTLY
        logs[i] += math.log(prior)
        largest = max(largest, logs[i])
    total = share_drift = share_tilt = real = 0.0
    for i in range(11):
        weight, share = math.exp(logs[i] - largest), 0.1 * i
        total += weight
        share_drift += weight * (1.0 - share) ** 2
        share_tilt += weight * share**2
        if i >= 3:
            real += weight
    number[REAL_TILT] = real / total
    return share_drift / total, share_tilt / total


@njit(**INNER)
def _not_warm_up(state: State, settings: FloatArray, drift: FloatArray, time: float) -> float:
    """Return how unlikely it is, as -log of the likelihood, that the known warm-up errs by all of a drift."""
    if settings[WARM_SD] <= 0.0:
        return 0.0
    begin, end = state.number[FINE_AT], state.number[LAST]
    variance = state.number[TILT2] + 1e-30
    for i in range(3):
        tau = settings[WARM_TAU + i]
        first, last = math.exp(-begin / tau), math.exp(-end / tau)
        grown, slope = first - last, (begin * first - end * last) / (tau * tau)
        amplitude, constant = grown * settings[WARM_SD], slope * settings[WARM_TAU_SD] * settings[WARM_X + i]
        # The mean of a horizontal direction's share over the three axes.
        variance += (amplitude * amplitude + constant * constant) / (3.0 * state.number[GRAVITY] ** 2)
    return float(0.5 * time * time * (drift[0] ** 2 + drift[1] ** 2) / variance)


@njit(**INNER)
def _compare_bends(state: State, time: float, logs: FloatArray) -> None:
    """Add the logarithm of the likelihood of each of 11 shares of true tilt, 0 to 1."""
    rate_normal, path_normal = np.empty((3, 3)), np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            path_normal[i, j] = state.moments[1, i + j] / time ** (i + j)
            if i < 3 and j < 3:
                rate_normal[i, j] = state.moments[0, i + j] / time ** (i + j)
    good_rate, rate_inverse = inverse(rate_normal, len(rate_normal))
    good_path, path_inverse = inverse(path_normal, len(path_normal))
    if not (good_rate and good_path):
        return
    seen, bend = np.empty(2), np.empty(2)
    for axis in range(2):
        for i in range(1, 3):
            seen[i - 1] = bend[i - 1] = 0.0
            for k in range(4):
                bend[i - 1] += (i + 1) / time * path_inverse[i + 1, k] * state.path_sums[k, axis] / time**k
                if k < 3:
                    seen[i - 1] += rate_inverse[i, k] * state.rate_sums[k, axis] / time**k
        for i in range(11):
            share = 0.1 * i
            logs[i] += _log_likelihood(state, share, seen, bend, rate_inverse, path_inverse, time)


@njit(**INNER)
def _log_likelihood(
    state: State,
    share: float,
    seen: FloatArray,
    bend: FloatArray,
    rate_inverse: FloatArray,
    path_inverse: FloatArray,
    time: float,
) -> float:
    """Return the log-likelihood of what the gyros see, given the bend of the level and the share of tilt.

    What is seen of the gyros has the sign opposite to that of the level: Φ(T) - Φ(0) = α - θ, and a true tilt
    turns the gyros while α stays.
    """
    arw2, tilt2 = state.number[ARW2] + 1e-30, state.number[TILT2]
    second, third = 2.0 * share / time, 3.0 * share / time
    a = arw2 * rate_inverse[1, 1] + second**2 * tilt2 * path_inverse[2, 2]
    b = arw2 * rate_inverse[1, 2] + second * third * tilt2 * path_inverse[2, 3]
    c = arw2 * rate_inverse[2, 2] + third**2 * tilt2 * path_inverse[3, 3]
    a += (MISFIT * share * bend[0]) ** 2
    c += (MISFIT * share * bend[1]) ** 2
    x, y = seen[0] + share * bend[0], seen[1] + share * bend[1]
    determinant = a * c - b * b
    if not determinant > 0.0:
        return 0.0
    return float(-0.5 * math.log(determinant) - 0.5 * (c * x * x - 2.0 * b * x * y + a * y * y) / determinant)


@njit(**INNER)
def _choose(state: State) -> None:
    """Choose the heading that is shown: the least sigma, but not another one for every small difference."""
    best, flag, number = 3, state.flag, state.number
    for k in (4, 0, 1, 2):
        if state.result[k, 1] < state.result[best, 1]:
            best = k
    if flag[CHOSEN] < 0:
        flag[CHOSEN] = best
    better = state.result[best, 1] < BETTER_BY * state.result[flag[CHOSEN], 1]
    if not better:
        number[BETTER_FOR] = 0.0
        return
    number[BETTER_FOR] = number[BETTER_FOR] + 1.0 if flag[BETTER] == best else 1.0
    flag[BETTER] = best
    if number[BETTER_FOR] >= BETTER_S:
        flag[CHOSEN], number[BETTER_FOR] = best, 0.0
