"""Variance of an overlapping deviation, and covariance between averaging times.

A difference of the integrated signal is stationary for every power-law noise, with a covariance that
follows from the generalised autocovariance G of the integral (Greenhall and Riley, "Uncertainty of stability
variances based on finite differences", PTTI 2003):

    E[d_i(t) d_j(t + k)] = sum over a, b of c_a c_b G(k + b m_j - a m_i) / norm

For Gaussian noise the covariance of two mean squares is then 2 / (N_i N_j) times the sum of the squares of
this over all pairs of positions.  The sum over the lag k is taken exactly where it is short, and by
Gauss-Legendre between the kinks of G where it is long.  Everything is in units of one sample, and scaled so
that each noise has the variance given in `SHAPES` per unit of its coefficient.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import leggauss

from imumon.blocks import FloatArray, IntArray

Kind = Literal["allan", "modified", "hadamard"]

COEFFICIENTS: dict[Kind, tuple[float, ...]] = {
    "allan": (1.0, -2.0, 1.0),
    "modified": (1.0, -2.0, 1.0),
    "hadamard": (-1.0, 3.0, -3.0, 1.0),
}
NORMS: dict[Kind, float] = {"allan": 2.0, "modified": 2.0, "hadamard": 6.0}

FLOOR_PER_INSTABILITY = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Flat part of the Allan deviation of flicker, over the bias instability B (IEEE Std 952, C.1.3)."""
NOISES = ("white", "flicker", "walk", "quantization")
"""The stochastic terms, by what they are of the rate (quantization: white noise of the angle)."""
SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "white": lambda m: 1.0 / m,
    "flicker": np.ones_like,
    "walk": lambda m: m,
    "quantization": lambda m: 1.0 / m**2,
    "ramp": lambda m: m**2,
}
"""Allan variance at averaging factor m per unit of the coefficient; the ramp is not a noise but a trend."""

CONFIDENCE = 0.683
"""Probability of the intervals: one standard deviation of a normal distribution."""
TRUSTED_FREEDOM = 4.0
"""An averaging time is trusted when its variance has so many degrees of freedom: the deviation is then known
to about 35 %."""

EXACT_LAGS = 16
SMALL = 0.05
"""Below it a series of five terms is exact to rounding."""
NODES, WEIGHTS = leggauss(10)
TAILS = (0.0, 1.0, 3.0, 8.0)
"""Lags beyond the span of a difference, in units of the longer m, up to which flicker noise is followed."""
GROUPS = 24
"""Runs of different length are summed up as so many kinds at the most."""


def _white(k: FloatArray) -> FloatArray:
    return -0.5 * np.abs(k)


def _flicker(k: FloatArray) -> FloatArray:
    size = np.maximum(np.abs(k), 1e-30)
    return np.asarray(size**2 * np.log(size) / (4.0 * np.log(2.0)))


def _walk(k: FloatArray) -> FloatArray:
    return 0.25 * np.abs(k) ** 3


def _quantization(k: FloatArray) -> FloatArray:
    return np.where(np.abs(k) < 1e-9, 1.0 / 3.0, 0.0)


Autocovariance = Callable[[FloatArray], FloatArray]
AUTOCOVARIANCES: tuple[Autocovariance, ...] = (_white, _flicker, _walk, _quantization)
"""G of the integral of each of `NOISES`."""


def markov(time: float) -> Autocovariance:
    """Return G of the integral of a first-order Gauss-Markov process of unit variance.

    The second difference of G is minus the autocovariance exp(-|k| / time), time the correlation time in
    samples.  The k² in it, which no second difference of the integral sees, is left out: with it a long time
    would leave no digits.
    """
    scale = 0.25 / math.sinh(0.5 / time) ** 2
    # sinh(x) - x at x = 1 / time, by its series.
    linear = (1.0 + 0.05 / time**2 * (1.0 + 1.0 / (42.0 * time**2))) / (6.0 * time**3)

    def g(k: FloatArray) -> FloatArray:
        x = np.abs(k) / time
        series = x**3 / -6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0))))
        rest = np.where(x < SMALL, series, np.expm1(-x) + x - 0.5 * x**2)
        return np.asarray(-scale * (rest + linear * np.abs(k)))

    return g


