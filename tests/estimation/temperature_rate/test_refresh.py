"""A reading that is repeated: the time is found from its changes, and it is measured once."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.filter import MEAN_MODELS, slow_error
from imumon.estimation.temperature_rate.stage import MultipleModelRate
from imumon.estimation.temperature_rate.thermometer import Thermometer
from tests.estimation.temperature_rate.records import clock, quantized, steady

STEP, RATE_HZ = 0.0625, 20.0
RAMP = 2.0 / 60.0


def repeated(temperature: FloatArray, interval_s: float, noise: float, seed: int) -> FloatArray:
    """Return a temperature, sampled at RATE_HZ, as read by a thermometer refreshed at intervals."""
    repeat = round(interval_s * RATE_HZ)
    fresh = quantized(temperature[::repeat], noise * STEP, seed, STEP)
    return np.repeat(fresh, repeat)[: len(temperature)]


@pytest.mark.parametrize("interval_s", [2.0, 4.0, 7.5, 20.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_repeat_time_is_found_from_flicker(interval_s: float, seed: int) -> None:
    temperature = np.full(int(60 * interval_s * RATE_HZ), 25.02)
    method = run(repeated(temperature, interval_s, 0.5, seed))
    assert method.thermometer.repeat_s == pytest.approx(interval_s, rel=0.15)


@pytest.mark.parametrize("rate", [3.0, 20.0, 100.0])
@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_crossings_of_a_thermometer_read_at_every_sample_are_no_repeats(rate: float, noise: float) -> None:
    method = run(quantized(steady(rate, 0.5, RATE_HZ), noise * STEP, step=STEP))
    assert method.thermometer.repeat_s < 0.5


def run(reading: FloatArray) -> MultipleModelRate:
    """Return the method after a record."""
    time_ns, segment = clock(len(reading), RATE_HZ)
    method = MultipleModelRate()
    method.process(time_ns, segment, reading)
    return method


@pytest.mark.parametrize("interval_s", [4.0, 10.0, 60.0])
@pytest.mark.parametrize("hold_s", [60.0, 300.0])
def test_a_ramp_is_never_farther_off_than_the_age_of_the_reading_allows(
    interval_s: float, hold_s: float
) -> None:
    t = np.arange(int((hold_s + 240.0) * RATE_HZ)) / RATE_HZ
    temperature = 25.02 + RAMP * np.maximum(t - hold_s, 0.0)
    time_ns, segment = clock(len(t), RATE_HZ)
    result = MultipleModelRate().process(time_ns, segment, repeated(temperature, interval_s, 0.3, 11))
    error = result.temperature - temperature
    assert np.abs(error[t > hold_s]).max() < 0.17 + RAMP * interval_s
    later = t > hold_s + 20.0 + interval_s
    assert np.abs(error / result.temperature_sd)[later].max() < 6.0
    assert np.abs((result.rate - RAMP) / result.rate_sd)[later].max() < 6.0


@pytest.mark.parametrize(("ramp", "interval_s"), [(5.0, 30.0), (5.0, 60.0), (10.0, 20.0)])
def test_a_first_change_that_leaps_after_a_silence_is_of_a_repeated_reading(
    ramp: float, interval_s: float
) -> None:
    t = np.arange(int(480.0 * RATE_HZ)) / RATE_HZ
    temperature = 25.02 + ramp / 60.0 * np.maximum(t - 305.0, 0.0)
    reading = repeated(temperature, interval_s, 0.0, 0)
    time_ns, segment = clock(len(t), RATE_HZ)
    result = MultipleModelRate(STEP).process(time_ns, segment, reading)
    later = t > t[np.flatnonzero(np.diff(reading))[0]] + 2.0
    assert np.abs((result.temperature - temperature) / result.temperature_sd)[later].max() < 7.0


def test_a_ramp_from_refresh_to_refresh_is_no_noise_that_a_soak_would_have_stopped() -> None:
    t = np.arange(int(3000.0 * RATE_HZ)) / RATE_HZ
    temperature = 25.02 + RAMP * np.clip(t - 300.0, 0.0, 1200.0)
    time_ns, segment = clock(len(t), RATE_HZ)
    result = MultipleModelRate().process(time_ns, segment, repeated(temperature, 5.0, 0.1, 11))
    soaked = t > 1600.0
    assert np.abs(result.temperature - temperature)[soaked].max() < 2.0 * STEP


@pytest.mark.parametrize("seed", range(3))
def test_a_silent_level_between_two_readings_is_no_certainty(seed: int) -> None:
    """A reading that flickers once a minute or so: its edge is found, and a ramp is not taken for noise."""
    t = np.arange(int(1500.0 * RATE_HZ)) / RATE_HZ
    temperature = 25.353 + RAMP * np.maximum(t - 1200.0, 0.0)
    reading = np.repeat(quantized(temperature[::200], 0.025, seed, step=0.25), 200)
    time_ns, segment = clock(len(t), RATE_HZ)
    result = MultipleModelRate().process(time_ns, segment, reading)
    error = result.temperature - temperature
    assert np.abs(error[(t > 600.0) & (t < 1200.0)]).max() < 0.125
    later = t > 1230.0
    assert np.abs((result.rate - RAMP) / result.rate_sd)[later].max() < 6.0
    assert np.abs(error / result.temperature_sd)[later].max() < 6.0


@pytest.mark.parametrize(("interval_s", "widest"), [(10.0, 1.2), (60.0, 2.5)])
def test_readings_far_apart_are_neighbours_whatever_the_jitter(interval_s: float, widest: float) -> None:
    temperature = steady(5.0, 2.0, 1.0 / interval_s)
    reading = quantized(temperature, 0.2 * STEP, step=STEP)
    jitter_ns = np.random.default_rng(2).integers(-1_000_000, 1_000_000, len(reading))
    time_ns, segment = clock(len(reading), 1.0 / interval_s)
    for offset_ns in (0 * jitter_ns, jitter_ns):
        result = MultipleModelRate().process(time_ns + offset_ns, segment, reading)
        late = slice(len(reading) // 2, None)
        assert np.abs(result.rate[late] * 3600.0 - 5.0).max() < 1.0
        assert np.median(result.rate_sd[late]) * 3600.0 < widest
        assert (np.abs(result.temperature - temperature) < 4.0 * result.temperature_sd)[late].all()


def test_the_slow_error_of_a_sensor_read_every_10_s_is_what_its_spacing_shows() -> None:
    row = MEAN_MODELS.index((0.0, 1.0, 5.0, 0.0)) - len(MEAN_MODELS)
    thermometer = Thermometer(0.001, rho=0.01)
    of_a_second, _ = slow_error(thermometer)
    thermometer.sample_s = 10.0
    variance, _ = slow_error(thermometer)
    assert of_a_second[row, 0] == pytest.approx(0.01 / 0.1318, rel=0.01)
    assert variance[row, 0] == pytest.approx(0.01 / 0.8258, rel=0.01)


@pytest.mark.parametrize("declared", [None, 0.01])
def test_a_noisy_thermometer_that_is_read_twice_a_minute_among_faster_rows(declared: float | None) -> None:
    time_ns, segment = clock(3600, 1.0)
    reading = np.full(3600, np.nan)
    reading[::30] = quantized(np.full(120, 20.0), 0.2, 3, 0.01)
    found = MultipleModelRate(declared).process(time_ns, segment, reading)
    error = (found.temperature - 20.0)[1200:]
    assert np.sqrt(np.mean((error / found.temperature_sd[1200:]) ** 2)) < 1.8
    assert np.median(found.temperature_sd[1200:]) < 0.2


def test_a_restart_of_the_device_keeps_that_readings_are_repeated() -> None:
    """Repeats of a thermometer without noise, that only a leap had shown, were taken for new readings."""
    t = np.arange(int(600.0 * RATE_HZ)) / RATE_HZ
    slowly = 25.02 + 0.004 * t  # the step shows
    reading = repeated(slowly + RAMP * np.maximum(t - 300.0, 0.0), 10.0, 0.0, 0)
    time_ns, segment = clock(len(t), RATE_HZ)
    method = MultipleModelRate()
    method.process(time_ns, segment, reading)
    assert method.thermometer.repeat_s == pytest.approx(10.0, rel=0.15)
    again = int(30.0 * RATE_HZ)
    method.process(time_ns[:again], segment[:again] + 1, reading[:again])
    assert method.thermometer.repeat_s == pytest.approx(10.0, rel=0.15)
