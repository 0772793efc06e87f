"""The stage of the pipeline: names, parameters, ranges, notices."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.config import parse_yaml
from imumon.errors import ImumonError
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.estimation.temperature_rate.thermometer import UNKNOWN_STEP_DEGC
from imumon.pipeline import Estimator
from imumon.protocols.thermometer import TemperatureRateParameters
from tests.estimation.temperature_rate.records import block, clock, quantized, self_heating

FIRST_SLOT = 10
"""Rows of the first second, at 10 Hz."""


def test_one_sensor_gives_four_columns() -> None:
    stage: Estimator = TemperatureRate()
    temperature, _ = self_heating(0.05)
    added = stage.process(block(temperature=quantized(temperature, 0.0)))
    names = ["temperature_estimate", "temperature_rate", "temperature_estimate_sd", "temperature_rate_sd"]
    assert [column.name for column in stage.columns] == names == list(added)
    assert [column.unit for column in stage.columns] == ["degC", "degC/s", "degC", "degC/s"]
    first = {name: np.argmax(np.isfinite(values)) for name, values in added.items()}
    assert first == dict.fromkeys(names, 0) | {"temperature_estimate_sd": FIRST_SLOT}
    assert all(np.isfinite(values[first[name] :]).all() for name, values in added.items())


@pytest.mark.parametrize("rate_hz", [0.1, 1.0, 10.0, 100.0])
def test_what_a_single_reading_is_worth_nobody_knows_before_a_second(rate_hz: float) -> None:
    n = max(3, int(5 * rate_hz))
    time_ns, _ = clock(n, rate_hz)
    garbage = np.random.default_rng(0).uniform(-100.0, 250.0, n)
    for reading in (garbage, np.full(n, 25.0)):
        stage = TemperatureRate()
        added = stage.process(block(time_ns, temperature=reading))
        sd, known = added["temperature_estimate_sd"], max(1, round(rate_hz))
        assert np.isnan(sd[:known]).all()
        assert added["temperature_estimate"][0] == reading[0]
    assert np.isfinite(sd[known:]).all()  # of the thermometer, not of the garbage


@pytest.mark.parametrize(
    ("declared", "floor"), [(None, UNKNOWN_STEP_DEGC / np.sqrt(12.0)), (0.01, 0.01 / np.sqrt(12.0))]
)
def test_a_segment_begins_with_the_steps_that_nobody_saw(declared: float | None, floor: float) -> None:
    time_ns, segment = clock(200)
    segment[100:] = 1
    columns = {"device_time_ns": time_ns, "segment": segment, "temperature": np.full(200, 25.0)}
    stage = TemperatureRate(TemperatureRateParameters(step_degc=declared))
    sd = stage.process(SampleBlock(columns))["temperature_estimate_sd"]
    np.testing.assert_allclose(sd[100 : 100 + FIRST_SLOT], floor, rtol=0.05)


def test_a_sensor_per_axis_gives_columns_per_axis_that_do_not_mix() -> None:
    temperature, _ = self_heating(0.1)
    x, y = quantized(temperature, 0.0), quantized(60.0 - temperature, 0.005)
    both = TemperatureRate().process(block(temperature_x=x, temperature_y=y))
    alone = TemperatureRate().process(block(temperature_y=y))
    assert both["temperature_rate_x"][-1] > 0 > both["temperature_rate_y"][-1]
    for name, values in alone.items():
        np.testing.assert_array_equal(both[name], values)
    assert "temperature_estimate_sd_y" in alone


def test_a_channel_without_readings_is_missing() -> None:
    added = TemperatureRate().process(block(temperature_z=np.full(50, np.nan)))
    assert np.isnan(added["temperature_rate_z"]).all()


def test_retired_parameters_are_read_and_ignored() -> None:
    given = parse_yaml("lowest_degc: 80\nhighest_degc: 20\n", TemperatureRateParameters, "device.yaml")
    assert "degc: 80" not in given.model_dump_json()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("method: kalman", "method"),
        ("step_degc: -1", "step_degc"),
        ("buffer_size: 6", "buffer_size"),
        ("steps: 0.05", "unknown key"),
    ],
)
def test_wrong_parameters_are_refused_with_the_line(text: str, said: str) -> None:
    with pytest.raises(ImumonError, match=said) as caught:
        parse_yaml(text, TemperatureRateParameters, "device.yaml")
    assert "device.yaml:1" in caught.value.seen


def test_a_reading_that_changes_in_the_first_second_of_a_segment_is_taken() -> None:
    segments, n = 6, 500
    temperature = np.tile(np.repeat([20.0, 20.05], (150, n - 150)), segments)
    segment = np.repeat(np.arange(segments), n)
    time_ns = np.tile(np.arange(n) * 4_000_000, segments)
    sent = SampleBlock({"device_time_ns": time_ns, "segment": segment, "temperature": temperature})
    assert np.isfinite(TemperatureRate().process(sent)["temperature_rate"][-1])
