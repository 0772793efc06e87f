"""Units that are laid in several poses: gravity and the earth rate are no errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray
from imumon.geodesy import EARTH_RATE, MICRO_G, STANDARD_GRAVITY
from imumon.lab.diagnosis.blocks import in_one_pose, make_blocks, poses, white_floor
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.runs import Run
from imumon.recordings.reduced import ACCEL
from tests.lab.diagnosis.units import DPH, SAMPLES, WHITE_DPH, cubic, lagged, ramps

SECONDS = 3600
WHITE_UG = 50.0
"""White noise of a mean of 30 s."""
SIDES = (("x", 0.0), ("x", 180.0), ("x", 90.0), ("x", -90.0), ("y", 90.0), ("y", -90.0))
LATITUDE_DEG, DECLINATION_DEG = 50.0, 10.0
Errors = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Of time, temperature and true specific force, (n, 3): in m/s², or for gyros in °/h."""


def nothing(_: FloatArray, __: FloatArray, force: FloatArray) -> FloatArray:
    return np.zeros_like(force)


def posed(seed: int, up: bool, rate: float, sensor: str, errors: Errors, mag: bool, seconds: int) -> Run:
    """Return a run in six poses with headings of their own."""
    random = np.random.default_rng(seed)
    time, temperature = ramps(seconds, up, rate)
    sides = [Rotation.from_euler(a, d, True) for a, d in SIDES]
    turned = [Rotation.from_euler("z", random.uniform(0, 360), True) * side for side in sides]
    which = random.permutation(6)[np.minimum(time * 6 // seconds, 5).astype(int)]
    to_body = np.array([one.inv().as_matrix() for one in turned])[which]
    force = to_body @ np.array([0.0, 0.0, STANDARD_GRAVITY])
    d, latitude = np.radians(DECLINATION_DEG), np.radians(LATITUDE_DEG)
    field = to_body @ np.array([20.0 * np.sin(d), 20.0 * np.cos(d), -43.0])
    earth = to_body @ (EARTH_RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)]))
    sd = {"gyro": WHITE_DPH * DPH * np.sqrt(30.0), "accel": WHITE_UG * MICRO_G * np.sqrt(30.0), "mag": 0.02}
    error = {"gyro": np.zeros_like(force), "accel": np.zeros_like(force)}
    error[sensor] = errors(time, temperature, force)
    true = {
        "gyro": earth + (cubic(temperature)[:, np.newaxis] + error["gyro"]) * DPH,
        "accel": force + error["accel"],
        "mag": field,
    }
    mean = {"temperature": np.round((temperature + 0.01 * random.standard_normal(seconds)) * 16) / 16}
    variance = {}
    for kind in ("gyro", "accel", *(["mag"] if mag else [])):
        for at, axis in enumerate("xyz"):
            name, noise = f"{kind}_{axis}", sd[kind]
            mean[name] = true[kind][:, at] + noise * random.standard_normal(seconds)
            variance[name] = noise**2 * SAMPLES * random.chisquare(SAMPLES - 1, seconds) / (SAMPLES - 1)
    count = dict.fromkeys(mean, np.full(seconds, SAMPLES))
    return Run(f"run {seed}", time, count, mean, variance, np.ones(seconds))


def found(sensor: str, errors: Errors, mag: bool = True, seconds: int = SECONDS) -> Diagnosis:
    first, second, last = (
        posed(seed, up, rate, sensor, errors, mag, seconds)
        for seed, up, rate in ((1, True, 1.5), (2, False, 1.5), (3, True, 1.0))
    )
    return diagnose([first, second], [last], sensors=(sensor,))


def names(diagnosis: Diagnosis) -> list[list[str]]:
    return [[claim.finding.name for claim in verdict.claims] for verdict in diagnosis.verdicts]


def test_a_perfect_accelerometer_in_several_poses_misses_nothing() -> None:
    diagnosis = found("accel", nothing)
    assert names(diagnosis) == [[], [], []]
    assert all(verdict.summary.startswith("nothing is missing") for verdict in diagnosis.verdicts)
    assert diagnosis.length is not None
    assert np.all(np.abs(diagnosis.length.bias) < 4 * diagnosis.length.bias_sd)
    assert diagnosis.length.after < 60 * MICRO_G


@pytest.mark.long
def test_bias_and_scale_follow_from_the_length_of_gravity_and_an_effect_is_named_beside_them() -> None:
    bias, scale = np.array([5e-3, -3e-3, 8e-3]) * STANDARD_GRAVITY, np.array([2e-3, -1e-3, 3e-3])

    def errors(_: FloatArray, temperature: FloatArray, force: FloatArray) -> FloatArray:
        behind = (temperature - lagged(temperature, 200.0))[:, np.newaxis]
        return np.asarray(bias + force * scale + behind * np.array([1.0, -1.0, 0.0]) * 200 * MICRO_G)

    diagnosis = found("accel", errors)
    assert names(diagnosis) == [["thermal_lag"], ["thermal_lag"], []]
    length = diagnosis.length
    assert length is not None
    assert np.all(np.abs(length.scale - scale) < 5 * length.scale_sd)
    assert np.all(np.abs(length.bias - bias) < 5 * length.bias_sd + 100 * MICRO_G)  # the lag is no part of it


