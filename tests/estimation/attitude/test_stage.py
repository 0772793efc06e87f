from __future__ import annotations

import pickle
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import NO_INT, FloatArray, SampleBlock
from imumon.config import parse_yaml
from imumon.estimation.attitude.fusion import ROW
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.sigma import Accelerometers, Gyros, HeadingSigma, Slot
from imumon.estimation.attitude.stage import AttitudeEstimate, tilt_into_heading
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.model import MagnetometerModel
from tests.estimation.attitude.scenes import NORTH_DEG, matrices, scene, without_mag, wrapped
from tests.lanes import texts

Q = [f"attitude_estimate_{part}" for part in "wxyz"]
CALIBRATED = MagnetometerModel(
    unit="uT",
    hard_iron=[0.0] * 3,
    hard_iron_sd=[0.05] * 3,
    soft_iron=np.eye(3).tolist(),
    soft_iron_sd=np.full((3, 3), 1e-3).tolist(),
    field=47.43,
    residual_sd=0.1,
    coverage=1.0,
)


def estimated(block: SampleBlock, stage: AttitudeEstimate) -> SampleBlock:
    block = block.with_columns(RestAndBias(mode="learned").process(block))
    return SampleBlock(dict(stage.process(block)))


@pytest.mark.parametrize("axes", ["FRD", "FLU"])
@pytest.mark.parametrize("rate_hz", [50.0, 400.0])
def test_it_follows_turns_and_its_errors_are_as_its_sigma_states(
    axes: Literal["FRD", "FLU"], rate_hz: float
) -> None:
    # The simulated gyros have no error of scale; three mg are drawn for the accelerometers.
    given = AttitudeParameters(gyro_scale=1e-3, accel_bias_m_per_s2=0.03)
    for seed in (1, 2):
        made = scene(axes, rate_hz, seed=seed)
        stage = AttitudeEstimate(given, axes, CALIBRATED)
        found = estimated(made.block, stage)
        turn = matrices(np.column_stack([found[name] for name in Q])) @ np.swapaxes(made.attitude, 1, 2)
        later = np.isfinite(found["attitude_estimate_heading_sd"])
        # While the first turn of 90° goes on no gyro is confirmed: its sigma would be more than a radian.
        assert later[int(30 * rate_hz) : int(40 * rate_hz)].all()
        assert later[int(46 * rate_hz) :].all()
        tilt = (
            np.column_stack([turn[:, 1, 2], turn[:, 0, 2]])
            / found["attitude_estimate_tilt_sd"][:, np.newaxis]
        )
        heading = found["attitude_estimate_heading"] - np.arctan2(
            made.attitude[:, 0, 0], made.attitude[:, 1, 0]
        )
        error = wrapped(heading + np.radians(NORTH_DEG)) / found["attitude_estimate_heading_sd"]
        assert np.sqrt(np.mean(tilt[later] ** 2)) < 1.8
        assert np.abs(tilt[later]).max() < 5.0
        assert np.sqrt(np.mean(error[later] ** 2)) < 1.8
        assert np.abs(error[later]).max() < 5.0
        settled = later & made.at_rest & (np.arange(len(later)) > 100 * rate_hz)
        assert found["attitude_estimate_heading_sd"][settled].max() < np.radians(3.6)
        # Of a single pose the magnitude says little of what the accelerometers are off by: 0.18° is declared.
        assert found["attitude_estimate_tilt_sd"][settled].max() < np.radians(0.4)
        assert texts(stage) == {"attitude": "magnetic north"}
        assert (found["attitude_estimate_north"][later] == 1).all()


@pytest.mark.parametrize("axes", ["FRD", "FLU"])
def test_roll_and_pitch_are_those_that_the_device_would_send(axes: Literal["FRD", "FLU"]) -> None:
    made = scene(axes)
    found = estimated(made.block, AttitudeEstimate(axes=axes))
    up = made.attitude[:, 2] * (-1.0 if axes == "FRD" else 1.0)
    late = slice(1000, None)
    roll, pitch = np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(up[:, 0])
    assert np.abs(found["attitude_estimate_roll"] - roll)[late].max() < np.radians(1.0)
    assert np.abs(found["attitude_estimate_pitch"] - pitch)[late].max() < np.radians(1.0)
    unknown = estimated(made.block, AttitudeEstimate())
    np.testing.assert_array_equal(unknown["attitude_estimate_roll"], found["attitude_estimate_roll"])


