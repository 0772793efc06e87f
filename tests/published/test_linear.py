"""Kalman and strong-tracking filter on model L."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.published.linear import LinearFilter, ModelL
from tests.published.plain_filters import CHECK_ROWS, check_signal, plain_kalman

CHECK = ModelL(0.3, 0.05, 0.02, (0.0, 0.0), (0.1, 0.1), 0.1)
Q = 0.05**2 + 0.02**2


@pytest.mark.parametrize(
    ("softening", "x"),
    [
        (None, [0.1083817025, 0.0952083533, 0.0772512974, 0.0967839605]),
        (1.0, [0.1083817025, 0.0902818533, 0.1003312472, 0.0960275247]),
    ],
)
def test_check_values(softening: float | None, x: list[float]) -> None:
    result = LinearFilter(CHECK, softening).process(check_signal())
    np.testing.assert_allclose(result.estimate[CHECK_ROWS], x, rtol=0, atol=5.1e-11)


def test_the_largest_fading_factor_of_the_check_signal() -> None:
    filtered = LinearFilter(CHECK, 1.0)
    filtered.process(check_signal())
    assert filtered.largest_fading == pytest.approx(3.3480452125, abs=5.1e-11)


@pytest.mark.parametrize("phi", [0.3, 0.0, -0.8])
@pytest.mark.parametrize("softening", [None, 1.0, 3.0])
def test_the_square_root_form_equals_the_plain_one(phi: float, softening: float | None) -> None:
    z = check_signal()
    expected, variance, largest = plain_kalman(z, phi, Q, 0.1, 0.1, softening)
    filtered = LinearFilter(ModelL(phi, 0.05, 0.02, (0.0, 0.0), (0.1, 0.1), 0.1), softening)
    result = filtered.process(z)
    np.testing.assert_allclose(result.estimate, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.sd**2, variance, rtol=0, atol=1e-9)
    assert filtered.largest_fading == pytest.approx(largest, abs=1e-9)


def test_missing_samples_are_predicted_and_leave_no_nan() -> None:
    z = check_signal()
    z[500:600] = np.nan
    result = LinearFilter(CHECK, 1.0).process(z)
    assert np.isfinite(result.estimate).all()
    assert (np.diff(result.sd[500:600]) >= 0).all()


def test_a_million_samples_with_steps_and_constant_input_leave_no_nan() -> None:
    z = 0.3 * np.random.default_rng(1).standard_normal(1_000_000)
    z[200_000:300_000] = 0.0
    z[400_000:500_000] += 20.0 * ((np.arange(100_000) // 100) % 2)
    for softening in (None, 1.0):
        result = LinearFilter(CHECK, softening).process(z)
        assert np.isfinite(result.estimate).all()
        assert np.isfinite(result.sd).all()
