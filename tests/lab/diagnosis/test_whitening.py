"""The noise of the diagnosis has the covariance that is stated, and flicker has the units of IEEE Std 952."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.allan.covariance import FLOOR_PER_INSTABILITY
from imumon.lab.diagnosis.likelihood import TAUS_S, law, whiten
from tests.bias_noise import INSTABILITY_PER_DECADE


@pytest.mark.parametrize("noise", [(0.0, 0.0), (2.0, 0.0), (0.0, 3.0), (2.0, 3.0)])
def test_it_whitens_as_the_covariance_states(noise: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    flicker, walk = noise
    time_s, white = np.cumsum(rng.uniform(0.5, 400.0, 60)), rng.uniform(0.5, 2.0, 60)
    apart = np.abs(np.subtract.outer(time_s, time_s))[..., np.newaxis]
    later = np.minimum.outer(time_s, time_s)
    v = np.diag(white) + flicker * np.exp(-apart / TAUS_S).mean(axis=-1) + walk * later / 7200.0
    factor, columns = np.linalg.cholesky(v), rng.normal(size=(60, 3))
    whitened, sd = whiten(*law(time_s, noise), white, columns)
    np.testing.assert_allclose(whitened, np.linalg.solve(factor, columns), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(sd, np.diag(factor), rtol=1e-9)


@pytest.mark.parametrize("per_decade", [1, 2])
def test_the_allan_floor_is_that_of_the_bias_instability(per_decade: int) -> None:
    taus = 10.0 ** np.arange(-1.0, 5.01, 1.0 / per_decade)
    m = 300.0
    # Allan variance from the covariance of means: those of a Gauss-Markov process over m s are known.
    a = m / taus
    mean = 2.0 / a**2 * (a - 1.0 + np.exp(-a))
    neighbours = ((1.0 - np.exp(-a)) / a) ** 2
    variance = float((mean - neighbours).sum()) / per_decade / INSTABILITY_PER_DECADE**2
    assert variance == pytest.approx(FLOOR_PER_INSTABILITY**2, rel=0.04)
