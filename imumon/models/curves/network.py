"""The published network, 1-n-n-1 with tanh in both hidden layers, trained by Levenberg-Marquardt from several
starts, with the analytic Jacobian.

Fontanella, Accardo, Schiano Lo Moriello, Angrisani, De Simone, Sensors 2018, 18(5), 1457, section 5 (n = 2).
"""

import math
from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray
from imumon.config import StrictModel

from .points import Points

MOST_NEURONS = 16
RESTARTS = 8
DECAY = 1e-7
"""Penalty on the squared weights, per point of unit variance: keeps weights finite that the data leaves free.

With 1e-5 it costs 2 % of the span, more than the noise of the soak, and the slope suffers."""
FIRST_STEP = 0.1
"""Bound of the first step, in norms of the start; the least that MINPACK takes.  With its usual 100 that step
makes neurons so steep that they jump between two levels, where there is no sample."""
MERGED = 200  # means within this part of the span are merged before training
FIRST, LAST = 50, 200  # evaluations from every start, and of those that go on
_Layer = Annotated[list[FiniteFloat], Field(min_length=1, max_length=MOST_NEURONS)]
_Positive = Annotated[FiniteFloat, Field(gt=0.0)]


class NetworkCurve(StrictModel):
    """b(T) = offset + scale (w3 · tanh(W2 tanh(w1 u + b1) + b2) + b3), u = (T - center) / half_width."""

    kind: Literal["network"] = "network"
    center_degc: FiniteFloat
    half_width_degc: _Positive
    """°C."""
    offset: FiniteFloat
    scale: _Positive
    """In the unit of the channel."""
    first_weights: _Layer
    first_biases: _Layer
    """w1, b1."""
    second_weights: Annotated[list[_Layer], Field(min_length=1, max_length=MOST_NEURONS)]
    """W2; a row per neuron of the second layer."""
    second_biases: _Layer
    output_weights: _Layer
    """b2, w3."""
    output_bias: FiniteFloat
    """b3."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = len(self.first_weights)
        layers = [self.first_biases, *self.second_weights, self.second_biases, self.output_weights]
        if len(self.second_weights) != n or any(len(layer) != n for layer in layers):
            raise ValueError(f"the layers are not all of {n} neurons, as first_weights is")
        return self

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return b at temperatures in °C, in the unit of the channel."""
        output = _times(self._layers(temperature)[1], np.array(self.output_weights)) + self.output_bias
        return self.offset + self.scale * output

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C; by the chain rule."""
        first, second = self._layers(temperature)
        inner = (1.0 - first**2) * np.array(self.first_weights)
        outer = (1.0 - second**2) * _times(inner[..., None, :], np.array(self.second_weights))
        return _times(outer, np.array(self.output_weights)) * (self.scale / self.half_width_degc)

    def minus(self, constant: float) -> "NetworkCurve":
        """Return the curve lowered by a constant."""
        return self.model_copy(update={"offset": self.offset - constant})

    def _layers(self, temperature: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        u = (np.asarray(temperature, np.float64) - self.center_degc) / self.half_width_degc
        layers = (self.first_weights, self.first_biases, self.second_weights, self.second_biases)
        return _hidden(u, *map(np.array, layers))


def _hidden(
    u: FloatArray, w1: FloatArray, b1: FloatArray, w2: FloatArray, b2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the outputs of both hidden layers at u, (...,), each (..., n)."""
    first = np.tanh(u[..., None] * w1 + b1)
    return first, np.tanh(_times(first[..., None, :], w2) + b2)


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sum of products over the last axis; in matrix products, digits depend on the other rows."""
    return np.asarray((a * b).sum(axis=-1))


class Scaled(NamedTuple):
    """Points in the network's own units, (n,): u within -1 to 1, y of unit variance, weights of mean 1."""

    u: FloatArray
    y: FloatArray
    w: FloatArray
    center: float = 0.0  # °C: u is 0 there
    half_width: float = 1.0  # °C from there to where it is 1
    offset: float = 0.0  # in the unit of the channel: y is 0 there
    scale: float = 1.0  # from there to where it is 1

    @classmethod
    def of(cls, points: Points) -> "Scaled":
        """Return points, scaled."""
        low, high = float(points.temperature.min()), float(points.temperature.max())
        center, half_width = 0.5 * (low + high), 0.5 * (high - low) or 1.0
        mean = float(np.average(points.value, weights=points.weight))
        scale = float(np.sqrt(np.average((points.value - mean) ** 2, weights=points.weight))) or 1.0
        u, y = (points.temperature - center) / half_width, (points.value - mean) / scale
        return cls(u, y, points.weight / points.weight.mean(), center, half_width, mean, scale)

    def curve(self, weights: FloatArray) -> NetworkCurve:
        """Return the curve of a network's weights, (p,)."""
        w1, b1, w2, b2, w3 = _layers(weights)
        return NetworkCurve(
            center_degc=self.center,
            half_width_degc=self.half_width,
            offset=self.offset,
            scale=self.scale,
            first_weights=w1.tolist(),
            first_biases=b1.tolist(),
            second_weights=w2.tolist(),
            second_biases=b2.tolist(),
            output_weights=w3.tolist(),
            output_bias=float(weights[-1]),
        )


