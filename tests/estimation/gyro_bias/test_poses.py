"""Rests in different poses: sensitivity to the specific force, turns, and a bias that jumps."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from tests.estimation.gyro_bias.records import (
    ARW,
    DPH,
    GIVEN,
    GRAVITY,
    LATITUDE_DEG,
    VRW,
    Truth,
    bias_noise,
    local_earth,
    record,
    vector,
    with_rest,
)
from tests.estimation.rest.scenes import block as scene

RATE_HZ = 50.0
TRUTH = Truth(rate_hz=RATE_HZ, low_pass_hz=None)


def in_the_hand(
    per_g_deg: float, seed: int, rests: int = 8
) -> tuple[SampleBlock, FloatArray, FloatArray, FloatArray]:
    """Return rests of 12 s in any pose with 8 s of turning between, the bias, earth rate and rest."""
    rng = np.random.default_rng(seed)
    dt = 1.0 / RATE_HZ
    pose, poses, still = Rotation.identity(), [], []
    for k in range(rests):
        n, m = round((60.0 if k == 0 else 12.0) * RATE_HZ), round(8.0 * RATE_HZ)
        axis, s = rng.normal(size=3), np.arange(1, m + 1) / m
        angle = rng.uniform(0.3, math.pi) * (s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi))
        turning = pose * Rotation.from_rotvec(np.outer(angle, axis / np.linalg.norm(axis)))
        poses += [np.tile(pose.as_quat(), (n, 1)), turning.as_quat()]
        still += [np.ones(n, np.int64), np.zeros(m, np.int64)]
        pose = turning[-1]
    turns = Rotation.from_quat(np.concatenate(poses))
    rate = np.vstack([np.zeros(3), (turns[:-1].inv() * turns[1:]).as_rotvec() / dt])
    force = turns.inv().apply([0.0, 0.0, -GRAVITY])
    earth = turns.inv().apply(local_earth())
    matrix = rng.uniform(-1.0, 1.0, (3, 3))
    matrix *= math.radians(per_g_deg) / GRAVITY / np.abs(matrix).max()
    n = len(force)
    bias = bias_noise(TRUTH, rng, n) + 0.01 * rng.normal(size=3) + force @ matrix.T
    noise = rng.normal(size=(2, n, 3)) / math.sqrt(dt)
    gyro, accel = rate + earth + bias + ARW * noise[0], force + VRW * noise[1]
    columns = {
        "device_time_ns": np.arange(n) * round(1e9 * dt),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.concatenate(still),
        **{f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")},
        **{f"accel_{axis}": accel[:, j] for j, axis in enumerate("xyz")},
    }
    return SampleBlock(columns), bias, earth, columns["at_rest"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("per_g_deg", "place_known"), [(0.0, True), (0.01, False), (0.1, True), (0.1, False)]
)
def test_the_sigma_holds_in_the_hand(per_g_deg: float, place_known: bool) -> None:
    at_ends, before_rests, in_motion, late = [], [], [], []
    for seed in range(4):
        block, bias, earth, rest = in_the_hand(per_g_deg, seed)
        stage = (
            RestAndBias(GIVEN, latitude_deg=LATITUDE_DEG, heading_deg=0.0)
            if place_known
            else RestAndBias(GIVEN)
        )
        added = stage.process(block)
        error = vector(added) - bias - (0.0 if place_known else earth)
        z = error / vector(added, "gyro_bias_sd")
        ends, begins = (np.flatnonzero(np.diff(rest) == change) for change in (-1, 1))
        at_ends.append(z[ends[1:]])
        before_rests.append(z[begins])
        in_motion.append(z[(rest == 0) & (np.arange(len(z)) > 60.0 * RATE_HZ)])
        late.append(error[ends[4:]] / DPH)
    for found in (np.concatenate(part) for part in (at_ends, before_rests, in_motion)):
        assert np.sqrt(np.mean(found**2)) < 1.8
        assert np.abs(found).max() < 7.0
    # 60 ARW/sqrt(t) of a rest is 4.8 deg/h.
    assert np.sqrt(np.mean(np.concatenate(late) ** 2)) < 9.0


@pytest.mark.parametrize("gap_s", [0.0, 5.0])
def test_a_jump_makes_the_sigma_wide_at_once_and_is_believed_in_the_end(gap_s: float) -> None:
    block, bias = record(TRUTH, 600.0, 3)
    t = np.arange(len(block)) / RATE_HZ
    jump = np.where(t > 120.0, math.radians(0.3), 0.0)
    kept = (t < 120.0 - gap_s) | (t > 120.0)
    columns = block.with_columns({"gyro_x": block["gyro_x"] + jump}).columns
    stage = RestAndBias(GIVEN)
    added = stage.process(SampleBlock({name: values[kept] for name, values in columns.items()}))
    error = added["gyro_bias_x"] - (bias[:, 0] + jump)[kept]
    z = np.abs(error / added["gyro_bias_sd_x"])
    assert np.sum(z > 5.0) / RATE_HZ < 2.0
    assert abs(error[-1]) < 10.0 * DPH
    assert any("jumped" in text for text in stage.notices())


@pytest.mark.parametrize("seed", [3, 5])
def test_a_jump_in_the_first_minute_is_one_when_that_is_filtered_again(seed: int) -> None:
    block, bias = record(Truth(rate_hz=10.0, low_pass_hz=None), 45.0, seed)
    t = np.arange(len(block)) / 10.0
    jump = np.where(t > 3.0, math.radians(1.0), 0.0)
    jumped = block.with_columns({"gyro_x": block["gyro_x"] + jump})
    added = RestAndBias(GIVEN).process(with_rest(jumped, t < 40.0))
    z = (added["gyro_bias_x"] - bias[:, 0] - jump) / added["gyro_bias_sd_x"]
    assert np.abs(z[t > 10.0]).max() < 5.0


@pytest.mark.parametrize("size_deg", [0.1, 0.3, 2.0])
def test_a_jump_without_a_rest_detector_is_in_the_sigma_and_learned_after_a_minute(size_deg: float) -> None:
    block, bias = record(TRUTH, 240.0, 3)
    t = np.arange(len(block)) / RATE_HZ
    jump = np.where(t > 120.25, math.radians(size_deg), 0.0)
    added = RestAndBias(GIVEN).process(block.with_columns({"gyro_x": block["gyro_x"] + jump}))
    error = added["gyro_bias_x"] - bias[:, 0] - jump
    assert np.sum(np.abs(error / added["gyro_bias_sd_x"]) > 5.0) / RATE_HZ < 2.0
    assert np.abs(error[t > 183.0]).max() < 40.0 * DPH
    assert added["gyro_bias_sd_x"][t > 185.0].max() < 200.0 * DPH


@pytest.mark.parametrize("axis", [0, 2])
def test_a_turn_that_is_given_as_rest_is_in_the_sigma_and_no_jump(axis: int) -> None:
    block, bias = record(TRUTH, 240.0, 3)
    t = np.arange(len(block)) / RATE_HZ
    rate = np.zeros((len(block), 3))
    rate[:, axis] = np.where((t > 120.0) & (t < 160.0), math.radians(0.3), 0.0)
    pose = Rotation.from_rotvec(np.cumsum(rate, axis=0) / RATE_HZ)
    force = pose.inv().apply(vector(block, "accel"))
    columns = {f"gyro_{name}": block[f"gyro_{name}"] + rate[:, j] for j, name in enumerate("xyz")}
    columns |= {f"accel_{name}": force[:, j] for j, name in enumerate("xyz")}
    stage = RestAndBias(GIVEN)
    added = stage.process(block.with_columns({**columns, "at_rest": np.ones(len(block), np.int64)}))
    turning = (t > 125.0) & (t < 159.0)
    z = (vector(added, "gyro_bias") - bias) / vector(added, "gyro_bias_sd")
    assert np.abs(z[turning, axis]).max() < 3.0
    assert np.abs(vector(added, "gyro_bias") - bias)[t > 165.0, axis].max() < 60.0 * DPH
    assert not any("jumped" in text for text in stage.notices())


def test_a_turn_of_half_a_minute_that_nobody_noticed_is_not_learned() -> None:
    block, bias = record(TRUTH, 300.0, 4)
    t = np.arange(len(block)) / RATE_HZ
    turn = np.where((t > 120.0) & (t < 150.0), math.radians(0.5), 0.0)
    added = RestAndBias(GIVEN).process(block.with_columns({"gyro_z": block["gyro_z"] + turn}))
    z = (added["gyro_bias_z"] - bias[:, 2]) / added["gyro_bias_sd_z"]
    assert np.abs(z[t > 5.0]).max() < 5.0
    assert abs(added["gyro_bias_z"][-1] - bias[-1, 2]) < 8.0 * DPH


@pytest.mark.parametrize(("slope_dph", "largest_dph", "z"), [(150.0, 70.0, 1.2), (500.0, 150.0, 1.7)])
def test_a_steep_slope_without_a_model_is_followed(slope_dph: float, largest_dph: float, z: float) -> None:
    t = np.arange(9000) / 10.0
    temperature = 25.0 + np.interp(t, [0.0, 200.0, 500.0, 900.0], [0.0, 0.0, 10.0, 10.0])
    thermal = np.column_stack([slope_dph * temperature * DPH] * 3)
    block, bias = record(Truth(rate_hz=10.0), 900.0, 1, thermal, temperature=temperature)
    added = RestAndBias(GIVEN, mode="learned").process(block)
    error = (vector(added, "gyro_random_error") - bias)[600:]
    assert np.sqrt(np.mean((error / vector(added, "gyro_random_error_sd")[600:]) ** 2)) < z
    assert np.abs(error).max() < largest_dph * DPH


def test_it_goes_on_from_a_snapshot() -> None:
    block, _, _, _ = in_the_hand(0.05, 9, rests=4)
    half = round(85.0 * RATE_HZ)
    stage = RestAndBias(GIVEN, mode="learned")
    stage.process(block.rows(0, half))
    saved, rest = pickle.dumps(stage), block.rows(half, len(block))
    expected = vector(stage.process(rest))
    np.testing.assert_array_equal(vector(pickle.loads(saved).process(rest)), expected)


def test_a_second_that_contradicts_the_bias_is_in_doubt_until_another_confirms_it() -> None:
    """As of a fan that starts: what its vibration does is not white."""
    block, bias = record(TRUTH, 90.0, 6)
    t = np.arange(len(block)) / RATE_HZ
    off = np.where((t > 60.0) & (t < 61.0), math.radians(0.1), 0.0)
    added = RestAndBias(GIVEN).process(block.with_columns({"gyro_x": block["gyro_x"] + off}))
    z = (added["gyro_bias_x"] - bias[:, 0]) / added["gyro_bias_sd_x"]
    assert np.abs(z[t > 10.0]).max() < 5.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_north_is_kept_through_steady_turns_though_the_gyros_feel_gravity(seed: int) -> None:
    """Turns of 90° within 2 s, also about the vertical, then 300 s in which the unit is only shaken."""
    rng, rate_hz, still = np.random.default_rng(seed), 25.0, np.zeros((500, 3))
    turns = [np.tile(np.pi / 4.0 * np.eye(3)[axis], (50, 1)) for axis in (0, 0, 1, 1, 0, 0, 1, 1, 2, 2) * 2]
    rests = [part for turn in turns for part in (still, turn)]
    rate = np.concatenate([*rests, still, np.zeros((7500, 3)), still])
    pose, poses = Rotation.identity(), []
    for turn in Rotation.from_rotvec(rate / rate_hz):
        pose = pose * turn
        poses.append(pose.as_matrix().T)
    t, body = np.arange(len(rate)) / rate_hz, np.array(poses)
    force = body @ np.array([0.0, 0.0, -GRAVITY])
    bias = math.radians(0.05) / GRAVITY * force + np.array([30.0, -20.0, 10.0]) * DPH
    white = math.radians(0.02) / 60.0 * math.sqrt(rate_hz) * rng.standard_normal(rate.shape)
    accel = force + 1e-3 * rng.standard_normal(rate.shape)
    accel[-8000:-500] += np.sin(18.0 * t[-8000:-500, np.newaxis])
    samples = scene(t, rate + body @ local_earth() + bias + white, accel)
    added = RestAndBias(latitude_deg=LATITUDE_DEG, heading_deg=0.0).process(samples)
    error = (vector(added) - bias)[-1]
    assert np.abs(error).max() < 1.5 * DPH
    assert np.abs(error / vector(added, "gyro_bias_sd")[-1]).max() < 3.0


def test_north_turns_also_in_the_slot_in_which_the_noise_of_a_turn_is_found() -> None:
    turn_s, rate, random = 5.0, math.radians(150.0), np.random.default_rng(0)
    t = np.arange(round(205.0 * RATE_HZ)) / RATE_HZ
    yaw = rate * np.clip(t - 80.0, 0.0, turn_s)
    turning = (t >= 80.0) & (t < 80.0 + turn_s)
    north, _, down = local_earth()
    gyro = np.column_stack([north * np.cos(yaw), -north * np.sin(yaw), down + rate * turning])
    gyro += np.where(turning, 5e-4, 2e-5)[:, np.newaxis] * random.standard_normal((len(t), 3))
    accel = 1e-3 * random.standard_normal((len(t), 3)) + [0.0, 0.0, -GRAVITY]
    added = RestAndBias(latitude_deg=LATITUDE_DEG, heading_deg=0.0).process(scene(t, gyro, accel))
    assert np.abs(vector(added)[-1]).max() < 3.0 * DPH
