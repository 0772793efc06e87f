"""Kalman and strong-tracking filter on model L."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.papers.shi_filters import LinearFilter, Model
from tests.papers.plain_filters import CHECK_ROWS, check_signal

CHECK = Model((0.0, 0.0, 0.3, 0.05, 0.02), (0.1, 0.1, 0.0, 0.0, 0.0), 0.1)
Q = 0.05**2 + 0.02**2


@pytest.mark.parametrize(
    ("softening", "x"),
    [
        (np.inf, [0.1083817025, 0.0952083533, 0.0772512974, 0.0967839605]),
        (1.0, [0.1083817025, 0.0902818533, 0.1003312472, 0.0960275247]),
    ],
)
def test_check_values(softening: float, x: list[float]) -> None:
    result = LinearFilter(CHECK, softening).process(check_signal())
    np.testing.assert_allclose(result.estimate[CHECK_ROWS], x, rtol=0, atol=5.1e-11)


def batch(
    z: FloatArray, phi: float, process: float, noise: float, start: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance of x_k given z_1..z_k, each from the joint normal distribution of all."""
    n = len(z)
    # x_k is linear in (x_0, x_-1, w_1 .. w_n): one row each.
    rows = np.zeros((n + 2, n + 2))
    rows[0, 1] = rows[1, 0] = 1.0
    for k in range(n):
        rows[k + 2] = (1 + phi) * rows[k + 1] - phi * rows[k]
        rows[k + 2, k + 2] += 1.0
    prior = rows @ np.diag([start, start, *[process] * n]) @ rows.T
    prior = prior[2:, 2:]
    mean, variance = np.empty(n), np.empty(n)
    for k in range(n):
        seen = prior[: k + 1, : k + 1] + noise * np.eye(k + 1)
        weights = np.linalg.solve(seen, prior[: k + 1, k])
        mean[k] = weights @ z[: k + 1]
        variance[k] = prior[k, k] - weights @ prior[: k + 1, k]
    return mean, variance


@pytest.mark.parametrize("phi", [0.3, 0.0, -0.8])
def test_the_filter_is_the_batch_fit_of_all_readings_so_far(phi: float) -> None:
    z = check_signal()[:80]
    expected, variance = batch(z, phi, Q, 0.1, 0.1)
    result = LinearFilter(Model((0.0, 0.0, phi, 0.05, 0.02), (0.1, 0.1, 0.0, 0.0, 0.0), 0.1)).process(z)
    np.testing.assert_allclose(result.estimate, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.sd**2, variance, rtol=0, atol=1e-10)


def test_innovations_as_small_as_expected_do_not_fade_and_a_jump_is_followed_at_once() -> None:
    quiet = 0.01 * check_signal()
    plain, strong = LinearFilter(CHECK).process(quiet), LinearFilter(CHECK, 1.0).process(quiet)
    np.testing.assert_array_equal(strong.estimate, plain.estimate)
    jumped = quiet + np.where(np.arange(len(quiet)) < 1000, 0.0, 50.0)
    plain, strong = LinearFilter(CHECK).process(jumped), LinearFilter(CHECK, 1.0).process(jumped)
    assert abs(strong.estimate[1000] - 50.0) < 0.1
    assert abs(plain.estimate[1000] - 50.0) > 20.0


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
    for softening in (np.inf, 1.0):
        result = LinearFilter(CHECK, softening).process(z)
        assert np.isfinite(result.estimate).all()
        assert np.isfinite(result.sd).all()
