"""The directions that each hypothesis makes likeliest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import i0e

from imumon.estimation.alignment.fit import eliminate
from imumon.estimation.alignment.posterior import peaks

AROUND = np.linspace(0.0, 2.0 * np.pi, 1441)
WAVES = np.stack([np.cos(AROUND), np.sin(AROUND), np.cos(2.0 * AROUND), np.sin(2.0 * AROUND)])


@pytest.mark.parametrize("of_second", [0.0, 1e-3, 0.3, 1.0, 1e3])
def test_no_direction_is_likelier_than_the_one_that_is_found(of_second: float) -> None:
    waves = np.random.default_rng(1).normal(size=(500, 4)) * [1e4, 1e4, 1e4 * of_second, 1e4 * of_second]
    c2, s2 = waves[:, 2:].T
    matrix = np.array([[-2.0 * c2, -2.0 * s2], [-2.0 * s2, 2.0 * c2]]).transpose(2, 0, 1)
    index, angle, height, sharpness = peaks(matrix, waves[:, :2])
    at = np.stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=-1)
    np.testing.assert_allclose(height, np.sum(at * waves[index], axis=-1), atol=1e-6)
    assert set(index.tolist()) == set(range(500))
    highest = np.array([height[index == k].max() for k in range(500)])
    assert (highest > (waves @ WAVES).max(axis=1) - 1e-6).all()
    assert (np.bincount(index).max() == 2) == (of_second > 0.1)
    assert (sharpness > 0.0).all()


@pytest.mark.parametrize("apart_deg", [0.0, 0.5, 2.0, 5.0])
def test_two_peaks_that_merge_are_one_direction_and_not_any(apart_deg: float) -> None:
    # North within a few degrees of the axis of a gyro that may have any bias.
    half, east = np.radians(0.5 * apart_deg), 1e6
    matrix, vector = np.diag([0.0, east]), np.array([0.0, east * np.cos(half)])
    _, angle, height, sharpness = peaks(matrix[None], vector[None])
    around = 0.5 * np.pi + np.linspace(-0.5, 0.5, 200001)
    z = np.stack([np.cos(around), np.sin(around)])
    exact = vector @ z - 0.5 * east * z[1] ** 2
    mass = np.sum(np.exp(exact - exact.max())) * (around[1] - around[0])
    approximate = np.sum(np.exp(height - exact.max()) * 2.0 * np.pi * i0e(sharpness))
    assert 0.4 < approximate / mass < 2.5
    assert np.abs(angle - 0.5 * np.pi).max() < half + 0.02


@pytest.mark.parametrize("apart_deg", [2.0, 5.0, 12.0, 20.0])
@pytest.mark.parametrize("axis_deg", [0.0, 3.0, 7.0])
def test_of_two_peaks_close_together_both_are_found(apart_deg: float, axis_deg: float) -> None:
    # Mirrored in the axis of a gyro that may have any bias.
    half, axis = np.radians(0.5 * apart_deg), np.radians(axis_deg)
    along = np.array([np.cos(axis), np.sin(axis)])
    matrix, vector = 1e6 * np.outer(along, along), 1e6 * np.cos(half) * along
    _, angle, height, _ = peaks(matrix[None], vector[None])
    off = np.angle(np.exp(1j * (angle - axis)))
    np.testing.assert_allclose(np.sort(off), [-half, half], atol=1e-6)
    assert height[0] == pytest.approx(height[1])


def test_an_unknown_with_a_prior_is_integrated_and_one_that_is_zero_is_left_out() -> None:
    rng = np.random.default_rng(1)
    design, sd = rng.normal(size=(9, 4)), np.array([[0.5, 2.0], [0.0, 2.0], [0.0, 0.0]])
    matrix, vector = design.T @ design, design.T @ rng.normal(size=(9, 1))
    given, vectors, log_density = eliminate(matrix, vector, sd)
    # What is left of the covariance of all unknowns, and of their mean.
    covariance = np.linalg.inv(matrix + np.diag([0.0, 0.0, *sd[0] ** -2.0]))
    np.testing.assert_allclose(np.linalg.inv(given[0]), covariance[:2, :2])
    np.testing.assert_allclose(np.linalg.solve(given[0], vectors[0]), (covariance @ vector)[:2])
    np.testing.assert_allclose(given[2], matrix[:2, :2])
    assert log_density[2] == 0.0
    first = [0, 1, 3]
    alone = eliminate(matrix[np.ix_(first, first)], vector[first], np.array([2.0]))
    for found, expected in zip((given[1], vectors[1], log_density[1]), alone, strict=True):
        np.testing.assert_allclose(found, expected)
