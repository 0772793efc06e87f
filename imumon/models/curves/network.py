"""The published network, 1-n-n-1 with tanh in both hidden layers, trained by Levenberg-Marquardt.

Fontanella, Accardo, Schiano Lo Moriello, Angrisani, De Simone, Sensors 2018, 18(5), 1457, section 5 (n = 2).
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray
from imumon.config import StrictModel

MOST_NEURONS = 16
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
        _, second = self._layers(temperature)
        output = second @ np.array(self.output_weights) + self.output_bias
        return np.asarray(self.offset + self.scale * output)

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in the unit of the channel per °C; by the chain rule."""
        first, second = self._layers(temperature)
        inner = (1.0 - first**2) * np.array(self.first_weights)
        outer = (1.0 - second**2) * (inner @ np.array(self.second_weights).T)
        return np.asarray(outer @ np.array(self.output_weights)) * (self.scale / self.half_width_degc)

    def minus(self, constant: float) -> NetworkCurve:
        """Return the curve lowered by a constant."""
        return self.model_copy(update={"offset": self.offset - constant})

    def _layers(self, temperature: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        u = (np.asarray(temperature, np.float64) - self.center_degc) / self.half_width_degc
        first = np.tanh(u[..., np.newaxis] * np.array(self.first_weights) + np.array(self.first_biases))
        return first, np.tanh(first @ np.array(self.second_weights).T + np.array(self.second_biases))
