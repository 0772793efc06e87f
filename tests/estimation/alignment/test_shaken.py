"""What shakes a unit for seconds must not cost what it told in minutes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from tests.estimation.alignment.units import aligned, error_deg, samples, scenario
from tests.lanes import texts

ARW, RATE_HZ, DISTURBED_S = 1e-3, 50.0, 120.0


def _shaken(seconds: float, angle: FloatArray, seed: int = 0) -> SampleBlock:
    """Return what a level unit sends that is turned by small angles, (n, 3), about its axes (FRD)."""
    plan = scenario(
        seconds, arw=ARW, rate_hz=RATE_HZ, warm_up=(1e-3, 100.0),
        accel_noise={"vrw_m_per_s_per_sqrt_s": 5e-5},
    )  # fmt: skip
    block = samples(plan, seed)
    rate = np.diff(angle, axis=0, append=angle[-1:]) * RATE_HZ
    columns = {f"gyro_{axis}": block[f"gyro_{axis}"] + rate[:, k] for k, axis in enumerate("xyz")}
    columns["accel_x"] = block["accel_x"] + STANDARD_GRAVITY * angle[:, 1]
    columns["accel_y"] = block["accel_y"] - STANDARD_GRAVITY * angle[:, 0]
    return block.with_columns(columns)


def _time(seconds: float) -> FloatArray:
    return np.asarray(np.arange(round(seconds * RATE_HZ)) / RATE_HZ, np.float64)


@pytest.mark.parametrize("until_s", [1.2, 3.0, 25.0])
def test_a_recording_may_begin_in_the_hand(until_s: float) -> None:
    t = _time(150.0)
    left = np.clip((until_s - t) / 1.5, 0.0, 1.0)[:, None]
    swing = 0.2 * np.sin(2.0 * math.pi * np.outer(t, [0.7, 1.1, 0.4]) + [0.3, 1.0, 2.0])
    stage, _ = aligned(_shaken(150.0, swing * left**2 * (3.0 - 2.0 * left)))
    status = stage.status
    assert status.rest_s == pytest.approx(150.0 - until_s, abs=2.0)
    assert status.positions == 1
    assert status.estimates
    assert math.degrees(status.shown.sd) < 0.1
    assert abs(error_deg(status.shown.heading, 30.0)) < 4.0 * math.degrees(status.shown.sd)


def test_a_pause_of_the_link_in_the_hand_is_no_rest() -> None:
    t = _time(100.0)
    block = _shaken(
        100.0, np.outer(np.sin(0.6 * math.pi * t) * np.clip((20.0 - t) / 3.0, 0.0, 1.0), [0, 0, 0.3])
    )
    received = np.flatnonzero((t < 8.3) | (t > 10.8))
    stage, _ = aligned(SampleBlock({name: values[received] for name, values in block.columns.items()}))
    assert stage.status.rest_s > 75.0
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 4.0 * math.degrees(stage.status.shown.sd)


@pytest.mark.parametrize("tau_s", [1.0, 10.0])
def test_a_turn_that_dies_away_at_the_start_hides_no_north(tau_s: float) -> None:
    t = _time(300.0)
    stage, _ = aligned(_shaken(300.0, np.outer(np.exp(-t / tau_s), [0.0, 2e-3, 5e-2])))
    assert stage.status.estimates
    assert math.degrees(stage.status.shown.sd) < 0.15
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 4.0 * math.degrees(stage.status.shown.sd)


def _lorry(t: FloatArray, amplitude: float) -> FloatArray:
    near = amplitude * np.exp(-(((t - DISTURBED_S) / 8.0) ** 2))
    return np.column_stack([near * np.sin(2.0 * math.pi * 1.3 * t), near, np.zeros(len(t))])


def _door(t: FloatArray, amplitude: float) -> FloatArray:
    since = np.maximum(t - DISTURBED_S, 0.0)
    swing = np.sin(2.0 * math.pi * np.outer(since, [5.0, 6.0, 4.0]))
    return np.asarray(amplitude * np.exp(-since / 2.0)[:, None] * swing)


@pytest.mark.parametrize(
    ("what", "amplitude"), [(_lorry, 3e-6), (_lorry, 3e-4), (_door, 3e-5), (_door, 3e-4), (_door, 3e-3)]
)
def test_one_lorry_or_door_leaves_the_heading_as_good_as_it_was(what: object, amplitude: float) -> None:
    assert callable(what)
    # A fit soon after it holds sigma up until the record is twice as long.
    stage, out = aligned(_shaken(320.0, what(_time(320.0), amplitude)))
    status = stage.status
    before = out["heading_sd"][round(95.0 * RATE_HZ)]
    assert not any("anew" in text for text in stage.notices())
    assert status.positions == 1
    assert status.estimates
    assert status.shown.sd < 1.5 * before
    assert abs(error_deg(status.shown.heading, 30.0)) < 4.0 * math.degrees(status.shown.sd)


def test_a_detector_that_sees_no_rest_in_a_sway_stops_nothing() -> None:
    t = _time(240.0)
    swell = 1e-3 * np.sin(2.0 * math.pi * np.outer(t, [1 / 14.0, 1 / 14.7, 0.0]))
    block = _shaken(240.0, swell)
    at_rest = (t < 8.0).astype(np.int64)
    stage, _ = aligned(block.with_columns({"at_rest": at_rest}))
    assert not any("anew" in text for text in stage.notices())
    assert stage.status.positions == 1
    assert stage.status.rest_s > 200.0
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 3.0 * math.degrees(stage.status.shown.sd)
    assert math.degrees(stage.status.shown.sd) < 2.0


def test_a_turn_by_hand_is_a_motion_after_a_sway_too() -> None:
    t = _time(100.0)
    sway = 7e-3 * np.sin(0.4 * math.pi * t) * (t < 30.0)
    stage, _ = aligned(
        _shaken(100.0, np.outer(sway + math.radians(1.5) * np.clip(t - 40.0, 0, 30), [0, 0, 1.0]))
    )
    assert stage.status.positions == 2


def test_a_sway_faster_than_the_motion_limit_becomes_rest() -> None:
    # The record begins around a peak of the rate, which is calm for 2 s.
    sway = 2e-3 * np.sin(0.2 * math.pi * _time(240.0) - 0.63)
    stage, _ = aligned(_shaken(240.0, np.outer(sway, [1.0, 1.0, 0.0])))
    status = stage.status
    assert status.rest_s > 200.0
    assert status.estimates
    assert math.degrees(status.shown.sd) < 0.3
    assert abs(error_deg(status.shown.heading, 30.0)) < 4.0 * math.degrees(status.shown.sd)


def test_a_heading_that_a_sway_hides_is_not_blamed_on_the_gyros_alone() -> None:
    # Less than two periods in the record.
    sway = 2e-3 * np.sin(2.0 * math.pi * 0.01 * _time(140.0))
    stage, _ = aligned(_shaken(140.0, np.outer(sway, [1.0, 0.5, 0.0])))
    assert texts(stage)["alignment"] == "not observable"
    assert stage.status.heading_text == "heading not observable"
    assert stage.status.to_go_text.endswith("or slow motion of the unit")
    (notice,) = stage.notices()
    assert "or the unit sways" in notice


def test_a_record_that_never_has_a_fit_is_not_observable_either() -> None:
    # Slower than the noise shows as motion, and it changes all the time.
    creep = 3.8e-3 * np.cos(2.0 * math.pi / 30.0 * _time(120.0))
    stage, _ = aligned(_shaken(120.0, np.outer(creep, [0.0, 0.0, 1.0])))
    assert not stage.status.estimates
    assert texts(stage)["alignment"] == "not observable"
    assert any("creeps" in text for text in stage.notices())
