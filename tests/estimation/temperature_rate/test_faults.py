"""Broken thermometers: what leaps as no temperature does, and sticks, is not heat."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.temperature_rate.stage import TemperatureRate
from tests.estimation.temperature_rate.records import block, quantized

POWER_ON_DEGC = 85.0


def process(stage: TemperatureRate, t: FloatArray, reading: FloatArray) -> Mapping[str, ColumnArray]:
    return stage.process(block(np.round(t * 1e9).astype(np.int64), temperature=reading))


def read(truth: FloatArray, step: float) -> FloatArray:
    return quantized(truth, 0.3 * step, 0, step)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("stuck_s", [4.0, 8.0, 80.0])
def test_a_value_that_sticks_after_a_leap_is_passed_over(rate_hz: float, stuck_s: float) -> None:
    t = np.arange(0.0, 900.0, 1.0 / rate_hz)
    truth = 25.0 + t / 36.0
    reading = read(truth, 0.0625)
    sticks = (t >= 700.0) & (t < 700.0 + stuck_s)
    reading[sticks] = POWER_ON_DEGC
    stage = TemperatureRate()
    found = process(stage, t, reading)
    off = np.abs(found["temperature_estimate"] - truth)[t > 600.0]
    assert off.max() < 1.0
    assert (off / found["temperature_estimate_sd"][t > 600.0]).max() < 5.0
    first, last = np.flatnonzero(sticks)[[0, -1]]
    assert found["temperature_rate_sd"][last] > found["temperature_rate_sd"][first]
    (text,) = stage.notices()
    assert "85 °C" in text


def test_a_spike_before_it_sticks_makes_no_difference() -> None:
    t = np.arange(0.0, 900.0, 0.1)
    truth = 25.0 + t / 36.0
    reading = read(truth, 0.0625)
    reading[(t >= 700.0) & (t < 708.0)] = POWER_ON_DEGC
    reading[[6995, 7033, 7034]] = -127.0
    found = process(TemperatureRate(), t, reading)["temperature_estimate"]
    assert np.abs(found - truth)[t > 600.0].max() < 1.0


@pytest.mark.parametrize("last", [9, 5])
def test_spikes_are_no_changes_back_wherever_they_are_in_a_second(last: int) -> None:
    t = np.arange(0.0, 900.0, 0.1)
    reading = 0.5 * np.round((25.0 + t / 720.0) / 0.5)
    clean = process(TemperatureRate(), t, reading)["temperature_estimate_sd"][-1]
    reading[[4000 + last, 4020 + last, 4040 + last]] = POWER_ON_DEGC
    found = process(TemperatureRate(), t, reading)["temperature_estimate_sd"][-1]
    assert found == pytest.approx(clean, rel=0.1)


@pytest.mark.parametrize("last", [9, 5])
@pytest.mark.parametrize("change", [1010, 1012, 1015])
def test_the_first_change_right_after_a_spike_is_learned(last: int, change: int) -> None:
    t = np.arange(0.0, 400.0, 0.1)
    reading = np.where(np.arange(len(t)) < change, 20.0, 20.5)
    clean = process(TemperatureRate(), t, reading)["temperature_estimate_sd"][-1]
    reading[1000 + last] = POWER_ON_DEGC
    found = process(TemperatureRate(), t, reading)["temperature_estimate_sd"][-1]
    assert found == pytest.approx(clean, rel=0.2)


def test_where_it_never_comes_back_nothing_is_reported_after_ten_minutes_until_it_moves() -> None:
    t = np.arange(0.0, 2400.0, 0.1)
    reading = read(np.full(len(t), 25.0) + t / 360.0, 0.0625)
    reading[(t >= 600.0) & (t < 1800.0)] = POWER_ON_DEGC
    found = process(TemperatureRate(), t, reading)["temperature_estimate"]
    assert np.isnan(found[(t > 1210.0) & (t < 1799.0)]).all()
    assert np.abs(found[t > 1810.0] - (25.0 + t[t > 1810.0] / 360.0)).max() < 0.2


def test_a_leap_to_readings_that_move_is_believed() -> None:
    t = np.arange(0.0, 900.0, 0.1)
    truth = np.where(t < 600.0, 25.0, 45.0)
    stage = TemperatureRate()
    found = process(stage, t, read(truth, 0.0625))["temperature_estimate"]
    assert np.abs(found - truth)[t > 620.0].max() < 0.2
    assert stage.notices() == []


@pytest.mark.parametrize("stuck_s", [0.75, 2.0, 8.0])
@pytest.mark.parametrize("step", [0.0625, 1.0])
@pytest.mark.parametrize("noisy", [False, True])
def test_the_value_at_power_on_is_doubted_and_left(stuck_s: float, step: float, noisy: bool) -> None:
    t = np.arange(0.0, 120.0, 0.1)
    measured = read(np.full(len(t), 25.03), step) if noisy else step * np.round(25.03 / step)
    reading = np.where(t < stuck_s, POWER_ON_DEGC, measured)
    found = process(TemperatureRate(), t, reading)
    behind = t >= stuck_s + 1.0
    off = np.abs(found["temperature_estimate"] - 25.03)
    assert np.nanmax((off / found["temperature_estimate_sd"])[behind]) < 4.0
    assert off[t > 3.0 * stuck_s + 15.0].max() < 0.5


@pytest.mark.parametrize("moves_s", [10.0, 1e9])
@pytest.mark.parametrize("glitch_s", [1.0, 2.0])
def test_a_glitch_after_a_long_silence_is_ignored(moves_s: float, glitch_s: float) -> None:
    t = np.arange(1200.0)
    truth = np.where(t < moves_s, 20.0, 20.5)
    glitch = (t >= 300.0) & (t < 300.0 + glitch_s)
    found = process(TemperatureRate(), t, np.where(glitch, POWER_ON_DEGC, truth))
    later = t >= 300.0
    off = np.abs(found["temperature_estimate"] - truth)[later]
    assert (off / found["temperature_estimate_sd"][later]).max() < 2.0
    assert found["temperature_estimate_sd"][t > 305.0].max() < 1.0


def test_three_glitches_of_a_quiet_thermometer_are_no_noise_over_an_edge() -> None:
    t = np.arange(400.0)
    truth = np.where(t < 50.0, 20.0, 20.5)
    found = process(TemperatureRate(), t, np.where(np.isin(t, [100, 140, 180]), POWER_ON_DEGC, truth))
    off = np.abs(found["temperature_estimate"] - truth)[t > 182.0]
    assert off.max() < 0.25
    assert found["temperature_estimate_sd"][-1] > 0.2


@pytest.mark.parametrize("rate_hz", [1.0, 100.0])
def test_a_constant_temperature_after_a_ramp_is_no_dead_thermometer(rate_hz: float) -> None:
    t = np.arange(0.0, 1500.0, 1.0 / rate_hz)
    truth = 20.0 + 0.003 * np.minimum(t, 60.0) + 0.05 * np.clip(t - 60.0, 0.0, 120.0)
    found = process(TemperatureRate(), t, np.round(truth / 0.01) * 0.01)
    assert np.abs(found["temperature_estimate"] - truth)[t > 200.0].max() < 0.02
    assert found["temperature_estimate_sd"][-1] < 0.05


def test_a_thermometer_that_dies_is_named_and_a_gap_is_not() -> None:
    t = np.arange(0.0, 900.0, 0.1)
    reading = read(np.full(len(t), 25.0), 0.01) + quantized(np.zeros(len(t)), 0.03, 1, 0.01)
    for fault, texts in ((np.nan, []), (25.0, ["temperature: its noise has stopped"])):
        stage = TemperatureRate()
        process(stage, t, np.where(t > 600.0, fault, reading))
        assert [text.split(": taken")[0] for text in stage.notices()] == texts


@pytest.mark.parametrize("size", [0.5, 3.0, 6.0])
def test_a_small_glitch_after_a_silence_is_no_repeated_reading(size: float) -> None:
    t = np.arange(1200.0)
    truth = np.where(t < 10.0, 20.0, 20.0625)
    found = process(TemperatureRate(), t, np.where(t == 600.0, truth + size, truth))
    assert np.abs(found["temperature_estimate"] - truth)[t > 605.0].max() < 0.0625
    assert found["temperature_estimate_sd"][t > 620.0].max() < 0.1
