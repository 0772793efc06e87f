"""The smoothing spline: the curve, the penalty, and the fit against what it shall find."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline

from imumon.models.curves.points import Points
from imumon.models.curves.spline import SplineCurve, fit_spline, penalised_basis

KNOTS = np.array([-20.0, -11.0, -3.0, 4.0, 20.0, 31.0, 48.0])


def test_the_penalty_is_the_integral_of_the_squared_second_derivative() -> None:
    knots = np.concatenate([[-20.0] * 3, KNOTS, [48.0] * 3])
    coefficients = np.random.default_rng(1).standard_normal(len(knots) - 4)
    points = noisy(0.0)
    basis, penalty = penalised_basis(points, KNOTS)
    curve = BSpline(knots, coefficients, 3)
    np.testing.assert_allclose(basis @ coefficients, curve(points.temperature), atol=1e-12)
    fine = np.linspace(-20.0, 48.0, 200_001)
    integral = np.trapezoid(curve(fine, nu=2) ** 2, fine)
    ratio = float(coefficients @ penalty @ coefficients) / integral
    other = np.random.default_rng(2).standard_normal(len(coefficients))
    again = np.trapezoid(BSpline(knots, other, 3)(fine, nu=2) ** 2, fine)
    assert float(other @ penalty @ other) / again == pytest.approx(ratio, rel=1e-6)


def test_a_curve_is_the_cubic_that_its_knots_are_taken_from_and_goes_on_outside() -> None:
    cubic = np.polynomial.Polynomial([0.3, -0.02, 1e-3, 4e-5])
    values, slopes = cubic(KNOTS), cubic.deriv()(KNOTS)
    curve = SplineCurve(knots_degc=KNOTS.tolist(), values=values.tolist(), slopes=slopes.tolist())
    x = np.linspace(-30.0, 60.0, 301)
    np.testing.assert_allclose(curve.value(x), cubic(x), atol=1e-11)
    np.testing.assert_allclose(curve.slope(x), cubic.deriv()(x), atol=1e-11)


def noisy(sd: float, seed: int = 0) -> Points:
    t = np.repeat(np.linspace(-20.0, 48.0, 15), 30)
    value = np.tanh((t - 18) / 15) + sd * np.random.default_rng(seed).standard_normal(len(t))
    return Points(t, value, np.ones(len(t)), np.repeat(np.arange(15), 30))


def test_noise_is_smoothed_and_shape_is_kept() -> None:
    x, knots = np.linspace(-20.0, 48.0, 500), np.linspace(-20.0, 48.0, 29)
    points = noisy(2.0)
    levels = points.temperature[::30]
    through = CubicSpline(levels, points.value.reshape(15, 30).mean(axis=1))
    assert (
        np.abs(np.diff(fit_spline(points, knots).slope(x))).sum() < 0.2 * np.abs(np.diff(through(x, 1))).sum()
    )
    error = fit_spline(noisy(1e-3), knots).value(x) - np.tanh((x - 18) / 15)
    assert np.sqrt(np.mean(error**2)) < 4e-3


def test_a_straight_line_is_found_exactly() -> None:
    points = noisy(0.0)
    line = Points(points.temperature, 3.0 - 0.2 * points.temperature, points.weight, points.level)
    curve = fit_spline(line, KNOTS)
    x = np.linspace(-20.0, 48.0, 100)
    np.testing.assert_allclose(curve.value(x), 3.0 - 0.2 * x, atol=1e-9)
    np.testing.assert_allclose(curve.slope(x), -0.2, atol=1e-9)


def test_lowered_by_a_constant_the_slope_stays() -> None:
    curve = fit_spline(noisy(0.1), KNOTS)
    np.testing.assert_allclose(curve.minus(0.5).value(10.0), curve.value(10.0) - 0.5)
    assert float(curve.minus(0.5).slope(10.0)) == pytest.approx(float(curve.slope(10.0)))
    # A curve that was in use before is lowered as well.
    assert float(curve.minus(0.5).value(10.0)) == pytest.approx(float(curve.value(10.0)) - 0.5)
