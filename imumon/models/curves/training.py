"""Training of the network: Levenberg-Marquardt from several starts, with the analytic Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import leastsq

from imumon.blocks import FloatArray
from imumon.models.curves.network import NetworkCurve
from imumon.models.curves.points import Points

RESTARTS = 8
DECAY = 1e-7
"""Penalty on the squared weights, per point of unit variance: keeps weights finite that the data leaves free.

With 1e-5 it costs 2 % of the span, more than the noise of the soak, and the slope suffers."""
FIRST_STEP = 0.1
"""Bound of the first step, in norms of the start; the least that MINPACK takes.  With its usual 100 that step
makes neurons so steep that they jump between two levels, where no sample sees it."""
FIRST, LAST = 50, 200
"""Evaluations from every start, and of those that go on."""
MERGED = 200
"""Means within this part of the span are merged before training."""


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """Points in the network's own units: u within -1 to 1, y of unit variance, weights of mean 1."""

    u: FloatArray
    y: FloatArray
    w: FloatArray


@dataclass(frozen=True, slots=True)
class Scaling:
    """How points are scaled, and curves scaled back."""

    center: float
    half_width: float
    offset: float
    scale: float

    @staticmethod
    def of(points: Points) -> Scaling:
        """Return the scaling that suits points."""
        low, high = float(points.temperature.min()), float(points.temperature.max())
        mean = float(np.average(points.value, weights=points.weight))
        scale = float(np.sqrt(np.average((points.value - mean) ** 2, weights=points.weight)))
        return Scaling(0.5 * (low + high), 0.5 * (high - low) or 1.0, mean, scale or 1.0)

    def apply(self, points: Points) -> Scaled:
        """Return points in the network's units."""
        return Scaled(
            (points.temperature - self.center) / self.half_width,
            (points.value - self.offset) / self.scale,
            points.weight / points.weight.mean(),
        )

    def curve(self, weights: FloatArray) -> NetworkCurve:
        """Return the curve of a network's weights, (p,)."""
        n = neurons_of(len(weights))
        parts = np.split(weights, np.cumsum([n, n, n * n, n, n]))
        return NetworkCurve(
            center_degc=self.center,
            half_width_degc=self.half_width,
            offset=self.offset,
            scale=self.scale,
            first_weights=parts[0].tolist(),
            first_biases=parts[1].tolist(),
            second_weights=parts[2].reshape(n, n).tolist(),
            second_biases=parts[3].tolist(),
            output_weights=parts[4].tolist(),
            output_bias=float(parts[5][0]),
        )


def weights_of(neurons: int) -> int:
    """Return the number of weights of a 1-n-n-1 network."""
    return neurons * neurons + 4 * neurons + 1


def neurons_of(weights: int) -> int:
    """Return the n of a 1-n-n-1 network with so many weights."""
    return math.isqrt(weights + 3) - 2


def starts(neurons: int, count: int, random: np.random.Generator) -> FloatArray:
    """Return first weights whose neurons bend at different places of the range, (count, p)."""
    n = neurons
    slope = random.uniform(0.8, 2.0, (count, n)) * n**0.5 * random.choice([-1.0, 1.0], (count, n))
    bend = -slope * random.uniform(-1.0, 1.0, (count, n))
    others = random.normal(0.0, 0.8, (count, n * n + 2 * n + 1))
    return np.concatenate([slope, bend, others], axis=1)


def response(weights: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the output of a network at u, (m,), and its derivative by the weights, (m, p)."""
    n = neurons_of(len(weights))
    w1, b1, w2, b2, w3, b3 = np.split(weights, np.cumsum([n, n, n * n, n, n]))
    w2 = w2.reshape(n, n)
    first = np.tanh(u[:, np.newaxis] * w1 + b1)
    second = np.tanh(first @ w2.T + b2)
    by_b2 = (1.0 - second**2) * w3
    by_w2 = by_b2[:, :, np.newaxis] * first[:, np.newaxis]
    by_b1 = (by_b2 @ w2) * (1.0 - first**2)
    by_w1 = by_b1 * u[:, np.newaxis]
    parts = [by_w1, by_b1, by_w2.reshape(len(u), -1), by_b2, second, np.ones((len(u), 1))]
    return second @ w3 + b3, np.hstack(parts)


def mean_square(weights: FloatArray, data: Scaled) -> float:
    """Return the weighted mean squared error of a network."""
    return float(np.mean(data.w * (data.y - response(weights, data.u)[0]) ** 2))


def train(
    start: FloatArray,
    data: Scaled,
    validation: Scaled | None = None,
    decay: float = DECAY,
    evaluations: int = 100,
) -> FloatArray:
    """Return the weights, (p,), that Levenberg-Marquardt (MINPACK's) comes to from a start.

    It minimises mean(w (y - output)²) + decay Σ weights².  With validation data, the weights returned are
    those of the least validation error on the way.
    """
    root = np.sqrt(data.w / len(data.u))
    shrink = np.sqrt(decay)
    best, least = start, np.inf

    def residual(weights: FloatArray) -> FloatArray:
        return np.concatenate([root * (response(weights, data.u)[0] - data.y), shrink * weights])

    def derivative(weights: FloatArray) -> FloatArray:  # is asked for after each step that was accepted
        nonlocal best, least
        if validation is not None and (error := mean_square(weights, validation)) < least:
            best, least = weights.copy(), error
        own = root[:, np.newaxis] * response(weights, data.u)[1]
        return np.vstack([own, shrink * np.eye(len(weights))])

    same = np.ones(len(start))
    found = leastsq(
        residual, start, Dfun=derivative, full_output=True, maxfev=evaluations, factor=FIRST_STEP, diag=same
    )
    return np.asarray(found[0] if validation is None else best)


def fit_network(points: Points, neurons: int, seed: int = 0, restarts: int = RESTARTS) -> NetworkCurve:
    """Fit a 1-n-n-1 network: several starts go some way, the best two to the end."""
    points = points.merged(float(np.ptp(points.temperature)) / MERGED)
    scaling = Scaling.of(points)
    data = scaling.apply(points)
    begun = starts(neurons, restarts, np.random.default_rng(seed))
    tried = sorted((train(start, data, evaluations=FIRST) for start in begun), key=lambda w: _cost(w, data))
    trained = [train(weights, data, evaluations=LAST) for weights in tried[:2]]
    return scaling.curve(min(trained, key=lambda weights: _cost(weights, data)))


def _cost(weights: FloatArray, data: Scaled) -> float:
    return mean_square(weights, data) + DECAY * float(weights @ weights)
