"""The one noise model: its two forms agree, and its units are those of IEEE Std 952."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.allan.covariance import FLOOR_PER_INSTABILITY
from imumon.lab.diagnosis.likelihood import whiten
from tests.bias_noise import covariance, flicker

TAUS = np.array([1.0, 10.0, 100.0, 1e3, 1e4])


@pytest.mark.parametrize(("instability", "walk"), [(0.0, 0.0), (2.0, 0.0), (0.0, 0.3), (2.0, 0.3)])
def test_it_whitens_as_the_covariance_states(instability: float, walk: float) -> None:
    rng = np.random.default_rng(1)
    model = flicker([instability], [walk], TAUS)
    time_s, white = np.cumsum(rng.uniform(0.5, 40.0, 60)), rng.uniform(0.5, 2.0, 60)
    factor = np.linalg.cholesky(covariance(model, time_s)[0] + np.diag(white))
    columns = rng.normal(size=(60, 3))
    noise = np.array([model.taus_s, model.markov_sd[0]]), float(model.walk[0])
    whitened, sd = whiten(columns, time_s, white, *noise)
    np.testing.assert_allclose(whitened, np.linalg.solve(factor, columns), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(sd, np.diag(factor), rtol=1e-9)


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
