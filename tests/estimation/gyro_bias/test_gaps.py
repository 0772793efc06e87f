"""Gaps: what nobody saw is in the sigma from the first row behind one."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock, join
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import EARTH_RATE
from tests.estimation.gyro_bias.records import ARW, DPH, GIVEN, Truth, record, slope_model, vector, with_rest

RATE_HZ, LAG_S, SLOPE = 20.0, 30.0, np.array([60.0, -90.0, 20.0]) * DPH
BEFORE_S, AFTER_S = 400.0, 20.0


def warmed(gap_s: float, seed: int, slope: FloatArray = SLOPE) -> tuple[SampleBlock, FloatArray]:
    """Return samples with a gap in which a ramp of 100 °C/h turns, and the true bias, (n, 3)."""
    truth = Truth(RATE_HZ, flicker=1.0 * DPH)
    t = np.arange(round((BEFORE_S + gap_s + AFTER_S) * RATE_HZ)) / RATE_HZ
    turn_s = BEFORE_S + 0.3 * gap_s
    degc = 25.0 + np.minimum(t, 2.0 * turn_s - t) / 36.0
    behind, keep = np.empty(len(t)), np.exp(-1.0 / (RATE_HZ * LAG_S))
    behind[0] = degc[0]
    for k in range(1, len(t)):
        behind[k] = degc[k] + keep * (behind[k - 1] - degc[k])
    thermal = slope * (behind - 25.0)[:, np.newaxis]
    block, bias = record(truth, t[-1] + 1.0 / RATE_HZ, seed, thermal, temperature=degc)
    seen = np.flatnonzero((t < BEFORE_S) | (t >= BEFORE_S + gap_s))
    columns = {
        name: values[seen] for name, values in with_rest(block, np.ones(len(t), np.bool_)).columns.items()
    }
    return SampleBlock(columns), bias[seen]


@pytest.mark.long
@pytest.mark.parametrize("gap_s", [30.0, 60.0, 1100.0])
def test_the_sigma_knows_of_a_gap_from_the_first_row_behind_it(gap_s: float) -> None:
    ratios = []
    for seed in range(3):
        block, bias = warmed(gap_s, seed)
        block = block.with_columns(TemperatureRate().process(block))
        added = RestAndBias(GIVEN, mode="learned").process(block)
        first = round(BEFORE_S * RATE_HZ)
        rows = slice(first, first + round(3.0 * RATE_HZ))
        ratios.append((vector(added) - bias)[rows] / vector(added, "gyro_bias_sd")[rows])
    ratio = np.concatenate(ratios)
    assert np.sqrt(np.mean(ratio**2)) < 1.5
    assert np.abs(ratio).max() < 5.0


def test_a_short_gap_costs_little() -> None:
    block, _ = warmed(2.0, 4)
    sd = vector(RestAndBias(GIVEN, mode="learned").process(block), "gyro_bias_sd")
    first = round(BEFORE_S * RATE_HZ)
    assert (sd[first] < 2.0 * sd[first - 1] + 5.0 * DPH).all()


def test_behind_a_gap_it_has_the_bias_again_within_seconds() -> None:
    block, bias = warmed(1100.0, 1)
    added = RestAndBias(GIVEN, mode="learned").process(block)
    assert np.abs(vector(added)[-1] - bias[-1]).max() < 30.0 * DPH


def test_with_a_model_the_lag_that_nobody_saw_is_in_the_sigma() -> None:
    block, bias = warmed(600.0, 3, np.full(3, 60.0 * DPH))
    first = round(BEFORE_S * RATE_HZ)
    added = RestAndBias(GIVEN, mode="thermal", model=slope_model(60.0)).process(block)
    before, behind = (vector(added, "gyro_bias_sd")[row] for row in (first - 1, first))
    assert (behind > before).all()
    assert (np.abs(vector(added)[first] - bias[first]) < 4.0 * behind).all()


@pytest.mark.long
@pytest.mark.parametrize("kept", [0.02, 0.05, 0.2])
def test_what_is_left_of_a_line_that_loses_most_packets_has_more_noise(kept: float) -> None:
    for seed in range(4):
        block, bias = record(Truth(100.0), 120.0, seed)
        t, random = np.arange(len(bias)) / 100.0, np.random.default_rng(seed)
        seen = np.flatnonzero((t < 60.0) | (random.random(len(t)) < kept))
        columns = with_rest(block, np.ones(len(t), np.bool_)).columns
        added = RestAndBias(GIVEN, mode="learned").process(
            SampleBlock({name: x[seen] for name, x in columns.items()})
        )
        lossy = t[seen] > 62.0
        error = (vector(added) - bias[seen])[lossy]
        # The minute before tells it, and not a few samples: 120 °/h if all slots count alike.
        assert np.sqrt(np.mean(error**2, 0)).max() < 15.0 * DPH
        assert np.abs(error / vector(added, "gyro_bias_sd")[lossy]).max() < 4.0


@pytest.mark.long
def test_a_unit_that_was_turned_in_a_gap_has_another_earth_rate_in_its_bias() -> None:
    truth = Truth(RATE_HZ, arw=ARW / 50.0, flicker=0.02 * DPH)
    earth = EARTH_RATE * np.array([0.75, 0.0, -0.66])
    poses, degc = (np.diag([-1.0, -1.0, 1.0]), np.eye(3)), np.full(6000, 25.0)
    (before, first), (behind, then) = (
        record(truth, 300.0, 1, attitude=pose, earth=earth, temperature=degc) for pose in poses
    )
    late = {name: behind[name] for name in behind.columns}
    late["device_time_ns"] = late["device_time_ns"] + np.int64(360e9)
    block = join([before, SampleBlock(late)])
    bias = np.concatenate([first + poses[0] @ earth, then + poses[1] @ earth])
    added = RestAndBias(mode="standard").process(block)
    z = (vector(added) - bias)[6000:] / vector(added, "gyro_bias_sd")[6000:]
    assert np.abs(z).max() < 5.0


def test_gyros_that_are_silent_may_have_missed_a_turn() -> None:
    block, _ = record(Truth(RATE_HZ, arw=ARW / 100.0, flicker=0.01 * DPH), 150.0, 1)
    t = np.arange(len(block)) / RATE_HZ
    silent = (t >= 60.0) & (t < 120.0)
    gyros = {f"gyro_{axis}": np.where(silent, np.nan, block[f"gyro_{axis}"]) for axis in "xyz"}
    sd = vector(RestAndBias().process(block.with_columns(gyros)), "gyro_bias_sd")
    assert (sd[round(119.0 * RATE_HZ), :2] > EARTH_RATE / 2.0).all()


def test_a_gyro_that_is_silent_has_no_error_by_rounding() -> None:
    block, _ = record(Truth(RATE_HZ), 120.0, 1)
    t = np.arange(len(block)) / RATE_HZ
    block = block.with_columns({"gyro_z": np.where(t >= 60.0, np.nan, block["gyro_z"])})
    turn = RestAndBias().process(block)["turn_hypothesis_z"]
    assert abs(turn[-1]) < 10.0 * DPH


def test_a_yaw_turns_no_rest_that_is_given_into_a_turn() -> None:
    block, _ = record(Truth(RATE_HZ), 60.0, 1)
    t = np.arange(len(block)) / RATE_HZ
    at_rest = np.ones(len(t), np.int64)
    drifting = {"gyro_z": block["gyro_z"] + 0.01, "yaw": 0.01 * t, "at_rest": at_rest}
    stage = RestAndBias(GIVEN)
    added = stage.process(block.with_columns(drifting))
    assert stage.unrest == ""
    assert added["gyro_bias_sd_z"][-1] < 30.0 * DPH
