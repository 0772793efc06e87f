"""The direction that each hypothesis makes likeliest."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.alignment.posterior import _peaks

AROUND = np.linspace(0.0, 2.0 * np.pi, 1441)
WAVES = np.stack([np.cos(AROUND), np.sin(AROUND), np.cos(2.0 * AROUND), np.sin(2.0 * AROUND)])


@pytest.mark.parametrize("of_second", [0.0, 1e-3, 0.3, 1.0, 1e3])
def test_no_direction_is_likelier_than_the_one_that_is_found(of_second: float) -> None:
    waves = np.random.default_rng(1).normal(size=(500, 4)) * [1e4, 1e4, 1e4 * of_second, 1e4 * of_second]
    c2, s2 = waves[:, 2:].T
    matrix = np.array([[-2.0 * c2, -2.0 * s2], [-2.0 * s2, 2.0 * c2]]).transpose(2, 0, 1)
    angle, height, sharpness = _peaks(waves[:, :2], matrix)
    values = waves @ WAVES
    at = np.stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=-1)
    known = np.isfinite(height)
    np.testing.assert_allclose(height[known], np.sum(at * waves, axis=-1)[known])
    assert (height.max(axis=0) > values.max(axis=1) - 1e-6).all()
    assert known[0].all()
    assert known[1].any() == (of_second > 0.1)
    assert (sharpness[known] > 0.0).all()
