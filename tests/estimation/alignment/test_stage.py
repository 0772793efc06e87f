from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.estimation.alignment.charting import to_go_text
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.simulation.unit.scenario import load_scenario
from tests.estimation.alignment.units import (
    INPUTS,
    MEMS_ARW,
    aligned,
    error_deg,
    in_pieces,
    samples,
    scenario,
)

KNOCK = {"kind": "bump", "frequency_hz": 25.0, "decay_s": 0.3, "acceleration_m_per_s2": [0.3, 0.2, 0.1]}


@pytest.mark.parametrize("axes", ["FRD", "FLU"])
@pytest.mark.parametrize(
    "attitude", [(0.0, 0.0, 200.0), (30.0, -50.0, 75.0), (180.0, 0.0, 10.0), (-95.0, 20.0, 300.0)]
)
def test_the_heading_is_found_in_any_attitude_and_axes(
    attitude: tuple[float, float, float], axes: str
) -> None:
    stage, out = aligned(samples(scenario(120.0, attitude=attitude, axes=axes, arw=1e-4)), axes=axes)
    standing = stage.standing
    assert standing.phase == "settled"
    assert standing.shown is not None
    assert abs(error_deg(standing.shown.heading, attitude[2])) < 0.03
    assert out["heading_sd"][-1] < math.radians(0.03)
    expected = np.deg2rad(attitude[1])
    assert out["pitch"][-1] == pytest.approx(expected if axes == "FRD" else -expected * 1.0, abs=2e-4) or (
        axes == "FLU"
    )


def test_a_vertical_x_axis_is_replaced_by_minus_z() -> None:
    # Pitched up by 90 degrees, z (FRD) points forwards, where x pointed before: -z is heading + 180.
    stage, _ = aligned(samples(scenario(100.0, attitude=(0.0, 90.0, 40.0))))
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 220.0)) < 0.05


def test_the_estimators_err_as_the_warm_up_makes_them() -> None:
    block = samples(scenario(180.0, arw=1e-5, warm_up=(83.7, 300.0), attitude=(0.0, 0.0, 0.0)))
    stage, _ = aligned(block)
    found = {name: error_deg(e.heading, 0.0) for name, e in stage.standing.estimates.items()}
    assert abs(found["tilt_corrected"]) < 0.002
    # (Φ(T) - Φ(0)) / (T Ω cos L) between 35 and 180 s; both level axes drift, the east rate counts.
    drift = 83.7e-6 * (math.exp(-35 / 300) - math.exp(-180 / 300)) / 145.0
    expected = math.degrees(drift / (7.292115e-5 * math.cos(math.radians(36.0))))
    assert abs(found["total_average"]) == pytest.approx(expected, rel=0.03)
    assert abs(found["curve_fit"]) == pytest.approx(expected, rel=0.1)
    assert abs(found["line_exponential"]) < 0.3 * expected
    sd = {name: math.degrees(e.sd) for name, e in stage.standing.estimates.items()}
    assert 0.5 * expected < sd["total_average"] < 2.0 * expected
    assert stage.standing.chosen == "tilt_corrected"


def test_a_known_warm_up_is_taken_off() -> None:
    block = samples(scenario(180.0, attitude=(0.0, 0.0, 30.0), warm_up=(83.7, 300.0)))
    known = {"known_warm_up": {"amplitude_ug": [83.7, 83.7, 0.0], "time_constant_s": 300.0}}
    stage, out = aligned(block, known)
    found = stage.standing.estimates["known_warm_up"]
    assert abs(error_deg(found.heading, 30.0)) < 0.02
    assert found.sd < math.radians(0.05)
    assert "heading_known_warm_up" in out


@pytest.mark.parametrize("seed", range(3))
def test_a_mems_gyro_never_shows_a_north(seed: int) -> None:
    plan = scenario(150.0, arw=MEMS_ARW, rate_hz=50.0, gyro_turn_on={"sd_deg_per_h": 10.0})
    stage, out = aligned(samples(plan, seed))
    assert stage.standing.phase == "not observable"
    assert not stage.standing.observable
    assert np.isnan(out["heading"]).all()
    assert out["heading_sd"][-1] > math.radians(15.0)
    assert any("heading not observable with this gyro" in text for text in stage.notices())


def test_a_mems_gyro_whose_bias_happens_to_be_nought_shows_no_north_either() -> None:
    stage, out = aligned(samples(scenario(150.0, arw=MEMS_ARW, rate_hz=50.0)))
    assert not stage.standing.observable
    assert np.isnan(out["heading"]).all()


