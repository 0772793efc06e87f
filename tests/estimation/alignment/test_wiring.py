from __future__ import annotations

from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.smoothing.stage import value_and_sd
from imumon.protocols.device import load_device
from imumon.run.setup import Setup, parse_setup
from imumon.run.stages import estimators
from imumon.view.panels import PANELS


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


def test_the_panels_draw_columns_that_the_stage_has() -> None:
    bands = [panel for panel in PANELS if panel.place == "Alignment"]
    stages = [_alignment(Setup(latitude_deg=36.0), device) for device in (None, "ax1")]
    there = {column.name for stage in stages if stage is not None for column in stage.columns}
    there |= set(value_and_sd("heading_smoothed"))
    assert bands
    assert all(set(panel.columns) <= there for panel in bands)
