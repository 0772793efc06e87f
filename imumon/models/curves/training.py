"""Training of the network: Levenberg-Marquardt from several starts at once, analytic Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.models.curves.network import NetworkCurve
from imumon.models.curves.points import Points, folds

RESTARTS = 8
DECAY = 1e-7
"""Penalty on the squared weights, per point of unit variance: keeps weights finite that the data leaves free.

With 1e-5 it costs 2 % of the span, more than the noise of the soak, and the slope suffers."""
ITERATIONS = 80
MERGED = 200
"""Means within this part of the span are merged before training."""
PATIENCE = 6
"""Steps in which the validation error may rise before a start is stopped."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-10, 1e8


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
    """Return the output of r networks at u, (r, m), and its derivative by their weights, (r, m, p)."""
    r, m = len(weights), len(u)
    output, first, second, w2, w3 = _forward(weights, u)
    by_b2 = (1.0 - second**2) * w3[:, np.newaxis]
    by_w2 = (by_b2[..., np.newaxis] * first[:, :, np.newaxis]).reshape(r, m, -1)
    by_b1 = (by_b2 @ w2) * (1.0 - first**2)
    by_w1 = by_b1 * u[np.newaxis, :, np.newaxis]
    return output, np.concatenate([by_w1, by_b1, by_w2, by_b2, second, np.ones((r, m, 1))], axis=2)


def _forward(weights: FloatArray, u: FloatArray) -> tuple[FloatArray, ...]:
    """Return output (r, m), both hidden layers (r, m, n), and the weights w2 (r, n, n) and w3 (r, n)."""
    n = neurons_of(weights.shape[1])
    w1, b1, w2, b2, w3, b3 = np.split(weights, np.cumsum([n, n, n * n, n, n]), axis=1)
    w2 = w2.reshape(-1, n, n)
    first = np.tanh(u[np.newaxis, :, np.newaxis] * w1[:, np.newaxis] + b1[:, np.newaxis])
    second = np.tanh(first @ w2.transpose(0, 2, 1) + b2[:, np.newaxis])
    return (second @ w3[..., np.newaxis])[..., 0] + b3, first, second, w2, w3


def mean_square(weights: FloatArray, data: Scaled) -> FloatArray:
    """Return the weighted mean squared error of r networks, (r,)."""
    return _mean_square(_forward(weights, data.u)[0], data)


def train(
    start: FloatArray,
    data: Scaled,
    validation: Scaled | None = None,
    decay: float = DECAY,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """Return the weights of r networks after training, (r, p), each from its own start.

    Minimises mean(w (y - output)²) + decay Σ weights².  With validation data, the weights returned are those
    of the least validation error on the way, and a start ends after `PATIENCE` steps above it.
    """
    weights = start.copy()
    damping = np.full(len(start), _FIRST_DAMPING)
    output, jacobian = response(weights, data.u)
    cost = _cost(output, data, weights, decay)
    best, best_error, waited = weights.copy(), np.full(len(start), np.inf), np.zeros(len(start), np.int64)
    if validation is not None:
        best_error = mean_square(weights, validation)
    for _ in range(iterations):
        step = _step(jacobian, output, data, weights, decay, damping)
        tried = weights + step
        new_output, new_jacobian = response(tried, data.u)
        new_cost = _cost(new_output, data, tried, decay)
        going = (damping < _MOST_DAMPING) & (waited < PATIENCE)
        accepted = going & (new_cost < cost)
        weights[accepted], cost[accepted] = tried[accepted], new_cost[accepted]
        output[accepted], jacobian[accepted] = new_output[accepted], new_jacobian[accepted]
        damping = np.where(accepted, np.maximum(damping * 0.1, _LEAST_DAMPING), damping * 4.0)
        if validation is not None:
            error = mean_square(weights, validation)
            better = accepted & (error < best_error)
            best[better], best_error[better] = weights[better], error[better]
            waited = np.where(better, 0, waited + accepted)
        if not going.any():
            break
    return weights if validation is None else best


def fit_network(points: Points, neurons: int, seed: int = 0, restarts: int = RESTARTS) -> NetworkCurve:
    """Fit a 1-n-n-1 network: several starts, stopped early on levels kept apart; the best goes on on all."""
    points = points.merged(float(np.ptp(points.temperature)) / MERGED)
    scaling = Scaling.of(points)
    everything = scaling.apply(points)
    begun = starts(neurons, restarts, np.random.default_rng(seed))
    apart = folds(points.level, 5)
    if len(apart) >= 2:
        fold = apart[len(apart) // 2]
        own = Scaled(everything.u[~fold], everything.y[~fold], everything.w[~fold])
        kept = Scaled(everything.u[fold], everything.y[fold], everything.w[fold])
        begun = train(begun, own, kept)
    error = mean_square(begun, everything)
    chosen = begun[np.argsort(error)[:2]]
    trained = train(chosen, everything)
    costs = mean_square(trained, everything) + DECAY * np.sum(trained**2, axis=1)
    return scaling.curve(trained[np.argmin(costs)])


def _step(
    jacobian: FloatArray,
    output: FloatArray,
    data: Scaled,
    weights: FloatArray,
    decay: float,
    damping: FloatArray,
) -> FloatArray:
    weighted = (jacobian * data.w[:, np.newaxis]).transpose(0, 2, 1) / len(data.u)
    normal = weighted @ jacobian
    gradient = (weighted @ (output - data.y)[..., np.newaxis])[..., 0] + decay * weights
    diagonal = np.arange(normal.shape[1])
    normal[:, diagonal, diagonal] += decay + damping[:, np.newaxis]
    return np.asarray(-np.linalg.solve(normal, gradient[..., np.newaxis])[..., 0], np.float64)


def _mean_square(output: FloatArray, data: Scaled) -> FloatArray:
    return np.asarray(np.mean(data.w * (output - data.y) ** 2, axis=1))


def _cost(output: FloatArray, data: Scaled, weights: FloatArray, decay: float) -> FloatArray:
    return np.asarray(_mean_square(output, data) + decay * np.sum(weights**2, axis=1))