def test_a_declared_bias_counts_and_is_contradicted_when_it_is_too_small() -> None:
    block = samples(scenario(100.0, gyro_turn_on={"offset_deg_per_h": [0.0, 0.0, 6.0]}))
    stage, _ = aligned(block, {"gyro_bias_sd_deg_per_h": 0.01})
    assert any("contradict the declared bias" in text for text in stage.notices())
    assert not stage.standing.observable
    stage, _ = aligned(samples(scenario(100.0)), {"gyro_bias_sd_deg_per_h": 0.1})
    assert stage.standing.shown is not None
    expected = 0.1 / (15.041 * math.cos(math.radians(36.0)))
    assert stage.standing.shown.sd == pytest.approx(expected, rel=0.1)


def test_a_knock_is_left_out_and_said() -> None:
    block = samples(scenario(120.0, motion=[{**KNOCK, "at_s": 70.0}]))
    stage, _ = aligned(block)
    texts = stage.notices()
    assert any("at 70." in text and "left out" in text for text in texts), texts
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.0)) < 0.05
    assert stage.notices() == []


def test_a_knock_in_the_coarse_alignment_begins_it_anew() -> None:
    plan = scenario(80.0, motion=[{**KNOCK, "at_s": 20.0}])
    _, out = aligned(samples(plan))
    begun = int(np.flatnonzero(np.isfinite(out["roll"]))[0]) / 200.0
    assert 50.0 < begun < 58.0


def test_someone_who_leans_on_the_table_and_turns_it_is_followed() -> None:
    lean = {"kind": "turn", "at_s": 80.0, "duration_s": 1.0, "roll_deg": 0.02, "heading_deg": 0.3}
    stage, _ = aligned(samples(scenario(140.0, motion=[lean])))
    assert stage.standing.phase == "settled"
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.3)) < 0.05
    assert any("left out" in text for text in stage.notices())


def test_a_unit_that_was_turned_aligns_anew() -> None:
    turn = {"kind": "turn", "at_s": 60.0, "duration_s": 3.0, "heading_deg": 90.0}
    stage, _ = aligned(samples(scenario(160.0, motion=[turn])))
    assert any("starts anew" in text for text in stage.notices())
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 120.0)) < 0.05


def test_a_sinking_tripod_is_told_from_a_warm_up() -> None:
    sinking = {"kind": "rotation", "at_s": 100.0, "duration_s": 500.0, "pitch_deg_per_s": 2e-5}
    stage, _ = aligned(samples(scenario(300.0, warm_up=(1e-3, 100.0), motion=[sinking])))
    assert any("tilting" in text for text in stage.notices())
    assert stage.standing.chosen != "tilt_corrected"
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.0)) < 3.0 * math.degrees(stage.standing.shown.sd)


def test_results_do_not_depend_on_the_blocks() -> None:
    block = samples(scenario(60.0, rate_hz=100.0, motion=[{**KNOCK, "at_s": 45.0}]))
    _, whole = aligned(block)
    stage = Alignment(AlignmentParameters(), 36.0)
    pieces = in_pieces(stage, block, sorted({1, 2, 700, 701, 3150, 4444, 4501, 4700}))
    assert whole.keys() == pieces.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(values, pieces[name], err_msg=name)


def test_rows_without_rates_gaps_and_restarts_are_survived() -> None:
    block = samples(scenario(150.0, rate_hz=100.0))
    columns = {name: block[name].copy() for name in INPUTS}
    columns["gyro_x"][3::7] = np.nan
    keep = np.ones(len(block), bool)
    keep[7000:7300] = False
    broken = SampleBlock({name: values[keep] for name, values in columns.items()})
    stage, _ = aligned(broken)
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.0)) < 0.05
    again = SampleBlock({**broken.columns, "segment": broken["segment"] + 1})
    out = stage.process(again.rows(0, 100))
    assert np.isnan(out["heading"]).all()
    assert stage.standing.phase == "coarse"


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 1000.0])
def test_any_rate_will_do(rate_hz: float) -> None:
    stage, _ = aligned(samples(scenario(90.0, rate_hz=rate_hz)))
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.0)) < 0.08


def test_motion_that_the_rest_detector_sees_counts() -> None:
    block = samples(scenario(60.0, rate_hz=100.0))
    at_rest = np.zeros(len(block), np.int64)
    stage, out = aligned(block.with_columns({"at_rest": at_rest}))
    assert stage.standing.phase == "coarse"
    at_rest = np.ones(len(block), np.int64)
    at_rest[4000:4100] = 0
    stage, out = aligned(block.with_columns({"at_rest": at_rest}))
    assert any("the unit moved" in text for text in stage.notices())
    assert np.isfinite(out["heading"][-1])


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
    assert stage.standing.phase == "waiting"


