"""The two steps and the smoother against the batch solution of the same problem."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from imumon.blocks import FloatArray
from imumon.filters.kalman import Estimate, correct, predict, smooth

F = np.array([[1.0, 0.5], [0.0, 0.9]])
Q = np.diag([0.01, 0.3])
H = np.array([[1.0, 0.2]])
R = np.array([[0.25]])
START = Estimate(np.array([1.0, -2.0]), np.diag([2.0, 3.0]))
N = 12


def _batch() -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of all states before any measurement, stacked."""
    mean, blocks = [START.mean], [START.covariance]
    for _ in range(N - 1):
        mean.append(F @ mean[-1])
        blocks.append(F @ blocks[-1] @ F.T + Q)
    covariance = np.zeros((2 * N, 2 * N))
    for i in range(N):
        for j in range(i, N):
            part = np.linalg.matrix_power(F, j - i) @ blocks[i]
            covariance[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = part
            covariance[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = part.T
    return np.concatenate(mean), covariance


def test_filter_likelihood_and_smoother_are_those_of_the_batch() -> None:
    z = np.random.default_rng(3).normal(size=N)
    mean, covariance = _batch()
    model = np.kron(np.eye(N), H)
    spread = covariance @ model.T
    total = model @ spread + R * np.eye(N)
    gain = spread @ np.linalg.inv(total)
    expected_mean = (mean + gain @ (z - model @ mean)).reshape(N, 2)
    expected_covariance = covariance - gain @ spread.T

    estimate, filtered, predicted, likelihood = START, [], [], 0.0
    for k in range(N):
        if k:
            estimate = predict(estimate, F, Q)
        predicted.append(estimate)
        done = correct(estimate, z[k : k + 1], H, R)
        likelihood += float(done.log_likelihood)
        estimate = done.estimate
        filtered.append(estimate)
    np.testing.assert_allclose(estimate.mean, expected_mean[-1], atol=1e-12)
    np.testing.assert_allclose(estimate.covariance, expected_covariance[-2:, -2:], atol=1e-12)
    assert np.isclose(likelihood, multivariate_normal(model @ mean, total).logpdf(z))

    later = filtered[-1]
    for k in range(N - 2, -1, -1):
        later = smooth(filtered[k], predicted[k + 1], later, F)
        np.testing.assert_allclose(later.mean, expected_mean[k], atol=1e-12)
        np.testing.assert_allclose(
            later.covariance, expected_covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], atol=1e-12
        )


def test_a_bank_is_many_filters() -> None:
    means = np.random.default_rng(4).normal(size=(5, 2))
    covariances = np.stack([START.covariance * (i + 1) for i in range(5)])
    together = correct(
        predict(Estimate(means, covariances), F, Q, np.array([0.1, 0.0])), np.array([0.7]), H, R
    )
    for i in range(5):
        alone = correct(
            predict(Estimate(means[i], covariances[i]), F, Q, np.array([0.1, 0.0])), np.array([0.7]), H, R
        )
        np.testing.assert_allclose(together.estimate.mean[i], alone.estimate.mean, rtol=1e-13)
        np.testing.assert_allclose(together.estimate.covariance[i], alone.estimate.covariance, rtol=1e-12)
        assert np.isclose(together.log_likelihood[i], alone.log_likelihood)
        np.testing.assert_allclose(
            together.standardised[i], alone.innovation / np.sqrt(alone.innovation_covariance[0]), rtol=1e-12
        )