@pytest.mark.long
def test_a_scale_that_depends_on_temperature_is_a_product() -> None:
    def scaled(_: FloatArray, temperature: FloatArray, force: FloatArray) -> FloatArray:
        return np.asarray(3e-4 * force * ((temperature - 25) / 20)[:, np.newaxis])

    diagnosis = found("accel", scaled, seconds=5400)
    assert names(diagnosis) == [["product(temperature, accel)"]] * 3


@pytest.mark.long
@pytest.mark.parametrize("mag", [False, True])
def test_the_earth_rate_of_every_pose_is_nothing_that_is_missing(mag: bool) -> None:
    diagnosis = found("gyro", nothing, mag, 3000)
    assert names(diagnosis) == [[], [], []]
    assert all(verdict.summary.startswith("nothing is missing") for verdict in diagnosis.verdicts)
    assert any("cannot be distinguished from the earth rate" in text for text in diagnosis.caveats)


@pytest.mark.long
def test_a_sensitivity_to_g_beyond_the_earth_rate_is_named() -> None:
    diagnosis = found(
        "gyro", lambda _, __, force: np.asarray(force @ np.diag([8.0, -9.0, 10.0])), False, 2400
    )
    assert all("g_sensitivity" in each for each in names(diagnosis))


@pytest.mark.long
def test_a_jump_is_no_earth_rate_and_no_g_sensitivity() -> None:
    def jump(time: FloatArray, _: FloatArray, __: FloatArray) -> FloatArray:
        return np.asarray((time > 1700)[:, np.newaxis] * np.array([12.0, -9.0, 8.0]))

    diagnosis = found("gyro", jump, seconds=3000)
    assert [set(each) for each in names(diagnosis)] == [{"step"}] * 3


def test_a_turn_begins_a_pose_and_a_block_is_of_one() -> None:
    random = np.random.default_rng(0)
    force = np.array([0.0, 0.0, 9.8]) + 1e-3 * random.standard_normal((100, 3))
    force[47:, 0] += 0.3
    resting = np.ones(100, bool)
    resting[40:45] = False
    pose, still = poses(force, resting)
    assert np.array_equal(still, resting)
    assert pose[:46].max() == 0
    assert pose[47:].min() == pose.max() == 1
    kept = in_one_pose(resting, pose, 20)
    assert not kept[40:47].any()
    assert kept[:40].all()
    assert kept[47:].all()
    assert poses(force[:47], resting[:47])[0].max() == 0


@pytest.mark.parametrize("turn_s", [1, 4, 10])
def test_a_turn_that_is_declared_as_rest_is_none(turn_s: int) -> None:
    """Means and floors had the turns in them: a floor of 1000 white ones, and nothing was missing."""
    random = np.random.default_rng(turn_s)
    runs = [posed(seed, True, 1.5, "accel", nothing, mag=False, seconds=1800) for seed in (1, 2)]
    for one in runs:
        force = np.column_stack([one.mean[name] for name in ACCEL])
        for at in np.flatnonzero(np.abs(np.diff(force, axis=0)).max(axis=1) > 1.0) + 1:
            first = at + int(random.integers(-15, 15))
            before, after = force[at - 20].copy(), force[at + 20].copy()
            force[at - 15 : at + 30] = np.where(np.arange(-15, 30)[:, np.newaxis] < first - at, before, after)
            share = (np.arange(turn_s)[:, np.newaxis] + 0.5) / turn_s
            force[first : first + turn_s] = before + share * (after - before)
            one.mean["gyro_x"][first : first + turn_s] += np.pi / 2 / turn_s
        one.mean |= dict(zip(ACCEL, force.T, strict=True))
        blocks = make_blocks(one, [*ACCEL, "gyro_x"], ["temperature"])
        assert white_floor("accel_x", [blocks]).sd < 1.2 * WHITE_UG * MICRO_G
        assert white_floor("gyro_x", [blocks]).sd < 1.2 * WHITE_DPH * DPH
        assert np.ptp(blocks.mean["gyro_x"]) < 100.0 * DPH
        assert len(set(blocks.pose)) == 6


@pytest.mark.long
@pytest.mark.parametrize("turn_on_dph", [60.0, 200.0])
def test_another_turn_on_bias_is_no_larger_earth_rate(turn_on_dph: float) -> None:
    """A loop was named, proven by the test."""
    of_runs = iter((0.0, turn_on_dph, 30.0))
    diagnosis = found("gyro", lambda _, __, force: np.full_like(force, next(of_runs)), False, 2400)
    assert names(diagnosis) == [[], [], []]
    assert all(verdict.summary.startswith("nothing is missing") for verdict in diagnosis.verdicts)
