"""A known place: what the earth rate adds to the sigma where pose or north are lost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest import odds
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.slots import Measurement
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY, earth_rate_along
from tests.estimation.gyro_bias.records import DPH, GIVEN, LATITUDE_DEG, local_earth, vector, with_rest
from tests.estimation.gyro_bias.test_poses import in_the_hand
from tests.estimation.rest.scenes import block as scene


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_without_accelerometers_leaves_the_earth_rate_in_the_sigma(seed: int) -> None:
    block, bias, _, rest = in_the_hand(0.0, seed, rests=3)
    turned = np.flatnonzero(np.diff(rest) < 0)[0]
    silent = {
        f"accel_{axis}": np.where(np.arange(len(rest)) < turned, block[f"accel_{axis}"], np.nan)
        for axis in "xyz"
    }
    stage = RestAndBias(GIVEN, latitude_deg=LATITUDE_DEG, heading_deg=0.0)
    result = stage.process(block.with_columns(silent))
    sigma, last = vector(result, "gyro_bias_sd")[-1], slice(-100, None)
    assert (np.abs(vector(result, "gyro_bias")[last] - bias[last]).max(0) < 4.0 * sigma).all()
    assert (sigma > 0.5 * EARTH_RATE).all()


def test_a_pose_that_comes_back_has_its_earth_rate_again() -> None:
    block, bias, _, rest = in_the_hand(0.0, 1, rests=5)
    turns, ends = np.flatnonzero(np.diff(rest) < 0), np.flatnonzero(np.diff(rest) > 0)
    at = np.arange(len(rest))
    silent = {
        f"accel_{axis}": np.where((at > turns[1]) & (at < turns[2]), np.nan, block[f"accel_{axis}"])
        for axis in "xyz"
    }
    restarted = {"segment": np.where(at < ends[3], 0, 1)}
    given = block.with_columns(silent)
    for parts in (given, given.with_columns(restarted)):
        result = RestAndBias(GIVEN, latitude_deg=LATITUDE_DEG, heading_deg=0.0).process(parts)
        z = (vector(result, "gyro_bias") - bias) / vector(result, "gyro_bias_sd")
        known = np.flatnonzero((rest == 1) & np.isfinite(z).all(1))
        assert np.abs(z[known[known > ends[0]]]).max() < 5.0


def test_a_jump_of_the_bias_that_was_taken_for_a_turn_does_not_turn_north() -> None:
    t = np.arange(1, 4001) / 10.0
    earth = earth_rate_along(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), math.radians(LATITUDE_DEG))
    jump = np.where(t > 120.0, math.radians(1000.0) / 3600.0, 0.0)
    rng = np.random.default_rng(0)
    gyro = earth + np.outer(jump, [0.0, 0.0, 1.0]) + 3e-6 * rng.standard_normal((len(t), 3))
    accel = [0.0, 0.0, STANDARD_GRAVITY] + 2e-3 * rng.standard_normal((len(t), 3))
    vectors = {"gyro": gyro, "accel": accel}
    columns = {f"{name}_{axis}": of[:, j] for name, of in vectors.items() for j, axis in enumerate("xyz")}
    time_ns = np.round(t * 1e9).astype(np.int64)
    block = SampleBlock({"device_time_ns": time_ns, "segment": np.zeros(len(t), np.int64), **columns})
    decided = RestParameters(undecided_s=60.0)
    result = RestAndBias(latitude_deg=LATITUDE_DEG, heading_deg=0.0, rest=decided).process(block)
    z = (vector(result, "gyro_bias") - np.outer(jump, [0.0, 0.0, 1.0])) / vector(result, "gyro_bias_sd")
    assert result["at_rest"][-1] == 1
    assert np.abs(z[t > 250.0]).max() < 4.0


def test_north_is_kept_by_the_bias_of_each_moment_of_a_motion_that_warms_the_gyros() -> None:
    t = np.arange(2600) / 4.0
    degc = np.interp(t, [0.0, 300.0, 600.0], [20.0, 25.0, 35.0])
    moving = (t > 300.0) & (t <= 600.0)
    yaw = np.where(moving, 0.5 * np.sin(np.pi * t), 0.0)
    turned = np.diff(yaw, prepend=0.0) * 4.0
    north, _, down = local_earth()
    bias = np.outer(60.0 * DPH * (degc - 20.0), [0.0, 0.0, 1.0])
    earth = np.column_stack([north * np.cos(yaw), -north * np.sin(yaw), down + turned])
    rng = np.random.default_rng(0)
    gyro = earth + bias + 4e-5 * rng.standard_normal(bias.shape)
    accel = [0.0, 0.0, -STANDARD_GRAVITY] + 2e-3 * rng.standard_normal(bias.shape)
    block = with_rest(scene(t, gyro, accel), ~moving).with_columns({"temperature": degc})
    stage = RestAndBias(GIVEN, mode="learned", latitude_deg=LATITUDE_DEG, heading_deg=0.0)
    error = (vector(stage.process(block)) - bias)[-1] / DPH
    assert np.abs(error[:2]).max() < 2.0


def test_a_heading_of_which_one_axis_is_missing_decides_nothing() -> None:
    slots = [
        Measurement(
            float(k),
            1.0,
            1.0,
            np.full(3, 0.01),
            np.array([0.0, 0.0, 9.81]),
            np.zeros((2, 3)),
            np.array([0.3, np.nan, 0.5]),
        )
        for k in range(8)
    ]
    assert (odds.log_ratio_by_heading(slots, np.zeros((1, 3))) == 0.0).all()
