from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.cli.align_command import as_data, estimator_rows
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.estimation.alignment.stage import Alignment
from tests.estimation.alignment.units import (
    EARTH,
    INPUTS,
    MEMS_ARW,
    aligned,
    error_deg,
    in_pieces,
    samples,
    scenario,
)
from tests.lanes import texts

TURN = {"kind": "turn", "at_s": 80.0, "duration_s": 6.0, "heading_deg": 180.0}
KNOCK = {"kind": "bump", "frequency_hz": 25.0, "decay_s": 0.3, "acceleration_m_per_s2": [0.3, 0.2, 0.1]}


@pytest.mark.parametrize("axes", ["FRD", "FLU"])
@pytest.mark.parametrize(
    "attitude", [(0.0, 0.0, 200.0), (30.0, -50.0, 75.0), (180.0, 0.0, 10.0), (-95.0, 20.0, 300.0)]
)
def test_the_heading_is_found_in_any_attitude_and_axes(
    attitude: tuple[float, float, float], axes: str
) -> None:
    plan = scenario(120.0, attitude=attitude, axes=axes, arw=1e-4)
    stage, out = aligned(samples(plan), {"accel_bias_sd_ug": 300.0}, axes=axes)
    status = stage.status
    assert status.phase == "settled"
    assert status.estimates
    assert abs(error_deg(status.shown.heading, attitude[2])) < 0.03
    assert out["heading_sd"][-1] < math.radians(0.03)
    # Forward-left-up axes have the x axis of the unit, and y and z the other way: pitch is nose down.
    roll, pitch = np.deg2rad(attitude[:2])
    for name, expected in (("roll", roll), ("pitch", pitch if axes == "FRD" else -pitch)):
        assert abs(math.remainder(out[name][-1] - expected, 2.0 * math.pi)) < 2e-4


def test_a_vertical_x_axis_is_replaced_by_minus_z() -> None:
    # Pitched up by 90 degrees, z (FRD) points forwards, where x pointed before: -z is heading + 180.
    stage, _ = aligned(samples(scenario(100.0, attitude=(0.0, 90.0, 40.0))))
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 220.0)) < 0.05


@pytest.mark.parametrize(("seed", "bias"), [(0, 10.0), (1, 10.0), (2, 10.0), (0, 0.0)])
def test_a_mems_gyro_never_shows_a_north(seed: int, bias: float) -> None:
    plan = scenario(150.0, arw=MEMS_ARW, rate_hz=50.0, gyro_turn_on={"sd_deg_per_h": bias})
    stage, out = aligned(samples(plan, seed))
    assert stage.status.phase == "not observable"
    assert not stage.status.observable
    assert np.isnan(out["heading"]).all()
    assert out["heading_sd"][-1] > math.radians(15.0 if bias else 5.0)
    assert any("heading not observable: " in text for text in stage.notices())


def test_a_heading_that_is_not_observable_yet_is_no_verdict_on_the_gyro() -> None:
    stage, _ = aligned(samples(scenario(20.0, arw=MEMS_ARW, rate_hz=50.0)))
    assert stage.status.estimates
    assert stage.status.phase == "coarse"
    assert stage.status.heading_text == "no heading yet"


@pytest.mark.parametrize("declared", [100.0, 1000.0])
def test_a_mean_that_tells_nothing_is_any_angle_and_reported_as_such(declared: float) -> None:
    plan = scenario(40.0, arw=MEMS_ARW, rate_hz=50.0)
    stage, out = aligned(samples(plan), {"gyro_bias_sd_deg_per_h": declared})
    shown = {name: cells for name, *cells in estimator_rows(stage.status)}
    for name in ("gyro_mean", "hann_mean"):
        assert out[f"heading_{name}_sd"][-1] == ANY_ANGLE_SD
        assert shown[name.replace("_", " ")] == ["-", "not known"]
    told = as_data(stage.status)["estimators"]
    assert isinstance(told, dict)
    assert all(math.isnan(value) for value in told["gyro_mean"].values())