def markov_shape(m: FloatArray, time: float) -> FloatArray:
    """Return the Allan variance at averaging factors of a Gauss-Markov process of unit variance, (n,)."""
    g = markov(time)
    # The terms of the second difference with itself; IEEE Std 952, C.1.5, is the limit of a long time.
    return np.asarray((g(2.0 * m) - 4.0 * g(m) + 3.0 * g(np.zeros(1))) / m**2)


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Lengths of runs in samples, and how many there are of each."""

    lengths: FloatArray
    weights: FloatArray

    @staticmethod
    def of(starts: IntArray, stops: IntArray, least: int) -> Runs:
        """Return the runs of this length or more, joined to `GROUPS` kinds of similar length."""
        lengths = np.sort((stops - starts).astype(np.float64))
        lengths = lengths[lengths >= least]
        parts = [part for part in np.array_split(lengths, min(GROUPS, len(lengths))) if len(part)]
        return Runs(np.array([part.mean() for part in parts]), np.array([float(len(p)) for p in parts]))

    def positions(self, m: int, span: int) -> FloatArray:
        """Return how many differences of averaging factor m and this span, in m, each kind of run has."""
        return np.maximum(self.lengths + 1.0 - span * m, 0.0)


def lag_nodes(m_i: int, m_j: int, order: int, smoothing: bool) -> tuple[FloatArray, FloatArray]:
    """Return lags and weights for a sum over all integer lags between differences of m_i and m_j."""
    if smoothing:
        knots = {step * m_i for step in range(-order - 1, order + 2)}
    else:
        knots = {a * m_i - b * m_j for a, b in product(range(order + 1), repeat=2)}
    longer = max(m_i, m_j)
    low, high = min(knots), max(knots)
    for tail in TAILS[1:]:
        knots |= {low - round(tail * longer), high + round(tail * longer)}
    edges = sorted(knots)
    lags, weights = [np.array(edges, np.float64)], [np.ones(len(edges))]
    for left, right in pairwise(edges):
        inside = right - left - 1
        if inside <= 0:
            continue
        if inside <= EXACT_LAGS:
            lags.append(np.arange(left + 1, right, dtype=np.float64))
            weights.append(np.ones(inside))
        else:
            lags.append(0.5 * (left + right) + 0.5 * inside * NODES)
            weights.append(0.5 * inside * WEIGHTS)
    return np.concatenate(lags), np.concatenate(weights)


def _correlations(
    kind: Kind, m_i: int, m_j: int, lags: FloatArray, covariances: Sequence[Autocovariance]
) -> FloatArray:
    """Return the covariance of scaled differences at these lags, one row per noise."""
    shifts, weights = _differences(COEFFICIENTS[kind], m_i, m_j)
    shifted = lags + shifts[:, np.newaxis]
    if kind == "modified":
        values = [_smoothed(covariance, m_i, shifted) for covariance in covariances]
    else:
        values = [covariance(shifted) for covariance in covariances]
    return np.array([weights @ value for value in values]) / (NORMS[kind] * m_i * m_j)


def _differences(coefficients: Sequence[float], m_i: int, m_j: int) -> tuple[FloatArray, FloatArray]:
    """Return by how much the terms of two differences are apart, and the product of their coefficients."""
    found: dict[int, float] = {}
    for (a, first), (b, second) in product(enumerate(coefficients), repeat=2):
        shift = b * m_j - a * m_i
        found[shift] = found.get(shift, 0.0) + first * second
    return np.array([*found], np.float64), np.array([*found.values()])


def _smoothed(covariance: Autocovariance, m: int, lags: FloatArray) -> FloatArray:
    """Return the autocovariance of the integral averaged over m samples, from its G."""
    if covariance is _quantization:
        return np.asarray(np.maximum(m - np.abs(lags), 0.0) / (3.0 * m**2))
    shifts, weights = lag_nodes(m, m, 0, smoothing=True) if m > 1 else (np.zeros(1), np.ones(1))
    weights = weights * np.maximum(m - np.abs(shifts), 0.0) / m**2
    return np.asarray(covariance(lags[..., np.newaxis] + shifts) @ weights)


def _pairs(first: FloatArray, second: FloatArray, weights: FloatArray, lags: FloatArray) -> FloatArray:
    """Return how many pairs of positions are a lag apart, summed over the runs."""
    upper = np.minimum(first[:, np.newaxis], second[:, np.newaxis] - lags)
    return np.asarray(weights @ np.maximum(upper - np.maximum(0.0, -lags), 0.0))


def cross_terms(
    kind: Kind,
    m_i: int,
    m_j: int,
    runs: Runs,
    covariances: Sequence[Autocovariance] = AUTOCOVARIANCES,
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of two mean squares: quadratic part (p, p), and part per trend (p,).

    With coefficients q of the p noises the covariance is q' A q, plus 2 mu_i mu_j b'q, where mu is the part
    of each scaled difference that a trend makes.
    """
    order = len(COEFFICIENTS[kind]) - 1
    span = order + (1 if kind == "modified" else 0)
    first, second = runs.positions(m_i, span), runs.positions(m_j, span)
    lags, weights = lag_nodes(m_i, m_j, order, smoothing=kind == "modified")
    pairs = weights * _pairs(first, second, runs.weights, lags)
    pairs /= (runs.weights @ first) * (runs.weights @ second)
    rows = _correlations(kind, m_i, m_j, lags, covariances)
    return 2.0 * (rows * pairs) @ rows.T, 2.0 * rows @ pairs


