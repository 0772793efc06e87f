from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.smoothing.stage import combine


def test_two_independent_sides_are_weighed_by_their_variances() -> None:
    rng = np.random.default_rng(0)
    n, f_sd, b_sd = 40_000, 2.0, 1.0
    found = combine(f_sd * rng.normal(size=n), np.full(n, f_sd), b_sd * rng.normal(size=n), np.full(n, b_sd))
    assert found.residual == pytest.approx(1.0, abs=0.02)
    assert found.sd[0] == pytest.approx(np.sqrt(4.0 / 5.0), rel=0.03)
    assert found.value.std() == pytest.approx(found.sd[0], rel=0.03)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_errors_in_common_make_sigma_too_small_by_the_root_of_two_at_most(share: float) -> None:
    rng = np.random.default_rng(1)
    n = 40_000
    common = np.sqrt(share) * rng.normal(size=n)
    f, b = (common + np.sqrt(1.0 - share) * rng.normal(size=n) for _ in range(2))
    found = combine(f, np.ones(n), b, np.ones(n))
    assert found.residual == pytest.approx(np.sqrt(1.0 - share), abs=0.02)
    assert found.value.std() == pytest.approx(np.sqrt(1.0 + share) * found.sd[0], rel=0.03)


def test_a_contradiction_widens_the_sigma() -> None:
    n = 100
    found = combine(np.full(n, 3.0), np.ones(n), np.full(n, -3.0), np.ones(n))
    assert found.residual == pytest.approx(6.0 / np.sqrt(2.0))
    assert (found.value == 0.0).all()
    assert found.sd[0] == pytest.approx(3.0)
    forward = np.where(np.arange(n) < 5, 6.0, 0.1)  # at a moment only
    moment = combine(forward, np.ones(n), np.zeros(n), np.ones(n))
    assert moment.sd[0] > 2.9
    assert moment.sd[50] < 1.0


def test_a_contradiction_widens_the_sigma_also_where_there_is_one_side() -> None:
    n, one = 100, np.arange(100) < 10
    backward = np.where(one, np.nan, -3.0)
    found = combine(np.full(n, 3.0), np.ones(n), backward, np.where(one, np.nan, 1.0))
    np.testing.assert_allclose(found.sd[one], found.residual)
    assert found.residual > 4.0


def test_one_side_alone_is_taken_and_none_is_nan() -> None:
    nan = np.nan
    f, f_sd = np.array([nan, 1.0, 2.0, nan]), np.array([nan, 0.5, 0.5, nan])
    b, b_sd = np.array([7.0, nan, 2.2, nan]), np.array([0.3, nan, 0.5, nan])
    found = combine(f, f_sd, b, b_sd)
    np.testing.assert_allclose(found.value, [7.0, 1.0, 2.1, nan])
    np.testing.assert_allclose(found.sd[[0, 1, 3]], [0.3, 0.5, nan])
    nothing = combine(f[:1], f_sd[:1], b[:1], b_sd[:1])
    assert np.isnan(nothing.residual)
    assert nothing.value[0] == 7.0
