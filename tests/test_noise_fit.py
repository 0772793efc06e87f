"""The fit of the noise model by the likelihood of means at rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from noise_fit import deviance, fit_noise

from tests.bias_noise import covariance, flicker

TAUS = np.array([1.0, 10.0, 100.0, 1e3, 1e4])


def test_the_deviance_is_that_of_the_joint_normal_distribution_of_differences() -> None:
    rng = np.random.default_rng(1)
    model = flicker([2.0], [0.3], TAUS)
    elapsed, white = rng.uniform(0.5, 40.0, 60), rng.uniform(0.5, 2.0, 60)
    elapsed[0] = np.inf
    time_s = np.cumsum(np.append(0.0, elapsed[1:]))
    z = 100.0 + rng.normal(size=60).cumsum()
    missing = rng.random(60) < 0.2
    missing[0] = False
    found, scale = deviance(model, elapsed, np.where(missing, np.nan, z), white)
    at = np.flatnonzero(~missing)
    # The level is free: differences from the first mean have the distribution that is meant.
    joint = covariance(model, time_s[at])[0] + np.diag(white[at])
    differ = np.hstack([-np.ones((len(at) - 1, 1)), np.eye(len(at) - 1)])
    of_differences, d = differ @ joint @ differ.T, differ @ z[at]
    square, determinant = d @ np.linalg.solve(of_differences, d), np.linalg.slogdet(of_differences)[1]
    assert float(scale[0]) == pytest.approx(square / (len(at) - 1), rel=1e-6)
    expected = (len(at) - 1) * math.log(scale[0]) + determinant
    assert float(found[0]) == pytest.approx(expected, rel=1e-6)


def test_models_side_by_side_are_the_same_one_by_one() -> None:
    rng = np.random.default_rng(2)
    z, ones = rng.normal(size=40), np.ones(40)
    together = deviance(flicker([1.0, 3.0], [0.1, 0.0], TAUS), ones, z, ones)[0]
    for k, (instability, walk) in enumerate(((1.0, 0.1), (3.0, 0.0))):
        alone = deviance(flicker([instability], [walk], TAUS), ones, z, ones)[0]
        np.testing.assert_allclose(together[k], alone[0], rtol=1e-6)


@pytest.mark.parametrize(("instability", "walk"), [(0.12, 0.0), (0.0, 0.1)])
def test_a_fit_tells_flicker_from_a_walk(instability: float, walk: float) -> None:
    rng = np.random.default_rng(3)
    n, white = 3600, 1.5
    model = flicker([instability * white], [walk * white], TAUS)
    x = rng.normal(size=len(TAUS) + 1) * np.append(0.0, model.markov_sd)
    kept = np.append(1.0, np.exp(-1.0 / TAUS))
    driving = np.append(model.walk, model.markov_sd * np.sqrt(1.0 - kept[1:] ** 2))
    z = np.empty(n)
    for k in range(n):
        x = kept * x + rng.normal(size=len(x)) * driving
        z[k] = x.sum() + white * rng.normal()
    z[500:700] = np.nan
    elapsed = np.append(np.inf, np.ones(n - 1))
    found = fit_noise(elapsed, z, np.ones(n))
    assert found.white == pytest.approx(white, rel=0.05)
    if walk:
        assert found.walk == pytest.approx(walk * white, rel=0.25)
    else:
        assert found.walk == 0.0
        assert found.instability == pytest.approx(instability * white, rel=0.5)