def test_a_quiet_vertical_gyro_makes_no_mean_of_the_level_ones_better() -> None:
    declared = {"gyro_bias_sd_deg_per_h": 1e-3, "accel_bias_sd_ug": 20.0}
    ratios = []
    for seed in range(6):
        block = samples(scenario(60.0, arw=0.05, rate_hz=20.0, warm_up=(0.0, 150.0)), seed)
        up = 0.1 * block["gyro_z"] - 0.9 * EARTH[2]
        stage, _ = aligned(block.with_columns({"gyro_z": up}), declared)
        mean = stage.status.estimates["gyro_mean"]
        ratios.append(error_deg(mean.heading, 30.0) / math.degrees(mean.sd))
    assert np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_a_declared_bias_counts_and_is_contradicted_when_it_is_too_small() -> None:
    block = samples(scenario(100.0, gyro_turn_on={"offset_deg_per_h": [0.0, 0.0, 6.0]}))
    declared = {"gyro_bias_sd_deg_per_h": 0.01}
    stage, _ = aligned(block, declared)
    assert any("contradict the declared bias" in text for text in stage.notices())
    expected = 0.1 / (15.041 * math.cos(math.radians(36.0)))
    # Or the unit has turned all along.
    assert stage.status.estimates
    assert stage.status.shown.sd > expected
    stage, _ = aligned(
        samples(scenario(100.0, gyro_turn_on={"offset_deg_per_h": [3.0, -3.0, 3.0]})), declared
    )
    assert not stage.status.observable
    stage, _ = aligned(samples(scenario(100.0)), {"gyro_bias_sd_deg_per_h": 0.1})
    assert stage.status.estimates
    assert stage.status.shown.sd == pytest.approx(expected, rel=0.1)


def test_a_bias_of_nothing_but_the_east_gyro_is_in_the_sigma_and_reported() -> None:
    block = samples(
        scenario(90.0, attitude=(0.0, 0.0, 0.0), gyro_turn_on={"offset_deg_per_h": [0.0, 3.0, 0.0]})
    )
    stage, _ = aligned(block)
    status = stage.status
    error = 14.0 if math.isnan(status.shown.heading) else 0.0
    error = error or error_deg(status.shown.heading, 0.0)
    assert status.estimates
    # Undisturbed the sigma is a fifth of a degree.
    assert abs(error) < 3.0 * math.degrees(status.shown.sd)
    assert math.degrees(status.shown.sd) > 5.0
    quiet, _ = aligned(samples(scenario(90.0)))
    (notice,) = (text for text in quiet.notices() if "turn-on bias is not declared" in text)
    assert "0.21 °/h of the gyro that points east turn the heading by 1°" in notice
    declared, _ = aligned(samples(scenario(90.0)), {"gyro_bias_sd_deg_per_h": 0.001})
    assert declared.notices() == []


@pytest.mark.parametrize("tilt_deg", [0.0, 0.005])
def test_a_knock_costs_its_seconds_and_no_more(tilt_deg: float) -> None:
    slam = {**KNOCK, "frequency_hz": 15.0, "tilt_deg": [tilt_deg, tilt_deg, 0.0], "at_s": 70.0}
    quiet, _ = aligned(samples(scenario(120.0)), {"gyro_bias_sd_deg_per_h": 0.0})
    stage, _ = aligned(samples(scenario(120.0, motion=[slam])), {"gyro_bias_sd_deg_per_h": 0.0})
    assert stage.notices() == []
    assert stage.status.positions == 1
    assert stage.status.rest_s > 119.0
    assert stage.status.estimates
    assert quiet.status.estimates
    assert stage.status.shown.sd < 1.3 * quiet.status.shown.sd
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 0.03