def test_without_a_magnetometer_the_heading_is_free_and_its_change_has_a_sigma() -> None:
    for seed in (1, 2, 3):
        made = scene(seed=seed)
        stage = AttitudeEstimate(AttitudeParameters(gyro_scale=1e-3), "FRD", heading_deg=10.0)
        found = estimated(without_mag(made.block), stage)
        heading = np.unwrap(found["attitude_estimate_heading"][20:])
        true = np.unwrap(np.arctan2(made.attitude[20:, 0, 0], made.attitude[20:, 1, 0]))
        assert wrapped(heading[:1] - np.radians(10.0)) == pytest.approx(0.0, abs=0.01)
        error = heading - true - (heading - true)[3000]
        sd = found["attitude_estimate_heading_sd"][20:]
        assert np.degrees(sd[-1]) < 2.0
        assert abs(error[-1]) < 4.0 * sd[-1]
        known = np.flatnonzero(np.isfinite(sd))
        moved = wrapped(error - error[known[0]])[known[1:]]
        assert np.abs(moved / sd[known[1:]]).max() < 4.0  # at every sample, that of the first motion too
        assert np.isnan(sd[0])  # nothing is known of the bias yet
        assert (found["attitude_estimate_north"][20:] == 0).all()
        assert texts(stage) == {"attitude": "relative heading"}
        assert [text for text in stage.notices() if "heading is relative; it counts from 10°" in text]


def test_a_restart_while_it_turns_takes_nothing_from_what_is_known_of_the_gyros() -> None:
    made = scene()
    turning = int(np.flatnonzero(made.at_rest == 0)[60])
    block = without_mag(made.block).with_columns(
        {"segment": (np.arange(len(made.at_rest)) >= turning).astype(np.int64)}
    )
    found = estimated(block, AttitudeEstimate(axes="FRD"))
    known = np.isfinite(found["attitude_estimate_tilt_sd"])
    assert known[turning - 1]
    assert known[-1]


def test_a_heading_at_rest_does_not_drift() -> None:
    made = scene(turns=False)
    found = estimated(without_mag(made.block), AttitudeEstimate(axes="FRD"))
    heading = np.unwrap(found["attitude_estimate_heading"][1500:])
    assert np.ptp(heading) < np.radians(0.02)  # the bias alone would turn it by seven degrees


@pytest.mark.long
def test_mixed_up_axes_are_reported_and_are_in_the_sigma_of_tilt_and_heading() -> None:
    made = scene()
    mixed = without_mag(made.block).with_columns({"gyro_z": -made.block["gyro_z"]})
    right, stage = AttitudeEstimate(axes="FRD"), AttitudeEstimate(axes="FRD")
    usual = estimated(without_mag(made.block), right)["attitude_estimate_tilt_sd"]
    wrong = estimated(mixed, stage)["attitude_estimate_tilt_sd"]
    assert [text for text in stage.notices() if "are axes, signs and units right?" in text]
    assert not [text for text in right.notices() if "right?" in text]
    found = estimated(mixed, AttitudeEstimate(axes="FRD"))
    heading = np.unwrap(found["attitude_estimate_heading"][3000:])
    off = heading - np.unwrap(np.arctan2(made.attitude[3000:, 0, 0], made.attitude[3000:, 1, 0]))
    known = np.isfinite(found["attitude_estimate_heading_sd"][3000:])
    ratio = (wrapped(off - off[0]) / found["attitude_estimate_heading_sd"][3000:])[known]
    assert known[0]
    assert not known.all()
    assert np.abs(wrapped(off - off[0])).max() > 1.0
    assert np.abs(ratio).max() < 7.0
    again = slice(8000, 8300)  # the third turn: the first two have shown it
    assert not np.nanmax(wrong[again]) < 3.0 * np.nanmax(usual[again])


def test_the_first_motion_of_mixed_axes_is_in_the_sigma_before_gravity_shows_it() -> None:
    made = scene(seconds=60.0)
    mixed = without_mag(made.block).with_columns({"gyro_z": -made.block["gyro_z"]})
    for block, most in ((without_mag(made.block), 3.0), (mixed, 7.0)):
        found = estimated(block, AttitudeEstimate(AttitudeParameters(gyro_scale=1e-3), "FRD"))
        turn = matrices(np.column_stack([found[name] for name in Q])) @ np.swapaxes(made.attitude, 1, 2)
        tilt = np.column_stack([turn[:, 1, 2], turn[:, 0, 2]])
        first = slice(3900, 4300)
        assert np.nanmax(np.abs(tilt / found["attitude_estimate_tilt_sd"][:, np.newaxis])[first]) < most


