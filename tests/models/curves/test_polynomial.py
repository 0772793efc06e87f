"""Polynomials in Chebyshev form."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial


def points(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Points:
    n = len(values)
    return Points(np.linspace(-20.0, 48.0, n), values, np.linspace(1.0, 2.0, n), np.arange(n))


@pytest.mark.parametrize("order", [1, 3, 9])
def test_a_polynomial_of_the_order_is_found_with_its_slope(order: int) -> None:
    coefficients = np.random.default_rng(order).standard_normal(order + 1) / 30.0 ** np.arange(order + 1)
    true = np.polynomial.Polynomial(coefficients)
    t = np.linspace(-20.0, 48.0, 40)
    curve = fit_polynomial(points(true(t)), order)
    x = np.linspace(-20.0, 48.0, 99)
    scale = np.abs(true(t)).max()
    np.testing.assert_allclose(curve.value(x), true(x), atol=1e-10 * scale)
    np.testing.assert_allclose(curve.slope(x), true.deriv()(x), atol=1e-10 * scale)
    np.testing.assert_allclose(curve.minus(1.0).value(x), true(x) - 1.0, atol=1e-10 * scale)


def test_the_weights_count() -> None:
    t = np.linspace(0.0, 1.0, 4)
    heavy = Points(t, np.array([0.0, 0.0, 1.0, 1.0]), np.array([1e6, 1.0, 1.0, 1e6]), np.arange(4))
    np.testing.assert_allclose(fit_polynomial(heavy, 1).value([0.0, 1.0]), [0.0, 1.0], atol=1e-5)


def test_too_few_temperatures_are_refused() -> None:
    with pytest.raises(ValueError, match="4 coefficients from fewer"):
        fit_polynomial(points(np.zeros(3)), 3)
