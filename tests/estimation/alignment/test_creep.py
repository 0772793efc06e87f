"""A unit that turns about the vertical more slowly than slots tell: heading goes along, or sigma says so."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.alignment.creep import Rest, Usual, creep
from tests.estimation.alignment.units import ANY_REST, aligned, samples, scenario

NOISE = 3e-7
"""rad/s: of slots of 1/4 s of a gyro of 5e-4 °/√h."""
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


@cache
def standing_sd() -> float:
    return float(found(300.0, 0.0)[1])


@cache
def turned_sd() -> float:
    return float(found(260.0, 180.0, HALF_TURN, bias=2.0)[1])


@pytest.mark.parametrize(
    ("degrees", "seconds"), [(0.3, 20.0), (0.3, 200.0), (1.0, 60.0), (10.0, 20.0), (10.0, 200.0)]
)
def test_the_heading_goes_along_with_a_head_that_creeps(degrees: float, seconds: float) -> None:
    off, sd = found(300.0, degrees, crept(degrees, 60.0, seconds))
    assert abs(off) < 4.0 * sd
    assert sd < 2.0 * standing_sd()


@pytest.mark.parametrize("degrees", [0.3, 1.0, 5.0])
def test_a_creep_after_half_a_turn_of_gyros_with_a_bias(degrees: float) -> None:
    off, sd = found(260.0, 180.0 + degrees, HALF_TURN, crept(degrees, 100.0, 140.0), bias=2.0)
    assert abs(off) < 4.0 * sd
    assert sd < 1.5 * turned_sd()


@pytest.mark.parametrize("bias", [2.0, 30.0])
def test_a_creep_before_half_a_turn_of_gyros_with_a_bias(bias: float) -> None:
    half = {**HALF_TURN, "at_s": 110.0}
    off, sd = found(260.0, 181.0, crept(1.0, 0.0, 100.0), half, bias=bias)
    assert abs(off) < 4.0 * sd
    assert sd < 1.0


@pytest.mark.parametrize("degrees", [0.3, 3.0, 10.0])
def test_a_creep_all_along_at_a_changing_rate_is_told_by_the_rate_of_the_earth(degrees: float) -> None:
    off, sd = found(200.0, degrees, crept(degrees, 0.0, 200.0))
    assert abs(off) < min(4.0 * sd, 0.2)


def test_a_creep_that_began_with_the_record_and_is_over_leaves_no_mark() -> None:
    off, sd = found(80.0, 10.0, crept(10.0, 0.0, 20.0))
    assert abs(off) < 4.0 * sd
    assert sd < 0.3


def test_a_creep_all_along_at_a_constant_rate_is_in_the_sigma() -> None:
    # A constant one is a bias of the vertical gyro, for all that one position tells.
    sure = {"offset_deg_per_h": [0.0, 0.0, 20.0]}
    stage, _ = aligned(samples(scenario(200.0, arw=ARW, rate_hz=50.0, gyro_turn_on=sure)))
    assert not stage.status.observable or math.degrees(stage.status.shown.sd) > 0.5  # type: ignore[union-attr]


def test_what_a_gyro_reads_at_rest_is_told_from_its_turn() -> None:
    rng = np.random.default_rng(1)
    time = 0.25 * np.arange(800.0)
    turning = 1e-4 * np.exp(-0.5 * ((time - 120.0) / 20.0) ** 2)
    rate = 3e-5 + turning + NOISE * rng.standard_normal(800)
    one = creep(time, np.ones(800), rate, ANY_REST)
    assert one.rest.rate == pytest.approx(3e-5, abs=4.0 * math.sqrt(one.rest.variance))
    assert math.sqrt(one.rest.variance) < 1e-7
    assert one.before + one.after == pytest.approx(0.25 * turning.sum(), abs=1e-4)
    assert one.noise.std() < 1.3 * NOISE  # the rate is 300 times that


def test_a_unit_that_stands_is_not_turned_and_its_noise_stays() -> None:
    rate = 3e-5 + NOISE * np.random.default_rng(2).standard_normal(800)
    one = creep(0.25 * np.arange(800.0), np.ones(800), rate, ANY_REST)
    assert abs(one.angle).max() < 3.0 * NOISE * 0.25 * math.sqrt(800)
    assert one.rest.variance == pytest.approx(NOISE**2 / 800, rel=0.5)
    np.testing.assert_allclose(one.noise, rate, atol=0.3 * NOISE)


def test_the_pose_before_tells_a_turn_that_lasts_a_whole_pose() -> None:
    rate = 8e-5 + NOISE * np.random.default_rng(3).standard_normal(400)
    alone = creep(0.25 * np.arange(400.0), np.ones(400), rate, ANY_REST)
    after = creep(0.25 * np.arange(400.0), np.ones(400), rate, ANY_REST, Rest(3e-5, (2e-8) ** 2))
    assert alone.before + alone.after == pytest.approx(0.0, abs=1e-5)
    assert after.before + after.after == pytest.approx(5e-5 * 100.0, rel=0.01)


def test_what_is_usual_tells_a_turn_that_lasts_the_whole_record() -> None:
    time = 0.25 * np.arange(800.0)
    turning = 1e-4 * (1.0 + np.sin(time / 40.0))
    rate = 4e-5 + turning + NOISE * np.random.default_rng(4).standard_normal(800)
    one = creep(time, np.ones(800), rate, Usual(4e-5, np.array([1e-9, 1e-6]) ** 2, np.log([0.9, 0.1])))
    assert one.before + one.after == pytest.approx(0.25 * turning.sum(), rel=0.01)
    any_rest = one.rests.together()  # without it, the rates tell no more than their own size
    assert abs(any_rest.rate - 4e-5) < 2.0 * math.sqrt(any_rest.variance)
    assert math.sqrt(any_rest.variance) > 3e-5