@pytest.mark.parametrize("off_mg", [1.0, 5.0, 20.0, 50.0])
def test_accelerometers_of_any_grade_are_in_the_sigma_once_six_faces_were_up(off_mg: float) -> None:
    rng = np.random.default_rng(11)
    ratios = []
    for off in off_mg * 1e-3 * STANDARD_GRAVITY * rng.normal(size=(400, 3)):
        accelerometers = Accelerometers(None)
        for up in np.vstack([np.eye(3), -np.eye(3)]):
            for _ in range(6):
                accelerometers.learn(up, float(np.linalg.norm(STANDARD_GRAVITY * up + off)))
        ratios.append(off / np.sqrt(accelerometers.variance))
    z = np.array(ratios)
    assert np.sqrt(np.mean(z**2)) < 1.0
    assert np.abs(z).max() < 4.0
    assert off_mg < 10.0 or np.sqrt(np.mean(z**2)) > 0.5


def test_a_magnet_that_is_put_on_while_it_rests_is_in_the_sigma_before_it_turns() -> None:
    """It turns the field about the vertical and leaves its strength: only the gyros show the rest."""
    made = scene(seconds=110.0)
    mag, accel = made.block.mag, made.block.accel
    assert mag is not None
    assert accel is not None
    row = int(np.flatnonzero(made.at_rest)[-1]) - 600
    assert made.at_rest[row:].all()
    magnet = np.cross(mag[row], accel[row])
    turned = mag[row] + 15.0 * magnet / np.linalg.norm(magnet)
    added = turned * np.linalg.norm(mag[row]) / np.linalg.norm(turned) - mag[row]
    put = mag + np.outer(np.arange(len(mag)) > row, added)
    block = made.block.with_columns({f"mag_{axis}": put[:, j] for j, axis in enumerate("xyz")})
    found = estimated(block, AttitudeEstimate(axes="FRD", magnetometer=CALIBRATED))
    true = np.arctan2(made.attitude[:, 0, 0], made.attitude[:, 1, 0])
    error = wrapped(found["attitude_estimate_heading"] - true + np.radians(NORTH_DEG))[row:]
    assert np.degrees(np.abs(error).max()) > 10.0
    assert np.abs(error / found["attitude_estimate_heading_sd"][row:]).max() < 7.0


def test_iron_that_comes_to_the_unit_is_in_the_sigma_once_turns_have_shown_it() -> None:
    made = scene(seconds=110.0)
    mag = made.block.mag
    assert mag is not None
    iron = mag + np.array([8.0, -8.0, 4.0])
    block = made.block.with_columns({f"mag_{axis}": iron[:, j] for j, axis in enumerate("xyz")})
    sd = {}
    given = AttitudeParameters(accel_bias_m_per_s2=0.05)
    for name, sent in (("as calibrated", made.block), ("iron", block)):
        found = estimated(sent, AttitudeEstimate(given, "FRD", CALIBRATED))
        true = np.arctan2(made.attitude[:, 0, 0], made.attitude[:, 1, 0])
        error = wrapped(found["attitude_estimate_heading"] - true + np.radians(NORTH_DEG))
        sd[name] = found["attitude_estimate_heading_sd"]
        later = np.isfinite(sd[name]) & (np.arange(len(error)) > 5000)
        assert np.abs(error / sd[name])[later].max() < 5.0
    assert np.degrees(np.nanmedian(sd["as calibrated"][7000:])) < 3.6
    assert not np.degrees(np.nanmedian(sd["iron"][7000:])) < 10.0


def test_a_heading_has_no_sigma_where_the_tilt_leaves_open_of_which_axis_it_is() -> None:
    pitch = np.radians([0.0, 60.0, 83.0, 84.26, 86.0, 90.0])  # at 84.26 the x axis is 0.1 from the vertical
    up = np.column_stack([-np.sin(pitch), np.zeros(6), np.cos(pitch)])
    expected = 0.005**2 * np.tan(np.where(pitch < np.radians(84.26), pitch, pitch - np.pi / 2)) ** 2
    found = tilt_into_heading(up, np.full(6, 0.005**2))
    assert np.isinf(found[3])
    np.testing.assert_allclose(np.delete(found, 3), np.delete(expected, 3), atol=1e-9)


