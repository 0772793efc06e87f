"""What a model lacks, drawn through what it leaves of a session that is running."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.diagnosis.live import FIRST_SEARCH_S, LiveDiagnosis
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.model import BiasModel, ChannelModel
from tests.lab.diagnosis.units import DPH, Bias, cubic, lagged, ramps, run

SECONDS = int(2.5 * FIRST_SEARCH_S)


def nothing(_: FloatArray, temperature: FloatArray) -> FloatArray:
    return np.zeros_like(temperature)


def behind(_: FloatArray, temperature: FloatArray) -> FloatArray:
    return cubic(lagged(temperature, 400.0)) - cubic(temperature)


@pytest.fixture(scope="module")
def curve_alone() -> BiasModel:
    degc = np.linspace(10.0, 42.0, 200)
    points = Points(degc, cubic(degc) * DPH, np.ones(200), np.zeros(200, np.int64))
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[10.0, 42.0],
        residual_sd=5.0 * DPH,
        curve=fit_polynomial(points, 3),
    )
    return BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels={"gyro_x": channel})


def watched(
    model: BiasModel, bias: Bias, names: Sequence[str] = ("gyro_x",), larger: str = ""
) -> LiveDiagnosis:
    """Return the diagnosis after a session of means of a second; one axis may have twice the bias."""
    told = run(5, *ramps(SECONDS, up=True), bias, tuple(names))
    if larger:
        told.mean[larger] = told.mean[larger] + bias(told.time_s, told.mean["temperature"]) * DPH
    columns = {**told.mean, "at_rest": told.rest}
    columns["device_time_ns"] = (told.time_s * 1e9).astype(np.int64)
    columns["segment"] = np.zeros(SECONDS, np.int64)
    stage = LiveDiagnosis(model)
    stage.process(SampleBlock(columns))
    stage.process(SampleBlock({name: values[-1:] for name, values in columns.items()}))
    return stage


def test_the_effect_that_is_lacking_follows_what_is_left(curve_alone: BiasModel) -> None:
    over_time, over_temperature = watched(curve_alone, behind).charts()
    points, line = over_time.curves
    assert line.name in ("thermal_lag", "dead_time", "temperature_rate", "hysteresis")
    assert np.std(points.y - line.y) < 0.5 * np.std(points.y)
    assert over_time.x.label == "time since power-on [min]"
    assert points.x[-1] > FIRST_SEARCH_S / 60.0 - 1.0
    for one, other in zip(over_time.curves, over_temperature.curves, strict=True):
        np.testing.assert_array_equal(one.y, other.y)
    assert over_temperature.curves[0].x.max() == pytest.approx(40.0, abs=0.1)


def test_a_model_that_lacks_nothing_has_no_chart(curve_alone: BiasModel) -> None:
    assert watched(curve_alone, nothing).charts() == []


def test_the_chart_is_of_the_axis_with_the_largest_error(curve_alone: BiasModel) -> None:
    names = [f"gyro_{axis}" for axis in "xyz"]
    every = curve_alone.model_copy(update={"channels": dict.fromkeys(names, curve_alone.channels["gyro_x"])})
    stage = watched(every, lambda time, _: 12.0 * np.sin(time / 90.0), names, larger="gyro_y")
    assert [chart.title.split(" minus")[0] for chart in stage.charts()] == ["Gyro y", "Gyro y"]