def test_the_magnetic_heading_stands_beside() -> None:
    block = samples(scenario(60.0, rate_hz=50.0, arw=MEMS_ARW))
    n = len(block)
    # Body x 30 degrees east of magnetic north, FRD, field down as well.
    field = {"mag_x": 20.0 * math.cos(math.radians(30.0)), "mag_y": -20.0 * math.sin(math.radians(30.0))}
    stage, out = aligned(
        block.with_columns({**{k: np.full(n, v) for k, v in field.items()}, "mag_z": np.full(n, 43.0)})
    )
    assert np.isnan(out["heading"]).all()
    assert abs(error_deg(stage.standing.magnetic, 30.0)) < 0.1


def test_charts_and_lanes_say_where_it_stands() -> None:
    stage, block = Alignment(AlignmentParameters(), 36.0), samples(scenario(90.0))
    in_pieces(stage, block, range(1000, len(block), 1000))
    assert stage.lanes() == {"alignment": "settled", "heading by": "tilt corrected"}
    headings, progress, integral = stage.charts()
    assert [curve.name for curve in headings.curves] == [
        "total average", "curve fit", "line exponential", "tilt corrected",
    ]  # fmt: skip
    assert "29.98" in headings.x.label
    assert "(tilt corrected)" in headings.x.label
    assert progress.x.label.endswith("settled")
    sigma, wanted = progress.curves
    assert sigma.y[-1] == pytest.approx(math.degrees(stage.standing.shown.sd), rel=0.05)  # type: ignore[union-attr]  # it is settled
    assert (wanted.y == 0.05).all()
    assert [curve.name for curve in integral.curves] == ["east", "line east", "north", "line north"]


def test_the_way_to_the_sigma_wanted_is_told_step_by_step() -> None:
    stage, block = Alignment(AlignmentParameters(), 36.0), samples(scenario(90.0, arw=3e-3))
    said = [to_go_text(stage.standing, 0.05)]
    for start in range(0, len(block), 2000):
        stage.process(block.rows(start, start + 2000))
        said.append(to_go_text(stage.standing, 0.05))
    assert said[0] == "0 of 30 s of coarse alignment"
    assert "the loop settles" in said
    assert said[2].endswith("of 30 s of coarse alignment")
    assert said[-1].startswith("about ") or "not in reach" in said[-1]


def test_without_an_observable_heading_the_chart_shows_what_the_device_says_as_such() -> None:
    block = samples(scenario(100.0, arw=MEMS_ARW, rate_hz=50.0))
    stage, _ = aligned(block.with_columns({"yaw": np.full(len(block), math.radians(-100.0))}))
    # One block gives one point only; the chart needs a second.
    stage.process(samples(scenario(110.0, arw=MEMS_ARW, rate_hz=50.0)).rows(5000, 5500))
    text = stage.charts()[0].x.label
    assert "heading not observable with this gyro; shown instead: the device's own yaw 260.0°" in text
    assert stage.lanes() == {
        "alignment": "not observable with this gyro", "heading by": "the device's own yaw",
    }  # fmt: skip
    assert all(math.isnan(estimate.heading) for estimate in stage.standing.estimates.values())


def test_how_well_the_warm_up_is_known_tells_a_tilt_at_a_constant_rate() -> None:
    sinking = {"kind": "rotation", "at_s": 5.0, "duration_s": 500.0, "pitch_deg_per_s": 2e-5}
    block = samples(scenario(200.0, warm_up=(83.7, 150.0), motion=[sinking]))
    known = {"amplitude_ug": [83.7, 83.7, 0.0], "time_constant_s": 150.0, "amplitude_sd_ug": 2.0}
    stage, _ = aligned(block, {"known_warm_up": known})
    assert stage.standing.tilting
    assert stage.standing.chosen == "known_warm_up"
    assert stage.standing.shown is not None
    assert abs(error_deg(stage.standing.shown.heading, 30.0)) < 3.0 * math.degrees(stage.standing.shown.sd)
    assert abs(error_deg(stage.standing.estimates["tilt_corrected"].heading, 30.0)) > 0.1


def test_a_gyro_that_drifts_with_temperature_is_not_taken_for_a_tilt() -> None:
    stage = Alignment(AlignmentParameters(), 40.93)
    stage.process(samples(load_scenario("crs05-ramp")))
    assert not stage.standing.observable
    assert not stage.standing.tilting
    assert not any("tilting" in text for text in stage.notices())