def test_a_magnetometer_without_calibration_gives_north_but_no_sigma() -> None:
    made = scene()
    stage = AttitudeEstimate(axes="FRD")
    found = estimated(made.block, stage)
    assert (found["attitude_estimate_north"][20:] == 1).all()
    assert np.isnan(found["attitude_estimate_heading_sd"]).all()
    assert np.isfinite(found["attitude_estimate_tilt_sd"][-1])
    assert texts(stage) == {"attitude": "magnetic north, magnetometer not calibrated"}
    assert any("imumon magnetometer" in text for text in stage.notices())


def test_a_field_that_is_too_strong_is_bent_by_as_much_as_its_sigma_states() -> None:
    made = scene(seconds=220.0)
    mag = made.block.mag
    assert mag is not None
    late = np.arange(len(mag)) >= 5000
    bent = mag + late[:, np.newaxis] * (np.array([25.0, 5.0, -10.0]) @ made.attitude)  # of east, north, up
    block = made.block.with_columns({f"mag_{axis}": bent[:, j] for j, axis in enumerate("xyz")})
    found = estimated(block, AttitudeEstimate(axes="FRD", magnetometer=CALIBRATED))
    true = np.arctan2(made.attitude[:, 0, 0], made.attitude[:, 1, 0])
    error = wrapped(found["attitude_estimate_heading"] - true + np.radians(NORTH_DEG))
    sd = found["attitude_estimate_heading_sd"]
    assert np.abs(error[5000:]).max() > np.radians(10.0)  # in the end it is followed
    assert np.nanmax(np.abs(error / sd)) < 4.0


def test_hard_and_soft_iron_are_taken_out() -> None:
    made = scene()
    soft = np.array([[1.1, 0.05, 0.0], [0.05, 0.9, 0.02], [0.0, 0.02, 1.0]])
    hard = np.array([15.0, -20.0, 8.0])
    mag = made.block.mag
    assert mag is not None
    bent = mag @ np.linalg.inv(soft).T + hard
    block = made.block.with_columns({f"mag_{axis}": bent[:, j] for j, axis in enumerate("xyz")})
    model = CALIBRATED.model_copy(update={"hard_iron": hard.tolist(), "soft_iron": soft.tolist()})
    plain = estimated(made.block, AttitudeEstimate(axes="FRD", magnetometer=CALIBRATED))
    found = estimated(block, AttitudeEstimate(axes="FRD", magnetometer=model))
    bare = estimated(block, AttitudeEstimate(axes="FRD"))
    away = wrapped(found["attitude_estimate_heading"] - plain["attitude_estimate_heading"])
    assert np.abs(away[3000:]).max() < np.radians(0.01)
    wrong = wrapped(bare["attitude_estimate_heading"] - plain["attitude_estimate_heading"])
    assert np.abs(wrong[3000:]).max() > np.radians(20.0)


@pytest.mark.parametrize("slower", [1, 4])
def test_missing_rows_a_gap_and_a_restart_cost_what_they_touch(slower: int) -> None:
    made = scene(seconds=70.0)
    block = made.block
    rows = np.arange(len(block))
    sparse = {f"mag_{axis}": np.where(rows % slower == 0, block[f"mag_{axis}"], np.nan) for axis in "xyz"}
    segment = (rows >= 5000).astype(np.int64)
    time_ns = block["device_time_ns"] + np.where(rows >= 3000, 700_000_000, 0)
    time_ns = np.where(rows == 1234, NO_INT, time_ns - np.where(rows >= 5000, time_ns[5000], 0))
    accel = {"accel_x": np.where((rows > 2000) & (rows < 2005), np.nan, block["accel_x"])}
    gyro = {"gyro_y": np.where((rows > 2500) & (rows < 2504), np.nan, block["gyro_y"])}
    block = block.with_columns({**sparse, **accel, **gyro, "segment": segment, "device_time_ns": time_ns})
    block = block.with_columns(RestAndBias(mode="learned").process(block))
    stage = AttitudeEstimate(axes="FRD")
    whole = stage.process(block)
    q = whole["attitude_estimate_w"]
    assert np.isnan(q[[0, 1234, 2501, 3000, 5000]]).all()  # no rate known yet, no time, no gyro, gap
    assert np.isfinite(q[[20, 2002, 2999, 3020, 4999, 5020]]).all()
    assert whole["attitude_estimate_north"][3000] == NO_INT
    assert any("reinitialized, 2 times so far, after a restart or a gap" in text for text in stage.notices())


