"""The default filter: true sigma, learning, motion, jumps, and what it is compared with."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.random_error.baselines import ExponentialMean, hold
from imumon.estimation.random_error.drift import (
    TAUS_S,
    TO_INSTABILITY,
    DriftFilter,
    equivalent_walk,
    ratios,
)
from imumon.estimation.random_error.parameters import GyroNoise
from tests.estimation.random_error.records import DEG_PER_HOUR, FLICKER, WHITE, flicker, seconds

TRUE_NOISE = GyroNoise(angle_random_walk=WHITE, bias_instability=FLICKER * TO_INSTABILITY)


def errors(kind: str, noise: GyroNoise | None, n: int = 1800) -> tuple[FloatArray, FloatArray]:
    """Return error and sd in °/h after the first minute over a dozen seeds, (12, n - 60) each."""
    found, sds = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        drift = flicker(n, rng) if kind == "flicker" else 0.011 * WHITE * np.cumsum(rng.standard_normal(n))
        result = DriftFilter(noise).process(seconds(drift + WHITE * rng.standard_normal(n)))
        found.append((result.estimate - drift)[60:] / DEG_PER_HOUR)
        sds.append(result.sd[60:] / DEG_PER_HOUR)
    return np.array(found), np.array(sds)


@pytest.mark.parametrize(
    ("kind", "noise", "low", "high"),
    [
        ("flicker", None, 0.85, 1.25),
        ("flicker", TRUE_NOISE, 0.85, 1.15),
        ("walk", GyroNoise(angle_random_walk=WHITE, rate_random_walk=0.011 * WHITE), 0.85, 1.15),
        # The prior expects flicker, which a pure walk lacks: the band is too wide then, not too narrow.
        ("walk", None, 0.6, 1.05),
    ],
)
def test_sigma_is_true(kind: str, noise: GyroNoise | None, low: float, high: float) -> None:
    error, sd = errors(kind, noise)
    assert low < math.sqrt(np.mean((error / sd) ** 2)) < high


def test_learning_costs_next_to_nothing_and_a_hold_is_worse() -> None:
    learnt, _ = errors("flicker", None)
    told, _ = errors("flicker", TRUE_NOISE)
    assert np.sqrt(np.mean(learnt**2)) < 1.05 * np.sqrt(np.mean(told**2))
    held = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        drift = flicker(1800, rng)
        slots = seconds(drift + WHITE * rng.standard_normal(1800))
        held.append((hold(60.0).process(slots) - drift)[60:] / DEG_PER_HOUR)
    assert np.sqrt(np.mean(np.square(held))) > 1.15 * np.sqrt(np.mean(learnt**2))


def test_one_filter_of_the_bank_equals_dense_matrices() -> None:
    noise = GyroNoise(
        angle_random_walk=WHITE, bias_instability=FLICKER * TO_INSTABILITY, rate_random_walk=0.005 * WHITE
    )
    rng = np.random.default_rng(5)
    z = flicker(300, rng) + WHITE * rng.standard_normal(300)
    z[100:140] = np.nan
    per_decade, walk = ratios(noise)
    a = np.diag([1.0, *np.exp(-1.0 / TAUS_S)])
    q = np.diag([walk, *(per_decade * (1 - np.exp(-2.0 / TAUS_S)))])
    h = np.ones(6)
    # A level of which nothing is known, written as one that may be anywhere.
    x, p = np.zeros(6), np.diag([1e9, *([per_decade] * 5)])
    expected = []
    for k, value in enumerate(z):
        if k:
            x, p = a @ x, a @ p @ a.T + q
        if np.isfinite(value):
            gain = p @ h / (h @ p @ h + 1.0)
            x, p = x + gain * (value - h @ x), p - np.outer(gain, h @ p)
        expected.append((h @ x, WHITE * math.sqrt(h @ p @ h)))
    result = DriftFilter(noise).process(seconds(z))
    estimate, sd = np.array(expected).T
    np.testing.assert_allclose(result.estimate, estimate, rtol=0, atol=1e-6 * WHITE)
    np.testing.assert_allclose(result.sd, sd, rtol=1e-6)


def test_the_estimate_is_held_in_motion_and_the_band_grows() -> None:
    rng = np.random.default_rng(6)
    z = flicker(1200, rng) + WHITE * rng.standard_normal(1200)
    z[600:] = np.nan
    result = DriftFilter().process(seconds(z))
    moving = slice(600, 1200)
    assert np.ptp(result.estimate[moving]) < result.sd[599]
    assert result.sd[1199] > 1.2 * result.sd[599]
    assert (np.diff(result.sd[610:1200]) > 0.0).all()


def test_a_rotation_of_half_a_minute_is_passed_over_and_a_jump_that_stays_is_followed() -> None:
    rng = np.random.default_rng(7)
    drift = flicker(1500, rng)
    z = drift + WHITE * rng.standard_normal(1500)
    z[600:630] += math.radians(0.5)
    z[1000:] += math.radians(0.5)
    filtered = DriftFilter()
    result = filtered.process(seconds(z))
    assert np.abs(result.estimate - drift)[600:1000].max() < 100 * DEG_PER_HOUR
    assert np.abs(result.estimate - drift - math.radians(0.5))[1100:].max() < 100 * DEG_PER_HOUR
    assert filtered.restarts == 1
    assert filtered.passed_over == 90


def test_the_white_noise_is_found_and_a_change_of_it_followed() -> None:
    rng = np.random.default_rng(8)
    z = flicker(1200, rng) + WHITE * rng.standard_normal(1200)
    result = DriftFilter().process(seconds(z))
    assert math.sqrt(result.white[-1]) == pytest.approx(WHITE, rel=0.06)
    louder = np.concatenate([z, 3 * WHITE * rng.standard_normal(20_000)])
    assert math.sqrt(DriftFilter().process(seconds(louder)).white[-1]) == pytest.approx(3 * WHITE, rel=0.1)


def test_a_constant_reading_and_huge_values_leave_no_nan() -> None:
    for values in (np.full(500, 0.01), np.zeros(500), 1e15 * np.random.default_rng(9).standard_normal(500)):
        result = DriftFilter().process(seconds(values))
        assert np.isfinite(result.estimate[10:]).all()
        assert np.isfinite(result.sd[10:]).all()


def test_the_walk_equivalent_to_flicker_has_the_least_error() -> None:
    per_decade = 0.0089
    h = per_decade / math.log(10)

    def error(span: float) -> float:
        return 0.5 / span + h * math.log(span)

    best = 1.0 / math.sqrt(equivalent_walk(per_decade, 0.0))
    assert error(best) < min(error(0.9 * best), error(1.1 * best))
    assert equivalent_walk(0.0, 1e-4) == pytest.approx(1e-4)


def test_the_exponential_mean_is_the_mean_until_its_memory_is_full() -> None:
    z = np.arange(400.0)
    result = ExponentialMean(100.0).process(seconds(z))
    np.testing.assert_allclose(result[:50], np.cumsum(z[:50]) / np.arange(1, 51))
    assert result[-1] == pytest.approx(z[-1] - 100.0, abs=3.0)
    held = hold(60.0).process(seconds(z))
    assert held[59] == held[-1] == pytest.approx(29.5)


def test_given_noise_that_the_data_contradict_is_said() -> None:
    rng = np.random.default_rng(12)
    z = flicker(400, rng) + WHITE * rng.standard_normal(400)
    right, wrong = (
        DriftFilter(TRUE_NOISE),
        DriftFilter(GyroNoise(angle_random_walk=WHITE / 3, bias_instability=FLICKER)),
    )
    right.process(seconds(z))
    assert right.contradiction is None
    wrong.process(seconds(z[:100]))
    assert wrong.contradiction is None
    wrong.process(seconds(z[100:]))
    assert wrong.contradiction == pytest.approx(3.0, rel=0.15)
