from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock, join
from imumon.geodesy import EARTH_RATE
from imumon.simulation.unit import Scenario, SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import CHUNK, TRUTH_COLUMNS
from tests.simulation.unit.scenarios import scenario

G = 9.80665
EVERYTHING = scenario(
    {"base": "full"},
    rate_hz=100,
    chamber={"start_degc": 20, "lag_s": 30, "steps": [{"to_degc": 30, "rate_degc_per_min": 4}]},
    motion=[
        {"kind": "turn", "at_s": 20, "duration_s": 3, "heading_deg": 90, "roll_deg": 10},
        {"kind": "bump", "at_s": 81, "frequency_hz": 12, "decay_s": 0.3, "acceleration_m_per_s2": 1},
        {"kind": "vibration", "at_s": 150, "duration_s": 9, "frequency_hz": 40, "acceleration_m_per_s2": 1},
    ],
)


def vector(block: SampleBlock, name: str) -> FloatArray:
    values = block.vector(name)
    assert values is not None
    return values


def assert_same_bits(a: SampleBlock, b: SampleBlock) -> None:
    assert a.columns.keys() == b.columns.keys()
    for name, values in a.columns.items():
        np.testing.assert_array_equal(b[name], values, err_msg=name)


@given(cuts=st.lists(st.integers(0, 2 * CHUNK + 500), max_size=6))
@settings(max_examples=8, deadline=None)
def test_the_calls_do_not_change_a_bit(cuts: list[int]) -> None:
    total = 2 * CHUNK + 500
    sent, truth = SimulatedUnit(EVERYTHING, 7).run(total)
    parts = SimulatedUnit(EVERYTHING, 7)
    edges = [0, *sorted(cuts), total]
    pieces = [parts.run(b - a) for a, b in pairwise(edges)]
    assert_same_bits(sent, join([piece[0] for piece in pieces]))
    assert_same_bits(truth, join([piece[1] for piece in pieces]))


def test_samples_are_those_of_run_and_the_seed_decides() -> None:
    sent, _ = SimulatedUnit(EVERYTHING, 1).run(500)
    unit = SimulatedUnit(EVERYTHING, 1)
    samples = join([unit.samples(n) for n in (1, 0, 499)])
    assert_same_bits(samples, SampleBlock({name: sent[name] for name in samples.columns}))
    other, _ = SimulatedUnit(EVERYTHING, 2).run(500)
    assert not np.any(other["gyro_x"] == sent["gyro_x"])


def test_an_error_that_is_switched_off_leaves_the_others_as_they_were() -> None:
    whole, _ = SimulatedUnit(scenario({"base": "crs05"}), 3).run(400)
    quiet, truth = SimulatedUnit(scenario({"base": "crs05", "gyro_bias_deg_per_s": {}}), 3).run(400)
    difference = whole["gyro_x"] - quiet["gyro_x"]
    assert np.ptp(difference) < 1e-12
    assert difference[0] > 1e-4
    assert np.ptp(truth["gyro_bias_x"]) > 0


@pytest.mark.parametrize("axes", ["FRD", "FLU"])
@pytest.mark.parametrize("latitude", [40.93, -30.0])
@pytest.mark.parametrize(
    "attitude", [(0, 0, 0), (0, 0, 90), (30, -20, 130), (180, 0, 45), (90, 0, 0), (10, 90, 0)]
)
def test_gravity_and_earth_rate_are_in_the_right_axes(
    axes: Literal["FRD", "FLU"], latitude: float, attitude: tuple[float, float, float]
) -> None:
    roll, pitch, heading = attitude
    plan = scenario(
        axes=axes,
        latitude_deg=latitude,
        attitude={"roll_deg": roll, "pitch_deg": pitch, "heading_deg": heading},
    )
    sent, truth = SimulatedUnit(plan).run(20)
    to_ned = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    flip = np.array([1, 1, 1] if axes == "FRD" else [1, -1, -1])
    lat = np.radians(latitude)
    earth = EARTH_RATE * np.array([np.cos(lat), 0, -np.sin(lat)])
    for k in (0, 19):
        np.testing.assert_allclose(vector(sent, "accel")[k], flip * to_ned.inv().apply([0, 0, -G]), atol=1e-9)
        np.testing.assert_allclose(vector(sent, "gyro")[k], flip * to_ned.inv().apply(earth), atol=1e-15)
    np.testing.assert_array_equal(vector(truth, "rate"), vector(sent, "gyro"))


