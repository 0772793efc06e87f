"""How far a gyro wanders at rest, and what follows from it for turns."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.rest.stage import RestDetector
from imumon.estimation.rest.state import LAGS, WIDTHS
from tests.estimation.rest.scenes import DEG, block, noise


def found(t: FloatArray, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at_rest and the hypothesis of a turn about z."""
    result = RestDetector().process(block(t, gyro, accel))
    return result["at_rest"], result["turn_hypothesis_z"]


def test_differences_of_white_noise_have_twice_the_variance_of_a_mean() -> None:
    t, gyro, accel = noise(3000.0, 25.0)
    detector = RestDetector()
    detector.process(block(t, gyro, accel))
    squares = detector._state.wander.mean(1)
    assert squares[:4] == pytest.approx(2.0 * 1e-6 / (25.0 * 0.125 * WIDTHS[:4]), rel=0.4)
    assert np.all(np.diff(LAGS) > 0)


def test_a_step_of_the_vertical_rate_is_a_turn_however_small_until_the_old_mean_is_back() -> None:
    t, gyro, accel = noise(900.0, 25.0, gyro_sd=5e-5)
    gyro[(t > 100.0) & (t < 700.0), 2] += 0.05 * DEG
    rest, hypothesis = found(t, gyro, accel)
    turning = (t > 101.0) & (t < 700.0)
    assert not rest[turning].any()
    assert hypothesis[t > 105.0][:1000] == pytest.approx(0.05 * DEG, rel=0.1)
    assert rest[t > 705.0].all()


def test_a_knock_does_not_end_a_turn_but_the_old_mean_does() -> None:
    t, gyro, accel = noise(600.0, 25.0, gyro_sd=5e-5)
    gyro[(t > 60.0) & (t < 500.0), 2] += 0.06 * DEG
    accel[(t > 200.0) & (t < 200.2)] += 1.0
    rest, _ = found(t, gyro, accel)
    assert not rest[(t > 61.0) & (t < 500.0)].any()
    assert rest[t > 505.0].all()


def test_after_a_knock_the_old_means_are_rest_at_once() -> None:
    t, gyro, accel = noise(60.0, 100.0)
    accel[4000:4003] += 1.0
    rest, _ = found(t, gyro, accel)
    assert not rest[4000:4025].any()
    assert rest[4100:].all()
