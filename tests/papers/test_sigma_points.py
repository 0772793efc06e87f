"""SR-UKF and SR-RSUKF: check values, identities, limits, endurance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import FloatArray
from imumon.papers.shi_filters import (
    LinearFilter,
    Model,
    SigmaPointFilter,
    take_risk,
)
from tests.papers.plain_filters import CHECK_ROWS, SevenStates, check_signal

CHECK = Model((0.0, 0.0, 0.3, 0.05, 0.02), (0.1, 0.1, 0.01, 1e-4, 1e-4), 0.1)


def known(phi: float, delta: float, noise: float, start: float = 0.1) -> Model:
    """Return a model whose parameters are certain: linear."""
    return Model((0.0, 0.0, phi, delta, 0.0), (start, start, 0.0, 0.0, 0.0), noise)


@pytest.mark.parametrize(
    ("mu", "x", "phi"),
    [
        (0.0, [0.1083817025, 0.0949032929, 0.0762944002, 0.0840572600], 0.0585437837),
        (1.0, [0.1244051170, 0.1030741902, 0.0848816720, 0.0896790833], 0.0453425380),
    ],
)
def test_check_values(mu: float, x: list[float], phi: float) -> None:
    result = SigmaPointFilter(CHECK, mu).process(check_signal())
    np.testing.assert_allclose(result.estimate[CHECK_ROWS], x, rtol=0, atol=5.1e-11)
    assert result.phi[-1] == pytest.approx(phi, abs=5.1e-11)


@pytest.mark.parametrize("mu", [0.0, 1.0])
@pytest.mark.parametrize("phi", [0.3, 0.0, -0.6])
def test_five_states_equal_seven(mu: float, phi: float) -> None:
    model = Model((0.02, 0.0, phi, 0.05, 0.02), CHECK.variance, 0.1)
    twin = SevenStates(np.array(model.mean), np.diag(model.variance), 0.1, np.array([mu, 0, 0, 0, 0]))
    fast = SigmaPointFilter(model, mu)
    z = check_signal()[:600]
    expected = np.array([twin.step(value) for value in z])
    result = fast.process(z)
    np.testing.assert_allclose(result.estimate, expected, rtol=0, atol=3e-13)
    np.testing.assert_allclose(fast.factor @ fast.factor.T, twin.covariance, rtol=0, atol=3e-13)
    np.testing.assert_allclose(fast.mean, twin.mean, rtol=0, atol=3e-13)


def test_a_weight_on_the_central_point_would_change_next_to_nothing() -> None:
    twin = SevenStates(np.array(CHECK.mean), np.diag(CHECK.variance), 0.1, np.zeros(5), beta=2.0)
    z = check_signal()[:600]
    expected = np.array([twin.step(value) for value in z])
    assert np.abs(SigmaPointFilter(CHECK).process(z).estimate - expected).max() < 1e-3


def test_no_risk_is_the_unscented_filter_and_risk_is_not() -> None:
    z = check_signal()
    plain = SigmaPointFilter(CHECK).process(z).estimate
    np.testing.assert_allclose(SigmaPointFilter(CHECK, 1e-13).process(z).estimate, plain, atol=1e-11)
    assert np.abs(SigmaPointFilter(CHECK, 1.0).process(z).estimate - plain).max() > 1e-3


@pytest.mark.parametrize("phi", [0.0, 0.4, -0.5])
def test_a_linear_model_gives_the_plain_kalman_filter(phi: float) -> None:
    z = check_signal()
    linear = LinearFilter(Model((0.0, 0.0, phi, 0.03, 0.0), (0.1, 0.1, 0.0, 0.0, 0.0), 0.1)).process(z)
    result = SigmaPointFilter(known(phi, 0.03, 0.1)).process(z)
    np.testing.assert_allclose(result.estimate, linear.estimate, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.sd**2, linear.sd**2, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(result.phi, phi)


def lasting_gain(mu: float, q: float, noise: float) -> float:
    """Return the gain that a random walk measured with risk settles at."""
    p = noise
    for _ in range(100_000):
        p = 1 / (1 / (p + q) - 2 * mu)
        gain = p / (p + noise)
        p *= 1 - gain
    return gain


@pytest.mark.parametrize(
    ("delta", "share", "gain", "equivalent"),
    [
        (0.01, 0.5, 0.04213, 0.014297),
        (0.01, 0.95, 0.13420, 0.047901),
        (1e-3, 0.5, None, 0.001416),
        (1e-3, 0.95, None, 0.004501),
    ],
)
def test_risk_on_x_is_a_kalman_filter_with_more_process_noise(
    delta: float, share: float, gain: float | None, equivalent: float
) -> None:
    noise = 0.1103
    expected = lasting_gain(share / (2 * noise), delta**2, noise)
    assert math.sqrt(noise * expected**2 / (1 - expected)) == pytest.approx(equivalent, rel=3e-4)
    assert gain is None or expected == pytest.approx(gain, rel=3e-4)
    # A little less, since 0.95 is allowed of R + q, not of R.
    mu = 0.999 * share / (2 * noise)
    settled = lasting_gain(mu, delta**2, noise)
    z = 0.33 * np.random.default_rng(1).standard_normal(20_000)
    risky = SigmaPointFilter(known(0.0, delta, noise), mu).process(z)
    more = noise * settled**2 / (1 - settled)
    same = SigmaPointFilter(known(0.0, math.sqrt(more), noise)).process(z)
    assert np.abs(risky.estimate - same.estimate)[15_000:].max() < 3e-8


def test_a_lasting_risk_breaks_the_filter_just_above_the_limit_and_not_below() -> None:
    """The bound 2μ(R + q) < 1: beyond it each sample is believed as if nothing were known before."""
    z = 0.3 * np.random.default_rng(2).standard_normal(3000)
    model = known(0.0, 0.1, 0.1, start=0.01)
    for factor, breaks in ((0.999, False), (1.001, True)):
        sd = SigmaPointFilter(model, factor / (2 * (0.1 + 0.01))).process(z).sd
        assert (sd[-1] ** 2 > 0.9998 * 0.1) == breaks


def test_a_risk_too_large_for_a_step_is_shrunk() -> None:
    z = np.concatenate([np.zeros(100), np.linspace(0, 500, 500), np.zeros(100)])
    model = Model((0.0, 0.0, 0.0, 0.01, 0.0), (1e-3, 1e-3, 0.1, 0.0, 0.0), 0.1)
    result = SigmaPointFilter(model, 0.9 / 0.2).process(z)
    assert np.isfinite(result.estimate).all()
    assert np.isfinite(result.sd).all()


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_risk_step_equals_the_information_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(5, 5))
    p = root @ root.T + 0.1 * np.eye(5)
    s: FloatArray = np.linalg.cholesky(p).astype(np.float64)
    mu = rng.uniform(0.05, 0.9) / (2 * p[0, 0])
    expected = np.linalg.inv(np.linalg.inv(p) - 2 * np.diag([mu, 0, 0, 0, 0]))
    take_risk(s, mu)
    assert np.array_equal(s, np.tril(s))
    np.testing.assert_allclose(s @ s.T, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


def test_model_nl_does_not_learn_its_deltas() -> None:
    filtered = SigmaPointFilter(CHECK)
    filtered.process(check_signal())
    assert filtered.mean[3:] == pytest.approx([0.05, 0.02], abs=1e-15)
    np.testing.assert_allclose(np.diag(filtered.factor)[3:], 0.01, rtol=1e-12)


def motion(n: int, rng: np.random.Generator) -> FloatArray:
    """Return deg/s: noise, with sines, steps, a ramp, constant input, NaN and infinities."""
    z = 0.33 * rng.standard_normal(n)
    k = np.arange(n)
    tenth = n // 10
    z[tenth : 2 * tenth] += 50 * np.sin(2 * np.pi * 2 * k[:tenth] / 100)
    z[3 * tenth : 4 * tenth] += 20 * ((k[:tenth] // 100) % 2)
    z[5 * tenth : 6 * tenth] += k[:tenth] / 100
    z[7 * tenth : 8 * tenth] = 0.25
    z[8 * tenth + rng.integers(0, tenth, tenth // 10)] = np.nan
    z[8 * tenth + 5] = np.inf
    return z


@pytest.mark.parametrize("share", [0.0, 0.95])
def test_a_long_record_of_noise_steps_gaps_and_motion_leave_no_nan(share: float) -> None:
    z = motion(300_000, np.random.default_rng(3))
    model = Model((0.0, 0.0, 0.0, 1e-2, 0.0), (1e-3, 1e-3, 0.1, 1e-6, 1e-6), 0.1103)
    for limit in (math.inf, 0.9):
        filtered = SigmaPointFilter(model, share / (2 * 0.1104), limit)
        result = filtered.process(z)
        for values in (result.predicted, result.estimate, result.sd, result.phi, result.phi_sd):
            assert np.isfinite(values).all()
        assert (np.abs(result.phi) <= limit).all()
        assert (np.abs(result.phi).max() == limit) == (limit < 1.0)


def test_motion_drives_phi_out_unless_it_is_frozen() -> None:
    rng = np.random.default_rng(4)
    z = 0.33 * rng.standard_normal(20_000)
    moving = slice(5000, 9000)
    z[moving] += 50 * np.sin(2 * np.pi * 2 * np.arange(4000) / 100)
    rest = np.ones(20_000, bool)
    rest[moving] = False
    model = Model((0.0, 0.0, 0.0, 1e-3, 0.0), (1e-3, 1e-3, 0.1, 0.0, 0.0), 0.1103)
    free = SigmaPointFilter(model).process(z)
    assert np.abs(free.phi).max() > 2.0
    frozen = SigmaPointFilter(model).process(np.where(rest, z, np.nan))
    assert np.abs(frozen.phi).max() < 1.0
    assert np.ptp(frozen.phi[moving]) == 0.0
    assert np.ptp(frozen.estimate[moving]) == 0.0
    assert (np.diff(frozen.sd[moving]) > 0.0).all()


def test_a_gap_widens_the_band_as_so_many_steps_of_rest_would() -> None:
    model = known(0.0, 0.01, 0.1)
    z = 0.3 * np.random.default_rng(5).standard_normal(3000)
    whole, cut = SigmaPointFilter(model), SigmaPointFilter(model)
    whole.process(z)
    cut.process(z)
    measured = np.zeros(500, bool)
    measured[-1] = True
    a = whole.process(np.where(measured, 0.1, np.nan))
    b = cut.process(np.array([0.1]), np.array([500.0]))
    assert b.estimate[-1] == pytest.approx(a.estimate[-1], rel=1e-9)
    assert b.sd[-1] == pytest.approx(a.sd[-1], rel=1e-9)