@pytest.mark.parametrize("rate_hz", [3.0, 100.0])
def test_results_do_not_depend_on_the_blocks(rate_hz: float) -> None:
    block = samples(scenario(60.0, rate_hz=rate_hz, motion=[{**KNOCK, "at_s": 45.0}]))
    _, whole = aligned(block)
    stage, n = Alignment(AlignmentParameters(), 36.0), len(block)
    pieces = in_pieces(stage, block, sorted({1, 2, n // 9, n // 9 + 1, n // 2, 3 * n // 4, 4 * n // 5}))
    assert whole.keys() == pieces.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(values, pieces[name], err_msg=name)


def test_readings_that_never_change_have_a_heading() -> None:
    block = samples(scenario(60.0, rate_hz=20.0))
    constant = {name: np.full(len(block), block[name].mean()) for name in INPUTS[2:]}
    stage, _ = aligned(block.with_columns(constant))
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 4.0 * math.degrees(stage.status.shown.sd) < 1.0


def test_rows_without_rates_gaps_and_restarts_are_survived() -> None:
    block = samples(scenario(150.0, rate_hz=100.0))
    columns = {name: block[name].copy() for name in INPUTS}
    columns["gyro_x"][3::7] = np.nan
    keep = np.ones(len(block), bool)
    keep[7000:7300] = False
    broken = SampleBlock({name: values[keep] for name, values in columns.items()})
    stage, _ = aligned(broken)
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 0.05
    again = SampleBlock({**broken.columns, "segment": broken["segment"] + 1})
    out = stage.process(again.rows(0, 100))
    assert np.isnan(out["heading"]).all()
    assert stage.status.phase == "coarse"


@pytest.mark.parametrize("seed", [11, 19])
def test_a_link_with_pauses_leaves_few_cells_and_an_honest_sigma(seed: int) -> None:
    block, rng = samples(scenario(110.0, rate_hz=20.0, arw=1e-3), seed), np.random.default_rng(seed)
    t, start = np.arange(len(block)) / 20.0, 6.0
    keep = np.ones(len(block), bool)
    while start < t[-1]:
        keep[(t >= start) & (t < start + 3.0)] = False
        start += 3.0 + rng.uniform(4.0, 14.0)
    received = SampleBlock({name: block[name][keep] for name in INPUTS})
    _, out = aligned(received, {"accel_bias_sd_ug": 30.0})
    shown = np.isfinite(out["heading"])
    off = np.remainder(out["heading"] - math.radians(30.0) + math.pi, 2.0 * math.pi) - math.pi
    assert shown.mean() > 0.8
    assert np.abs(off[shown] / out["heading_sd"][shown]).max() < 4.0


def test_after_a_gap_that_may_hide_a_turn_the_alignment_starts_anew() -> None:
    block = samples(scenario(120.0, rate_hz=20.0, arw=1e-3))
    seconds = block["device_time_ns"] * 1e-9
    kept = (seconds < 60.0) | (seconds >= 66.0)
    stage, out = aligned(SampleBlock({name: values[kept] for name, values in block.columns.items()}))
    assert np.isfinite(out["heading"][seconds[kept] < 60.0][-1])
    assert np.isnan(out["heading"][seconds[kept] >= 67.0][0])
    assert stage.status.rest_s == pytest.approx(54.0, abs=3.0)


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 1000.0])
def test_any_rate_will_do(rate_hz: float) -> None:
    stage, _ = aligned(samples(scenario(90.0, rate_hz=rate_hz)))
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 0.08


def test_a_device_of_a_sample_in_five_seconds_does_not_start_anew_at_each() -> None:
    block = samples(scenario(600.0, rate_hz=20.0))
    late = np.random.default_rng(0).integers(0, 3, len(block) // 100)
    kept = np.arange(len(late)) * 100 + late
    stage, _ = aligned(SampleBlock({name: values[kept] for name, values in block.columns.items()}))
    assert not [text for text in stage.notices() if "anew" in text]


def test_angles_that_a_device_sends_stay_its_own() -> None:
    block = samples(scenario(5.0, rate_hz=50.0))
    assert {"roll", "pitch"} <= {c.name for c in Alignment(None, 36.0).columns}
    assert "aligned_roll" in {c.name for c in Alignment(None, 36.0, sent=["roll"]).columns}
    stage, out = aligned(block.with_columns({"roll": np.zeros(len(block))}))
    assert "aligned_roll" in out
    assert "roll" not in out
    assert list(out) == [column.name for column in stage.columns]


def test_missing_sensors_give_nothing() -> None:
    block = samples(scenario(5.0, rate_hz=50.0))
    bare = SampleBlock({name: block[name] for name in ("device_time_ns", "segment", "gyro_x")})
    stage, out = aligned(bare)
    assert all(np.isnan(values).all() for values in out.values())
    assert stage.status.phase == "waiting"


def test_the_magnetic_heading_stands_beside() -> None:
    block = samples(scenario(60.0, rate_hz=50.0, arw=MEMS_ARW))
    n = len(block)
    # Body x 30 degrees east of magnetic north, FRD, field down as well.
    field = {"mag_x": 20.0 * math.cos(math.radians(30.0)), "mag_y": -20.0 * math.sin(math.radians(30.0))}
    _, out = aligned(
        block.with_columns({**{k: np.full(n, v) for k, v in field.items()}, "mag_z": np.full(n, 43.0)})
    )
    assert np.isnan(out["heading"]).all()
    assert abs(error_deg(out["heading_magnetic"][-1], 30.0)) < 0.1


def test_charts_and_lanes_say_where_it_stands() -> None:
    stage, block = Alignment(AlignmentParameters(), 36.0), samples(scenario(90.0))
    in_pieces(stage, block, range(1000, len(block), 1000))
    assert texts(stage) == {"alignment": "settled", "heading by": "joint fit"}
    (progress,) = stage.charts()
    shown = stage.status.shown
    assert progress.headline == f"{math.degrees(shown.heading):.3f}° ± {math.degrees(shown.sd):.3f}°; settled"
    sigma, wanted = progress.curves
    assert sigma.y[-1] == pytest.approx(math.degrees(shown.sd), rel=0.05)
    assert (wanted.y == 0.05).all()


def test_without_an_observable_heading_the_chart_and_lanes_report_it() -> None:
    block = samples(scenario(100.0, arw=MEMS_ARW, rate_hz=50.0))
    stage, _ = aligned(block)
    # One block gives one point only; the chart needs a second.
    stage.process(samples(scenario(110.0, arw=MEMS_ARW, rate_hz=50.0)).rows(5000, 5500))
    assert "heading not observable" in stage.charts()[0].headline
    assert texts(stage) == {"alignment": "not observable", "heading by": "none yet"}
    assert all(math.isnan(estimate.heading) for estimate in stage.status.estimates.values())


def test_a_known_warm_up_tells_a_tilt_from_a_drift() -> None:
    known = {"amplitude_ug": [83.7, 83.7, 0.0], "time_constant_s": 150.0, "amplitude_sd_ug": 2.0}
    sinking = {"kind": "rotation", "at_s": 5.0, "duration_s": 500.0, "pitch_deg_per_s": 2e-5}
    block = samples(scenario(200.0, warm_up=(83.7, 150.0), motion=[sinking]))
    stage, _ = aligned(block, {"known_warm_up": known})
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 3.0 * math.degrees(stage.status.shown.sd)
    assert abs(error_deg(stage.status.estimates["gyro_mean"].heading, 30.0)) > 0.1


def test_a_known_warm_up_keeps_its_time_constant() -> None:
    # What remains of a warm-up has its time constant, which a settling tripod may have as well.
    known = {"amplitude_ug": [83.7, 83.7, 0.0], "time_constant_s": 20.0, "amplitude_sd_ug": 20.0}
    stage, _ = aligned(samples(scenario(150.0, warm_up=(113.7, 20.0))), {"known_warm_up": known})
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 0.03


def test_a_tripod_that_begins_to_sink_is_in_the_sigma() -> None:
    sinking = {"kind": "rotation", "at_s": 100.0, "duration_s": 500.0, "pitch_deg_per_s": 2e-5}
    stage, _ = aligned(samples(scenario(300.0, warm_up=(1e-3, 100.0), motion=[sinking])))
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 3.0 * math.degrees(stage.status.shown.sd)


@pytest.mark.parametrize("tau_s", [80.0, 300.0])
def test_a_warm_up_is_not_taken_for_a_tilt(tau_s: float) -> None:
    stage, _ = aligned(samples(scenario(120.0, warm_up=(83.7, tau_s))))
    assert stage.status.phase == "settled"


def test_a_turn_is_measured_and_separates_the_bias() -> None:
    turn = {"kind": "turn", "at_s": 90.0, "duration_s": 4.0, "heading_deg": 180.0}
    plan = scenario(190.0, motion=[turn], gyro_turn_on={"offset_deg_per_h": [2.0, -3.0, 1.0]})
    stage, out = aligned(samples(plan))
    assert stage.status.positions == 2
    assert math.degrees(abs(stage.status.turned)) == pytest.approx(180.0, abs=0.05)
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 210.0)) < 0.1
    assert math.degrees(stage.status.shown.sd) < 0.2
    # One position alone does not know the bias, and says so.
    assert not out["heading_sd"][80 * 200] < math.radians(10.0)


