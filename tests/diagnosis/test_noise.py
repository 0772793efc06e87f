"""The whitening filter is the inverse Cholesky factor of the covariance that it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.diagnosis.noise import TAUS_S, WALK_S, whitener


@pytest.mark.parametrize(("flicker", "walk"), [(0.0, 0.0), (3.0, 0.0), (0.0, 10.0), (30.0, 3.0)])
def test_it_whitens_as_the_covariance_says(flicker: float, walk: float) -> None:
    random = np.random.default_rng(1)
    time = np.sort(random.uniform(15.0, 3000.0, 60))
    white = random.uniform(1.0, 2.0, 60)
    apart = np.abs(time[:, np.newaxis] - time)
    shape = np.exp(-apart[:, :, np.newaxis] / TAUS_S).mean(axis=2)
    covariance = np.diag(white) + flicker * shape + walk * np.minimum(time[:, np.newaxis], time) / WALK_S
    factor = np.linalg.cholesky(covariance)
    columns = random.standard_normal((60, 3))
    found = whitener(time, white, flicker, walk)
    np.testing.assert_allclose(found(columns), np.linalg.solve(factor, columns), rtol=1e-7, atol=1e-9)
    assert found.log_determinant == pytest.approx(float(np.log(np.diag(factor)).sum()), rel=1e-9)
