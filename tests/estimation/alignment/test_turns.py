"""A unit in an unsteady hand: where it points afterwards, and what the sigma says of that."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.pipeline import Pipeline
from imumon.protocols.ranges import Ranges
from tests.estimation.alignment.units import UP, aligned, error_deg, samples, scenario, sent

BEGIN_S, REST_S = 60.0, 60.0


def edges(t: FloatArray, seconds: float) -> FloatArray:
    """Return a window that opens and closes within a second, (n,)."""
    window = np.clip(t - BEGIN_S, 0.0, 1.0) * np.clip(BEGIN_S + seconds - t, 0.0, 1.0)
    return np.asarray(window**2 * (3.0 - 2.0 * window))


def waved(t: FloatArray, seconds: float, degrees: float, seed: int) -> Rotation:
    """Return the attitudes of a unit that is waved and put back."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.2, 2.0, (3, 6, 1)), rng.uniform(0.0, 2.0 * np.pi, (3, 6, 1))
    swing = np.sin(2.0 * np.pi * frequency * t + phase).sum(1).T * edges(t, seconds)[:, np.newaxis]
    return Rotation.from_rotvec(math.radians(degrees) * swing / np.abs(swing).max())


def wobbling(t: FloatArray, seconds: float, degrees: float, frequency: float, angle: float) -> Rotation:
    """Return the attitudes of a unit that is turned by an angle, deg, in a hand that goes round."""
    s = np.clip((t - BEGIN_S) / seconds, 0.0, 1.0)
    phase = 2.0 * np.pi * frequency * t
    round_ = np.column_stack([np.sin(phase), np.cos(phase), 0.0 * t]) * edges(t, seconds)[:, np.newaxis]
    way = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    turn = Rotation.from_rotvec(math.radians(angle) * np.outer(way, UP))
    return Rotation.from_rotvec(math.radians(degrees) * round_) * turn


def times(seconds: float, hz: float) -> FloatArray:
    return np.arange(round((BEGIN_S + seconds + REST_S) * hz) + 1) / hz


def error_and_sd(stage: Alignment, heading: float) -> tuple[float, float]:
    stage.finish()
    joint = stage._aligner.estimates["joint"]
    return error_deg(joint.heading, heading), math.degrees(joint.sd)


@pytest.mark.parametrize(("hz", "seed"), [(20.0, 1), (50.0, 2), (50.0, 3), (200.0, 4)])
def test_a_unit_that_is_waved_and_put_back_points_where_it_did(hz: float, seed: int) -> None:
    block, heading = sent(waved(times(10.0, hz), 10.0, 38.0, seed), hz, seed=seed)
    error, sd = error_and_sd(aligned(block)[0], heading)
    assert abs(error) < 3.0 * sd
    assert sd < (0.15 if hz > 20.0 else 1.0)


@pytest.mark.parametrize(
    ("hz", "degrees", "frequency"), [(100.0, 5.0, 1.5), (50.0, 5.0, 0.7), (25.0, 3.0, 1.5)]
)
def test_a_wobbling_hand_does_not_turn_the_second_position(
    hz: float, degrees: float, frequency: float
) -> None:
    block, heading = sent(wobbling(times(6.0, hz), 6.0, degrees, frequency, 172.0), hz)
    stage, _ = aligned(block)
    error, sd = error_and_sd(stage, heading)
    assert stage.status.positions == 2
    assert abs(error) < 3.0 * sd
    assert sd < 0.3


@pytest.mark.long
def test_a_declared_scale_error_is_in_the_sigma_of_the_turn_and_of_coning() -> None:
    ratios = []
    for seed in range(6):
        block, heading = sent(wobbling(times(20.0, 50.0), 20.0, 30.0, 0.7, 90.0), 50.0, 0.01, seed)
        error, sd = error_and_sd(aligned(block, {"gyro_scale_sd_ppm": 1e4})[0], heading)
        ratios.append(error / sd)
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.8
    assert np.abs(ratios).max() < 4.0


def stepped(t: FloatArray, turns: int, degrees: float, rest_s: float) -> Rotation:
    """Return the attitudes of a unit that is turned in one sense, for 4 s each time."""
    begun = rest_s + (rest_s + 4.0) * np.arange(turns)
    way = np.clip((t[:, np.newaxis] - begun) / 4.0, 0.0, 1.0).sum(1)
    return Rotation.from_rotvec(math.radians(degrees) * np.outer(way, UP))


