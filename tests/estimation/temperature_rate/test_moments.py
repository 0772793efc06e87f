"""Moments of confined and weighed Gaussians against SciPy and numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import log_ndtr
from scipy.stats import norm, truncnorm

from imumon.estimation.temperature_rate.moments import inverse_mills, log_probability, truncated, weigh


@settings(max_examples=100, deadline=None)
@given(st.floats(-30.0, 8.0))
def test_the_density_over_the_mass_far_into_the_tail(x: float) -> None:
    # The first term of the asymptotic series: within 1/x² of the truth.
    assert inverse_mills(x) == pytest.approx(np.exp(norm.logpdf(x) - log_ndtr(x)), rel=2e-3)
    assert log_probability(x) == pytest.approx(log_ndtr(x), rel=1e-4, abs=1e-15)


@settings(max_examples=100, deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(0.01, 10.0))
def test_moments_between_two_edges(a: float, width: float) -> None:
    mean, variance, log_mass = truncated(a, a + width)
    expected_mean, expected_variance = truncnorm.stats(a, a + width, moments="mv")
    mass = norm.cdf(a + width) - norm.cdf(a) if a < 0 else norm.sf(a) - norm.sf(a + width)
    assert mean == pytest.approx(float(expected_mean), abs=1e-3)
    assert variance == pytest.approx(float(expected_variance), rel=0.05, abs=2e-6)
    assert log_mass == pytest.approx(np.log(mass), abs=1e-6)


@pytest.mark.parametrize(("a", "b"), [(-50.0, -40.0), (40.0, 41.0), (-30.0, -29.999), (8.5, 60.0)])
def test_moments_out_of_reach_stay_inside_the_edges(a: float, b: float) -> None:
    mean, variance, log_mass = truncated(a, b)
    assert a < mean < b
    assert 0 < variance < 1
    assert log_mass < -30


@pytest.mark.parametrize(("above", "below", "sd"), [(3.0, 7.0, 0.002), (10.0, 10.0, 0.004), (0.5, 9.5, 0.02)])
def test_weighed_moments_approach_the_integral(above: float, below: float, sd: float) -> None:
    mean, sigma, edge = 0.004, 0.005, 0.0

    def density(t: float) -> float:
        u = (t - edge) / sigma
        return float(np.exp(norm.logpdf(t, mean, sd) + above * log_ndtr(u) + below * log_ndtr(-u)))

    span, points = (-0.06, 0.06), [-0.01, 0.0, 0.01]
    total = quad(density, *span, points=points)[0]
    m = quad(lambda t: t * density(t), *span, points=points)[0] / total
    v = quad(lambda t: (t - m) ** 2 * density(t), *span, points=points)[0] / total
    got_mean, got_variance, log_mass = weigh(mean, sd, edge, edge, above, below, sigma)
    assert got_mean == pytest.approx(m, abs=0.35 * np.sqrt(v))
    assert got_variance == pytest.approx(v, rel=0.4)
    assert log_mass == pytest.approx(np.log(total), abs=0.15)


def test_readings_that_say_nothing_change_nothing() -> None:
    mean, variance, log_mass = weigh(0.0, 0.001, -0.05, 0.05, 10.0, 10.0, 0.005)
    assert mean == pytest.approx(0.0, abs=1e-9)
    assert variance == pytest.approx(1e-6, rel=1e-6)
    assert log_mass == pytest.approx(0.0, abs=1e-9)