@pytest.mark.parametrize("angle", [60.0, -90.0])
def test_any_turn_will_do_and_the_heading_goes_on_while_it_turns(angle: float) -> None:
    turn = {"kind": "turn", "at_s": 60.0, "duration_s": 10.0, "heading_deg": angle}
    plan = scenario(130.0, motion=[turn], gyro_turn_on={"offset_deg_per_h": [0.3, 0.3, 0.1]})
    stage, out = aligned(samples(plan))
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.0 + angle)) < 4.0 * math.degrees(
        stage.status.shown.sd
    )
    assert math.degrees(stage.status.shown.sd) < 0.3
    turning = np.rad2deg(out["heading"][65 * 200 : 66 * 200])
    assert np.isfinite(turning).all()
    assert abs(error_deg(np.deg2rad(turning[100]), 30.0 + 0.55 * angle)) < 10.0


def test_someone_who_leans_on_the_table_and_turns_it_is_followed() -> None:
    lean = {"kind": "turn", "at_s": 80.0, "duration_s": 1.0, "roll_deg": 0.02, "heading_deg": 0.3}
    stage, _ = aligned(samples(scenario(140.0, motion=[lean])))
    assert stage.status.phase == "settled"
    assert stage.status.estimates
    assert abs(error_deg(stage.status.shown.heading, 30.3)) < 0.05
    assert any("by 0.30° ±" in text for text in stage.notices())


