"""STF, SR-UKF and SR-RSUKF as a stage: columns, blocks, motion, restarts, gaps."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.papers.random_error import TITLES, RandomErrorMethods
from imumon.pipeline import Estimator
from imumon.run.setup import AxisNoise, RandomErrorParameters
from tests.papers.records import DEG_PER_HOUR, WHITE, flicker, samples

GIVEN = RandomErrorParameters()
QUICK = RandomErrorParameters(learn_s=40.0)


def record(n_s: int = 200, rate_hz: int = 50, seed: int = 1, offset: float = 0.01) -> SampleBlock:
    rng = np.random.default_rng(seed)
    return samples(offset + flicker(n_s, rng), rate_hz, rng)


def test_each_method_has_columns_of_its_own() -> None:
    stage: Estimator = RandomErrorMethods([*TITLES], GIVEN)
    names = [column.name for column in stage.columns]
    assert list(stage.process(record(20))) == names
    assert {f"{method}_random_error_sd_z" for method in TITLES} < set(names)
    assert {"sr_ukf_phi_x", "sr_rsukf_phi_sd_y", "gyro_rest_mean_x", "gyro_rest_hold_z"} < set(names)
    assert "stf_phi_x" not in names


def test_the_filters_follow_the_drift_and_the_strong_tracking_one_the_noise() -> None:
    rng = np.random.default_rng(2)
    drift = 0.01 + flicker(300, rng)
    added = RandomErrorMethods([*TITLES], GIVEN).process(samples(drift, 50, rng))
    late = slice(150 * 50, None)
    truth = np.repeat(drift, 50)[late]

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean((added[name][late] - truth) ** 2))) / DEG_PER_HOUR

    for axis in "xyz":
        assert rms(f"sr_ukf_random_error_{axis}") < 60
        assert rms(f"sr_rsukf_random_error_{axis}") < 60
        assert rms(f"stf_random_error_{axis}") > 200
        assert (np.abs(added[f"sr_rsukf_phi_{axis}"][late]) < 0.9).all()
        raw = added[f"gyro_rest_hold_{axis}"][-1]
        assert raw == pytest.approx(np.mean(drift[:60]), abs=4 * WHITE / np.sqrt(60))


def test_motion_is_not_learnt_and_the_band_grows() -> None:
    block = record(300)
    rest = np.ones(len(block), np.int64)
    rest[8000:12000] = 0
    moved = block["gyro_x"] + np.where(rest == 0, 3.0 * np.sin(np.arange(len(block)) / 10), 0.0)
    added = RandomErrorMethods([*TITLES], GIVEN).process(
        block.with_columns({"at_rest": rest, "gyro_x": moved})
    )
    for method in TITLES:
        estimate, sd = added[f"{method}_random_error_x"], added[f"{method}_random_error_sd_x"]
        assert np.ptp(estimate[8000:12000]) == 0.0
        # The strong-tracking filter is nearly as uncertain as a reading, always.
        assert sd[11_999] > (1.0 if method == "stf" else 1.0005) * sd[7999]
    assert np.ptp(added["sr_rsukf_phi_x"][8000:12000]) == 0.0


def test_a_restart_of_the_device_forgets_the_level_but_not_the_noise() -> None:
    block = record(200)
    segment = np.zeros(len(block), np.int64)
    segment[6000:] = 1
    x = block["gyro_x"] + np.where(segment == 1, 0.02, 0.0)
    added = RandomErrorMethods([*TITLES], GIVEN).process(
        block.with_columns({"segment": segment, "gyro_x": x})
    )
    for name in ("sr_rsukf_random_error_x", "gyro_rest_mean_x"):
        assert np.isnan(added[name][6000:6050]).all()
        assert added[name][5999] == pytest.approx(0.01, abs=1e-3)
        assert np.isfinite(added[name][6060:]).all()
        assert added[name][7000] == pytest.approx(0.03, abs=1e-3)


def test_gaps_and_another_rate_are_survived() -> None:
    rng = np.random.default_rng(3)
    n = 12_000
    interval = np.where(np.arange(n) < 6000, 10_000_000, 100_000_000)
    interval[5500] = 30_000_000_000
    block = SampleBlock(
        {
            "device_time_ns": np.cumsum(interval),
            "segment": np.zeros(n, np.int64),
            "gyro_x": 0.01 + WHITE * np.sqrt(1e9 / interval) * rng.standard_normal(n),
            "at_rest": np.ones(n, np.int64),
        }
    )
    added = RandomErrorMethods([*TITLES], QUICK).process(block)
    for name in ("sr_ukf_random_error_x", "sr_rsukf_random_error_x"):
        assert np.isfinite(added[name][4200:]).all()
        np.testing.assert_allclose(added[name][4200:], 0.01, atol=8e-4)
        assert added["sr_ukf_random_error_sd_x"][5500] > added["sr_ukf_random_error_sd_x"][5499]
    assert np.isnan(added["sr_rsukf_random_error_y"]).all()


def test_a_slow_log_is_learnt_from_as_many_means_as_a_fast_one() -> None:
    n, period_s = 100, 2.5
    rng = np.random.default_rng(3)
    times = np.rint(np.arange(n) * period_s * 1e9).astype(np.int64)
    block = samples(0.01 + flicker(n, rng), 1, rng).with_columns({"device_time_ns": times})
    added = RandomErrorMethods([*TITLES], QUICK).process(block)
    for method in TITLES:
        begins = np.flatnonzero(np.isfinite(added[f"{method}_random_error_x"]))
        assert begins[0] == 30
        assert len(begins) == n - 30


def test_known_noise_starts_the_filters_after_a_second() -> None:
    noise = AxisNoise(angle_random_walk=WHITE, rate_random_walk=1e-2 * WHITE)
    known = QUICK.model_copy(update={"noise": {"gyro_x": noise}})
    added = RandomErrorMethods([*TITLES], known).process(record(20))
    assert np.isfinite(added["sr_rsukf_random_error_x"][60])
    assert np.isnan(added["sr_rsukf_random_error_y"]).all()


def test_motion_that_nobody_noticed_drives_phi_to_its_limit() -> None:
    """It takes 30 rad/s: with a fitted δ¹ the gain of φ is small."""
    block = record(150)
    k = np.arange(len(block))
    shaken = block["gyro_x"] + np.where(k > 5000, 30.0 * np.sin(k / 50), 0.0)
    added = RandomErrorMethods(["sr_rsukf"], GIVEN).process(block.with_columns({"gyro_x": shaken}))
    assert np.nanmax(np.abs(added["sr_rsukf_phi_x"])) == 0.9
    assert np.isfinite(added["sr_rsukf_random_error_x"][5000:]).all()
