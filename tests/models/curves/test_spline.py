"""The smoothing spline: the basis against scipy's, the fit against what it shall find."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicHermiteSpline, CubicSpline

from imumon.models.curves.points import Points
from imumon.models.curves.spline import SplineCurve, b_spline_basis, fit_spline

KNOTS = np.array([-20.0, -11.0, -3.0, 4.0, 20.0, 31.0, 48.0])


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_the_basis_is_that_of_scipy(derivative: int) -> None:
    knots = np.concatenate([[-20.0] * 3, KNOTS, [48.0] * 3])
    x = np.linspace(-20.0, 48.0, 501)
    n = len(knots) - 4
    expected = [BSpline(knots, np.eye(n)[i], 3)(x, nu=derivative) for i in range(n)]
    np.testing.assert_allclose(b_spline_basis(knots, x, derivative), np.transpose(expected), atol=1e-12)


def test_between_knots_the_curve_is_the_cubic_of_its_values_and_slopes() -> None:
    random = np.random.default_rng(0)
    values, slopes = random.standard_normal((2, len(KNOTS)))
    curve = SplineCurve(knots_degc=KNOTS.tolist(), values=values.tolist(), slopes=slopes.tolist())
    x = np.linspace(-20.0, 48.0, 301)
    expected = CubicHermiteSpline(KNOTS, values, slopes)
    np.testing.assert_allclose(curve.value(x), expected(x), atol=1e-12)
    np.testing.assert_allclose(curve.slope(x), expected(x, nu=1), atol=1e-12)


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
