"""The terms of the noise; variance of an overlapping deviation, and covariance between averaging times.

A difference of the integrated signal is stationary for every power-law noise, with a covariance that
follows from the generalised autocovariance G of the integral (Greenhall and Riley, "Uncertainty of stability
variances based on finite differences", PTTI 2003):

    E[d_i(t) d_j(t + k)] = sum over a, b of c_a c_b G(k + b m_j - a m_i) / norm

For Gaussian noise the covariance of two mean squares is then 2 / (N_i N_j) times the sum of the squares of
this over all pairs of positions.  The sum over the lag k is taken exactly where it is short, and by
Gauss-Legendre between the kinks of G where it is long.  Everything is in units of one sample, and scaled so
that each noise has the variance given in `SHAPES` per unit of its coefficient.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss

from imumon.blocks import FloatArray, IntArray
from imumon.config import StrictModel
from imumon.geodesy import MICRO_G
from imumon.run.setup import AccelNoise, GyroNoise

NAMES = (
    "angle_random_walk", "bias_instability", "rate_random_walk", "quantization", "rate_ramp",
    "correlated_noise", "correlation_time",
)  # fmt: skip
"""The terms of a fit, in the order of the fields of a sensor's noise."""
_DEG = math.degrees(1.0)


class TermOfSensor(NamedTuple):
    """How a term of one sensor is reported: field of the noise section and SI unit, and for people its name,
    its unit, and how many of that are one SI unit."""

    key: str
    unit: str
    title: str
    shown: str
    factor: float


def _terms(section: type[StrictModel], *rows: tuple[str, str, str, float]) -> dict[str, TermOfSensor]:
    fields = zip(NAMES, section.model_fields, rows, strict=True)
    return {name: TermOfSensor(key, *row) for name, key, row in fields}


TERMS_OF = {
    "gyro": _terms(
        GyroNoise,
        ("rad/sqrt(s)", "angle random walk", "°/√h", 60.0 * _DEG),
        ("rad/s", "bias instability", "°/h", 3600.0 * _DEG),
        ("rad/s/sqrt(s)", "rate random walk", "°/h/√h", 60.0 * 3600.0 * _DEG),
        ("rad", "quantization", "arcsec", 3600.0 * _DEG),
        ("rad/s^2", "rate ramp", "°/h/h", 3600.0**2 * _DEG),
        ("rad/s", "correlated noise", "°/h", 3600.0 * _DEG),
        ("s", "  correlated for", "s", 1.0),
    ),
    "accel": _terms(
        AccelNoise,
        ("m/s/sqrt(s)", "velocity random walk", "m/s/√h", 60.0),
        ("m/s^2", "bias instability", "µg", 1.0 / MICRO_G),
        ("m/s^2/sqrt(s)", "accel. random walk", "µg/√h", 60.0 / MICRO_G),
        ("m/s", "quantization", "mm/s", 1e3),
        ("m/s^3", "accel. ramp", "µg/h", 3600.0 / MICRO_G),
        ("m/s^2", "correlated noise", "µg", 1.0 / MICRO_G),
        ("s", "  correlated for", "s", 1.0),
    ),
}
"""Every term of each sensor, by `NAMES`."""


Kind = Literal["allan", "modified", "hadamard"]
Autocovariance = Callable[[FloatArray], FloatArray]


class Difference(NamedTuple):
    """What a deviation is a mean of squares of: a difference of the signal, integrated once or twice."""

    coefficients: tuple[float, ...]
    integrals: int
    norm: float  # the mean of squares over the variance, at an averaging factor of one


DIFFERENCES: dict[Kind, Difference] = {
    "allan": Difference((1.0, -2.0, 1.0), 1, 2.0),
    "modified": Difference((-1.0, 3.0, -3.0, 1.0), 2, 2.0),
    "hadamard": Difference((-1.0, 3.0, -3.0, 1.0), 1, 6.0),
}

