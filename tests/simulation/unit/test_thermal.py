from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.simulation.unit import load_scenario
from imumon.simulation.unit.parameters import SelfHeating, Thermometer
from imumon.simulation.unit.scenario import Chamber, Wobble
from imumon.simulation.unit.thermal import (
    Lags,
    SensorTemperature,
    Thermometers,
    chamber_knots,
    chamber_log,
    chamber_temperature,
)


def test_the_ramp_is_that_of_the_specification() -> None:
    chamber = load_scenario("crs05-ramp").chamber
    t = np.array([0.0, 60.0, 162.0, 264.0, 324.0, 426.0, 528.0, 600.0, 9e9])
    expected = [27.28, 27.28, 30.68, 34.08, 34.08, 30.68, 27.28, 27.28, 27.28]
    np.testing.assert_allclose(chamber_temperature(chamber, t), expected, atol=1e-9)


def test_the_soak_holds_fifteen_levels_for_two_and_a_half_hours_each() -> None:
    plan = load_scenario("crs05-soak")
    ends: FloatArray = np.arange(9000.0, 136_000.0, 9000.0)
    levels = np.array([-20.53 + 5 * step for step in range(14)] + [48.08])
    np.testing.assert_allclose(chamber_temperature(plan.chamber, ends), levels, atol=1e-9)
    np.testing.assert_allclose(chamber_temperature(plan.chamber, ends - 8600), levels, atol=1e-9)
    assert chamber_knots(plan.chamber)[0][-1] == pytest.approx(plan.duration_s)


def test_sensors_lag_the_chamber_and_warm_themselves() -> None:
    chamber = Chamber(start_degc=20.0, lag_s=50.0, wobble=Wobble(amplitude_degc=1.0, period_s=100.0))
    t = np.arange(0, 2000, 0.5)
    alone = SensorTemperature(chamber, None).process(t)
    heated = SensorTemperature(chamber, SelfHeating(rise_degc=(8.0, 0.0, 4.0), tau_s=200.0)).process(t)
    gain = 1 / np.hypot(1, 2 * np.pi * 50.0 / 100.0)
    assert np.max(alone[2000:, 0]) - 20.0 == pytest.approx(gain, rel=1e-3)
    grown = 1 - np.exp(-t / 200.0)
    np.testing.assert_allclose(heated - alone, np.outer(grown, [8.0, 0.0, 4.0]), atol=1e-9)


def test_readings_are_noisy_quantized_and_held() -> None:
    true = np.column_stack([np.linspace(20, 22, 4000), np.linspace(30, 29, 4000)])
    readings = Thermometers(Thermometer(step_degc=0.05, noise_degc=0.005, rate_hz=10), 2, 100.0, 1).process(
        0, true
    )
    assert np.allclose(readings / 0.05, np.rint(readings / 0.05), atol=1e-6)
    changes = np.flatnonzero(np.diff(readings[:, 0])) + 1
    assert np.all(changes % 10 == 0)
    assert len(changes) >= 39
    error = readings[::10] - true[::10]
    assert error.std() == pytest.approx(np.hypot(0.05 / np.sqrt(12), 0.005), rel=0.1)


def test_readings_do_not_depend_on_the_blocks() -> None:
    true = np.random.default_rng(1).normal(20, 1, (100, 1))
    parameters = Thermometer(rate_hz=30)  # held for three packets
    whole = Thermometers(parameters, 1, 100.0, 2).process(0, true)
    parts = Thermometers(parameters, 1, 100.0, 2)
    pieces = [parts.process(a, true[a:b]) for a, b in ((0, 1), (1, 2), (2, 3), (3, 50), (50, 100))]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


@pytest.mark.parametrize("step_s", [0.01, 0.5, 7.0])
def test_a_lag_follows_a_ramp_exactly_at_any_rate(step_s: float) -> None:
    """Response to a ramp r t: r (t - tau (1 - exp(-t / tau))); the second column does not lag."""
    tau, t = 30.0, step_s * np.arange(1, 200)
    ramp = np.column_stack([20 + 0.03 * t, 5 - 0.01 * t])
    time = np.asarray(step_s * np.arange(200), np.float64)
    out = Lags([tau, 0.0]).process(time, np.vstack([[20.0, 5.0], ramp]))
    np.testing.assert_allclose(out[1:, 0], 20 + 0.03 * (t - tau * -np.expm1(-t / tau)), rtol=1e-12)
    np.testing.assert_array_equal(out[1:, 1], ramp[:, 1])


def test_a_lag_stays_where_it_is_in_equilibrium() -> None:
    out = Lags([100.0]).process(np.asarray(0.01 * np.arange(5000), np.float64), np.full((5000, 1), -20.53))
    np.testing.assert_allclose(out, -20.53, rtol=1e-12)


def test_the_log_shows_the_wall_and_the_case_behind_it() -> None:
    scenario = load_scenario("crs05-soak-chamber")
    time_s, read = chamber_log(scenario, 1)
    assert read.shape == (13_500, 2)
    wall = chamber_temperature(scenario.chamber, time_s)
    unit = SensorTemperature(scenario.chamber, None).process(time_s)[:, 0]
    assert np.std(read[:, 0] - wall) == pytest.approx(np.hypot(0.1 / np.sqrt(12), 0.05), rel=0.1)
    assert np.std(read[:, 1] - unit) == pytest.approx(np.hypot(0.1 / np.sqrt(12), 0.05), rel=0.1)
    # A step of 5 °C at 1 °C/min leaves the case tau (1 - exp(-5 min / tau)) minutes behind at its end.
    behind = (wall - read[:, 1])[np.abs(time_s - 9300.0) < 1.0]
    assert behind == pytest.approx(-10.0 * np.expm1(-0.5), abs=0.3)
