"""A unit that is carried about while its temperature rises, with rests of ten seconds: the whole chain."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.simulation.unit.scenario import Chamber, Scenario, Step, load_scenario
from imumon.simulation.unit.unit import SimulatedUnit
from tests.estimation.gyro_bias.records import DPH, GIVEN, vector

BAR_DPH, LARGEST_DPH = 10.0, 60.0
"""Bar of `scripts/reproduce/bias_race`, and half of what the bias moves from rest to rest."""
CENTER_DEGC, HALF_DEGC = 35.0, 12.0


def carried() -> Scenario:
    """Return the ramp of the race: 25 to 45 °C at 2 °C/min, a rest of 10 s every 2 min."""
    base = load_scenario("warm-up")
    chamber = Chamber(start_degc=25.0, steps=[Step(to_degc=45.0, rate_degc_per_min=2.0)])
    unit = base.unit.model_copy(update={"self_heating": None})
    return base.model_copy(update={"unit": unit, "chamber": chamber, "duration_s": 600.0})


def model_of(truth: SampleBlock) -> BiasModel:
    """Return a curve through the true bias."""
    channels = {}
    for axis in "xyz":
        degc = (truth[f"temperature_{axis}"][::100] - CENTER_DEGC) / HALF_DEGC
        fit = np.polynomial.chebyshev.chebfit(degc, truth[f"gyro_bias_{axis}"][::100], 4)
        channels[f"gyro_{axis}"] = ChannelModel(
            unit="rad/s",
            temperature_column="temperature",
            temperature_range_degc=[20.0, 50.0],
            residual_sd=DPH,
            curve=PolynomialCurve(
                center_degc=CENTER_DEGC, half_width_degc=HALF_DEGC, coefficients=fit.tolist()
            ),
        )
    return BiasModel(made_by="test", created="2026-01-01T00:00:00Z", channels=channels)


@pytest.mark.long
def test_a_change_that_the_temperature_explains_is_no_turn_and_does_not_cost_the_bias() -> None:
    scenario = carried()
    samples, truth = SimulatedUnit(scenario, 9).run(scenario.samples)
    model, heading = model_of(truth), scenario.attitude.heading_deg
    for stage in (
        TemperatureRate(),
        RestAndBias(None, model, "thermal", scenario.latitude_deg, heading),
    ):
        samples = samples.with_columns(stage.process(samples))
    late = samples["device_time_ns"] * 1e-9 > 250.0
    error: FloatArray = (vector(samples.columns) - vector(truth.columns))[late]
    assert np.sqrt(np.mean(error**2)) < BAR_DPH * DPH
    assert np.abs(error).max() < LARGEST_DPH * DPH
    assert np.abs(error / vector(samples.columns, "gyro_bias_sd")[late]).max() < 5.0


def test_a_heading_that_a_scale_error_has_turned_is_in_the_sigma_of_the_rest_after_it() -> None:
    rng, rate_hz = np.random.default_rng(3), 50.0
    t = np.arange(round(120.0 * rate_hz)) / rate_hz
    rest = (t < 30.0) | (t >= 90.0)
    yaw = np.radians(120.0) * np.clip(t - 30.0, 0.0, 60.0)
    level = EARTH_RATE * np.cos(np.radians(50.0))
    upright = EARTH_RATE * np.sin(np.radians(50.0)) + 1.01 * np.radians(120.0) * ~rest
    gyro = np.column_stack([level * np.cos(yaw), -level * np.sin(yaw), upright])
    gyro += 1e-6 * rng.normal(size=gyro.shape)
    columns = {f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")}
    columns |= {f"accel_{axis}": np.full(len(t), STANDARD_GRAVITY * (axis == "z")) for axis in "xyz"}
    block = SampleBlock(
        {
            "device_time_ns": np.round(t * 1e9).astype(np.int64),
            "segment": np.zeros(len(t), np.int64),
            "at_rest": rest.astype(np.int64),
            **columns,
        }
    )
    found = RestAndBias(GIVEN, None, "standard", 50.0, 0.0).process(block)
    bias, sd = vector(found)[-1], vector(found, "gyro_bias_sd")[-1]
    assert np.abs(bias[:2]).max() > 3.0 * DPH  # the known heading is off by 70 degrees
    assert (np.abs(bias) < 4.0 * sd).all()
    assert sd[:2].max() < EARTH_RATE
