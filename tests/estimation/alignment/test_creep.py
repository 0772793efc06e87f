"""A unit that turns about the vertical more slowly than slots show: sigma has it, and it is left out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray
from tests.estimation.alignment.units import UP, aligned, error_deg, samples, scenario, sent

ARW = 1e-3
HALF_TURN = {"kind": "turn", "at_s": 50.0, "duration_s": 6.0, "heading_deg": 180.0}


def crept(degrees: float, begin_s: float, seconds: float) -> dict[str, Any]:
    return {"kind": "turn", "at_s": begin_s, "duration_s": seconds, "heading_deg": degrees}


def found(
    seconds: float, degrees: float, *motion: dict[str, Any], seed: int = 0, bias: float = 0.0
) -> FloatArray:
    """Return error and sigma of the heading at the end, degrees."""
    offset = {"offset_deg_per_h": [bias, -bias, 0.5 * bias]}
    plan = scenario(seconds, arw=ARW, rate_hz=50.0, warm_up=(0.0, 100.0), motion=motion, gyro_turn_on=offset)
    _, out = aligned(samples(plan, seed), {"accel_bias_sd_ug": 30.0})
    off = math.degrees(out["heading"][-1]) - 30.0 - degrees
    return np.array([(off + 180.0) % 360.0 - 180.0, math.degrees(out["heading_sd"][-1])])


@pytest.mark.parametrize(
    ("degrees", "begin_s", "seconds"),
    [
        (0.3, 60.0, 20.0),
        (0.3, 60.0, 200.0),
        (1.0, 60.0, 60.0),
        (10.0, 60.0, 200.0),
        (10.0, 0.0, 20.0),
        (30.0, 60.0, 60.0),
    ],
)
def test_a_head_that_has_crept_shows_north_again(degrees: float, begin_s: float, seconds: float) -> None:
    off, sd = found(600.0, degrees, crept(degrees, begin_s, seconds))
    assert abs(off) < 4.0 * sd
    assert sd < 0.1


def test_while_a_head_creeps_sigma_has_what_it_has_turned() -> None:
    off, sd = found(150.0, 1.5, crept(3.0, 60.0, 180.0))
    assert np.isnan(off) or abs(off) < 3.0 * sd
    assert sd > 0.5


def test_a_head_that_creeps_is_not_settled_any_more() -> None:
    still, creeps = (
        scenario(seconds, arw=ARW, rate_hz=50.0, warm_up=(0.0, 100.0), motion=[crept(3.0, 60.0, 180.0)])
        for seconds in (60.0, 150.0)
    )
    limits = {"accel_bias_sd_ug": 30.0, "settled_deg": 0.1}
    assert aligned(samples(still, 0), limits)[0].status.phase == "settled"
    assert aligned(samples(creeps, 0), limits)[0].status.phase != "settled"


@pytest.mark.parametrize("degrees", [0.3, 1.0, 5.0])
def test_a_creep_after_half_a_turn_of_gyros_with_a_bias(degrees: float) -> None:
    off, sd = found(260.0, 180.0 + degrees, HALF_TURN, crept(degrees, 100.0, 140.0), bias=2.0)
    assert np.isnan(off) or abs(off) < 4.0 * sd
    assert sd < 1.2 * degrees


@pytest.mark.parametrize("bias", [2.0, 30.0])
def test_a_creep_before_half_a_turn_of_gyros_with_a_bias(bias: float) -> None:
    half = {**HALF_TURN, "at_s": 110.0}
    off, sd = found(260.0, 181.0, crept(1.0, 0.0, 100.0), half, bias=bias)
    assert abs(off) < 4.0 * sd
    assert sd < 1.0


def test_a_creep_of_a_head_that_leans_turns_the_tilt_too() -> None:
    t, hz = np.arange(400 * 20) / 20.0, 20.0
    share = np.clip(t / 200.0, 0.0, 1.0)
    angle = math.radians(10.0) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    errors = []
    for seed in range(4):
        lean = Rotation.from_rotvec(math.radians(1.0) * np.array([math.cos(seed), math.sin(seed), 0.0]))
        block, heading = sent(lean * Rotation.from_rotvec(np.outer(angle, UP)), hz, seed=seed)
        stage, _ = aligned(block, {"accel_bias_sd_ug": 30.0})
        assert stage.status.estimates
        errors.append(error_deg(stage.status.shown.heading, heading))
    assert np.sqrt(np.mean(np.square(errors))) < 0.5


def test_a_creep_all_along_at_a_constant_rate_is_in_the_sigma() -> None:
    # A constant one is a bias of the vertical gyro, for all that one position tells.
    sure = {"offset_deg_per_h": [0.0, 0.0, 20.0]}
    stage, _ = aligned(samples(scenario(200.0, arw=ARW, rate_hz=50.0, gyro_turn_on=sure)))
    assert not stage.status.observable or math.degrees(stage.status.shown.sd) > 0.5


@pytest.mark.parametrize(("mrad_per_s", "seconds"), [(0.05, 40.0), (0.05, 300.0), (0.3, 120.0)])
def test_a_constant_creep_that_begins_after_half_a_turn_is_in_the_sigma(
    mrad_per_s: float, seconds: float
) -> None:
    t = np.arange(round((106.0 + seconds) * 20.0) + 1) / 20.0
    angle = math.pi * np.clip((t - 100.0) / 6.0, 0.0, 1.0) + 1e-3 * mrad_per_s * np.clip(t - 106.0, 0.0, None)
    ratios = []
    for seed in range(4):
        block, heading = sent(Rotation.from_rotvec(np.outer(angle, UP)), 20.0, seed=seed)
        stage, _ = aligned(block)
        stage.finish()
        estimate = stage._aligner.estimates["joint"]
        ratios.append(error_deg(estimate.heading, heading) / math.degrees(estimate.sd))
    assert np.sqrt(np.mean(np.square(ratios))) < 1.8


@pytest.mark.long
@pytest.mark.parametrize(("mrad_per_s", "seconds"), [(0.05, 900.0), (0.02, 1800.0)])
def test_a_constant_creep_that_has_ended_is_in_the_sigma_as_a_whole(
    mrad_per_s: float, seconds: float
) -> None:
    t = np.arange(round((606.0 + seconds) * 4.0) + 1) / 4.0
    creep = 1e-3 * mrad_per_s * np.clip(t - 106.0, 0.0, seconds)
    angle = math.pi * np.clip((t - 100.0) / 6.0, 0.0, 1.0) + creep
    block, heading = sent(Rotation.from_rotvec(np.outer(angle, UP)), 4.0)
    bias = math.radians(2.0) / 3600.0
    biased = block.with_columns({"gyro_x": block["gyro_x"] + bias, "gyro_y": block["gyro_y"] - bias})
    stage, _ = aligned(biased, {"accel_bias_sd_ug": 30.0})
    shown = stage.status.shown
    assert abs(error_deg(shown.heading, heading)) < 3.0 * math.degrees(shown.sd)


def test_a_creep_before_the_last_fit_and_since_then_adds_up_as_an_angle() -> None:
    # Of three positions the second creeps by 24 mrad, and faster by 8 mrad, which forbids a fit.
    t = np.arange(420 * 4 + 1) / 4.0
    creep = 1e-4 * np.clip(t - 66.0, 0.0, 240.0) + 2e-4 * np.clip(t - 306.0, 0.0, 40.0)
    turns = math.pi * np.clip((t - 60.0) / 6.0, 0.0, 1.0) + 1.7 * np.clip((t - 346.0) / 6.0, 0.0, 1.0)
    block, _ = sent(Rotation.from_rotvec(np.outer(turns + creep, UP)), 4.0)
    stage, _ = aligned(block, {"accel_bias_sd_ug": 30.0})
    first, _, last = stage.finish()
    assert math.sqrt(first.sd**2 - last.sd**2) > 0.030


@pytest.mark.long
def test_a_creep_against_a_larger_bias_is_in_the_sigma() -> None:
    t = np.arange(406 * 20 + 1) / 20.0
    creep = math.radians(-5.0) / 3600.0 * np.clip(t - 106.0, 0.0, None)
    turned = Rotation.from_rotvec(np.outer(math.pi * np.clip((t - 100.0) / 6.0, 0.0, 1.0) + creep, UP))
    ratios = []
    for seed in range(4):
        block, heading = sent(turned, 20.0, seed=seed)
        biased = block.with_columns({"gyro_z": block["gyro_z"] + math.radians(20.0) / 3600.0})
        stage, _ = aligned(biased, {"accel_bias_sd_ug": 30.0})
        assert stage.status.estimates
        ratios.append(error_deg(stage.status.shown.heading, heading) / math.degrees(stage.status.shown.sd))
    assert np.abs(ratios).max() < 4.0


@pytest.mark.long
def test_a_short_first_position_of_a_noisy_gyro_does_not_widen_hours_of_rest() -> None:
    t = np.arange(4 * 3600 * 2 + 1) / 2.0
    bumped = Rotation.from_rotvec(np.outer(math.radians(0.5) * np.clip(t - 15.0, 0.0, 1.0), UP))
    sds = []
    for seed in range(4):
        block, heading = sent(bumped, 2.0, seed=seed)
        noise = (
            math.radians(0.1)
            / 60.0
            * math.sqrt(2.0)
            * np.random.default_rng(seed).normal(size=(3, len(block)))
        )
        noisy = {name: block[name] + noise[k] for k, name in enumerate(("gyro_x", "gyro_y", "gyro_z"))}
        noisy["gyro_z"] += math.radians(1.0) / 3600.0
        stage, _ = aligned(block.with_columns(noisy), {"gyro_bias_sd_deg_per_h": 0.3})
        assert stage.status.estimates
        sds.append(math.degrees(stage.status.shown.sd))
        assert not abs(error_deg(stage.status.shown.heading, heading)) > 4.0 * sds[-1]
    assert max(sds) < 1.8


SAME_DPH, OFF_DEG, SD_DEG = 1.0, 0.1, 0.02


@pytest.mark.long
def test_a_creep_of_the_same_rate_in_both_positions_is_not_in_the_sigma() -> None:
    """It looks like a bias of the vertical gyro: a known limit."""
    t = np.arange(round(608.0 * 20.0) + 1) / 20.0
    angle = math.radians(SAME_DPH) / 3600.0 * t + math.pi * np.clip((t - 300.0) / 8.0, 0.0, 1.0)
    found = []
    for seed in range(4):
        block, heading = sent(Rotation.from_rotvec(np.outer(angle, UP)), 20.0, seed=seed)
        _, out = aligned(block, {"accel_bias_sd_ug": 30.0})
        found.append([error_deg(out["heading"][-1], heading), math.degrees(out["heading_sd"][-1])])
    off, sd = np.mean(found, axis=0)
    assert off == pytest.approx(OFF_DEG, abs=0.02)
    assert sd == pytest.approx(SD_DEG, abs=0.005)
