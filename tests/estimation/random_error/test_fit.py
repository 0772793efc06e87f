"""Noise from a recording."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.estimation.random_error.drift import TO_INSTABILITY
from imumon.estimation.random_error.fit import (
    fit_local_level,
    fit_noise,
    gather,
    local_level_deviance,
)
from tests.estimation.random_error.records import FLICKER, WHITE, flicker, seconds


def at_two_hertz(mean: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return two samples of each second, and one more that ends the last slot."""
    reading = np.repeat(mean, 2)
    return np.arange(len(reading), dtype=np.int64) * 500_000_000, reading


def walk(n: int, ratio: float, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    steps = math.sqrt(ratio) * WHITE * np.cumsum(rng.standard_normal(n))
    return np.asarray(steps + WHITE * rng.standard_normal(n))


def test_the_deviance_is_that_of_the_joint_normal_distribution() -> None:
    z, ratio = walk(40, 1e-2, 1), 3e-2
    k = np.arange(1, 40)
    # Differences from the first mean are free of the unknown level.
    covariance = np.eye(39) + 1.0 + ratio * np.minimum.outer(k, k)
    d = z[1:] - z[0]
    square = d @ np.linalg.solve(covariance, d)
    expected = 39 * math.log(square / 39) + np.linalg.slogdet(covariance)[1]
    deviance, white = local_level_deviance(seconds(z), ratio)
    assert deviance == pytest.approx(expected, abs=1e-9)
    assert white == pytest.approx(square / 39, rel=1e-9)


@pytest.mark.parametrize("ratio", [1e-4, 1e-2])
def test_a_local_level_is_found_within_its_limits(ratio: float) -> None:
    inside = 0
    for seed in range(10):
        fit = fit_local_level(*at_two_hertz(walk(2000, ratio, seed)))
        assert fit.identified
        assert math.sqrt(fit.white) == pytest.approx(WHITE, rel=0.08)
        inside += fit.walk_range[0] <= ratio * WHITE**2 <= fit.walk_range[1]
    assert inside >= 8
    assert fit.delta1(0.01) == pytest.approx(math.sqrt(fit.walk / 100))
    assert fit.noise_variance(0.01) == pytest.approx(100 * fit.white)


def test_a_minute_does_not_show_the_walk_of_an_mti() -> None:
    shown = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        z = flicker(61, rng) + WHITE * rng.standard_normal(61)
        shown += fit_local_level(*at_two_hertz(z)).identified
    assert shown <= 3


def test_flicker_is_told_from_a_walk() -> None:
    rng = np.random.default_rng(2)
    n = 7200
    found = fit_noise(*at_two_hertz(flicker(n, rng) + WHITE * rng.standard_normal(n)))
    assert found.angle_random_walk == pytest.approx(WHITE, rel=0.03)
    assert found.rate_random_walk is None
    assert found.bias_instability == pytest.approx(FLICKER * TO_INSTABILITY, rel=0.35)
    walking = fit_noise(*at_two_hertz(walk(n, 1e-2, 3)))
    assert walking.rate_random_walk == pytest.approx(0.1 * WHITE, rel=0.2)


def test_motion_and_gaps_are_left_out() -> None:
    time_ns, reading = at_two_hertz(walk(2000, 1e-3, 4))
    rest = np.ones(len(reading), bool)
    rest[1000:1600] = False
    spoilt = reading.copy()
    spoilt[1000:1600] += 1.0
    spoilt[2000:2100] = np.nan
    fit = fit_local_level(time_ns, spoilt, rest)
    assert math.sqrt(fit.white) == pytest.approx(WHITE, rel=0.08)
    assert fit.slots < 1700


def test_too_short_a_recording_is_refused() -> None:
    with pytest.raises(ImumonError, match="19 s of readings at rest") as caught:
        gather(*at_two_hertz(walk(20, 1e-3, 5)))
    assert caught.value.reason is Reason.BAD_DATA
