from __future__ import annotations

import pytest

from imumon.effects.since_power_on import StressRelaxation, WarmUp
from imumon.estimation.alignment.parameters import known_warm_up
from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.smoothing.stage import value_and_sd
from imumon.geodesy import MICRO_G
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.protocols.device import load_device
from imumon.run.setup import Setup, parse_setup
from imumon.run.stages import estimators
from imumon.view.panels import PANELS


def _model() -> BiasModel:
    channel = ChannelModel(
        unit="m/s^2",
        temperature_column="temperature",
        temperature_range_degc=[5.0, 35.0],
        residual_sd=5.0 * MICRO_G,
        curve=PolynomialCurve(center_degc=20.0, half_width_degc=15.0, coefficients=[0.0, 1e-3]),
        effects=[WarmUp(time_constant_s=150.0, coefficients=[-80.0 * MICRO_G])],
    )
    gyro = channel.model_copy(update={"unit": "rad/s", "effects": []})
    channels = {"accel_x": channel} | {f"gyro_{axis}": gyro for axis in "xyz"}
    return BiasModel(made_by="test", created="2026-01-01T00:00:00Z", channels=channels)


def _alignment(setup: Setup, device: str | None = None) -> Alignment | None:
    stages = estimators(load_device(device) if device else None, setup)
    return next((stage for stage in stages if isinstance(stage, Alignment)), None)


def test_the_heading_is_sought_only_where_the_latitude_is_known() -> None:
    assert _alignment(Setup()) is None
    assert _alignment(Setup(latitude_deg=36.0)) is not None


def test_a_device_that_sends_angles_keeps_their_names() -> None:
    stage = _alignment(Setup(latitude_deg=36.0), "ax1")
    assert stage is not None
    names = {column.name for column in stage.columns}
    assert {"aligned_roll", "aligned_pitch", "heading"} <= names
    assert not {"roll", "pitch"} & names


def test_a_pipeline_file_sets_the_alignment_and_keys_of_before_are_read() -> None:
    text = "format: imumon-pipeline/1\nlatitude_deg: 36\nalignment: {corner_hz: 1.0, settled_deg: 0.1}\n"
    setup = parse_setup(text, "pipeline.yaml")
    assert setup.alignment.settled_deg == 0.1
    again = parse_setup(setup.text() or "", "session.yaml")
    assert again.alignment.model_dump() == setup.alignment.model_dump()


def test_the_warm_up_of_a_model_is_that_of_its_accelerometers() -> None:
    assert known_warm_up(None) is None
    found = known_warm_up(_model())
    assert found is not None
    assert found.amplitude_ug == pytest.approx([80.0, 0.0, 0.0])
    assert found.time_constant_s[0] == 150.0
    assert found.amplitude_sd_ug == pytest.approx(5.0)


def test_an_accelerometer_that_may_drift_otherwise_leaves_the_level_unknown() -> None:
    model = _model()
    relaxing = StressRelaxation(time_constant_s=1.0, ratio=1e4, coefficients=[60.0 * MICRO_G])
    other = model.channels["accel_x"].model_copy(update={"effects": [relaxing]})
    found = known_warm_up(model.model_copy(update={"channels": model.channels | {"accel_y": other}}))
    assert found is not None
    assert found.amplitude_ug == pytest.approx([80.0, 0.0, 0.0])
    assert found.amplitude_sd_ug is None


def test_the_stage_takes_the_warm_up_from_the_model_unless_given_another() -> None:
    stage = _alignment(Setup(latitude_deg=36.0, model=_model()))
    assert stage is not None
    own = {"amplitude_ug": [1.0, 2.0, 3.0], "time_constant_s": 60.0}
    setup = parse_setup(Setup(model=_model()).text() or "", "x").model_copy(
        update={"alignment": Setup.model_validate({"alignment": {"known_warm_up": own}}).alignment}
    )
    known = setup.alignment_with_warm_up.known_warm_up
    assert known is not None
    assert known.amplitude_ug == [1.0, 2.0, 3.0]
    assert known.time_constant_s == [60.0] * 3


def test_the_panels_draw_columns_that_the_stage_has() -> None:
    bands = [panel for panel in PANELS if panel.place == "Alignment"]
    stages = [_alignment(Setup(latitude_deg=36.0), device) for device in (None, "ax1")]
    there = {column.name for stage in stages if stage is not None for column in stage.columns}
    there |= set(value_and_sd("heading_smoothed"))
    assert bands
    assert all(set(panel.columns) <= there for panel in bands)