def test_what_the_rest_detector_sees_counts() -> None:
    block = samples(scenario(60.0, rate_hz=100.0))
    moving = np.zeros(len(block), np.int64)
    stage, out = aligned(block.with_columns({"at_rest": moving}))
    assert stage.status.phase == "coarse"
    assert np.isnan(out["heading"]).all()
    late = np.ones(len(block), np.int64)
    late[:800] = 0  # it takes the detector a while; the unit rested all the time
    stage, out = aligned(block.with_columns({"at_rest": late}))
    assert stage.status.rest_s == pytest.approx(59.75, abs=0.5)


def test_it_goes_on_from_a_snapshot() -> None:
    block = samples(scenario(60.0, rate_hz=100.0, motion=[{**KNOCK, "at_s": 35.0}]))
    first = Alignment(AlignmentParameters(), 36.0)
    first.process(block.rows(0, 3333))
    second = pickle.loads(pickle.dumps(first))
    rest = block.rows(3333, len(block))
    expected, found = first.process(rest), second.process(rest)
    for name, values in expected.items():
        np.testing.assert_array_equal(values, found[name], err_msg=name)


@pytest.mark.parametrize("latitude", [35.0, 37.0])
@pytest.mark.parametrize("declared", [{}, {"gyro_bias_sd_deg_per_h": 0.0035}])
def test_a_latitude_that_is_wrong_by_a_degree_is_in_the_sigma(
    latitude: float, declared: dict[str, float]
) -> None:
    # The lengths of the rates do not fit, as with a large bias.
    plan = scenario(150.0, arw=1e-3, rate_hz=20.0, warm_up=(0.0, 100.0))
    stage, _ = aligned(samples(plan), {"accel_bias_sd_ug": 30.0} | declared, latitude)
    assert math.degrees(stage.status.shown.sd) > 1.0
    assert any("contradict the declared bias" in notice for notice in stage.notices()) == bool(declared)


@pytest.mark.parametrize("gyro_every", [1, 2])
def test_gyros_and_accelerometers_in_rows_of_their_own_are_aligned(gyro_every: int) -> None:
    """They were dropped, and the turn of a sensor that is faster than the other lost rows."""
    block = samples(scenario(180.0, rate_hz=100.0, motion=[TURN]), seed=3)
    row = np.arange(len(block))
    for axis in "xyz":
        block[f"accel_{axis}"][row % 2 == 0] = np.nan
        block[f"gyro_{axis}"][row % gyro_every == 1] = np.nan
    _, found = aligned(block)
    assert abs(error_deg(found["heading"][-1], 210.0)) < 4.0 * np.degrees(found["heading_sd"][-1]) < 0.5