@pytest.mark.parametrize("heading_deg", [None, 130.0])
def test_each_new_reference_of_a_free_heading_is_reported(heading_deg: float | None) -> None:
    made = scene(seconds=60.0)
    block = without_mag(made.block)
    time_ns = block["device_time_ns"].copy()
    for row in (1500, 3000, 4500):  # gaps of a second
        time_ns[row:] += 1_000_000_000
    block = block.with_columns({"device_time_ns": time_ns})
    block = block.with_columns(RestAndBias(mode="learned").process(block))
    stage, said, began = AttitudeEstimate(axes="FRD", heading_deg=heading_deg), list[str](), list[float]()
    for start in range(0, len(block), 500):
        heading = stage.process(block.rows(start, start + 500))["attitude_estimate_heading"]
        began += heading[np.isfinite(heading)][:1].tolist() if start in (0, 1500, 3000, 4500) else []
        said += [text for text in stage.notices() if "reinitialized" in text and text not in said]
    reference = heading_deg or 0.0
    np.testing.assert_allclose(wrapped(np.array(began) - np.radians(reference)), 0.0, atol=0.01)
    assert [int(text.split(", ")[1].split()[0]) for text in said] == [1, 2, 3]
    assert all(text.endswith(f"the relative heading counts from {reference:.0f}° again") for text in said)


@pytest.mark.long
def test_samples_too_far_apart_for_an_attitude_do_not_begin_one_anew() -> None:
    block = without_mag(scene(seconds=30.0).block)
    slow = block.with_columns({"device_time_ns": 50 * block["device_time_ns"]})  # 2 Hz
    stage = AttitudeEstimate(axes="FRD")
    assert np.isnan(estimated(slow, stage)["attitude_estimate_w"]).all()
    assert not [text for text in stage.notices() if "reinitialized" in text]


def test_intervals_that_differ_do_not_turn_the_heading() -> None:
    made = scene(seconds=100.0)
    keep = np.ones(len(made.block), bool)
    keep[np.random.default_rng(2).permutation(np.arange(3000, 10_000))[:2500]] = False
    keep[-1] = True
    block = without_mag(SampleBlock({name: values[keep] for name, values in made.block.columns.items()}))
    found = estimated(block, AttitudeEstimate(AttitudeParameters(gyro_scale=1e-3), "FRD"))
    heading = np.unwrap(found["attitude_estimate_heading"][20:])
    true = np.unwrap(np.arctan2(made.attitude[keep][20:, 0, 0], made.attitude[keep][20:, 1, 0]))
    assert abs((heading - true)[-1] - (heading - true)[2900]) < np.radians(2.0)


def spun(seconds: float, rate_hz: float = 50.0, deg_per_s: float = 40.0) -> tuple[SampleBlock, FloatArray]:
    """A unit at rest for 20 s that is spun about an axis that leans by 30°, by gyros with 1 % too much."""
    rng, n = np.random.default_rng(3), round((20.0 + seconds) * rate_hz)
    t = np.arange(1, n + 1) / rate_hz
    speed = np.clip(t - 20.0, 0.0, 1.0) * np.radians(deg_per_s) * (1.0 + 0.3 * np.sin(0.7 * t))
    angle = np.cumsum(speed) / rate_hz
    pose = Rotation.from_euler("y", 30.0, degrees=True) * Rotation.from_rotvec(np.outer(angle, [0, 0, 1]))
    force = pose.inv().apply([0.0, 0.0, STANDARD_GRAVITY]) + 0.01 * rng.normal(size=(n, 3))
    gyro = np.outer(1.01 * speed, [0.0, 0.0, 1.0])
    columns = {
        "device_time_ns": np.round(t * 1e9).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        "at_rest": (t < 20.0).astype(np.int64),
        **{f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")},
        **{f"gyro_corrected_{axis}": gyro[:, j] for j, axis in enumerate("xyz")},
        **{f"gyro_bias_sd_{axis}": np.full(n, 1e-5) for axis in "xyz"},
        **{f"accel_{axis}": force[:, j] for j, axis in enumerate("xyz")},
    }
    return SampleBlock(columns), pose.as_matrix()


def test_a_slow_magnetometer_corrects_as_fast_as_a_quick_one_wherever_it_begins() -> None:
    block, body = spun(60.0)  # gyros with 1 % too much: the heading lags behind the field
    field = np.einsum("nji,j->ni", body, [0.0, 20.0, -43.0])
    found = {}
    for every, first in ((1, 0), (1, 300), (10, 0), (10, 9), (50, 20)):
        mag = np.full_like(field, np.nan)
        mag[first::every] = field[first::every]
        sent = block.with_columns({f"mag_{axis}": mag[:, j] for j, axis in enumerate("xyz")})
        whole = AttitudeEstimate(axes="FLU", magnetometer=CALIBRATED).process(sent)
        in_parts = AttitudeEstimate(axes="FLU", magnetometer=CALIBRATED)
        parts = [in_parts.process(sent.rows(at, at + 7)) for at in range(0, 400, 7)]
        parts.append(in_parts.process(sent.rows(406, len(sent))))
        for name, values in whole.items():
            np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values)
        found[every, first] = whole["attitude_estimate_heading"][-1000:]
    for one in found.values():
        assert np.abs(np.degrees(wrapped(one - found[1, 0]))).max() < 1.0