def weights_of(neurons: int) -> int:
    """Return the number of weights of a 1-n-n-1 network."""
    return neurons * neurons + 4 * neurons + 1


def starts(neurons: int, count: int, random: np.random.Generator) -> FloatArray:
    """Return first weights whose neurons bend at different places of the range, (count, p)."""
    each = (count, neurons)
    slope = random.uniform(0.8, 2.0, each) * neurons**0.5 * random.choice([-1.0, 1.0], each)
    bend = -slope * random.uniform(-1.0, 1.0, each)
    others = random.normal(0.0, 0.8, (count, weights_of(neurons) - 2 * neurons))
    return np.concatenate([slope, bend, others], axis=1)


def _layers(weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return w1, b1, W2, b2 and w3 of a 1-n-n-1 network: views of its weights, (p,); the last is b3."""
    n = math.isqrt(len(weights) + 3) - 2
    w1, b1, w2, b2, w3, _ = np.split(weights, np.cumsum([n, n, n * n, n, n]))
    return w1, b1, w2.reshape(n, n), b2, w3


def response(weights: FloatArray, u: FloatArray) -> FloatArray:
    """Return the output of a network at u, (m,)."""
    *hidden, w3 = _layers(weights)
    return np.asarray(_hidden(u, *hidden)[1] @ w3 + weights[-1])


def sensitivity(weights: FloatArray, u: FloatArray) -> FloatArray:
    """Return the derivative of a network's output at u, (m,), by its weights, (m, p)."""
    w1, b1, w2, b2, w3 = _layers(weights)
    first, second = _hidden(u, w1, b1, w2, b2)
    by_b2 = (1.0 - second**2) * w3
    by_w2 = (by_b2[:, :, None] * first[:, None]).reshape(len(u), -1)
    by_b1 = (by_b2 @ w2) * (1.0 - first**2)
    return np.hstack([u[:, None] * by_b1, by_b1, by_w2, by_b2, second, np.ones((len(u), 1))])


def mean_square(weights: FloatArray, data: Scaled) -> float:
    """Return the weighted mean squared error of a network."""
    return float(np.mean(data.w * (data.y - response(weights, data.u)) ** 2))


def train(
    start: FloatArray,
    data: Scaled,
    decay: float = DECAY,
    evaluations: int = 100,
    accepted: Callable[[FloatArray], object] = lambda _: None,
) -> FloatArray:
    """Return the weights, (p,), that Levenberg-Marquardt (MINPACK's) comes to from a start.

    It minimises mean(w (y - output)²) + decay Σ weights².  `accepted` takes the weights after each step.
    """
    from scipy.optimize import leastsq  # takes 0.3 s, and a model is read without it

    root, shrink, same = np.sqrt(data.w / len(data.u)), np.sqrt(decay), np.ones(len(start))

    def residual(weights: FloatArray) -> FloatArray:
        return np.concatenate([root * (response(weights, data.u) - data.y), shrink * weights])

    def derivative(weights: FloatArray) -> FloatArray:  # is called after each step that was accepted
        accepted(weights)
        return np.vstack([root[:, None] * sensitivity(weights, data.u), np.diag(shrink * same)])

    found = leastsq(
        residual, start, Dfun=derivative, full_output=True, maxfev=evaluations, factor=FIRST_STEP, diag=same
    )
    return np.asarray(found[0])


def fit_network(points: Points, neurons: int, restarts: int = RESTARTS) -> NetworkCurve:
    """Fit a 1-n-n-1 network: several starts go some way, the best two to the end."""
    data = Scaled.of(points.merged(float(np.ptp(points.temperature)) / MERGED))
    begun = starts(neurons, restarts, np.random.default_rng(0))

    def cost(weights: FloatArray) -> float:
        return mean_square(weights, data) + DECAY * float(weights @ weights)

    tried = sorted((train(start, data, evaluations=FIRST) for start in begun), key=cost)
    return data.curve(min((train(weights, data, evaluations=LAST) for weights in tried[:2]), key=cost))