@dataclass(frozen=True, slots=True, eq=False)
class Covariances:
    """Shapes and covariances of the overlapping Allan variances at several averaging factors."""

    m: IntArray
    """Array, (n,)."""
    shapes: FloatArray
    """Expected variance per unit of the coefficients of `SHAPES` and of a Gauss-Markov process, (n, 6)."""
    quadratic: FloatArray
    """Array, (n, n, 5, 5)."""
    linear: FloatArray
    """See `cross_terms`, for `NOISES` and the Gauss-Markov process, (n, n, 5)."""

    def matrix(self, coefficients: FloatArray) -> FloatArray:
        """Return the covariance matrix, (n, n), for the coefficients of the shapes, (6,)."""
        noise, ramp = coefficients[[0, 1, 2, 3, 5]], coefficients[4]
        n = len(self.m)
        matrix = (self.quadratic.reshape(n * n, -1) @ np.outer(noise, noise).ravel()).reshape(n, n)
        if ramp:
            m = self.m.astype(np.float64)
            matrix += 2.0 * ramp * np.outer(m, m) * (self.linear @ noise)
        return matrix

    def part(self, start: int, stop: int) -> Covariances:
        """Return those of some of the averaging factors."""
        part = slice(start, stop)
        return Covariances(
            self.m[part], self.shapes[part], self.quadratic[part, part].copy(), self.linear[part, part]
        )


def covariances_of(factors: IntArray, runs: list[Runs], time: float) -> Covariances:
    """Return shapes and covariances; of two averaging factors the runs of the longer one count.

    Parameters
    ----------
    factors : array of int64, (n,)
    runs : list of Runs
        At each averaging factor.
    time : float
        Correlation time of the Gauss-Markov process, samples.
    """
    m = factors.astype(np.float64)
    shapes = [*(shape(m) for shape in SHAPES.values()), markov_shape(m, time)]
    noises = (*AUTOCOVARIANCES, markov(time))
    n, p = len(factors), len(noises)
    quadratic, linear = np.empty((n, n, p, p)), np.empty((n, n, p))
    for j in range(n):
        for i in range(j + 1):
            square, trend = cross_terms("allan", int(factors[i]), int(factors[j]), runs[j], noises)
            quadratic[i, j] = quadratic[j, i] = square
            linear[i, j] = linear[j, i] = trend
    return Covariances(factors, np.column_stack(shapes), quadratic, linear)


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """What the degrees of freedom of a variance follow from: its mean, (4,), and its variance, (4, 4)."""

    mean: FloatArray
    square: FloatArray

    def of(self, noise: FloatArray) -> float:
        """Return the equivalent degrees of freedom for a mixture of `NOISES`, (4,).

        The variance is distributed about as chi-square with 2 mean² / variance degrees of freedom.
        """
        variance = float(noise @ self.square @ noise)
        return 2.0 * float(self.mean @ noise) ** 2 / variance if variance > 0.0 else 0.0


def freedom(kind: Kind, m: int, runs: Runs) -> Freedom:
    """Return what the degrees of freedom of one overlapping variance follow from."""
    mean = _correlations(kind, m, m, np.zeros(1), AUTOCOVARIANCES)[:, 0]
    return Freedom(mean, cross_terms(kind, m, m, runs)[0])


def intervals(variances: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both ends of the intervals of deviations, (n,) each, by chi-square; `freedom` of shape (n,)."""
    from scipy.special import gammaincinv  # 0.13 s, which no command spends before the first curve

    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (
        np.sqrt(variances * freedom / (2.0 * gammaincinv(0.5 * freedom, probability)))
        for probability in (1.0 - tail, tail)
    )
    return low, high