def test_in_a_motion_the_tilt_is_known_as_the_filter_follows_gravity() -> None:
    block, truth = spun(40.0)
    found = AttitudeEstimate(AttitudeParameters(accel_bias_m_per_s2=0.05), "FLU").process(block)
    turn = matrices(np.column_stack([found[name] for name in Q])) @ np.swapaxes(truth, 1, 2)
    late, sd = slice(-500, None), found["attitude_estimate_tilt_sd"]
    assert np.max(np.abs(np.column_stack([turn[:, 1, 2], turn[:, 0, 2]]) / sd[:, np.newaxis])[late]) < 4.0
    assert np.max(sd[late]) < np.radians(6.0)  # of the gyros alone: 15°


def test_a_reversed_gyro_is_not_confirmed_before_the_filter_has_followed_its_turn() -> None:
    block, truth = spun(20.0, deg_per_s=90.0)
    columns = {name: -block[name] for name in ("gyro_z", "gyro_corrected_z")}
    found = AttitudeEstimate(axes="FLU").process(block.with_columns(columns))
    q, true = matrices(np.column_stack([found[name] for name in Q]))[999:], truth[999:]
    off = np.unwrap(np.arctan2(q[:, 1, 0], q[:, 0, 0]) - np.arctan2(true[:, 1, 0], true[:, 0, 0]))
    sd = found["attitude_estimate_heading_sd"][999:]
    known = np.isfinite(sd)
    assert known[0]
    assert np.abs((off - off[0]) / sd)[known].max() < 4.0


@pytest.mark.parametrize(("declared", "expected"), [(None, 0.1), (0.01, 0.01)])
def test_gyros_that_were_shown_to_be_bad_widen_the_heading_up_to_what_is_declared(
    declared: float | None, expected: float
) -> None:
    learned = Gyros(declared, change=0.2, turned=18.0, followed=10.0)
    sensitivity = np.zeros((3, 9))
    sensitivity[2, 8] = 1.0  # a radian about the vertical, by the third gyro
    up = np.array([0.0, 0.0, 1.0])
    slot = Slot(np.zeros(1, ROW)[0], False, up, up, sensitivity, 0.0, 0.0, np.zeros(3))
    variance = HeadingSigma(learned, None, 0.0).step(slot, 0.0)
    assert np.sqrt(variance) == pytest.approx(expected, rel=0.01)


def test_an_attitude_that_begins_in_motion_has_no_tilt_sigma_for_six_seconds() -> None:
    block, truth = spun(40.0)
    found = AttitudeEstimate(axes="FLU").process(block.rows(1250, len(block)))
    sd = found["attitude_estimate_tilt_sd"]
    assert np.isnan(sd[: 5 * 50]).all()
    assert np.isfinite(sd[7 * 50 :]).all()
    turn = matrices(np.column_stack([found[name] for name in Q])) @ np.swapaxes(truth[1250:], 1, 2)
    tilt = np.column_stack([turn[:, 1, 2], turn[:, 0, 2]])
    assert np.abs(tilt / sd[:, np.newaxis])[7 * 50 :].max() < 4.0


