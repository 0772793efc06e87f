from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.motion import PART_S, PARTS, Motion
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.filters.turns import Turn
from imumon.geodesy import DEG_PER_H, STANDARD_GRAVITY
from tests.estimation.gyro_bias.records import GIVEN, slope_model, vector

BIAS = np.array([0.008, -0.005, 0.006])


def driven(seed: int, seconds: float, rate_hz: float = 25.0) -> SampleBlock:
    """A unit on the level that is driven about, turns and sways, and never rests."""
    rng, t = np.random.default_rng(seed), np.arange(seconds * rate_hz + 1) / rate_hz
    phase = rng.uniform(0.0, 6.28, 4)
    yaw = 1.5 * np.sin(0.2 * t + phase[0])
    sway = 0.03 * np.sin(2.0 * t + phase[1])
    speed = 1.0 + 0.5 * np.sin(0.3 * t + phase[2])
    velocity = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.1 * np.sin(9.0 * t + phase[3])])
    pose = Rotation.from_euler("ZYX", np.column_stack([yaw, sway, 0.5 * sway]))
    rate = (pose[:-1].inv() * pose[1:]).as_rotvec() * rate_hz
    middle = (pose[:-1] * Rotation.from_rotvec(0.5 * rate / rate_hz)).as_matrix()
    acceleration = np.diff(velocity, axis=0) * rate_hz + [0.0, 0.0, STANDARD_GRAVITY]
    force = np.einsum("nij,ni->nj", middle, acceleration) + rng.normal(0.0, 0.05, 3)
    gyro = rate @ (np.eye(3) + rng.normal(0.0, 0.01, (3, 3))).T + BIAS + 3e-4 * rng.normal(size=rate.shape)
    n = len(rate)
    vectors = {"gyro": gyro, "accel": force}
    columns = {
        f"{name}_{axis}": values[:, j] for name, values in vectors.items() for j, axis in enumerate("xyz")
    }
    time_ns = np.round(t[1:] * 1e9).astype(np.int64)
    none = np.zeros(n, np.int64)
    return SampleBlock({"device_time_ns": time_ns, "segment": none, "at_rest": none, **columns})


def estimated(block: SampleBlock) -> tuple[FloatArray, FloatArray]:
    found = block.with_columns(RestAndBias(GIVEN).process(block))
    return vector(found, "gyro_bias"), vector(found, "gyro_bias_sd")


def test_a_unit_that_never_rests_has_a_bias_but_about_the_vertical() -> None:
    for seed in (1, 2, 3):
        bias, sd = estimated(driven(seed, 200.0))
        late = slice(62 * 25, None)
        assert np.isnan(bias[: 55 * 25]).all()  # a window is a minute
        assert np.isnan(bias[:, 2]).all()
        error = (bias - BIAS)[late, :2]
        assert np.abs(error / sd[late, :2]).max() < 4.0
        assert np.abs(error).max() < np.abs(BIAS[:2]).min() / 3.0
        assert (sd[late, :2] < 0.03).all()


def test_what_the_model_explains_of_a_warm_up_is_in_the_bias_once() -> None:
    block, slope_dph = driven(6, 200.0), 300.0
    temperature = np.linspace(25.0, 45.0, len(block))
    drift = slope_dph * DEG_PER_H * (temperature - 25.0)
    gyros = {f"gyro_{axis}": block[f"gyro_{axis}"] + drift for axis in "xyz"}
    warm = SampleBlock({**block.columns, **gyros, "temperature": temperature})
    found = warm.with_columns(RestAndBias(GIVEN, model=slope_model(slope_dph)).process(warm))
    error = (vector(found, "gyro_bias") - BIAS - drift[:, np.newaxis])[62 * 25 :, :2]
    assert np.abs(error).max() < np.abs(BIAS[:2]).min() / 3.0


def test_constant_readings_have_a_rounding_in_the_sigma_where_rest_is_given() -> None:
    n = 60 * 25
    force = 9.8 + 1e-3 * np.random.default_rng(7).normal(size=n)
    gyros, accels = ({f"{kind}_{axis}": np.zeros(n) for axis in "xyz"} for kind in ("gyro", "accel"))
    times = {"device_time_ns": 40_000_000 * np.arange(n), "segment": np.zeros(n, np.int64)}
    block = SampleBlock({**times, **gyros, **accels, "accel_z": force, "at_rest": np.ones(n, np.int64)})
    _, sd = estimated(block)
    assert (sd[-1] > 50.0 * DEG_PER_H).all()  # a step of 220 °/h is not known to be finer


