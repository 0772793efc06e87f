"""What shakes a unit for seconds must not cost what it told in minutes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.alignment.fit import PoseFit, PoseRecord, fit_pose
from imumon.estimation.alignment.loudness import quietness
from imumon.estimation.alignment.windows import Windows, bank, coloured, of_white, spectrum
from imumon.geodesy import STANDARD_GRAVITY
from tests.estimation.alignment.units import ANY_REST, aligned, error_deg, samples, scenario

ARW, RATE_HZ, SLOT_S = 1e-3, 50.0, 0.25
DEG_PER_SQRT_H = math.pi / 180.0 / 60.0


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
    assert status.time_s == pytest.approx(150.0 - until_s, abs=2.0)
    assert status.positions == 1
    assert status.arw < 2.0 * ARW * DEG_PER_SQRT_H
    assert status.shown is not None
    assert math.degrees(status.shown.sd) < 0.1
    assert abs(error_deg(status.shown.heading, 30.0)) < 4.0 * math.degrees(status.shown.sd)


@pytest.mark.parametrize("tau_s", [1.0, 10.0])
def test_a_turn_that_dies_away_at_the_start_hides_no_north(tau_s: float) -> None:
    t = _time(300.0)
    stage, _ = aligned(_shaken(300.0, np.outer(np.exp(-t / tau_s), [0.0, 2e-3, 5e-2])))
    assert stage.status.shown is not None
    assert math.degrees(stage.status.shown.sd) < 0.15
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 4.0 * math.degrees(stage.status.shown.sd)


def _lorry(t: FloatArray, amplitude: float) -> FloatArray:
    near = amplitude * np.exp(-(((t - t[-1] / 2.0) / 8.0) ** 2))
    return np.column_stack([near * np.sin(2.0 * math.pi * 1.3 * t), near, np.zeros(len(t))])


def _door(t: FloatArray, amplitude: float) -> FloatArray:
    since = np.maximum(t - t[-1] / 2.0, 0.0)
    swing = np.sin(2.0 * math.pi * np.outer(since, [5.0, 6.0, 4.0]))
    return np.asarray(amplitude * np.exp(-since / 2.0)[:, None] * swing)


@pytest.mark.parametrize(
    ("what", "amplitude"), [(_lorry, 3e-6), (_lorry, 3e-4), (_door, 3e-5), (_door, 3e-4), (_door, 3e-3)]
)
def test_one_lorry_or_door_leaves_the_heading_as_good_as_it_was(what: object, amplitude: float) -> None:
    assert callable(what)
    stage, out = aligned(_shaken(240.0, what(_time(240.0), amplitude)))
    status = stage.status
    before = out["heading_sd"][round(95.0 * RATE_HZ)]
    assert status.restarts == 0
    assert status.positions == 1
    assert status.arw < 3.0 * ARW * DEG_PER_SQRT_H
    assert status.shown is not None
    assert status.shown.sd < 1.5 * before
    assert abs(error_deg(status.shown.heading, 30.0)) < 4.0 * math.degrees(status.shown.sd)


def test_a_detector_that_sees_no_rest_in_a_sway_stops_nothing() -> None:
    t = _time(240.0)
    swell = 1e-3 * np.sin(2.0 * math.pi * np.outer(t, [1 / 14.0, 1 / 14.7, 0.0]))
    block = _shaken(240.0, swell)
    at_rest = (t < 8.0).astype(np.int64)
    stage, _ = aligned(block.with_columns({"at_rest": at_rest}))
    assert stage.status.restarts == 0
    assert stage.status.positions == 1
    assert stage.status.time_s > 200.0
    assert stage.status.shown is not None
    assert abs(error_deg(stage.status.shown.heading, 30.0)) < 3.0 * math.degrees(stage.status.shown.sd)
    assert math.degrees(stage.status.shown.sd) < 2.0


def _fit(rate: FloatArray) -> PoseFit:
    rng, n = np.random.default_rng(1), len(rate)
    level = 1e-5 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    found = fit_pose(PoseRecord(SLOT_S * np.arange(0.5, n), np.full(n, 25.0), rate, level), ANY_REST)
    assert found is not None
    return found


def test_white_noise_is_nowhere_loud_and_a_knock_is() -> None:
    rng = np.random.default_rng(0)
    rate, all_of_them = rng.normal(size=(1200, 3)), np.ones(1200, bool)
    assert (quietness(rate, all_of_them) == 1.0).all()
    rate[600:604, 1] += [100.0, -100.0, 50.0, -50.0]
    quiet = quietness(rate, all_of_them)
    assert (quiet[596:608] < 0.02).all()
    assert (quiet[:580] == 1.0).all()
    assert (quiet[624:] == 1.0).all()
    all_of_them[600:604] = False
    assert (quietness(rate, all_of_them) == all_of_them).all()


def test_the_noise_of_the_gyros_is_not_that_of_what_shook_them() -> None:
    rng, n = np.random.default_rng(0), 1200
    rate = 5.8e-7 * rng.normal(size=(n, 3)) + [5e-5, 2e-5, 4e-5]
    quiet = _fit(rate)
    rate[500:560, :2] += 1e-4 * rng.normal(size=(60, 2))
    shaken = _fit(rate)
    assert shaken.white < 1.3 * quiet.white
    assert shaken.variance[0] < 1.5 * quiet.variance[0]
    assert abs(shaken.mean[0] - quiet.mean[0]) < math.sqrt(quiet.variance[0])
    assert shaken.seconds < quiet.seconds - 10.0


def _coloured(data: FloatArray, noise: float) -> Windows:
    every = np.ones(len(data))
    return coloured(every, np.maximum(spectrum(data, every) / noise, of_white(len(data), 1)))


def test_the_spectrum_of_white_noise_leaves_all_weights_alike() -> None:
    rng, cells = np.random.default_rng(0), 160
    for _ in range(10):
        data = rng.normal(size=(cells, 2))
        found = _coloured(data, 1.0)
        assert 1.0 / cells < found.variance < 1.2 / cells
        assert found.scatter(data)[0] == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize("at", [0.0, 0.23, 0.5])
def test_what_sways_at_random_is_weighed_by_its_spectrum(at: float) -> None:
    rng, cells, noise = np.random.default_rng(0), 160, 1e-4
    errors, claimed, means = [], [], []
    for _ in range(40):
        angle = rng.normal(size=(cells + 1, 2))
        if at:  # a resonance at this share of the fastest
            angle = lfilter([1.0], [1.0, -1.9 * math.cos(math.pi * at), 0.9], angle, axis=0)
        data = np.diff(angle, axis=0) + math.sqrt(noise) * rng.normal(size=(cells, 2))
        found = _coloured(data, noise)
        products = found.products(np.column_stack([np.ones(cells), data]))
        errors.append(products[0, 1:] / products[0, 0])
        claimed.append(max(found.scatter(data)[0], noise) * found.variance)
        means.append(min(one.scatter(data)[0] * one.variance for one in bank(cells, 1)))
    # Their mean is known by the angles at the ends, not by the square root of time.
    assert 0.3 < np.mean(np.square(errors)) / np.mean(claimed) < 2.0
    assert np.mean(claimed) < 0.4 * np.mean(means)