@pytest.mark.parametrize("rest_from_s", [40.0, 40.25])
def test_a_new_bias_at_a_rest_corrects_no_heading_of_the_motion_before(rest_from_s: float) -> None:
    t = np.arange(1, 3001) / 50.0
    still, _ = spun(40.0)
    block = still.with_columns({"at_rest": ((t < 20.0) | (t >= rest_from_s)).astype(np.int64)})
    bias_sd = np.where(t < rest_from_s, 1e-3, 1e-5)
    zero = {f"gyro{of}_{axis}": np.zeros(len(t)) for of in ("", "_corrected") for axis in "xyz"}
    force = {f"accel_{axis}": np.full(len(t), STANDARD_GRAVITY * (axis == "z")) for axis in "xyz"}
    block = block.with_columns({**zero, **force, **{f"gyro_bias_sd_{axis}": bias_sd for axis in "xyz"}})
    sd = AttitudeEstimate(axes="FLU").process(block)["attitude_estimate_heading_sd"]
    known = sd[np.isfinite(sd)]
    assert known[0] == 0.0
    assert np.diff(known).min() > -1e-12
    assert known[-1] == pytest.approx(0.02, rel=0.03)  # 1 mrad/s for 20 s


def test_samples_that_are_missing_in_a_turn_as_where_the_gyros_are_saturated_widen_the_sigma() -> None:
    block, _ = spun(20.0)
    lost = (np.arange(len(block)) >= 1030) & (np.arange(len(block)) < 1040)  # 0.2 s in which it speeds up
    sd = {}
    for name, z in (("whole", block["gyro_z"]), ("lost", np.where(lost, np.nan, block["gyro_z"]))):
        sent = block.with_columns({"gyro_z": z, "gyro_corrected_z": z})
        sd[name] = AttitudeEstimate(axes="FLU").process(sent)["attitude_estimate_heading_sd"]
    assert sd["lost"][1350] > 1.1 * sd["whole"][1350]  # by then the gyro is confirmed


def test_accelerometers_that_read_zero_at_rest_leave_no_error() -> None:
    block, _ = spun(5.0)
    dead = block.with_columns({f"accel_{axis}": np.zeros(len(block)) for axis in "xyz"})
    found = AttitudeEstimate(axes="FLU").process(dead)
    assert np.isnan(found["attitude_estimate_tilt_sd"]).all()


def test_retired_parameters_are_read_and_ignored() -> None:
    text = "use_magnetometer: false\naxes_doubt: 0.3\naccel_error_probability: 0.2\n"
    given = parse_yaml(text, AttitudeParameters, "session.yaml")
    assert given == AttitudeParameters(use_magnetometer=False)
    assert "axes" not in given.model_dump_json()


def test_gyros_without_gravity_have_no_attitude() -> None:
    made = scene(seconds=5.0)
    names = [name for name in made.block.columns if not name.startswith("accel")]
    stage = AttitudeEstimate()
    assert stage.process(SampleBlock({name: made.block[name] for name in names})) == {}
    assert texts(stage) == {"attitude": "waiting"}
    silent = made.block.with_columns({f"accel_{axis}": np.full(500, np.nan) for axis in "xyz"})
    assert np.isnan(stage.process(silent)["attitude_estimate_w"]).all()
    size = len(pickle.dumps(stage))
    for k in range(1, 5):
        later = silent.with_columns({"device_time_ns": silent["device_time_ns"] + k * 5_000_000_000})
        stage.process(later)
    assert len(pickle.dumps(stage)) < size + 100  # it keeps no samples


@pytest.mark.parametrize("every", [1, 10, 100])
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_axes_are_found_with_accelerometers_slower_than_the_gyros(every: int, up: float) -> None:
    """Of FRD axes the roll was off by half a turn."""
    n, tilt = 2000, np.radians(20.0)
    force = np.tile(up * STANDARD_GRAVITY * np.array([0.0, np.sin(tilt), np.cos(tilt)]), (n, 1))
    force[np.arange(n) % every > 0] = np.nan
    still = 1e-4 * np.random.default_rng(0).standard_normal((n, 3))
    columns = {f"gyro_{axis}": still[:, j] for j, axis in enumerate("xyz")}
    columns |= {f"accel_{axis}": force[:, j] for j, axis in enumerate("xyz")}
    time_ns = np.arange(n, dtype=np.int64) * 10_000_000
    block = SampleBlock({"device_time_ns": time_ns, "segment": np.zeros(n, np.int64), **columns})
    found = AttitudeEstimate().process(block)
    np.testing.assert_allclose(np.degrees(found["attitude_estimate_roll"][-1000:]), 20.0, atol=0.2)
