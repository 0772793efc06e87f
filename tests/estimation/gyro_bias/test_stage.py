"""The stage: what it may be given, what it must not depend on, and what it says."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from imumon.blocks import ColumnArray, FloatArray, SampleBlock, join
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import body_to_ned
from imumon.pipeline import Estimator
from tests.estimation.gyro_bias.records import (
    ARW,
    DPH,
    GIVEN,
    GRAVITY,
    Truth,
    local_earth,
    record,
    vector,
    with_rest,
)
from tests.estimation.rest.scenes import block as scene

SLOW = Truth(rate_hz=20.0)
QUIET = Truth(rate_hz=20.0, arw=ARW / 10, flicker=0.0)


def run(block: SampleBlock, stage: RestAndBias | None = None) -> Mapping[str, ColumnArray]:
    return (stage or RestAndBias(GIVEN)).process(block)


def test_columns_units_and_the_corrected_rate() -> None:
    stage: Estimator = RestAndBias(GIVEN)
    block, bias = record(SLOW, 120.0, 1)
    added = stage.process(block)
    assert [column.name for column in stage.columns] == list(added)
    assert {column.name: column.unit for column in stage.columns}["gyro_bias_sd_x"] == "rad/s"
    np.testing.assert_allclose(added["gyro_corrected_y"], block["gyro_y"] - added["gyro_bias_y"])
    assert np.abs(vector(added)[-1] - bias[-1]).max() < 5 * vector(added, "gyro_bias_sd")[-1].max()
    innovations = vector(added, "zupt_innovation")
    assert np.isfinite(innovations[:, 0]).sum() == pytest.approx(116, abs=5)


def test_rows_before_the_first_gyro_do_not_matter() -> None:
    block, _ = record(SLOW, 60.0, 3)
    time = block["device_time_ns"]
    early = SampleBlock(
        {
            "device_time_ns": np.arange(50) * 50_000_000 - 50 * 50_000_000,
            "segment": np.zeros(50, np.int64),
            "at_rest": np.ones(50, np.int64),
        }
    )
    stage = RestAndBias(GIVEN)
    added = stage.process(early)
    assert np.isnan(vector(added)).all()
    np.testing.assert_array_equal(vector(stage.process(block)), vector(run(block)))
    assert time[0] == 0


@pytest.mark.long
@pytest.mark.parametrize("rate_hz", [1.0, 3.0, 10.0, 100.0, 2000.0])
def test_any_rate(rate_hz: float) -> None:
    truth = Truth(rate_hz=rate_hz, flicker=DPH)
    block, bias = record(truth, 300.0 if rate_hz < 1000 else 40.0, 4)
    added = run(block)
    off = (vector(added)[-1] - bias[-1]) / vector(added, "gyro_bias_sd")[-1]
    assert np.abs(off).max() < 4.0


def attitudes() -> dict[str, FloatArray]:
    ups: dict[str, list[float]] = {
        "FRD": [0, 0, -1],
        "FLU": [0, 0, 1],
        "x up": [1, 0, 0],
        "y down": [0, -1, 0],
        "tilted": [2, -1, 1.5],
    }
    return {name: np.array(up, float) / np.linalg.norm(up) for name, up in ups.items()}


@pytest.mark.parametrize("name", list(attitudes()))
@pytest.mark.parametrize("heading_deg", [0.0, 130.0])
def test_earth_rate_is_not_in_the_bias_at_any_attitude(name: str, heading_deg: float) -> None:
    matrix = body_to_ned(attitudes()[name], math.radians(heading_deg)).T
    block, bias = record(QUIET, 120.0, 5, attitude=matrix, earth=local_earth())
    added = run(block, RestAndBias(GIVEN, latitude_deg=40.93, heading_deg=heading_deg))
    assert np.abs(vector(added)[-1] - bias[-1]).max() / DPH < 1.0
    blind = run(block)
    assert vector(blind)[-1] - bias[-1] == pytest.approx(matrix @ local_earth(), abs=1.0 * DPH)


def test_without_heading_only_the_vertical_earth_rate_is_removed_and_it_is_reported() -> None:
    stage = RestAndBias(GIVEN, latitude_deg=40.93)
    block, bias = record(QUIET, 120.0, 6, earth=local_earth())
    off = vector(run(block, stage))[-1] - bias[-1]
    assert off / DPH == pytest.approx([11.36, 0.0, 0.0], abs=1.0)
    (said,) = stage.notices()
    assert "heading is not known" in said
    assert "11.4 °/h" in said
    assert "latitude is not known" in RestAndBias().notices()[0]
    assert RestAndBias(latitude_deg=1.0, heading_deg=2.0).notices() == []


def moved(
    seconds: tuple[float, float, float], turned_deg: float, seed: int = 7
) -> tuple[SampleBlock, FloatArray, FloatArray]:
    """Return rest, a turn about the vertical, and rest, level, axes forward-right-down, with earth rate."""
    before, during, after = (round(part * 20) for part in seconds)
    n = before + during + after
    heading = np.concatenate(
        [
            np.zeros(before),
            np.linspace(0, math.radians(turned_deg), during),
            np.full(after, math.radians(turned_deg)),
        ]
    )
    block, bias = record(QUIET, n / 20, seed)
    north, down = local_earth()[0], local_earth()[2]
    turning = np.gradient(heading) * 20
    rate = np.column_stack([north * np.cos(heading), -north * np.sin(heading), down + turning])
    columns = {f"gyro_{axis}": block[f"gyro_{axis}"] + rate[:, j] for j, axis in enumerate("xyz")}
    rest = np.abs(turning) < 1e-9
    return with_rest(block, rest).with_columns(columns), bias, rest.astype(float)


def test_a_turn_keeps_the_bias_and_turns_the_earth_rate() -> None:
    block, bias, rest = moved((90.0, 30.0, 60.0), 120.0)
    added = run(block, RestAndBias(GIVEN, latitude_deg=40.93, heading_deg=0.0))
    off, sd = vector(added) - bias, vector(added, "gyro_bias_sd")
    moving = rest == 0.0
    # The last second at rest is taken back with the first slot in motion.
    moving[np.flatnonzero(moving)[:6]] = False
    # What was taken for flicker of seconds dies away meanwhile.
    assert np.ptp(vector(added)[moving], axis=0).max() < 0.2 * DPH
    by_the_second = sd[moving][: 29 * 20, 0].reshape(-1, 20).mean(1)
    assert (np.diff(by_the_second) > -0.02 * by_the_second[1:]).all()
    assert by_the_second[-1] > 1.05 * by_the_second[0]
    assert sd[moving][-1, 0] > sd[moving][0, 0]
    assert np.abs(off[-1]).max() / DPH < 1.0
    corrected = vector(added, "gyro_corrected")
    assert np.degrees(corrected[rest == 0.0][:, 2].sum() / 20) == pytest.approx(120.0, abs=0.5)


def test_without_heading_a_turn_widens_what_it_may_have_changed() -> None:
    block, bias, rest = moved((90.0, 30.0, 60.0), 120.0)
    added = run(block)
    off, sd = vector(added) - bias, vector(added, "gyro_bias_sd")
    first = int(np.flatnonzero(rest == 0.0)[-1]) + 40
    # The part of the earth rate in the bias of x has changed by 11.4 (cos 120 - 1) deg/h.
    assert sd[first, 0] / DPH > 1.0
    assert off[-1] / DPH == pytest.approx(np.array([-5.68, -9.84, -9.87]), abs=1.0)


def test_what_moves_the_unit_before_it_is_noticed_is_not_learned() -> None:
    block, _ = record(QUIET, 120.0, 8)
    gyro = block["gyro_z"].copy()
    gyro[1990:2100] += 0.5
    rest = np.ones(len(gyro), bool)
    rest[2000:2100] = False
    added = run(with_rest(block.with_columns({"gyro_z": gyro}), rest))
    change = np.abs(added["gyro_bias_z"] - added["gyro_bias_z"][1980])
    assert (change <= 4.0 * added["gyro_bias_sd_z"])[1980:2100].all()
    assert change[2005:2100].max() / DPH < 0.7


def test_a_slow_rotation_that_is_given_as_rest_is_in_the_sigma() -> None:
    block, bias = record(QUIET, 180.0, 9)
    n = len(block)
    angle = np.clip((np.arange(n) / 20 - 90.0) * math.radians(0.1), 0.0, math.radians(6.0))
    rate = np.gradient(angle) * 20
    force = GRAVITY * np.column_stack([np.zeros(n), -np.sin(angle), -np.cos(angle)])
    still = GRAVITY * np.array([0.0, 0.0, -1.0])
    columns = {f"accel_{a}": block[f"accel_{a}"] + (force - still)[:, j] for j, a in enumerate("xyz")}
    added = run(block.with_columns({"gyro_x": block["gyro_x"] + rate, **columns}))
    z = (added["gyro_bias_x"] - bias[:, 0]) / added["gyro_bias_sd_x"]
    assert np.abs(z[1900:]).max() < 3.0  # the rotation is 360 deg/h, and begins at 90 s


def test_a_warm_bias_of_two_degrees_per_second_is_found() -> None:
    block, bias = record(SLOW, 40.0, 10)
    added = run(block.with_columns({"gyro_y": block["gyro_y"] + math.radians(2.0)}))
    off = added["gyro_bias_y"][-1] - bias[-1, 1] - math.radians(2.0)
    assert abs(off) < 4 * added["gyro_bias_sd_y"][-1]


def test_a_gap_a_lost_sample_and_missing_readings_are_survived() -> None:
    block, bias = record(SLOW, 200.0, 11)
    keep = np.ones(len(block), bool)
    keep[1500:1900] = False
    keep[::97] = False
    columns = {name: values[keep] for name, values in block.columns.items()}
    columns["accel_x"] = np.where(np.arange(keep.sum()) % 3 == 0, np.nan, columns["accel_x"])
    columns["gyro_z"] = np.where(np.arange(keep.sum()) % 5 == 0, np.nan, columns["gyro_z"])
    added = run(SampleBlock(columns))
    off = (vector(added)[-1] - bias[-1]) / vector(added, "gyro_bias_sd")[-1]
    assert np.abs(off).max() < 4.0
    assert np.isfinite(vector(added)[200:]).all()


def test_a_restart_forgets_the_bias_but_not_the_noise() -> None:
    one, _ = record(SLOW, 60.0, 12)
    two, bias = record(SLOW, 20.0, 13)
    two = two.with_columns({"segment": np.ones(len(two), np.int64), "gyro_x": two["gyro_x"] + 0.05})
    added = run(join([one, two]))
    after = vector(added)[len(one) :]
    assert np.isnan(after[0]).all()
    known = np.flatnonzero(np.isfinite(after[:, 0]))[0]
    assert known / 20 < 2.0
    assert after[-1, 0] == pytest.approx(bias[-1, 0] + 0.05, abs=30 * DPH)


def test_a_bias_that_jumps_is_found_again_and_it_is_reported() -> None:
    block, _ = record(SLOW, 600.0, 14)
    jumped = np.where(np.arange(len(block)) > 3000, math.radians(2.0), 0.0)
    stage = RestAndBias(GIVEN)
    added = run(block.with_columns({"gyro_z": block["gyro_z"] + jumped}), stage)
    assert added["gyro_bias_sd_z"][4000] > math.radians(1.0)
    assert added["gyro_bias_z"][-1] == pytest.approx(math.radians(2.0), abs=30 * DPH)
    assert any("jumped" in text for text in stage.notices())


def test_without_a_rest_column_rest_is_detected_unless_it_is_assumed() -> None:
    block, _ = record(SLOW, 30.0, 15)
    shaken = block.with_columns({"accel_x": block["accel_x"] + np.sin(np.arange(len(block)))})
    bare = SampleBlock({name: values for name, values in shaken.columns.items() if name != "at_rest"})
    assert not run(bare, RestAndBias())["at_rest"].any()
    assumed = run(bare)
    assert assumed["at_rest"].all()
    assert np.isfinite(vector(assumed)[100:]).all()
    np.testing.assert_array_equal(vector(assumed), vector(run(shaken)))


def test_without_accelerometers_the_unit_is_taken_as_still() -> None:
    block, bias = record(SLOW, 120.0, 16)
    bare = SampleBlock({name: v for name, v in block.columns.items() if not name.startswith("accel")})
    added = run(bare)
    assert np.abs((vector(added)[-1] - bias[-1]) / vector(added, "gyro_bias_sd")[-1]).max() < 4.0


def test_constant_readings_are_survived() -> None:
    block, _ = record(SLOW, 120.0, 17)
    constant = {
        name: np.full(len(block), block[name][0]) for name in block.columns if name[:4] in ("gyro", "acce")
    }
    added = run(block.with_columns(constant))
    assert np.isfinite(vector(added)[200:]).all()
    assert added["gyro_bias_x"][-1] == pytest.approx(constant["gyro_x"][0], abs=0.1 * DPH)


def test_a_coarse_gyro_whose_readings_do_not_change_at_rest_keeps_its_bias_when_it_is_turned_over() -> None:
    t, step, bias = np.arange(6000) / 50.0, math.radians(0.06), math.radians(0.31)
    angle = math.pi * np.clip((t - 60.0) / 4.0, 0.0, 1.0)
    turning = np.where((t > 60.0) & (t < 64.0), math.pi / 4.0, 0.0)
    rate = np.stack([turning + bias, -0.4 * bias + 0.0 * t, 0.2 * bias + 0.0 * t], axis=1)
    force = np.stack([0.0 * t, GRAVITY * np.sin(angle), GRAVITY * np.cos(angle)], axis=1)
    noise = 0.005 * np.random.default_rng(3).normal(size=force.shape)
    samples = scene(t, step * np.round(rate / step), force + noise)
    added = RestAndBias().process(samples)
    error = vector(added)[50 * 55 :] - bias * np.array([1.0, -0.4, 0.2])
    assert np.abs(error).max() < step
    assert np.abs(error / vector(added, "gyro_bias_sd")[50 * 55 :]).max() < 2.0


@pytest.mark.parametrize("bias_steps", [0.53, 0.55, 0.58])
def test_a_gyro_that_alternates_between_two_readings_has_its_rounding_in_the_sigma(bias_steps: float) -> None:
    t, step = np.arange(6000) / 50.0, math.radians(0.06)
    bias = step * (bias_steps + np.array([0.0, 3.0, -5.0]))
    rng = np.random.default_rng(3)
    rate = bias + 0.1 * step * rng.normal(size=(len(t), 3))
    force = 0.01 * rng.normal(size=(len(t), 3)) + [0.0, 0.0, GRAVITY]
    added = RestAndBias().process(scene(t, step * np.round(rate / step), force))
    error = (vector(added) - bias)[50 * 60 :] / vector(added, "gyro_bias_sd")[50 * 60 :]
    assert np.abs(error).max() < 3.0


@pytest.mark.parametrize("noise_steps", [0.01, 0.1])
def test_a_gyro_whose_equal_readings_begin_to_alternate_is_still_at_rest(noise_steps: float) -> None:
    """Its noise was not measurable, and its bias creeps to the limit between two readings."""
    t, step = np.arange(1200) / 20.0, math.radians(0.061)
    bias = step * np.column_stack([np.interp(t, [20.0, 25.0], [0.2, 0.5]), 0.1 + 0.0 * t, -0.1 + 0.0 * t])
    rng = np.random.default_rng(0)
    rate = bias + noise_steps * step * rng.normal(size=bias.shape)
    force = 0.005 * rng.normal(size=bias.shape) + [0.0, 0.0, GRAVITY]
    added = RestAndBias().process(scene(t, step * np.round(rate / step), force))
    assert (added["at_rest"][t > 5.0] == 1).all()
    assert np.abs((vector(added) - bias) / vector(added, "gyro_bias_sd"))[t > 5.0].max() < 3.0
