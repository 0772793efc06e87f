"""The one noise model: its two forms agree, and its units are those of IEEE Std 952."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.allan.covariance import FLOOR_PER_INSTABILITY
from imumon.blocks import FloatArray
from imumon.lab.diagnosis.whitening import whitener
from tests.bias_noise import BiasNoise, covariance, flicker

TAUS = np.array([1.0, 10.0, 100.0, 1e3, 1e4])


def parameters(model: BiasNoise) -> tuple[FloatArray, FloatArray, FloatArray]:
    return model.taus_s, model.markov_sd, model.walk


@pytest.mark.parametrize(("instability", "walk"), [(0.0, 0.0), (2.0, 0.0), (0.0, 0.3), (2.0, 0.3)])
def test_it_whitens_as_the_covariance_says(instability: float, walk: float) -> None:
    rng = np.random.default_rng(1)
    model, level = flicker([instability], [walk], TAUS), np.array([4.0])
    elapsed, white = rng.uniform(0.5, 40.0, 60), rng.uniform(0.5, 2.0, 60)
    found = whitener(*parameters(model), elapsed, white, level)
    time_s = np.cumsum(elapsed) - elapsed[0]
    factor = np.linalg.cholesky(covariance(model, time_s)[0] + level + np.diag(white))
    columns = rng.normal(size=(60, 3))
    np.testing.assert_allclose(found(columns), np.linalg.solve(factor, columns), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(np.log(found.sd).sum(), np.log(np.diag(factor)).sum(), rtol=1e-9)


@pytest.mark.parametrize("per_decade", [1, 2])
def test_the_allan_floor_is_that_of_the_bias_instability(per_decade: int) -> None:
    taus = 10.0 ** np.arange(-1.0, 5.01, 1.0 / per_decade)
    model = flicker([1.0], [0.0], taus)
    m = 300.0
    # Allan variance from the covariance of means: those of a Gauss-Markov process over m s are known.
    a = m / taus
    mean = 2.0 / a**2 * (a - 1.0 + np.exp(-a))
    neighbours = ((1.0 - np.exp(-a)) / a) ** 2
    variance = float((model.markov_sd**2 * (mean - neighbours)).sum())
    assert variance == pytest.approx(FLOOR_PER_INSTABILITY**2, rel=0.04)


def test_a_new_run_begins_with_a_new_level() -> None:
    model = flicker([1.0], [0.1], TAUS)
    z, ones = np.arange(20.0) ** 2, np.ones(20)
    elapsed = ones.copy()
    elapsed[10] = np.inf
    level = np.array([4.0])
    whole = whitener(*parameters(model), elapsed, ones, level)(z[:, np.newaxis])
    alone = whitener(*parameters(model), ones[:10], ones[:10], level)(z[10:, np.newaxis])
    np.testing.assert_array_equal(whole[10:], alone)