def test_level_and_north_the_signs_are_those_of_the_manual() -> None:
    """FRD: -9.81 along z and the earth's rate forward and up; FLU: +9.81 and the rate along +z."""
    frd, _ = SimulatedUnit(scenario()).run(1)
    flu, _ = SimulatedUnit(scenario(axes="FLU")).run(1)
    assert frd["accel_z"][0] == pytest.approx(-G)
    assert flu["accel_z"][0] == pytest.approx(G)
    assert frd["gyro_x"][0] == pytest.approx(EARTH_RATE * np.cos(np.radians(40.93)))
    assert frd["gyro_z"][0] == pytest.approx(-EARTH_RATE * np.sin(np.radians(40.93)))
    assert flu["gyro_z"][0] == pytest.approx(EARTH_RATE * np.sin(np.radians(40.93)))


def test_rates_integrate_to_the_attitude_that_is_reported() -> None:
    motion = [
        {"kind": "handling", "at_s": 0, "rounds": 2, "every_s": 20, "rest_s": 3, "swing_deg": [30, 20, 60]}
    ]
    sent, truth = SimulatedUnit(scenario(rate_hz=400, motion=motion, axes="FLU")).run(400 * 40)
    rates = vector(truth, "rate")
    middle = (rates[:-1] + rates[1:]) / 2 / 400.0
    attitude = Rotation.from_quat(np.column_stack([sent[f"q_{c}"] for c in "xyzw"]))
    turned = attitude[0]
    for step in middle:
        turned = turned * Rotation.from_rotvec(step)
    # What is left is the turn of the earth in 40 s, 0.17 deg, and the error of the trapezoids.
    assert np.degrees((turned.inv() * attitude[-1]).magnitude()) < 0.25
    up = attitude.apply(vector(sent, "accel"))
    np.testing.assert_allclose(up, np.tile([0, 0, G], (len(up), 1)), atol=1e-6)


def test_a_slow_rotation_shows_in_the_accelerometers() -> None:
    plan = load_scenario("slow-rotation")
    sent, truth = SimulatedUnit(plan).run(30_000)
    turning = truth["at_rest"] == 0
    assert np.flatnonzero(turning)[[0, -1]].tolist() == [9_000, 20_999]
    earth = EARTH_RATE * 1.01
    np.testing.assert_allclose(truth["rate_y"][turning], np.radians(0.1), atol=earth)
    assert sent["accel_x"][25_000:].mean() == pytest.approx(G * np.sin(np.radians(12.0)), abs=1e-3)


def oadev(rate: FloatArray, hz: float, tau_s: float) -> float:
    """Allan deviation in deg/h."""
    import allantools  # takes a second, which not every process of the tests needs

    return float(allantools.oadev(np.degrees(rate) * 3600, rate=hz, data_type="freq", taus=[tau_s])[1][0])


@pytest.mark.parametrize("low_pass_hz", [None, 30])
def test_the_angular_random_walk_is_as_stated(low_pass_hz: float | None) -> None:
    """0.28 deg/sqrt(h) is 16.8 deg/h at 1 s, with the low-pass and without; 600 s, three axes: 2 % sd."""
    unit: dict[str, Any] = {"gyro_noise": {"arw_deg_per_sqrt_h": 0.28}, "low_pass_hz": low_pass_hz}
    sent, truth = SimulatedUnit(scenario(unit), 5).run(60_000)
    levels = [oadev(sent[f"gyro_{axis}"], 100.0, 1.0) for axis in "xyz"]
    assert np.mean(levels) == pytest.approx(16.8, rel=0.06)
    assert not np.any(truth["gyro_bias_x"])
    noise = vector(sent, "gyro") - vector(truth, "rate")
    spread = np.degrees(noise.std()) / (0.28 / 60 * 10)
    assert spread == pytest.approx(1.0 if low_pass_hz is None else 0.770, rel=0.01)


def test_the_velocity_random_walk_is_as_stated() -> None:
    unit = {"accel_noise": {"vrw_m_per_s_per_sqrt_s": 1e-3}, "low_pass_hz": 30}
    sent, _ = SimulatedUnit(scenario(unit), 5).run(60_000)
    seconds = (vector(sent, "accel") - [0, 0, -G]).reshape(-1, 100, 3).mean(axis=1)
    assert seconds.std() == pytest.approx(1e-3, rel=0.07)


def test_the_bias_instability_of_crs05_is_as_stated() -> None:
    """Three Gauss-Markov processes of 2 deg/h; 200,000 s at 1 Hz."""
    unit = {"base": "crs05", "gyro_bias_deg_per_s": {}}
    _, truth = SimulatedUnit(scenario(unit, rate_hz=1), 6).run(200_000)
    bias = np.degrees(vector(truth, "gyro_bias")) * 3600
    assert bias.std() == pytest.approx(np.sqrt(12.0), rel=0.06)
    for tau_s in (5.0, 30.0, 300.0):
        ratios = np.array([10.0, 100.0, 1000.0]) / tau_s
        brackets = 1 - ratios / 2 * (3 - 4 * np.exp(-1 / ratios) + np.exp(-2 / ratios))
        expected = 2.0 * np.sqrt(np.sum(2 * ratios * brackets))
        levels = [oadev(truth[f"gyro_bias_{axis}"], 1.0, tau_s) for axis in "xyz"]
        assert np.mean(levels) == pytest.approx(expected, rel=0.06)


