"""Biases over temperature: value and slope of sums of terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import polynomial

from imumon.blocks import FloatArray
from imumon.simulation.unit.parameters import Curves, Polynomial, Sin, Tanh

Terms = Sequence[Tanh | Sin | Polynomial]


def _cosh_2(u: FloatArray) -> FloatArray:
    return 1.0 / np.cosh(np.clip(u, -300.0, 300.0)) ** 2


_SHAPES: dict[str, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]] = {
    "tanh": (np.tanh, _cosh_2),
    "sin": (np.sin, np.cos),
}
"""Function and derivative of the kinds that have an amplitude."""


def curve_value(terms: Terms, temperature_degc: FloatArray) -> FloatArray:
    """Return the sum of the terms at each temperature, in their unit; same shape."""
    total = np.zeros_like(temperature_degc)
    for term in terms:
        u = (temperature_degc - term.at_degc) / term.width_degc
        if isinstance(term, Polynomial):
            total += polynomial.polyval(u, term.coefficients)
        else:
            total += term.amplitude * _SHAPES[term.kind][0](u)
    return total


def curve_slope(terms: Terms, temperature_degc: FloatArray) -> FloatArray:
    """Return the derivative of `curve_value`, in its unit per °C; same shape."""
    total = np.zeros_like(temperature_degc)
    for term in terms:
        u = (temperature_degc - term.at_degc) / term.width_degc
        if isinstance(term, Polynomial):
            total += polynomial.polyval(u, polynomial.polyder(term.coefficients)) / term.width_degc
        else:
            total += term.amplitude * _SHAPES[term.kind][1](u) / term.width_degc
    return total


def axis_values(curves: Curves, temperature_degc: FloatArray) -> FloatArray:
    """Return the bias of each axis at its own temperature; both of shape (n, 3)."""
    return np.column_stack(
        [curve_value(getattr(curves, axis), temperature_degc[:, i]) for i, axis in enumerate("xyz")]
    )
