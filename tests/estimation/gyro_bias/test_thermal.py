"""What the temperature does to the bias: followed by a model, or learned."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import Mode, RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from tests.estimation.gyro_bias.records import (
    DPH,
    GIVEN,
    Truth,
    record,
    slope_model,
    vector,
    with_rest,
)

SLOW = Truth(rate_hz=10.0)
SLOPE = 60.0


def warming(
    temperature: FloatArray, slope_dph: float = SLOPE, seed: int = 0
) -> tuple[SampleBlock, FloatArray]:
    """Return samples at 10 Hz of gyros with that slope and these temperatures, and the true bias."""
    thermal = np.column_stack([slope_dph * temperature * DPH] * 3)
    rate = np.gradient(temperature) * 10.0
    columns = {"temperature": temperature, "temperature_rate": rate}
    return record(SLOW, len(temperature) / 10, seed, thermal, **columns)


def triangle(seconds: float) -> FloatArray:
    t = np.arange(round(seconds * 10)) / 10
    return np.asarray(np.interp(t, [0, 60, 264, 324, 528], [27.3, 27.3, 34.1, 34.1, 27.3]))


def rms(block: SampleBlock, bias: FloatArray, stage: RestAndBias, from_s: float = 60.0) -> FloatArray:
    off = (vector(stage.process(block)) - bias)[round(from_s * 10) :] / DPH
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


@pytest.mark.long
def test_on_calibrated_data_and_thermal_it_is_one_filter() -> None:
    block, bias = warming(triangle(540.0))
    model = slope_model(SLOPE)
    standard = vector(RestAndBias(GIVEN, model=model).process(block))
    thermal = vector(RestAndBias(GIVEN, model=model, mode="thermal").process(block))
    np.testing.assert_allclose(thermal[100:], standard[100:], atol=3e-3 * DPH)
    assert rms(block, bias, RestAndBias(GIVEN, model=model, mode="thermal")).max() < 4.5
    # Without the model the same filter follows a ramp of 120 deg/h per minute as best it can.
    assert rms(block, bias, RestAndBias(GIVEN)).min() > 6.0


def test_zeroing_on_a_ramp_refers_to_its_end() -> None:
    t = np.arange(620) / 10
    block, bias = warming(25.0 + t / 30.0)
    off = vector(RestAndBias(GIVEN, model=slope_model(SLOPE), mode="thermal").process(block))[-1] - bias[-1]
    assert np.abs(off).max() / DPH < 12.0  # the mean over the minute lags by 60 deg/h


@pytest.mark.long
def test_while_it_moves_the_bias_follows_the_temperature() -> None:
    temperature = triangle(540.0)
    block, bias = warming(temperature)
    rest = np.arange(len(temperature)) < 700
    stage = RestAndBias(GIVEN, model=slope_model(SLOPE, residual_dph=2.0), mode="thermal")
    added = stage.process(with_rest(block, rest))
    off, sd = vector(added) - bias, vector(added, "gyro_bias_sd")
    assert np.abs(off[2600]).max() / DPH < 15.0
    assert sd[2600].max() / DPH < 22.0
    assert sd[2600, 0] > 1.2 * sd[700, 0]
    held = vector(RestAndBias(GIVEN).process(with_rest(block, rest)))
    assert np.abs(held[2600] - bias[2600]).max() / DPH > 300.0


@pytest.mark.parametrize("mode", ["standard", "thermal"])
def test_short_rests_are_enough_with_a_model(mode: Mode) -> None:
    t = np.arange(5400) / 10
    temperature = 45.0 - 20.0 * np.exp(-t / 300.0)
    block, bias = warming(temperature)
    rest = t % 120.0 < 10.0
    added = RestAndBias(GIVEN, model=slope_model(SLOPE), mode=mode).process(with_rest(block, rest))
    after = t > 260.0
    off = (vector(added) - bias)[after] / DPH
    assert np.sqrt(np.mean(off**2, axis=0)).max() < 10.0
    assert np.mean((vector(added) - bias)[after] ** 2 / vector(added, "gyro_bias_sd")[after] ** 2) < 3.0


def test_outside_the_range_the_sigma_widens_and_it_is_reported() -> None:
    t = np.arange(3000) / 10
    temperature = np.interp(t, [0, 100, 200], [48.0, 48.0, 56.0])
    block, _ = warming(temperature)
    stage = RestAndBias(GIVEN, model=slope_model(SLOPE), mode="thermal")
    added = stage.process(with_rest(block, t < 100.0))
    assert added["gyro_bias_sd_x"][-1] / DPH == pytest.approx(SLOPE * 6.0, rel=0.1)
    (said,) = [text for text in stage.notices() if "outside" in text]
    assert "20.0 to 50.0" in said


def test_the_sigma_widens_on_the_way_back_into_the_range() -> None:
    """The curve goes on in a straight line, and the gyro has no slope up there: its bias was found there."""
    t = np.arange(3000) / 10
    temperature = np.interp(t, [0, 100, 200], [60.0, 60.0, 50.0])
    block, bias = warming(temperature, 0.0)
    stage = RestAndBias(GIVEN, model=slope_model(SLOPE), mode="thermal")
    added = stage.process(with_rest(block, t < 100.0))
    ratio = (vector(added) - bias)[-1] / vector(added, "gyro_bias_sd")[-1]
    assert np.abs(ratio).max() < 2.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_slope_is_learned(seed: int) -> None:
    t = np.arange(12000) / 10
    block, bias = warming(30.0 + 2.0 * np.sin(2 * np.pi * t / 600.0), 40.0, seed)
    plain = rms(block, bias, RestAndBias(GIVEN), 300.0)
    learned = rms(block, bias, RestAndBias(GIVEN, mode="learned"), 300.0)
    assert (learned < 0.8 * plain).all()
    assert learned.max() < 5.5


@pytest.mark.long
@pytest.mark.parametrize(("flicker", "seed"), [(0.0, 0), (2.0, 1), (2.0, 2)])
def test_on_a_unit_without_slope_learning_costs_next_to_nothing(flicker: float, seed: int) -> None:
    t = np.arange(9000) / 10
    temperature = 30.0 + 10.0 * (1.0 - np.exp(-t / 400.0))
    truth = Truth(rate_hz=10.0, flicker=flicker * DPH)
    block, bias = record(truth, 900.0, seed, temperature=temperature)
    ratio = rms(block, bias, RestAndBias(GIVEN, mode="learned")) / rms(block, bias, RestAndBias(GIVEN))
    assert ratio.max() <= 1.1


@pytest.mark.long
def test_the_temperature_estimate_is_preferred_to_the_reading() -> None:
    block, _ = warming(triangle(300.0))
    coarse = block.with_columns(
        {"temperature": np.round(block["temperature"]), "temperature_estimate": block["temperature"]}
    )
    model = slope_model(SLOPE)
    expected = vector(RestAndBias(GIVEN, model, "thermal").process(block))
    np.testing.assert_array_equal(vector(RestAndBias(GIVEN, model, "thermal").process(coarse)), expected)


def test_a_model_without_temperature_leaves_the_bias_where_it_is() -> None:
    block, bias = record(SLOW, 120.0, 1)
    stage = RestAndBias(GIVEN, model=slope_model(SLOPE), mode="thermal")
    assert np.abs(vector(stage.process(block))[-1] - bias[-1]).max() < 20 * DPH
    assert any("lacks its temperature" in text for text in stage.notices())


@pytest.mark.parametrize(("arw_deg", "slope_dph", "error_dph"), [(1e-3, 40.0, 12.0), (1e-2, 300.0, 12.0)])
def test_a_quiet_gyro_is_followed_as_it_warms_up(arw_deg: float, slope_dph: float, error_dph: float) -> None:
    rate_hz, seconds = 20.0, 600.0
    truth = Truth(rate_hz, np.radians(arw_deg) / 60.0, 1e-4, flicker=10.0 * arw_deg * DPH, low_pass_hz=None)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    degc = 25.0 + 10.0 * (1.0 - np.exp(-t / 600.0))
    thermal = np.outer(degc - 25.0, np.array([0.5, -1.0, 0.25]) * slope_dph * DPH)
    block, bias = record(truth, seconds, 1, thermal, temperature=degc)
    added = RestAndBias(GIVEN, mode="learned").process(with_rest(block, np.ones(len(t), np.bool_)))
    known = t > 60.0
    error = (vector(added) - bias)[known]
    assert np.sqrt(np.mean(error**2, 0)).max() < error_dph * DPH
    assert np.abs(error / vector(added, "gyro_bias_sd")[known]).max() < 7.0


@pytest.mark.parametrize("names", [["temperature"], [f"temperature_{axis}" for axis in "xyz"]])
def test_noise_of_the_thermometer_is_no_evidence_that_there_is_no_slope(names: list[str]) -> None:
    t = np.arange(3600) / 10
    temperature = np.interp(t, [0, 300, 360], [25.0, 25.0, 27.0])
    block, bias = warming(temperature)
    noise = np.repeat(0.03 * np.random.default_rng(0).standard_normal(360), 10)
    every = {name: values for name, values in block.columns.items() if not name.startswith("temperature")}
    block = SampleBlock(every | dict.fromkeys(names, temperature + noise))
    block = with_rest(block, t < 300.0)
    block = block.with_columns(TemperatureRate().process(block))
    added = RestAndBias(GIVEN, mode="learned").process(block)
    off, sd = (vector(added) - bias)[-1], vector(added, "gyro_bias_sd")[-1]
    assert np.abs(off / sd).max() < 2.5


@pytest.mark.long
@pytest.mark.parametrize(
    ("mode", "noise_degc", "seed", "estimated", "off_by_sigmas"),
    [
        ("standard", 0.0, 0, False, 24.0),
        ("learned", 0.03, 0, False, 7.0),
        ("learned", 0.1, 0, False, 24.0),
        ("learned", 0.3, 2, True, 12.0),
    ],
)
def test_the_limits_of_temperature_are_as_the_page_has_them(
    mode: Mode, noise_degc: float, seed: int, estimated: bool, off_by_sigmas: float
) -> None:
    t = np.arange(20400) / 10
    temperature = np.interp(t, [0, 1980, 2040], [25.0, 25.0, 27.0])
    block, bias = warming(temperature)
    noise = np.repeat(noise_degc * np.random.default_rng(seed).standard_normal(2040), 10)
    block = with_rest(block.with_columns({"temperature": temperature + noise}), t < 1980.0)
    if estimated:
        block = block.with_columns(TemperatureRate().process(block))
    added = RestAndBias(GIVEN, mode=mode).process(block)
    z = ((vector(added) - bias) / vector(added, "gyro_bias_sd"))[-1]
    assert np.abs(z).max() == pytest.approx(off_by_sigmas, rel=0.25)


@pytest.mark.long
def test_steps_of_a_degree_widen_the_sigma_in_motion_and_not_at_rest() -> None:
    t = np.arange(12000) / 10
    temperature = np.interp(t, [0, 900, 1200], [25.0, 40.0, 37.0])
    block, bias = warming(temperature)
    block = with_rest(block.with_columns({"temperature": np.round(temperature)}), t < 900.0)
    block = block.with_columns(TemperatureRate().process(block))
    added = RestAndBias(GIVEN, mode="learned").process(block)
    off, sd = np.abs(vector(added) - bias) / DPH, vector(added, "gyro_bias_sd") / DPH
    assert sd[8990].max() < 20.0
    assert (off[-1] < np.maximum(2.0 * sd[-1], 1.0)).all()
    assert off[-1].max() < 30.0


def test_what_a_silent_thermometer_does_not_know_is_in_the_sigma() -> None:
    t = np.arange(4000) / 10.0
    temperature = np.interp(t, [0.0, 200.0, 400.0], [25.0, 28.0, 38.0])
    block, bias = warming(temperature)
    silent = t > 200.0
    columns = {
        "temperature_estimate": np.where(silent, 28.0, temperature),
        "temperature_estimate_sd": np.where(silent, 0.05 + 0.05 * (t - 200.0), 0.05),
    }
    stage = RestAndBias(GIVEN, mode="learned")
    added = stage.process(with_rest(block.with_columns(columns), ~silent))
    z = np.abs((vector(added) - bias) / vector(added, "gyro_bias_sd"))
    assert z[silent].max() < 5.0