@pytest.mark.long
def test_an_error_of_scale_is_the_same_in_all_turns() -> None:
    ratios = []
    t = np.arange(round((12 * 20.0 + 11 * 4.0) * 20.0) + 1) / 20.0
    for seed in range(6):
        block, heading = sent(stepped(t, 11, 30.0, 20.0), 20.0, 0.01, seed)
        error, sd = error_and_sd(aligned(block, {"gyro_scale_sd_ppm": 1e4})[0], heading)
        ratios.append(error / sd)
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.8
    assert np.abs(ratios).max() < 4.0


@pytest.mark.parametrize("declared", [{}, {"gyro_bias_sd_deg_per_h": 0.0035}])
def test_of_a_scale_error_that_is_not_declared_half_stays_after_the_next_fit(
    declared: dict[str, float],
) -> None:
    t = np.arange(round(364.0 * 20.0) + 1) / 20.0
    block, heading = sent(stepped(t, 1, 180.0, 60.0), 20.0)
    scaled = block.with_columns({"gyro_z": 1.01 * block["gyro_z"]})
    stage, out = aligned(scaled, {"accel_bias_sd_ug": 30.0} | declared)
    off = [abs(error_deg(out["heading"][round(at_s * 20.0)], heading)) for at_s in (70.0, 363.0)]
    assert off == pytest.approx([1.8, 0.9], abs=0.15)
    assert math.degrees(out["heading_sd"][-1]) < 0.06
    assert any("contradict the declared bias" in notice for notice in stage.notices()) == bool(declared)


def test_a_last_position_too_short_for_a_fit_has_what_the_turn_to_it_adds() -> None:
    t = np.arange(round(66.9 * 50.0) + 1) / 50.0
    block, _ = sent(stepped(t, 1, 90.0, 60.0), 50.0)
    stage, _ = aligned(block, {"gyro_scale_sd_ppm": 1e4})
    first, last = stage.finish()
    assert last.sd > math.hypot(first.sd, 0.009 * math.radians(90.0))


@pytest.mark.parametrize("heading_deg", [0.0, 7.0, 12.0, 83.0])
def test_half_a_turn_of_a_table_whose_axis_leans(heading_deg: float) -> None:
    # The bias along the axis is then a constant level rate: with a turn all along it could explain any north.
    s = np.clip((times(6.0, 100.0) - BEGIN_S) / 6.0, 0.0, 1.0)
    begun = Rotation.from_euler("ZYX", [0.7, -0.01, 0.02])
    turned = begun * Rotation.from_rotvec(math.pi * np.outer(s, UP)) * begun.inv()
    block, truth = sent(Rotation.from_rotvec(math.radians(heading_deg) * UP) * turned, 100.0)
    error, sd = error_and_sd(aligned(block)[0], truth)
    assert abs(error) < 4.0 * sd < 4.0


def test_half_a_turn_removes_the_bias_of_the_accelerometers() -> None:
    t = times(6.0, 50.0)
    half = Rotation.from_rotvec(math.pi * np.outer(np.clip((t - BEGIN_S) / 6.0, 0.0, 1.0), UP))
    block, heading = sent(half, 50.0, force_bias=2e-2)
    one_position, _ = sent(half[:2900], 50.0, force_bias=2e-2)
    declared = {"accel_bias_sd_ug": 2000.0}
    error, sd = error_and_sd(aligned(block, declared)[0], heading)
    assert abs(error) < 3.0 * sd
    assert sd < 0.06
    _, sd = error_and_sd(aligned(one_position, declared)[0], heading)
    assert sd > math.degrees(2e-3 * math.tan(math.radians(36.0)))


def test_the_heading_states_while_it_is_waved_how_far_it_may_be_off() -> None:
    block, _ = sent(waved(times(30.0, 20.0), 30.0, 60.0, 5), 20.0)
    _, out = aligned(block)
    sd = np.degrees(out["heading_sd"])
    before, during = sd[round((BEGIN_S - 2.0) * 20.0)], sd[round((BEGIN_S + 28.0) * 20.0)]
    assert during > 2.0 * before