def test_what_is_sent_is_truth_plus_white_noise() -> None:
    """Through the low-pass, which delays by 7.5 ms: of no matter at rest."""
    sent, truth = SimulatedUnit(load_scenario("self-heating"), 4).run(60_000)
    left = vector(sent, "gyro") - vector(truth, "rate") - vector(truth, "gyro_bias")
    np.testing.assert_allclose(np.degrees(left.mean(axis=0)) * 3600, 0.0, atol=4 * 16.8 / np.sqrt(600))
    assert vector(truth, "gyro_bias").std() > 10 * abs(left.mean())
    force = vector(sent, "accel") - vector(truth, "accel_bias")
    assert np.linalg.norm(force.mean(axis=0)) == pytest.approx(G, abs=2e-4)


@pytest.mark.long
def test_turn_on_biases_are_drawn_for_each_seed() -> None:
    unit = {
        "gyro_turn_on": {"sd_deg_per_h": 15, "offset_deg_per_h": [100, 0, 0]},
        "accel_turn_on": {"sd_mg": 2},
    }
    truths = [SimulatedUnit(scenario(unit), seed).run(1)[1] for seed in range(150)]
    gyro = np.degrees(np.vstack([vector(truth, "gyro_bias") for truth in truths])) * 3600
    np.testing.assert_allclose(gyro.mean(axis=0), [100, 0, 0], atol=4 * 15 / np.sqrt(150))
    np.testing.assert_allclose(gyro.std(axis=0), 15, rtol=0.25)
    accel = np.vstack([vector(truth, "accel_bias") for truth in truths]) / G * 1e3
    np.testing.assert_allclose(accel.std(axis=0), 2, rtol=0.25)


def test_accelerometers_warm_up() -> None:
    unit = {"accel_warm_up": {"amplitude_ug": [30, 0, -60], "tau_s": 300}}
    _, truth = SimulatedUnit(scenario(unit, rate_hz=1)).run(301)
    grown = 1 - np.exp(-1.0)
    np.testing.assert_allclose(
        vector(truth, "accel_bias")[300] / G * 1e6, [30 * grown, 0, -60 * grown], atol=1e-9
    )


def test_a_gyro_that_lags_has_the_bias_of_an_earlier_temperature() -> None:
    plan = load_scenario("crs05-ramp")
    quick = plan.unit.model_copy(update={"gyro_noise": scenario().unit.gyro_noise})
    slow = quick.model_copy(update={"gyro_lag_s": (30.0, 30.0, 30.0)})
    unit, late = (SimulatedUnit(plan.model_copy(update={"unit": u})) for u in (quick, slow))
    bias, lagged = (vector(u.run(26_000)[1], "gyro_bias") for u in (unit, late))
    # Long after the begin of a ramp a first-order lag of 30 s is a delay of 30 s.
    np.testing.assert_allclose(lagged[25_900], bias[22_900], atol=2e-3 * np.ptp(bias, axis=0).max())
    assert np.all(np.abs(lagged[25_900] - bias[25_900]) > 1e-6)


def test_the_descent_of_the_ramp_moves_the_bias_as_the_specification_states() -> None:
    """A bias of y that is held errs by -146 deg/h after 66 s of the descent and by -463 after 204 s."""
    plan = load_scenario("crs05-ramp")
    quiet = plan.unit.model_copy(update={"gyro_noise": scenario().unit.gyro_noise})
    _, truth = SimulatedUnit(plan.model_copy(update={"unit": quiet})).run(plan.samples)
    bias = np.degrees(truth["gyro_bias_y"]) * 3600
    assert bias[32_400] - bias[39_000] == pytest.approx(-146, abs=0.5)
    assert bias[32_400] - bias[52_800] == pytest.approx(-463, abs=0.5)


def test_times_are_those_that_a_decoder_finds() -> None:
    sent, truth = SimulatedUnit(scenario(rate_hz=60), 0, Fraction(100_000)).run(61)
    assert sent["device_ticks"][[1, 60]].tolist() == [167, 10_000]
    assert sent["device_time_ns"][[1, 60]].tolist() == [16_700_000, 10**9]
    assert truth["device_time_ns"].tolist() == sent["device_time_ns"].tolist()
    assert list(truth.columns) == ["device_time_ns", "segment", *(column.name for column in TRUTH_COLUMNS)]


def test_after_its_end_a_scenario_goes_on_as_it_is() -> None:
    plan: Scenario = load_scenario("crs05-ramp").played(1.0, "FRD")
    _, truth = SimulatedUnit(plan).run(plan.samples + 100)
    assert truth["temperature"][-1] == pytest.approx(27.28)