def test_without_accelerometers_a_turn_against_the_earth_is_in_the_sigma() -> None:
    n, hz = 100 * 25, 25
    gyro = 1e-6 * np.random.default_rng(8).normal(size=(n, 3))
    gyro[60 * hz : 70 * hz, 2] += np.radians(18.0)
    columns = {f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")}
    times = {"device_time_ns": 40_000_000 * np.arange(n), "segment": np.zeros(n, np.int64)}
    rest = (np.arange(n) < 60 * hz).astype(np.int64)
    block = SampleBlock({**times, **columns, "at_rest": rest})
    sd = vector(
        block.with_columns(RestAndBias(GIVEN, latitude_deg=45.0, heading_deg=0.0).process(block)),
        "gyro_bias_sd",
    )
    assert (sd[80 * hz, :2] > 7.0 * DEG_PER_H).all()


def test_a_rest_takes_over() -> None:
    moved = driven(4, 70.0)
    rows = np.arange(25 * 70, 25 * 90)
    rng = np.random.default_rng(5)
    still = {
        "device_time_ns": (rows + 1) * 40_000_000,
        "segment": np.zeros(len(rows), np.int64),
        "at_rest": np.ones(len(rows), np.int64),
        **{f"gyro_{axis}": BIAS[j] + 3e-4 * rng.normal(size=len(rows)) for j, axis in enumerate("xyz")},
        **{
            f"accel_{axis}": 9.8 * (j == 2) + 1e-3 * rng.normal(size=len(rows))
            for j, axis in enumerate("xyz")
        },
    }
    whole = SampleBlock({name: np.concatenate([moved[name], values]) for name, values in still.items()})
    bias, sd = estimated(whole)
    assert np.isfinite(bias[-1]).all()
    assert (sd[-1] < 1e-3).all()
    assert np.abs((bias[-1] - BIAS) / sd[-1]).max() < 4.0


def test_a_window_that_was_interrupted_begins_anew() -> None:
    motion, force = Motion(), np.array([0.0, 0.0, STANDARD_GRAVITY])
    slot = Turn(by_bias=0.5 * np.eye(3), seconds=0.5)
    for _ in range(2):
        motion.interrupt(0.0)
        for _ in range(round(PART_S * PARTS / 0.5) - 1):
            motion.take(slot, force)
            assert motion.parts  # of a window that goes on
    motion.take(slot, force)
    assert not motion.parts
    bias, variance = motion.bias
    assert np.isnan(bias[2])
    assert np.isnan(variance[2])
    assert np.abs(bias[:2]).max() < 1e-3  # nothing turned


def cruised(seed: int, minutes: float = 10.0) -> FloatArray:
    """Errors over sigma, (windows, 2), where a speed of 30 m/s comes and goes smoothly within minutes."""
    rng, dt = np.random.default_rng(seed), 0.5
    t = np.arange(round(60.0 * minutes / dt) + 1) * dt
    waves = rng.uniform(0.003, 0.02, (2, 4, 1)), rng.uniform(0.0, 6.28, (2, 4, 1))
    velocity = 15.0 * np.sin(2.0 * np.pi * waves[0] * t + waves[1]).sum(1)
    force = np.column_stack([*np.diff(velocity) / dt, np.full(len(t) - 1, STANDARD_GRAVITY)])
    bias, motion, off = np.array([0.002, -0.003, 0.0]), Motion(), []
    by_scale = np.einsum("ai,j->aij", np.eye(3), bias * dt)
    turn = Turn(Rotation.from_rotvec(bias * dt).as_matrix(), dt * np.eye(3), by_scale, seconds=dt)
    for one in force:
        motion.take(turn, one)
        if not motion.parts:
            mean, variance = motion.bias
            off.append(((mean - bias) / np.sqrt(variance))[:2])
    return np.array(off)


def test_a_speed_that_changes_smoothly_is_in_the_sigma_and_takes_no_bias_away() -> None:
    z = np.concatenate([cruised(seed) for seed in range(4)])
    assert np.isfinite(z).mean() > 0.7
    assert np.nanmax(np.abs(z)) < 4.0