def test_a_turn_beyond_the_declared_range_is_in_the_sigma() -> None:
    """Half a turn in 2 s has 169 °/s at most; of what a gyro of 165 °/s cannot say, 0.7° are lost."""
    turn = {"kind": "turn", "at_s": 30.0, "duration_s": 2.0, "heading_deg": 180.0}
    plan = scenario(60.0, arw=1e-3, rate_hz=50.0, warm_up=(0.0, 100.0), motion=[turn])
    sent = dict(samples(plan).columns)
    sent["gyro_z"] = np.clip(sent["gyro_z"], -math.radians(165.0), math.radians(165.0))
    stage = Alignment(AlignmentParameters(accel_bias_sd_ug=30.0), 36.0, "FRD")
    pipeline = Pipeline(None, [stage], Ranges(gyro_deg_per_s=165.0))
    pipeline.push(SampleBlock(sent))
    out = pipeline.take()
    after, end = round(33.5 * 50.0), len(out["heading"]) - 1
    (off, sd), (last, last_sd) = (
        (error_deg(out["heading"][k], 210.0), math.degrees(out["heading_sd"][k])) for k in (after, end)
    )
    assert 0.3 < abs(off) < 3.0 * sd
    assert sd < 10.0
    assert abs(last) < 3.0 * last_sd < 1.0  # by the second position alone
    assert pipeline.counters.left_out > 5


@pytest.mark.parametrize(("degrees", "after_s"), [(5.0, 31.0), (30.0, 91.0)])
def test_a_turn_in_a_gap_is_in_the_sigma_from_a_fit_on(degrees: float, after_s: float) -> None:
    """The first fit after a large turn rejects what is behind it as a knock: a known limit."""
    t = np.arange(260 * 20 + 1) / 20.0
    way = np.clip((t - 150.5) / 3.5, 0.0, 1.0)
    block, _ = sent(Rotation.from_rotvec(math.radians(degrees) * np.outer(way, UP)), 20.0)
    after = block["device_time_ns"] * 1e-9 - 154.5
    kept = (after < -4.5) | (after >= 0.0)
    received = SampleBlock({name: values[kept] for name, values in block.columns.items()})
    _, out = aligned(received, {"accel_bias_sd_ug": 30.0})
    wide = (after[kept] > -60.0) & (out["heading_sd"] > math.radians(1.0))
    assert after[kept][wide][0] == pytest.approx(after_s, abs=0.5)


def tumbled(axis: tuple[float, float, float]) -> Rotation:
    """Return the attitudes of a unit that is turned by 90° about an axis, east-north-up, in 4 s."""
    way = np.clip((times(4.0, 20.0) - BEGIN_S) / 4.0, 0.0, 1.0)
    return Rotation.from_rotvec(0.5 * math.pi * np.outer(way, axis))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.98, 0.17, 0.0), (0.0, 1.0, 0.0)])
def test_a_tumble_about_an_axis_near_east_leaves_two_headings(axis: tuple[float, float, float]) -> None:
    # The bias along the axis does not turn, so north may be mirrored in it.
    ratios = []
    for seed in range(4):
        block, heading = sent(tumbled(axis), 20.0, seed=seed)
        declared = {"gyro_bias_sd_deg_per_h": 1.0, "accel_bias_sd_ug": 30.0}
        error, sd = error_and_sd(aligned(block, declared)[0], heading)
        ratios.append(error / sd)
    assert np.abs(ratios).max() < 3.0


def test_the_bias_of_another_vertical_gyro_is_no_creep() -> None:
    block, _ = sent(tumbled((1.0, 0.0, 0.0)), 20.0)
    biased = {
        f"gyro_{axis}": block[f"gyro_{axis}"] + sign * 5e-4
        for axis, sign in zip("xyz", (0, 1, -1), strict=True)
    }
    declared = {"gyro_bias_sd_deg_per_h": 100.0, "accel_bias_sd_ug": 30.0}
    stages = [aligned(given, declared)[0] for given in (block, block.with_columns(biased))]
    without, with_bias = (stage.status.shown.sd for stage in stages)
    assert with_bias < 1.1 * without
