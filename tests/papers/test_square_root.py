"""Square-root update, pull-back and fit against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import FloatArray
from imumon.papers.fir import fit, pull_back, update

SIGMA = 0.0125


def random_state(seed: int, n: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return x, S, h and z of any size."""
    rng = np.random.default_rng(seed)
    s = np.triu(rng.normal(size=(n, n))) * 10.0 ** rng.uniform(-3, 1)
    s[np.diag_indices(n)] = np.abs(np.diag(s)) + 1e-3
    return rng.normal(size=n), s, rng.normal(size=n), float(rng.normal())


def textbook_update(x: FloatArray, p: FloatArray, z: float, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x and P after a measurement (eq. 9)."""
    d = SIGMA**2 + h @ p @ h
    return x + p @ h * (z - h @ x) / d, p - np.outer(p @ h, h @ p) / d


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4))
def test_update_equals_the_textbook_and_stays_triangular(seed: int, n: int) -> None:
    x, s, h, z = random_state(seed, n)
    expected_x, expected_p = textbook_update(x, s @ s.T, z, h)
    scale = np.abs(s @ s.T).max()
    x, s = update(x, s, z, h, SIGMA)
    assert np.array_equal(s, np.triu(s))
    np.testing.assert_allclose(x, expected_x, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(s @ s.T, expected_p, rtol=1e-7, atol=1e-9 * scale)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4))
def test_pull_back_undoes_an_update(seed: int, n: int) -> None:
    x, s, h, z = random_state(seed, n)
    x_before, s_before = x, s
    x, s = update(x, s, z, h, SIGMA)
    assert not np.array_equal(s, s_before)
    pulled = pull_back(x, s, z, h, SIGMA, 0.0)
    assert pulled is not None
    x, s = pulled
    np.testing.assert_allclose(s, s_before, rtol=1e-6, atol=1e-6 * np.abs(s_before).max())
    np.testing.assert_allclose(x, x_before, rtol=1e-6, atol=1e-6)


def test_the_printed_sign_of_the_pull_back_does_not_undo_an_update() -> None:
    x, s, h, z = random_state(5, 3)
    before = s
    x, s = update(x, s, z, h, SIGMA * 30)
    f, d0, gain = s.T @ h, (SIGMA * 30) ** 2, np.zeros(3)
    for j in range(3):
        d1 = d0 - f[j] ** 2
        e = gain[: j + 1].copy()
        gain[: j + 1] += s[: j + 1, j] * f[j]
        s[: j + 1, j] = s[: j + 1, j] * np.sqrt(d0 / d1) - e * f[j] / np.sqrt(d0 * d1)
        d0 = d1
    assert np.abs(s @ s.T - before @ before.T).max() > 1e-2 * np.abs(before @ before.T).max()


def test_pull_back_refuses_what_would_leave_too_little() -> None:
    h = np.array([1.0, 0.0])
    x, s = update(np.zeros(2), 1e6 * np.eye(2), 1.0, h, SIGMA)
    assert pull_back(x, s, 1.0, h, SIGMA, 1e-4) is None


@pytest.mark.parametrize("n", [2, 3])
def test_a_fit_from_scratch_is_least_squares(n: int) -> None:
    rng = np.random.default_rng(n)
    h, z = rng.normal(size=(20, n)), rng.normal(size=20)
    x, s = fit(h, z, SIGMA, 1e9)
    np.testing.assert_allclose(x, np.linalg.lstsq(h, z, rcond=None)[0], rtol=1e-9)
    np.testing.assert_allclose(s @ s.T, np.linalg.inv(h.T @ h) * SIGMA**2, rtol=1e-9)
    assert (np.diag(s) > 0).all()
    assert np.array_equal(s, np.triu(s))
