from __future__ import annotations

from pathlib import Path

import pytest

from imumon.errors import ImumonError
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.protocols.ranges import Ranges
from imumon.run.setup import FORMAT, Setup, load_setup, parse_setup, unused_keys
from imumon.run.stages import pipeline_of


def _model() -> BiasModel:
    curve = PolynomialCurve(center_degc=20.0, half_width_degc=15.0, coefficients=[1e-3, 1 / 3 * 1e-4])
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature_x",
        temperature_range_degc=[5.0, 35.0],
        residual_sd=1e-5,
        curve=curve,
    )
    return BiasModel(made_by="test", created="2026-01-01T00:00:00Z", channels={"gyro_x": channel})


def test_nothing_stated_is_no_file() -> None:
    assert Setup().text() is None


def test_what_a_session_keeps_states_the_same_again_with_the_model_in_it() -> None:
    setup = Setup().with_options(model=_model(), latitude_deg=40.93, heading_deg=12.5, zupt_mode="thermal")
    text = setup.text()
    assert text is not None
    again = parse_setup(text, "session.yaml")
    assert again == setup
    assert again.text() == text


def test_a_model_is_read_from_beside_the_pipeline_file(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    _model().write(tmp_path / "model.yaml")
    file = tmp_path / "deep" / "pipeline.yaml"
    file.write_text("format: imumon-pipeline/1\nlatitude_deg: 48.1\nmodel: ../model.yaml\n")
    setup = load_setup(file)
    assert setup.bias_model == _model()
    assert (setup.latitude_deg, setup.mode) == (48.1, "thermal")


def test_without_a_model_the_slope_is_learned_unless_another_mode_is_chosen() -> None:
    assert Setup().mode == "learned"
    assert Setup().with_options(zupt_mode="standard").mode == "standard"


def test_the_thermal_mode_without_a_model_is_refused_with_what_to_do() -> None:
    with pytest.raises(ImumonError, match="there is no model") as caught:
        Setup().with_options(zupt_mode="thermal")
    assert "imumon calibrate" in (caught.value.hint or "")
    with pytest.raises(ImumonError, match="there is no model"):
        pipeline_of(load_device("ax1"), Setup(zupt_mode="thermal"))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("latitude_deg: 91.0", r"pipeline.yaml:2: latitude_deg"),
        ("latitude: 45.0", r"pipeline.yaml:2: latitude: unknown key"),
        ("rest: {undecided_s: -1.0}", r"pipeline.yaml:2: rest.undecided_s"),
        ("published: [fir, kalman]", r"pipeline.yaml:2: published"),
        ("published: [fir, fir]", r"named twice"),
        ("model: missing.yaml", r"missing.yaml: cannot be read"),
    ],
)
def test_mistakes_in_a_pipeline_file_are_named_with_their_line(
    tmp_path: Path, line: str, message: str
) -> None:
    file = tmp_path / "pipeline.yaml"
    file.write_text(f"format: imumon-pipeline/1\n{line}\n")
    with pytest.raises(ImumonError, match=message):
        load_setup(file)


NOISE = """format: imumon-pipeline/1
noise:
  gyro:
    angle_random_walk_rad_per_sqrt_s: [8e-5, 7e-5, 9e-5]
    bias_instability_rad_per_s: [1e-5, null, 2e-5]
    rate_random_walk_rad_per_s_sqrt_s: [null, 3e-7, null]
"""


def test_known_noise_holds_for_every_estimator() -> None:
    setup = parse_setup(NOISE, "pipeline.yaml")
    zupt, error = setup.zupt_with_noise, setup.random_error_with_noise
    assert zupt.angle_random_walk_rad_per_sqrt_s == [8e-5, 7e-5, 9e-5]
    assert zupt.bias_instability_rad_per_s == [1e-5, 0.0, 2e-5]
    assert zupt.rate_random_walk_rad_per_s_per_sqrt_s == [0.0, 3e-7, 0.0]
    assert error.noise["gyro_y"].rate_random_walk == 3e-7
    assert error.noise["gyro_z"].angle_random_walk == 9e-5


def test_what_an_estimator_is_given_itself_comes_first_and_what_is_not_known_is_learned() -> None:
    told = NOISE + "zupt: {angle_random_walk_rad_per_sqrt_s: 1e-3}\n"
    setup = parse_setup(told.replace("[null, 3e-7, null]", "[null, null, null]"), "pipeline.yaml")
    assert setup.zupt_with_noise.angle_random_walk_rad_per_sqrt_s == 1e-3
    assert setup.zupt_with_noise.bias_instability_rad_per_s is None
    assert set(setup.random_error_with_noise.noise) == {"gyro_x", "gyro_z"}


def test_a_setup_with_noise_states_the_same_again() -> None:
    setup = parse_setup(NOISE, "pipeline.yaml")
    assert parse_setup(setup.text() or "", "session.yaml") == setup


def test_a_pipeline_file_declares_the_range_and_a_session_keeps_it() -> None:
    setup = parse_setup(f"format: {FORMAT}\nrange: {{gyro_deg_per_s: 200, accel_g: 8}}\n", "my.yaml")
    assert setup.range == Ranges(gyro_deg_per_s=200.0, accel_g=8.0)
    kept = setup.text()
    assert kept is not None
    assert parse_setup(kept, "session") == setup


def test_every_key_that_is_not_used_any_more_is_reported_with_its_section() -> None:
    sections = {
        "rest": "gyro_walk: 1.0",
        "zupt": "zeroing_s: 3.0",
        "attitude": "axes_doubt: 0.3",
        "alignment": "damping: 0.7",
        "allan": "gyro_sheet: {white: 1.0e-3}",
        "random_error": "risk: 0.3, method: sr_rsukf",
    }
    lines = [f"{name}: {{{text}}}" for name, text in sections.items()]
    setup = parse_setup("\n".join([f"format: {FORMAT}", *lines]), "my.yaml")
    text = f"{device_text('ax1')[0]}temperature: {{lowest_degc: 3.0, method: fir_exponential}}\n"
    device = parse_device(text, "device.yaml")
    found = unused_keys(setup, device)
    named = {text.partition(" is not used any more")[0] for text in found}
    assert len(found) == len(named) == 9
    assert named == {
        *(f"{name}: {text.split(':')[0]}" for name, text in sections.items()),
        *("random_error: method", "temperature: lowest_degc", "temperature: method"),
    }
    assert set(found) <= set(pipeline_of(device, setup).warnings())
    assert unused_keys(Setup(), None) == []


def test_a_session_with_retired_probabilities_is_read_and_does_not_write_them_again() -> None:
    setup = parse_setup(
        f"format: {FORMAT}\nattitude: {{accel_doubt: 0.2, axes_error_probability: 0.1, gyro_scale: 0.02}}\n",
        "session.yaml",
    )
    assert setup.attitude == AttitudeParameters(gyro_scale=0.02)
    assert "probability" not in (setup.text() or "")
    assert parse_setup(setup.text() or "", "session.yaml") == setup


def test_a_session_that_names_the_one_form_of_the_thermal_mode_is_read() -> None:
    text = f"format: {FORMAT}\nzupt: {{zeroing_s: 30.0, thermal_form: increments}}\n"
    assert parse_setup(text, "session.yaml").zupt == GyroBiasParameters()
    with pytest.raises(ImumonError, match=r"session.yaml:2: zupt.thermal_form"):
        parse_setup(text.replace("increments", "slope_rate"), "session.yaml")
