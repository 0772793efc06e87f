"""The one noise model: its two forms agree, and its units are those of IEEE Std 952."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.filters.noise import FLOOR_PER_INSTABILITY, BiasNoise, fit_noise, flicker_sd, whiten

TAUS = np.array([1.0, 10.0, 100.0, 1e3, 1e4])


def noise(instability: float, walk: float, taus: FloatArray = TAUS) -> BiasNoise:
    return BiasNoise(taus, flicker_sd(np.array(instability), taus), np.array(walk))


def test_the_innovations_are_those_of_the_joint_normal_distribution() -> None:
    rng = np.random.default_rng(1)
    model = noise(2.0, 0.3)
    elapsed = rng.uniform(0.5, 40.0, 60)
    time_s = np.cumsum(elapsed)
    white = rng.uniform(0.5, 2.0, 60)
    z = 100.0 + rng.normal(size=60).cumsum()
    missing = rng.random(60) < 0.2
    missing[0] = False
    found = whiten(model, elapsed, np.where(missing, np.nan, z), white)
    at = np.flatnonzero(~missing)
    # The level is free: differences from the first mean have the distribution that is meant.
    joint = model.covariance(time_s[at]) + np.diag(white[at])
    differ = np.hstack([-np.ones((len(at) - 1, 1)), np.eye(len(at) - 1)])
    covariance, d = differ @ joint @ differ.T, differ @ z[at]
    square, determinant = d @ np.linalg.solve(covariance, d), np.linalg.slogdet(covariance)[1]
    assert np.nansum(found.innovation**2 / found.variance) == pytest.approx(square, rel=1e-6)
    assert np.nansum(np.log(found.variance)) == pytest.approx(determinant, rel=1e-6)
    deviance, scale = found.deviance
    assert float(scale) == pytest.approx(square / (len(at) - 1), rel=1e-6)
    assert float(deviance) == pytest.approx((len(at) - 1) * math.log(scale) + determinant, rel=1e-6)


def test_models_side_by_side_are_the_same_one_by_one() -> None:
    rng = np.random.default_rng(2)
    both = BiasNoise(TAUS, flicker_sd(np.array([1.0, 3.0]), TAUS), np.array([0.1, 0.0]))
    z, ones = rng.normal(size=40), np.ones(40)
    together = whiten(both, ones, z, ones)
    for k, (instability, walk) in enumerate(((1.0, 0.1), (3.0, 0.0))):
        alone = whiten(noise(instability, walk), ones, z, ones)
        np.testing.assert_allclose(together.innovation[:, k], alone.innovation, rtol=1e-12)


@pytest.mark.parametrize("per_decade", [1, 2])
def test_the_allan_floor_is_that_of_the_bias_instability(per_decade: int) -> None:
    taus = 10.0 ** np.arange(-1.0, 5.01, 1.0 / per_decade)
    model = noise(1.0, 0.0, taus)
    m = 300.0
    # Allan variance from the covariance of means: those of a Gauss-Markov process over m s are known.
    a = m / taus
    mean = 2.0 / a**2 * (a - 1.0 + np.exp(-a))
    neighbours = ((1.0 - np.exp(-a)) / a) ** 2
    variance = float((model.markov_sd**2 * (mean - neighbours)).sum())
    assert math.sqrt(variance) == pytest.approx(FLOOR_PER_INSTABILITY, rel=0.02)


def test_a_new_run_begins_with_a_new_level() -> None:
    model = noise(1.0, 0.1)
    z, ones = np.arange(20.0) ** 2, np.ones(20)
    elapsed = ones.copy()
    elapsed[10] = np.inf
    whole = whiten(model, elapsed, z, ones)
    alone = whiten(model, ones[:10], z[10:], ones[:10])
    np.testing.assert_array_equal(whole.innovation[10:], alone.innovation)


@pytest.mark.parametrize(("instability", "walk"), [(0.12, 0.0), (0.0, 0.1)])
def test_a_fit_tells_flicker_from_a_walk(instability: float, walk: float) -> None:
    rng = np.random.default_rng(3)
    n, white = 3600, 1.5
    model = noise(instability * white, walk * white)
    x = rng.normal(size=len(TAUS) + 1) * np.append(0.0, model.markov_sd)
    z = np.empty(n)
    for k in range(n):
        x = model.decay(1.0) * x + rng.normal(size=len(x)) * np.sqrt(model.growth(1.0))
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
