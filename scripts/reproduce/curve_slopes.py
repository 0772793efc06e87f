"""Slopes of the simulated biases over temperature: what a calibration is to find."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import polynomial

from imumon.blocks import FloatArray
from imumon.simulation.unit.curves import Terms
from imumon.simulation.unit.parameters import Polynomial


def _cosh_2(u: FloatArray) -> FloatArray:
    return 1.0 / np.cosh(np.clip(u, -300.0, 300.0)) ** 2


_DERIVATIVES: dict[str, Callable[[FloatArray], FloatArray]] = {"tanh": _cosh_2, "sin": np.cos}


def curve_slope(terms: Terms, temperature_degc: FloatArray) -> FloatArray:
    """Return the derivative of the sum of the terms, in their unit per °C; same shape as the temperatures."""
    total = np.zeros_like(temperature_degc)
    for term in terms:
        u = (temperature_degc - term.at_degc) / term.width_degc
        if isinstance(term, Polynomial):
            total += polynomial.polyval(u, polynomial.polyder(term.coefficients)) / term.width_degc
        else:
            total += term.amplitude * _DERIVATIVES[term.kind](u) / term.width_degc
    return total
