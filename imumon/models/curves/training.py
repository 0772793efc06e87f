"""Training of the network: Levenberg-Marquardt from several starts, with the analytic Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

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
        layers = Layers.of(weights)
        return NetworkCurve(
            center_degc=self.center,
            half_width_degc=self.half_width,
            offset=self.offset,
            scale=self.scale,
            first_weights=layers.w1.tolist(),
            first_biases=layers.b1.tolist(),
            second_weights=layers.w2.tolist(),
            second_biases=layers.b2.tolist(),
            output_weights=layers.w3.tolist(),
            output_bias=float(layers.b3),
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


class Layers(NamedTuple):
    """Weights of a 1-n-n-1 network, layer by layer: views of one row, (p,)."""

    w1: FloatArray
    b1: FloatArray
    w2: FloatArray
    b2: FloatArray
    w3: FloatArray
    b3: np.float64

    @classmethod
    def of(cls, weights: FloatArray) -> Layers:
        """Divide a row of weights."""
        n = neurons_of(len(weights))
        second, third = 2 * n, 2 * n + n * n
        return cls(
            weights[:n],
            weights[n:second],
            weights[second:third].reshape(n, n),
            weights[third : third + n],
            weights[third + n : -1],
            weights[-1],
        )

    def hidden(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what both hidden layers give at u, (m,), each (m, n)."""
        first = np.tanh(u[:, np.newaxis] * self.w1 + self.b1)
        return first, np.tanh(first @ self.w2.T + self.b2)


def response(weights: FloatArray, u: FloatArray) -> FloatArray:
    """Return the output of a network at u, (m,)."""
    layers = Layers.of(weights)
    return np.asarray(layers.hidden(u)[1] @ layers.w3 + layers.b3)


def sensitivity(weights: FloatArray, u: FloatArray) -> FloatArray:
    """Return the derivative of a network's output at u, (m,), by its weights, (m, p)."""
    layers = Layers.of(weights)
    first, second = layers.hidden(u)
    by = np.empty((len(u), len(weights)))
    n = len(layers.w1)
    by_w1, by_b1 = by[:, :n], by[:, n : 2 * n]
    by_w2, by_b2 = by[:, 2 * n : -2 * n - 1], by[:, -2 * n - 1 : -n - 1]
    by_b2[:] = (1.0 - second**2) * layers.w3
    by_w2[:] = (by_b2[:, :, np.newaxis] * first[:, np.newaxis]).reshape(len(u), -1)
    by_b1[:] = (by_b2 @ layers.w2) * (1.0 - first**2)
    by_w1[:] = by_b1 * u[:, np.newaxis]
    by[:, -n - 1 : -1] = second
    by[:, -1] = 1.0
    return by


def mean_square(weights: FloatArray, data: Scaled) -> float:
    """Return the weighted mean squared error of a network."""
    return float(np.mean(data.w * (data.y - response(weights, data.u)) ** 2))


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
    shrinking = shrink * np.eye(len(start))
    best, least = start, np.inf

    def residual(weights: FloatArray) -> FloatArray:
        return np.concatenate([root * (response(weights, data.u) - data.y), shrink * weights])

    def derivative(weights: FloatArray) -> FloatArray:  # is asked for after each step that was accepted
        nonlocal best, least
        if validation is not None and (error := mean_square(weights, validation)) < least:
            best, least = weights.copy(), error
        return np.concatenate([root[:, np.newaxis] * sensitivity(weights, data.u), shrinking])

    same = np.ones(len(start))
    found = leastsq(
        residual, start, Dfun=derivative, full_output=True, maxfev=evaluations, factor=FIRST_STEP, diag=same
    )
    return np.asarray(found[0] if validation is None else best)


def fit_network(points: Points, neurons: int, restarts: int = RESTARTS) -> NetworkCurve:
    """Fit a 1-n-n-1 network: several starts go some way, the best two to the end."""
    points = points.merged(float(np.ptp(points.temperature)) / MERGED)
    scaling = Scaling.of(points)
    data = scaling.apply(points)
    begun = starts(neurons, restarts, np.random.default_rng(0))
    tried = sorted((train(start, data, evaluations=FIRST) for start in begun), key=lambda w: _cost(w, data))
    trained = [train(weights, data, evaluations=LAST) for weights in tried[:2]]
    return scaling.curve(min(trained, key=lambda weights: _cost(weights, data)))


def _cost(weights: FloatArray, data: Scaled) -> float:
    return mean_square(weights, data) + DECAY * float(weights @ weights)
