"""Biases over temperature: sums of terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import polynomial

from imumon.blocks import FloatArray
from imumon.simulation.unit.parameters import Curves, Polynomial, Sin, Tanh

Terms = Sequence[Tanh | Sin | Polynomial]


_SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {"tanh": np.tanh, "sin": np.sin}
"""Function of the kinds that have an amplitude."""


def curve_value(terms: Terms, temperature_degc: FloatArray) -> FloatArray:
    """Return the sum of the terms at each temperature, in their unit; same shape."""
    total = np.zeros_like(temperature_degc)
    for term in terms:
        u = (temperature_degc - term.at_degc) / term.width_degc
        if isinstance(term, Polynomial):
            total += polynomial.polyval(u, term.coefficients)
        else:
            total += term.amplitude * _SHAPES[term.kind](u)
    return total


def axis_values(curves: Curves, temperature_degc: FloatArray) -> FloatArray:
    """Return the bias of each axis at its own temperature; both of shape (n, 3)."""
    return np.column_stack(
        [curve_value(getattr(curves, axis), temperature_degc[:, i]) for i, axis in enumerate("xyz")]
    )
