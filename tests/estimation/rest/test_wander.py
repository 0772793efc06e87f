"""How far a gyro wanders at rest, and what follows from it for turns."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import RestDetector
from tests.estimation.rest.scenes import DEG, block, flicker, noise, rolled

TAUS_S = (1.0, 10.0, 100.0, 1000.0)


def found(t: FloatArray, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at_rest and the hypothesis of a turn about z."""
    result = RestDetector().process(block(t, gyro, accel))
    return result["at_rest"], result["turn_hypothesis_z"]


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 12])
def test_a_ramp_of_temperature_leaves_no_hypothesis(seed: int) -> None:
    """The slope bends from 60 to 92 °/h/K: what seemed to be a turn at first goes with the temperature."""
    t, gyro, accel = noise(900.0, 10.0, gyro_sd=2e-4)
    warm = np.clip((t - 100.0) / 30.0, 0.0, 8.0) - np.clip((t - 500.0) / 30.0, 0.0, 8.0)
    gyro += flicker(gyro, 10.0, 2.0 / 3600.0 * DEG, seed, TAUS_S)
    gyro[:, 2] += (60.0 * warm + 2.0 * warm**2) / 3600.0 * DEG
    result = RestDetector().process(block(t, gyro, accel).with_columns({"temperature": 25.0 + warm}))
    hypothesis = result["turn_hypothesis_z"] * 3600.0 / DEG
    assert result["at_rest"][200:].all()
    assert np.sqrt(np.mean(hypothesis[t > 150.0] ** 2)) < 80.0
    assert np.abs(hypothesis[t > 800.0]).max() < 60.0


@pytest.mark.long
def test_a_step_of_the_vertical_rate_is_in_doubt_however_small_until_the_old_mean_is_back() -> None:
    t, gyro, accel = noise(900.0, 25.0, gyro_sd=5e-5)
    gyro[(t > 100.0) & (t < 700.0), 2] += 0.05 * DEG
    rest, hypothesis = found(t, gyro, accel)
    turning = (t > 101.0) & (t < 700.0)
    assert ((rest == 0) | (hypothesis > 0.02 * DEG))[turning & (t > 103.0)].all()
    assert rest[t > 705.0].all()


@pytest.mark.parametrize("seed", [3, 5])
def test_a_turn_that_begins_slowly_on_a_coarse_gyro_is_no_creep(seed: int) -> None:
    t, gyro, accel = noise(420.0, 25.0, gyro_sd=0.025 * DEG, seed=seed)
    gyro += flicker(gyro, 25.0, 25.0 / 3600.0 * DEG, seed, TAUS_S)
    gyro[:, 2] += 0.5 * DEG * np.clip((t - 150.0) / 120.0, 0.0, 1.0)
    gyro = 0.06 * DEG * np.round(gyro / (0.06 * DEG))
    rest, _ = found(t, gyro, accel)
    assert rest[t < 150.0].mean() > 0.9
    assert not rest[t > 190.0].any()  # by then it is 0.17 °/s, ten times the wander


@pytest.mark.long
def test_a_turn_that_begins_slowly_on_a_coarse_gyro_is_detected_as_soon_as_noise_allows() -> None:
    rested = []
    for seed in range(20, 24):
        t, gyro, accel = noise(180.0, 25.0, gyro_sd=0.025 * DEG, seed=seed)
        gyro += flicker(gyro, 25.0, 10.0 / 3600.0 * DEG, seed, TAUS_S)
        gyro[:, 2] += 0.5 * DEG * np.clip((t - 150.0) / 120.0, 0.0, 1.0)
        rest, _ = found(t, 0.06 * DEG * np.round(gyro / (0.06 * DEG)), accel)
        rested.append(rest[t > 150.0].sum() / 25.0)
    assert np.mean(rested) < 26.0


@pytest.mark.parametrize("follows", [True, False])
def test_a_tilt_that_begins_slowly_is_detected_where_gravity_follows_it(follows: bool) -> None:
    """Gyros and gravity take 7 s; that the gyros creep and nothing tilts takes 17 s."""
    for seed in range(20, 23):
        t, gyro, accel = noise(180.0, 25.0, gyro_sd=4e-6, accel_sd=2.5e-3, seed=seed)
        gyro += flicker(gyro, 25.0, 0.1 / 3600.0 * DEG, seed, TAUS_S)
        rate = 0.5 * DEG * np.clip((t - 150.0) / 120.0, 0.0, 1.0)
        gyro[:, 0] += rate
        rest, _ = found(t, gyro, rolled(accel, np.cumsum(rate) / 25.0) if follows else accel)
        assert rest[t < 150.0].mean() > 0.9
        assert not rest[t > 158.0].any() if follows else rest[t > 167.0].all()


def test_a_knock_does_not_end_a_turn_but_the_old_mean_does() -> None:
    t, gyro, accel = noise(600.0, 25.0, gyro_sd=5e-5)
    gyro[(t > 60.0) & (t < 500.0), 2] += 0.06 * DEG
    accel[(t > 200.0) & (t < 200.2)] += 1.0
    rest, hypothesis = found(t, gyro, accel)
    assert ((rest == 0) | (hypothesis > 0.02 * DEG))[(t > 63.0) & (t < 500.0)].all()
    assert rest[t > 505.0].all()


def test_after_a_knock_the_old_means_are_rest_at_once() -> None:
    t, gyro, accel = noise(60.0, 100.0)
    accel[4000:4003] += 1.0
    rest, _ = found(t, gyro, accel)
    assert not rest[4000:4025].any()
    assert rest[4175:].all()
