"""What is found at rest and what is not, by the stage as the pipeline runs it."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import NO_INT, FloatArray, IntArray, SampleBlock, join
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.estimation.rest.parameters import RestParameters
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.recordings.source import capture_items, run_over
from tests.data_folder import measured
from tests.estimation.rest.scenes import DEG, GRAVITY, block, detect, noise, rolled


def onset(t: FloatArray, rest: IntArray, after: float) -> float:
    """Return the seconds from `after` to the first sample that is not at rest."""
    return float(t[np.flatnonzero((rest == 0) & (t >= after))[0]] - after)


def rest_again(t: FloatArray, rest: IntArray, after: float) -> float:
    """Return the seconds from `after` until rest is found for good."""
    return float(t[np.flatnonzero(rest == 0)[-1] + 1] - after)


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 100.0, 2000.0])
@pytest.mark.parametrize(("gyro_sd", "accel_sd"), [(0.3 * DEG, 0.05), (1e-3, 0.01), (1e-6, 1e-4)])
def test_a_unit_at_rest_with_a_large_bias_is_found_at_rest_and_stays_so(
    rate_hz: float, gyro_sd: float, accel_sd: float
) -> None:
    t, gyro, accel = noise(40.0, rate_hz, gyro_sd, accel_sd)
    rest = detect(block(t, gyro, accel))
    begin = np.flatnonzero(rest)[0]
    assert t[begin] <= max(4.5, 68 / rate_hz)
    assert np.all(rest[begin:] == 1)


def test_warming_up_is_rest() -> None:
    t, gyro, accel = noise(300.0, gyro_sd=3e-5, accel_sd=1e-3)
    gyro += np.outer(t, np.array([70.0, -70.0, 30.0]) * DEG / 3600 * 2 / 60)
    accel += np.outer(t, np.array([1.0, -1.0, 1.0]) * 0.5e-3 * GRAVITY * 2 / 60)
    assert np.all(detect(block(t, gyro, accel))[500:] == 1)


def test_slow_tilt_is_motion_until_it_ends() -> None:
    t, gyro, accel = noise(80.0)
    angle = 0.1 * DEG * (np.clip(t, 20.0, 50.0) - 20.0)
    gyro[(t > 20) & (t < 50), 0] += 0.1 * DEG
    rest = detect(block(t, gyro, rolled(accel, angle)))
    assert onset(t, rest, 20.0) < 3.5
    assert np.all(rest[(t > 23.5) & (t < 50.0)] == 0)
    assert rest_again(t, rest, 50.0) < 9.0


def test_slow_tilt_from_the_start_is_never_rest_though_the_gyros_show_nothing() -> None:
    t, gyro, accel = noise(60.0)
    assert not np.any(detect(block(t, gyro, rolled(accel, 0.1 * DEG * t))))


def test_steady_yaw_is_motion_by_the_change_of_the_gyros_mean() -> None:
    t, gyro, accel = noise(90.0)
    gyro[(t > 20) & (t < 60), 2] += 2.0 * DEG
    rest = detect(block(t, gyro, accel))
    assert onset(t, rest, 20.0) < 0.05
    assert np.all(rest[(t > 20.05) & (t < 60.0)] == 0)
    assert rest_again(t, rest, 60.0) < 3.0


def test_a_bias_that_jumps_is_undecided_for_a_while_and_then_taken() -> None:
    t, gyro, accel = noise(70.0)
    gyro[t > 20, 2] += 0.8 * DEG
    parameters = RestParameters(gyro_drift=1e-5, undecided_s=30.0)
    again = rest_again(t, detect(block(t, gyro, accel), parameters), 20.0)
    assert 30.0 < again < 38.0


def test_turning_by_hand_is_motion_and_rest_is_found_a_second_after_it() -> None:
    t, gyro, accel = noise(60.0)
    turning = (t > 20.0) & (t < 23.0)
    gyro[turning, 2] += 30.0 * DEG * np.sin((t[turning] - 20.0) * np.pi / 3.0)
    rest = detect(block(t, gyro, accel))
    assert onset(t, rest, 20.0) < 0.1
    assert np.all(rest[(t > 20.1) & (t < 22.95)] == 0)
    assert rest_again(t, rest, 23.0) < 1.5


def test_put_down_in_another_attitude_with_another_bias_is_rest_at_once() -> None:
    t, gyro, accel = noise(50.0)
    roll = 90 * DEG * np.clip((t - 20.0) / 3.0, 0.0, 1.0)
    gyro[(t > 20) & (t < 23), 0] += 30.0 * DEG
    gyro[t >= 23.0, 1] += 0.1 * DEG
    assert rest_again(t, detect(block(t, gyro, rolled(accel, roll))), 23.0) < 1.5


def test_a_knock_is_motion_while_it_rings() -> None:
    t, gyro, accel = noise(40.0)
    since = np.maximum(t - 20.0, 0.0)
    accel[:, 2] += 3.0 * np.exp(-since / 0.2) * np.sin(2 * np.pi * 17.0 * since)
    rest = detect(block(t, gyro, accel))
    assert onset(t, rest, 20.0) < 0.05
    assert np.all(rest[(t > 20.02) & (t < 20.6)] == 0)
    assert rest_again(t, rest, 20.0) < 3.2


def test_steady_vibration_of_a_standing_unit_becomes_rest() -> None:
    t, gyro, accel = noise(60.0)
    accel[:, 2] += np.where(t > 20.0, 0.5 * np.sin(2 * np.pi * 23.17 * t), 0.0)
    rest = detect(block(t, gyro, accel))
    assert onset(t, rest, 20.0) < 0.05
    assert 2.5 < rest_again(t, rest, 20.0) < 8.0


def test_held_in_a_hand_from_the_start_is_not_rest() -> None:
    t, gyro, accel = noise(60.0)
    wander = np.cumsum(np.random.default_rng(5).standard_normal(len(t)))
    wander -= np.convolve(wander, np.ones(200) / 200, "same")
    angle = 0.4 * DEG * wander / wander.std()
    gyro[:, 0] += np.gradient(angle, t)
    assert not np.any(detect(block(t, gyro, rolled(accel, angle))))


def test_constant_readings_of_a_coarse_sensor_are_rest_and_so_is_a_step_now_and_then() -> None:
    t, gyro, accel = noise(120.0, gyro_sd=2e-4, accel_sd=4e-3)
    gyro += np.outer(t, [1e-5, 1e-5, -1e-5])
    gyro, accel = np.round(gyro / 1.1e-3) * 1.1e-3, np.round(accel / 0.04) * 0.04
    assert np.all(detect(block(t, gyro, accel))[1000:] == 1)


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_either_sensor_alone_finds_rest_and_motion(sensor: str) -> None:
    t, gyro, accel = noise(40.0)
    moving = (t > 20.0) & (t < 22.0)
    gyro[moving] += 0.3 * np.sin(3.0 * t[moving])[:, np.newaxis]
    accel[moving] += 2.0 * np.sin(3.0 * t[moving])[:, np.newaxis]
    rest = detect(block(t, gyro if sensor == "gyro" else None, accel if sensor == "accel" else None))
    assert np.all(rest[(t > 5.0) & (t < 20.0)] == 1)
    assert np.all(rest[(t > 20.1) & (t < 21.9)] == 0)
    assert rest[-1] == 1


def test_without_sensors_nothing_is_at_rest() -> None:
    assert not np.any(detect(block(np.arange(3000) / 100.0, None, None)))


def test_rows_before_the_first_reading_and_rows_without_readings_do_not_matter() -> None:
    t, gyro, accel = noise(30.0)
    plain = detect(block(t, gyro, accel))
    lead = np.full((700, 3), np.nan)
    led = detect(
        block(np.r_[np.arange(-700, 0) / 100.0, t], np.vstack([lead, gyro]), np.vstack([lead, accel]))
    )
    assert np.array_equal(led[700:], plain)
    twice = block(
        np.repeat(t, 2) + np.tile([0.0, 0.004], len(t)), np.repeat(gyro, 2, 0), np.repeat(accel, 2, 0)
    )
    for name in (*(f"gyro_{a}" for a in "xyz"), *(f"accel_{a}" for a in "xyz")):
        twice[name][1::2] = np.nan
    assert np.array_equal(detect(twice)[::2], plain)


def test_undated_rows_and_endless_silence_are_not_rest() -> None:
    t, gyro, accel = noise(30.0)
    gyro[2000:], accel[2000:] = np.nan, np.nan
    samples = block(t, gyro, accel)
    samples["device_time_ns"][1500:1510] = NO_INT
    rest = detect(samples)
    assert np.all(rest[1000:1500] == 1)
    assert not np.any(rest[1500:1510])
    assert np.all(rest[1510:2200] == 1)
    assert not np.any(rest[2300:])


def test_after_a_gap_and_after_a_restart_rest_is_found_anew() -> None:
    t, gyro, accel = noise(40.0)
    gyro[2000:] += 0.5 * DEG
    samples = block(np.where(t < 20.0, t, t - 20.0), gyro, accel)
    samples["segment"][2000:] = 1
    rest = detect(samples)
    assert not np.any(rest[2000:2090])
    assert np.all(rest[2150:] == 1)
    t, gyro, accel = noise(40.0)
    rest = detect(block(np.where(t < 20.0, t, t + 60.0), gyro, accel))
    assert not np.any(rest[2000:2025])
    assert np.all(rest[2150:] == 1)


def test_a_change_of_rate_is_survived() -> None:
    t, gyro, accel = noise(60.0)
    keep = (t < 20.0) | (np.arange(len(t)) % 10 == 0)
    rest = detect(block(t[keep], gyro[keep], accel[keep]))
    assert np.all(rest[t[keep] > 35.0] == 1)


@pytest.mark.parametrize(
    ("capture", "device"), [("microstrain/stream.bin", "microstrain"), ("aceinna/z1.raw", "openimu")]
)
def test_measured_streams_in_motion_are_never_rest(capture: str, device: str) -> None:
    path = measured(capture)
    pipeline = Pipeline(load_device(device), [RestDetector()])
    samples: SampleBlock = join([*run_over(capture_items(path), pipeline), pipeline.take()])
    assert len(samples) > 2000
    assert not np.any(samples["at_rest"] == 1)


@pytest.mark.long
@pytest.mark.parametrize("thermometer", [True, False])
def test_a_measured_chamber_run_of_a_standing_unit_is_rest(thermometer: bool) -> None:
    table = np.genfromtxt(measured("chamber-cycle/cooling-heating.csv"), delimiter=",", skip_header=1)
    samples = block(table[:, 0], table[:, 1:4], table[:, 4:7])
    if thermometer:
        samples = samples.with_columns({"temperature": table[:, 7].copy()})
    assert detect(samples).mean() > 0.94


def test_the_cause_of_no_rest_is_named() -> None:
    t, gyro, accel = noise(60.0)
    gyro[5000:, 2] += 0.3 * DEG  # a turn from 50 s on
    gyro[3010] += 0.5
    stage, samples, causes = RestDetector(), block(t, gyro, accel), {}
    for start in range(0, len(t), 10):
        added = stage.process(samples.rows(start, start + 10))
        causes[start] = stage.unrest
        assert (stage.unrest == "") == bool(added["at_rest"][-1])
    assert causes[100] == "the noise at rest is not known yet"
    assert causes[2000] == ""
    assert causes[3010] == "a single sample is far from the mean"
    assert causes[5030] == "the mean changes by more than noise and drift"
    assert causes[5900] == "a turn is more likely than a changed bias"
