"""Mixing and weighing against the formulas of the textbook, written as loops."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.multiple_models import mix, mixture, mode_probabilities, mode_transition

MODES, STATES, KINDS = 3, 2, 4
RNG = np.random.default_rng(7)


def estimates() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means, covariances and probabilities of every mode of some sets."""
    mean = 1e4 + RNG.normal(size=(STATES, KINDS, MODES))
    root = RNG.normal(size=(STATES, STATES, KINDS, MODES))
    mu = RNG.uniform(0.1, 1.0, (KINDS, MODES))
    return mean, np.einsum("ik...,jk...->ij...", root, root), mu / mu.sum()


def test_mixing_is_that_of_the_textbook() -> None:
    mean, covariance, mu = estimates()
    transition = mode_transition(MODES, 0.2)
    found = mix(mean, covariance, mu, transition)
    for kind in range(KINDS):
        for j in range(MODES):
            predicted = sum(transition[i, j] * mu[kind, i] for i in range(MODES))
            omega = [transition[i, j] * mu[kind, i] / predicted for i in range(MODES)]
            x0 = sum(omega[i] * mean[:, kind, i] for i in range(MODES))
            off = [mean[:, kind, i] - x0 for i in range(MODES)]
            p0 = sum(omega[i] * (covariance[:, :, kind, i] + np.outer(off[i], off[i])) for i in range(MODES))
            np.testing.assert_allclose(found.probability[kind, j], predicted)
            np.testing.assert_allclose(found.mean[:, kind, j], x0, rtol=1e-13)
            np.testing.assert_allclose(found.covariance[:, :, kind, j], p0, rtol=1e-9)


def test_a_mode_changes_to_its_neighbours() -> None:
    transition = mode_transition(4, 0.2)
    np.testing.assert_allclose(transition.sum(axis=1), 1.0)
    np.testing.assert_allclose(transition[1], [0.1, 0.8, 0.1, 0.0])
    np.testing.assert_allclose(transition[0], [0.9, 0.1, 0.0, 0.0])


def test_probabilities_follow_the_likelihoods_and_none_is_lost() -> None:
    mu = np.array([0.5, 0.3, 0.2])
    found = mode_probabilities(mu, np.log([0.1, 0.4, 0.2]), least=0.0)
    np.testing.assert_allclose(found, np.array([0.05, 0.12, 0.04]) / 0.21)
    floor = mode_probabilities(mu, np.array([0.0, -1e9, -1e9]), least=1e-12)
    np.testing.assert_allclose(floor, [1.0, 1e-12, 1e-12])


def test_a_mixture_has_the_moments_of_its_parts() -> None:
    mu, mean, variance = np.array([0.2, 0.5, 0.3]), np.array([4.0, 5.0, 7.0]), np.array([1.0, 0.5, 2.0])
    expected = float(mu @ mean)
    found_mean, found_variance = mixture(mu, mean, variance)
    assert abs(found_mean - expected) < 1e-12
    assert abs(found_variance - float(mu @ (variance + (mean - expected) ** 2))) < 1e-12