FLOOR_PER_INSTABILITY = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Flat part of the Allan deviation of flicker, over the bias instability B (IEEE Std 952, C.1.3)."""
SHAPES: tuple[Callable[[FloatArray], FloatArray], ...] = (
    lambda m: 1.0 / m,  # white noise of the rate
    np.ones_like,  # flicker
    lambda m: m,  # random walk
    lambda m: 1.0 / m**2,  # quantization: white noise of the angle
    lambda m: m**2,  # ramp, which is no noise but a trend
)
"""Allan variance at averaging factor m per unit of the coefficient of each noise."""
_FLICKER = 4.0 * math.log(2.0)
AUTOCOVARIANCES: dict[int, tuple[Autocovariance, ...]] = {
    1: (
        lambda k: -k / 2.0,
        lambda k: k**2 * np.log(np.maximum(k, 1.0)) / _FLICKER,
        lambda k: k**3 / 4.0,
        lambda k: np.where(k < 0.5, 1.0 / 3.0, 0.0),
    ),
    2: (
        lambda k: (k**3 - k) / 12.0,
        lambda k: -(k**4 - k**2) * np.log(np.maximum(k, 1.0)) / (12.0 * _FLICKER),
        lambda k: -(3.0 * k**5 - 5.0 * k**3 + 2.0 * k) / 240.0,
        lambda k: -k / 6.0,
    ),
}
"""G at lags k >= 0 of the signal integrated once and twice, for each noise of `SHAPES`.

The second difference of the latter is minus the former; for flicker up to 1 / k² and a polynomial, which no
difference here sees.
"""

CONFIDENCE = 0.683
"""Probability of the intervals: one standard deviation of a normal distribution."""
TRUSTED_FREEDOM = 4.0
"""An averaging time is trusted when its variance has so many degrees of freedom: the deviation is then known
to about 35 %."""
EXACT_LAGS = 16
NODES, WEIGHTS = leggauss(10)
TAILS = (1.0, 3.0, 8.0)
"""Lags beyond the span of a difference, in units of the longer m, up to which flicker noise is followed."""
SMALL = 0.05
"""Below it a series of five terms is exact to rounding."""
STEP = 1.01
"""Ratio of the correlation times between which the derivative by the time is taken."""


def markov(time: float) -> Autocovariance:
    """Return G of the integral of a first-order Gauss-Markov process of unit variance, at lags k >= 0.

    The second difference of G is minus the autocovariance exp(-k / time), time the correlation time in
    samples.  The k² in it, which no second difference of the integral sees, is left out: with it a long time
    would leave no digits.
    """
    scale = 0.25 / math.sinh(0.5 / time) ** 2
    # sinh(x) - x at x = 1 / time, by its series.
    linear = (1.0 + 0.05 / time**2 * (1.0 + 1.0 / (42.0 * time**2))) / (6.0 * time**3)

    def g(k: FloatArray) -> FloatArray:
        x = k / time
        series = x**3 / -6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0))))
        return -scale * (np.where(x < SMALL, series, np.expm1(-x) + x - 0.5 * x**2) + linear * k)

    return g


def markov_shape(m: FloatArray, time: float) -> FloatArray:
    """Return the Allan variance at averaging factors of a Gauss-Markov process of unit variance, (n,)."""
    g = markov(time)
    # The terms of the second difference with itself; IEEE Std 952 has the limit of a long time.
    return (g(2.0 * m) - 4.0 * g(m) + 3.0 * g(np.zeros(1))) / m**2


def shapes_at(m: FloatArray, time: float) -> FloatArray:
    """Return the Allan variance at averaging factors, (n,), per unit of the first six terms, (n, 6).

    `time`: correlation time of the Gauss-Markov process, samples.
    """
    return np.column_stack([*(shape(m) for shape in SHAPES), markov_shape(m, time)])


class Runs(NamedTuple):
    """Lengths of runs in samples, and how many there are of each."""

    lengths: FloatArray
    weights: FloatArray


def _lags(knots: set[int], longer: int) -> tuple[FloatArray, FloatArray]:
    """Return lags and weights for a sum over all integer lags of what has kinks at the knots."""
    tails = [round(tail * longer) for tail in TAILS]
    edges = sorted(knots | {min(knots) - tail for tail in tails} | {max(knots) + tail for tail in tails})
    lags, weights = [np.array(edges, np.float64)], [np.ones(len(edges))]
    for left, right in pairwise(edges):
        inside = right - left - 1
        if inside > EXACT_LAGS:
            lags.append(0.5 * (left + right) + 0.5 * inside * NODES)
            weights.append(0.5 * inside * WEIGHTS)
        else:
            lags.append(np.arange(left + 1, right, dtype=np.float64))
            weights.append(np.ones(inside))
    return np.concatenate(lags), np.concatenate(weights)


def _correlations(
    kind: Kind, m_i: int, m_j: int, runs: Runs, noises: Sequence[Autocovariance]
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of scaled differences, (p, k), at k lags; and what share of pairs is apart so."""
    coefficients, integrals, norm = DIFFERENCES[kind]
    places = np.arange(len(coefficients))
    shifts = np.subtract.outer(places * m_j, places * m_i).ravel()
    products = np.outer(coefficients, coefficients).ravel() / (norm * float(m_i * m_j) ** integrals)
    lags, weights = _lags({int(shift) for shift in -shifts}, max(m_i, m_j))
    shifted = np.abs(lags + shifts[:, None])
    rows = np.array([products @ noise(shifted) for noise in noises])
    # Positions of the differences in each kind of run, and pairs of them that are a lag apart.
    first, second = (np.maximum(runs.lengths + 1.0 - places[-1] * m, 0.0) for m in (m_i, m_j))
    upper = np.minimum(first[:, None], second[:, None] - lags)
    pairs = runs.weights @ np.maximum(upper - np.maximum(0.0, -lags), 0.0)
    return rows, weights * pairs / ((runs.weights @ first) * (runs.weights @ second))


