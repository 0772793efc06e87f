"""The kernel decides as the plain detector does, sample for sample."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.rest.parameters import RestParameters
from tests.data_folder import measured
from tests.estimation.rest.plain import PlainDetector
from tests.estimation.rest.scenes import DEG, block, detect, noise, rolled


def same(samples: SampleBlock, parameters: RestParameters | None = None) -> FloatArray:
    """Compare both detectors; return what they found."""
    plain = PlainDetector(parameters).process(samples)
    found = detect(samples, parameters)
    assert np.array_equal(found, plain)
    return found.astype(np.float64)


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 100.0])
def test_rest_and_turns(rate_hz: float) -> None:
    t, gyro, accel = noise(100.0, rate_hz)
    moving = (t > 40.0) & (t < 43.0)
    gyro[moving] += 0.5 * np.sin(t[moving])[:, np.newaxis]
    gyro[t > 70.0, 2] += 3.0 * DEG
    assert 0.1 < same(block(t, gyro, accel)).mean() < 0.9


def test_slow_tilt_by_noisy_accelerometers() -> None:
    t, gyro, accel = noise(80.0, gyro_sd=5e-3, accel_sd=0.05)
    angle = 0.1 * DEG * np.clip(t - 30.0, 0.0, 30.0)
    assert 0.1 < same(block(t, gyro, rolled(accel, angle))).mean() < 0.9


def test_vibration_knocks_and_a_jump_of_the_bias() -> None:
    t, gyro, accel = noise(150.0)
    accel[:, 2] += np.where(t > 20.0, 0.5 * np.sin(2 * np.pi * 23.17 * t), 0.0)
    since = np.maximum(t - 50.0, 0.0)
    accel[:, 0] += 3.0 * np.exp(-since / 0.2) * np.sin(2 * np.pi * 17.0 * since)
    gyro[t > 70.0, 1] += 0.9 * DEG
    assert 0.2 < same(block(t, gyro, accel), RestParameters(gyro_drift=1e-5, doubt_s=40.0)).mean() < 0.9


def test_coarse_steps_gaps_and_readings_that_are_missing() -> None:
    t, gyro, accel = noise(120.0, gyro_sd=2e-4, accel_sd=4e-3)
    gyro += np.outer(t, [1e-5, 1e-5, -1e-5])
    gyro, accel = np.round(gyro / 1.1e-3) * 1.1e-3, np.round(accel / 0.04) * 0.04
    gyro[::3, 1], accel[1::2] = np.nan, np.nan
    accel[:2000] = np.nan
    keep = (t < 60.0) | (t > 70.0)
    assert 0.5 < same(block(t[keep], gyro[keep], accel[keep])).mean() < 1.0


def test_a_measured_chamber_run() -> None:
    table = np.genfromtxt(measured("chamber-cycle/cooling-heating.csv"), delimiter=",", skip_header=1)
    same(block(table[1400:2600, 0], table[1400:2600, 1:4], table[1400:2600, 4:7]))
