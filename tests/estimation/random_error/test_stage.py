"""The stage of the pipeline: columns, blocks, motion, restarts, models, notices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.config import parse_yaml
from imumon.errors import ImumonError
from imumon.estimation.random_error.parameters import RandomErrorParameters
from imumon.estimation.random_error.stage import RandomError
from imumon.pipeline import Estimator
from imumon.simulation.unit import SimulatedUnit, load_scenario
from tests.estimation.random_error.records import DEG_PER_HOUR, WHITE, flicker, samples
from tests.models.models import POLYNOMIAL, three_curves


def record(n_s: int = 200, rate_hz: int = 50, seed: int = 1, offset: float = 0.01) -> SampleBlock:
    rng = np.random.default_rng(seed)
    return samples(offset + flicker(n_s, rng), rate_hz, rng)


def in_blocks(stage: Estimator, block: SampleBlock, size: int) -> dict[str, ColumnArray]:
    parts = [stage.process(block.rows(i, min(i + size, len(block)))) for i in range(0, len(block), size)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_columns_by_default() -> None:
    block = record(20)
    plain: Estimator = RandomError()
    names = [column.name for column in plain.columns]
    assert names == [f"gyro_random_error{part}_{a}" for part in ("", "_sd") for a in "xyz"]
    assert list(plain.process(block)) == names


def test_the_estimate_is_near_the_truth() -> None:
    rng = np.random.default_rng(2)
    drift = 0.01 + flicker(300, rng)
    block = samples(drift, 50, rng)
    added = RandomError().process(block)
    late = slice(150 * 50, None)
    truth = np.repeat(drift, 50)[late]
    for axis in "xyz":
        error = added[f"gyro_random_error_{axis}"][late] - truth
        assert np.sqrt(np.mean(error**2)) < 60 * DEG_PER_HOUR


def test_neither_the_division_into_blocks_nor_rows_before_matter() -> None:
    block = record(120, 10)
    columns = dict(block.columns)
    segment = columns["segment"].copy()
    segment[750:] = 1
    rest = columns["at_rest"].copy()
    rest[450:550] = 0
    x = columns["gyro_x"].copy()
    x[:150] = np.nan
    block = block.with_columns({"segment": segment, "at_rest": rest, "gyro_x": x})
    whole = RandomError().process(block)
    for size in (1, 333):
        pieces = in_blocks(RandomError(), block, size)
        for name, values in whole.items():
            np.testing.assert_array_equal(pieces[name], values, err_msg=name)
    late = RandomError().process(block.rows(150, len(block)))
    for name, values in whole.items():
        if name.endswith("_x"):
            np.testing.assert_array_equal(late[name], values[150:], err_msg=name)


def test_motion_is_not_learnt_and_the_band_grows() -> None:
    block = record(300)
    rest = np.ones(len(block), np.int64)
    rest[8000:12000] = 0
    moved = block["gyro_x"] + np.where(rest == 0, 3.0 * np.sin(np.arange(len(block)) / 10), 0.0)
    block = block.with_columns({"at_rest": rest, "gyro_x": moved})
    added = RandomError().process(block)
    estimate, sd = added["gyro_random_error_x"], added["gyro_random_error_sd_x"]
    assert np.abs(estimate[8000:] - estimate[7999]).max() < 60 * DEG_PER_HOUR
    assert sd[11_999] > 1.005 * sd[7999]


def test_a_restart_of_the_device_forgets_the_level_but_not_the_noise() -> None:
    block = record(200)
    segment = np.zeros(len(block), np.int64)
    segment[6000:] = 1
    x = block["gyro_x"] + np.where(segment == 1, 0.02, 0.0)
    added = RandomError().process(block.with_columns({"segment": segment, "gyro_x": x}))
    estimate = added["gyro_random_error_x"]
    assert np.isnan(estimate[6000:6050]).all()
    assert estimate[5999] == pytest.approx(0.01, abs=1e-3)
    # A second later there is an estimate again, since the noise is known.
    assert np.isfinite(estimate[6060:]).all()
    assert estimate[7000] == pytest.approx(0.03, abs=1e-3)


def test_gaps_and_another_rate_are_survived() -> None:
    rng = np.random.default_rng(3)
    n = 12_000
    interval = np.where(np.arange(n) < 6000, 10_000_000, 100_000_000)
    interval[3000] = 30_000_000_000
    block = SampleBlock(
        {
            "device_time_ns": np.cumsum(interval),
            "segment": np.zeros(n, np.int64),
            "gyro_x": 0.01 + WHITE * np.sqrt(1e9 / interval) * rng.standard_normal(n),
            "at_rest": np.ones(n, np.int64),
        }
    )
    added = RandomError().process(block)
    assert np.isfinite(added["gyro_random_error_x"][2200:]).all()
    np.testing.assert_allclose(added["gyro_random_error_x"][2200:], 0.01, atol=8e-4)
    assert np.isnan(added["gyro_random_error_y"]).all()


def test_without_a_word_on_rest_there_is_no_estimate_unless_it_is_assumed() -> None:
    columns = {name: values for name, values in record(30).columns.items() if name != "at_rest"}
    block = SampleBlock(columns)
    silent = RandomError()
    assert np.isnan(silent.process(block)["gyro_random_error_x"]).all()
    (text,) = silent.notices()
    assert "at_rest" in text
    assert silent.notices() == []
    assumed = RandomError(RandomErrorParameters(assume_rest=True))
    assert np.isfinite(assumed.process(block)["gyro_random_error_x"][-1])
    assert assumed.notices() == []


def test_given_noise_is_used_for_its_axis_at_once() -> None:
    text = "noise:\n  gyro_x: {angle_random_walk: 6.2e-4, bias_instability: 7.0e-5}\n"
    parameters = parse_yaml(text, RandomErrorParameters, "pipeline.yaml")
    added = RandomError(parameters).process(record(20))
    assert np.isfinite(added["gyro_random_error_x"][60])
    assert np.isnan(added["gyro_random_error_y"][60])
    # White noise of 6.2e-4 rad/s/√Hz over one second, with some flicker.
    assert added["gyro_random_error_sd_x"][60] == pytest.approx(6.2e-4, rel=0.1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("risk: 0.96", "risk"),
        ("method: ukf", "method"),
        ("noise: {gyro_x: {angle_random_walk: 1e-4}}", "leave the axis out"),
        ("noise: {gyro_w: {angle_random_walk: 1e-4, rate_random_walk: 1e-6}}", "gyro_w"),
        ("phi_limit: 1.0", "phi_limit"),
        ("q: 1", "unknown key"),
    ],
)
def test_wrong_parameters_are_refused(text: str, said: str) -> None:
    with pytest.raises(ImumonError, match=said):
        parse_yaml(text, RandomErrorParameters, "pipeline.yaml")


def test_a_jump_that_stays_is_said_once() -> None:
    block = record(200)
    jumped = block["gyro_x"] + np.where(np.arange(len(block)) > 5000, math.radians(1.0), 0.0)
    stage = RandomError()
    stage.process(block.with_columns({"gyro_x": jumped}))
    (text,) = stage.notices()
    assert "gyro x" in text
    assert "jumped" in text
    assert stage.notices() == []


def warming(n_s: int = 400) -> tuple[SampleBlock, FloatArray]:
    """Return a record whose bias follows a polynomial in temperature, and its drift beside that."""
    rng = np.random.default_rng(11)
    drift = flicker(n_s, rng)
    block = samples(drift, 20, rng)
    temperature = np.linspace(-10.0, 40.0, len(block))
    x = block["gyro_x"] + POLYNOMIAL.value(temperature)
    return block.with_columns({"gyro_x": x, "temperature": temperature}), np.repeat(drift, 20)


def test_the_thermal_bias_of_a_model_is_taken_off_first() -> None:
    block, drift = warming()
    late = slice(100 * 20, None)
    modelled = RandomError(model=three_curves())
    error = (modelled.process(block)["gyro_random_error_x"] - drift)[late]
    assert np.sqrt(np.mean(error**2)) < 45 * DEG_PER_HOUR
    assert modelled.notices() == []
    plain = RandomError()
    total = drift + POLYNOMIAL.value(block["temperature"])
    lagging = (plain.process(block)["gyro_random_error_x"] - total)[late]
    assert np.sqrt(np.mean(lagging**2)) > 1.2 * np.sqrt(np.mean(error**2))
    (text,) = plain.notices()
    assert "no bias model" in text


def test_a_model_without_temperatures_gives_no_estimate_and_says_so() -> None:
    block, _ = warming(30)
    cold = SampleBlock({k: v for k, v in block.columns.items() if k != "temperature"})
    stage = RandomError(model=three_curves())
    assert np.isnan(stage.process(cold)["gyro_random_error_x"]).all()
    (text,) = stage.notices()
    assert "temperature, which has not come" in text


def test_the_sigma_is_true_on_the_simulated_unit() -> None:
    """The zero of the estimate is a rate of nought: it holds the bias and the earth's rate."""
    scenario = load_scenario("crs05-soak")
    normalised = []
    for seed in range(3):
        block, truth = SimulatedUnit(scenario, seed=seed).run(60_000)
        added = RandomError(RandomErrorParameters(assume_rest=True)).process(block)
        late = slice(6000, None)
        for axis in "xyz":
            reads = truth[f"gyro_bias_{axis}"] + truth[f"rate_{axis}"]
            error = (added[f"gyro_random_error_{axis}"] - reads)[late]
            normalised.append(np.mean((error / added[f"gyro_random_error_sd_{axis}"][late]) ** 2))
    assert 0.6 < math.sqrt(np.mean(normalised)) < 1.3