class Covariances(NamedTuple):
    """Shapes and covariances of the overlapping Allan variances at several averaging factors.

    The covariance of two mean squares with coefficients q of the noises, the fifth a Gauss-Markov process, is
    q' A q, plus 2 mu_i mu_j b'q, where mu is the part of each scaled difference that a ramp makes.
    """

    m: FloatArray
    time: float
    """Averaging factors, (n,), and correlation time of the Gauss-Markov process, samples."""
    shapes: FloatArray
    """Expected variance per unit of the coefficients of `SHAPES` and of the Gauss-Markov process, and the
    derivative of the last by the logarithm of its time, (n, 7)."""
    quadratic: FloatArray
    linear: FloatArray
    """A, (n, n, 5, 5), and b, (n, n, 5)."""

    def matrix(self, coefficients: FloatArray) -> FloatArray:
        """Return the covariance matrix, (n, n), for the coefficients of the shapes, (6,)."""
        noise, ramp = coefficients[[0, 1, 2, 3, 5]], coefficients[4]
        return np.asarray(
            (self.quadratic @ noise) @ noise + 2.0 * ramp * np.outer(self.m, self.m) * (self.linear @ noise)
        )


def covariances_of(factors: IntArray, runs: Sequence[Runs], times: Sequence[float]) -> list[Covariances]:
    """Return shapes and covariances at averaging factors, (n,), with the runs at each.

    Of two factors the runs of the longer one count; `times` are those of the Gauss-Markov process, samples.
    """
    m, noises = factors.astype(np.float64), (*AUTOCOVARIANCES[1], *map(markov, times))
    n, fixed = len(factors), len(AUTOCOVARIANCES[1])
    quadratic = np.empty((len(times), n, n, fixed + 1, fixed + 1))
    linear = np.empty((len(times), n, n, fixed + 1))
    for j in range(n):
        for i in range(j + 1):
            every, pairs = _correlations("allan", int(factors[i]), int(factors[j]), runs[j], noises)
            for k in range(len(times)):
                rows = every[[*range(fixed), fixed + k]]
                quadratic[k, i, j] = quadratic[k, j, i] = 2.0 * (rows * pairs) @ rows.T
                linear[k, i, j] = linear[k, j, i] = 2.0 * rows @ pairs
    found = []
    for k, time in enumerate(times):
        by_time = (markov_shape(m, time * STEP) - markov_shape(m, time / STEP)) / (2.0 * math.log(STEP))
        shapes = np.column_stack([shapes_at(m, time), by_time])
        found.append(Covariances(m, time, shapes, quadratic[k], linear[k]))
    return found


def freedom(kind: Kind, m: int, runs: Runs, noise: FloatArray) -> float:
    """Return the equivalent degrees of freedom of one overlapping variance for a mixture of noises, (4,).

    The variance is distributed about as chi-square with 2 mean² / variance degrees of freedom; 0 where no run
    is long enough.
    """
    if not len(runs.lengths) or runs.lengths[-1] < (len(DIFFERENCES[kind].coefficients) - 1) * m:
        return 0.0
    rows, pairs = _correlations(kind, m, m, runs, AUTOCOVARIANCES[DIFFERENCES[kind].integrals])
    correlation = noise @ rows  # highest at no lag, where it is the mean
    half_variance = float(pairs @ correlation**2)
    return float(correlation.max()) ** 2 / half_variance if half_variance > 0.0 else 0.0


def intervals(variances: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both ends of the intervals of deviations, (n,) each, by chi-square; `freedom` of shape (n,)."""
    from scipy.special import gammaincinv  # 0.13 s, which no command spends before the first curve

    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (
        np.sqrt(variances * freedom / (2.0 * gammaincinv(0.5 * freedom, probability)))
        for probability in (1.0 - tail, tail)
    )
    return low, high
