"""A session forward and backward, as `imumon replay --smooth` does it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from imumon.blocks import SampleBlock, join
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.source import open_source, run_over
from imumon.run.setup import Setup
from imumon.run.stages import estimators, smoothed
from imumon.simulation.recording import record_session
from imumon.simulation.unit.scenario import Scenario

SCENARIO = {
    "format": "imumon-scenario/1",
    "unit": {"base": "crs05", "self_heating": {"rise_degc": 8.0, "tau_s": 100.0}},
    "rate_hz": 50,
    "duration_s": 200.0,
    "latitude_deg": 40.0,
    "attitude": {"heading_deg": 70.0},
    "chamber": {"start_degc": 25.0},
    "motion": [
        {"kind": "handling", "at_s": 60.0, "rounds": 1, "every_s": 60.0, "rest_s": 5.0,
         "swing_deg": [20.0, 15.0, 30.0], "heading_deg": 90.0}
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("smoothed") / "session"
    text = device_text("ax1")[0]
    scenario = Scenario.model_validate(SCENARIO)
    record_session(scenario, parse_device(text, "ax1"), text, 1, folder, lambda *_: None)
    return folder


def truth_of(session: Path) -> SampleBlock:
    table = pq.read_table(session / "truth.parquet")
    return SampleBlock({name: table.column(name).to_numpy() for name in table.column_names})


def calibrated(truth: SampleBlock) -> BiasModel:
    """Return the true curve of each gyro, without its constant: the turn-on is for the filter."""
    channels = {}
    for axis in "xyz":
        degc, bias = truth[f"temperature_{axis}"], truth[f"gyro_bias_{axis}"]
        fit = np.polynomial.Chebyshev.fit(degc, bias, 4, domain=[24.0, 34.0])
        curve = PolynomialCurve(
            center_degc=29.0, half_width_degc=5.0, coefficients=[0.0, *fit.coef[1:].tolist()]
        )
        channels[f"gyro_{axis}"] = ChannelModel(
            unit="rad/s",
            temperature_column=f"temperature_estimate_{axis}",
            temperature_range_degc=[24.0, 34.0],
            residual_sd=1e-5,
            curve=curve,
        )
    return BiasModel(made_by="test", created="now", channels=channels)


@pytest.mark.long
@pytest.mark.parametrize("known", ["heading", "model"])
def test_the_bias_is_that_of_the_unit_whatever_is_known(session: Path, known: str) -> None:
    truth = truth_of(session)
    setup = Setup(
        latitude_deg=40.0,
        heading_deg=70.0,
        model=calibrated(truth) if known == "model" else None,
    )
    stage = smoothed(open_source(session), setup)
    source = open_source(session)
    pipeline = Pipeline(source.device, [*estimators(source.device, setup)[:3], stage])
    found = join([block for block in run_over(source.items, pipeline) if len(block)])
    for axis in "xyz":
        error = found[f"gyro_bias_smoothed_{axis}"] - truth[f"gyro_bias_{axis}"]
        before = found[f"gyro_bias_{axis}"] - truth[f"gyro_bias_{axis}"]
        z = error / found[f"gyro_bias_smoothed_sd_{axis}"]
        assert np.isfinite(z[10 * 50 :]).all()
        assert np.nanmax(np.abs(z)) < 5.0, axis
        both = np.isfinite(before)
        assert np.sqrt(np.mean(error[both] ** 2)) <= np.sqrt(np.mean(before[both] ** 2)), axis
        assert stage.residuals[f"gyro_bias_{axis}"] < 2.0
