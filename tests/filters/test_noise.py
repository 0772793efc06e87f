"""The one noise model: its two forms agree, and its units are those of IEEE Std 952."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.filters.noise import (
    BiasNoise,
    NoiseTerms,
    deviance,
    fit_noise,
    flicker_sd,
    whitener,
)

TAUS = np.array([1.0, 10.0, 100.0, 1e3, 1e4])


def side_by_side(instability: list[float], walk: list[float]) -> BiasNoise:
    return BiasNoise(TAUS, flicker_sd(np.array(instability), TAUS), np.array(walk))


@pytest.mark.parametrize(("instability", "walk"), [(0.0, 0.0), (2.0, 0.0), (0.0, 0.3), (2.0, 0.3)])
def test_it_whitens_as_the_covariance_says(instability: float, walk: float) -> None:
    rng = np.random.default_rng(1)
    model, level = side_by_side([instability], [walk]), np.array([4.0])
    elapsed, white = rng.uniform(0.5, 40.0, 60), rng.uniform(0.5, 2.0, 60)
    found = whitener(model, elapsed, white, level)
    time_s = np.cumsum(elapsed) - elapsed[0]
    factor = np.linalg.cholesky(model.covariance(time_s)[0] + level + np.diag(white))
    columns = rng.normal(size=(60, 3))
    np.testing.assert_allclose(found(columns), np.linalg.solve(factor, columns), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(np.log(found.sd).sum(), np.log(np.diag(factor)).sum(), rtol=1e-9)


def test_the_deviance_is_that_of_the_joint_normal_distribution_of_differences() -> None:
    rng = np.random.default_rng(1)
    model = side_by_side([2.0], [0.3])
    elapsed, white = rng.uniform(0.5, 40.0, 60), rng.uniform(0.5, 2.0, 60)
    elapsed[0] = np.inf
    time_s = np.cumsum(np.append(0.0, elapsed[1:]))
    z = 100.0 + rng.normal(size=60).cumsum()
    missing = rng.random(60) < 0.2
    missing[0] = False
    found, scale = deviance(model, elapsed, np.where(missing, np.nan, z), white)
    at = np.flatnonzero(~missing)
    # The level is free: differences from the first mean have the distribution that is meant.
    joint = model.covariance(time_s[at])[0] + np.diag(white[at])
    differ = np.hstack([-np.ones((len(at) - 1, 1)), np.eye(len(at) - 1)])
    covariance, d = differ @ joint @ differ.T, differ @ z[at]
    square, determinant = d @ np.linalg.solve(covariance, d), np.linalg.slogdet(covariance)[1]
    assert float(scale[0]) == pytest.approx(square / (len(at) - 1), rel=1e-6)
    expected = (len(at) - 1) * math.log(scale[0]) + determinant
    assert float(found[0]) == pytest.approx(expected, rel=1e-6)


def test_models_side_by_side_are_the_same_one_by_one() -> None:
    rng = np.random.default_rng(2)
    z, ones = rng.normal(size=40), np.ones(40)
    together = deviance(side_by_side([1.0, 3.0], [0.1, 0.0]), ones, z, ones)[0]
    for k, (instability, walk) in enumerate(((1.0, 0.1), (3.0, 0.0))):
        alone = deviance(side_by_side([instability], [walk]), ones, z, ones)[0]
        np.testing.assert_allclose(together[k], alone[0], rtol=1e-6)


@pytest.mark.parametrize("per_decade", [1, 2])
def test_the_allan_floor_is_that_of_the_bias_instability(per_decade: int) -> None:
    taus = 10.0 ** np.arange(-1.0, 5.01, 1.0 / per_decade)
    model = BiasNoise(taus, flicker_sd(np.array(1.0), taus), np.array(0.0))
    m = 300.0
    # Allan variance from the covariance of means: those of a Gauss-Markov process over m s are known.
    a = m / taus
    mean = 2.0 / a**2 * (a - 1.0 + np.exp(-a))
    neighbours = ((1.0 - np.exp(-a)) / a) ** 2
    variance = float((model.markov_sd**2 * (mean - neighbours)).sum())
    told = NoiseTerms(white=0.0, instability=1.0, walk=0.0).allan_variance(np.array([m]))
    assert variance == pytest.approx(told[0], rel=0.04)


def test_a_new_run_begins_with_a_new_level() -> None:
    model = side_by_side([1.0], [0.1])
    z, ones = np.arange(20.0) ** 2, np.ones(20)
    elapsed = ones.copy()
    elapsed[10] = np.inf
    level = np.array([4.0])
    whole = whitener(model, elapsed, ones, level)(z[:, np.newaxis])
    alone = whitener(model, ones[:10], ones[:10], level)(z[10:, np.newaxis])
    np.testing.assert_array_equal(whole[10:], alone)


@pytest.mark.parametrize(("instability", "walk"), [(0.12, 0.0), (0.0, 0.1)])
def test_a_fit_tells_flicker_from_a_walk(instability: float, walk: float) -> None:
    rng = np.random.default_rng(3)
    n, white = 3600, 1.5
    model = side_by_side([instability * white], [walk * white])
    x = rng.normal(size=len(TAUS) + 1) * np.append(0.0, model.markov_sd)
    z = np.empty(n)
    for k in range(n):
        x = model.decay(1.0) * x + rng.normal(size=len(x)) * np.sqrt(model.growth(1.0)[0])
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
