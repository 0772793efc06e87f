"""A driver from end to end: simulated, recorded in a table, found, in the model file, and followed live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.runs import read_runs
from imumon.models.model import load_model
from imumon.models.predictor import BiasPredictor
from imumon.recordings.table import iterate_table
from imumon.simulation.recording import write_table
from imumon.simulation.unit.scenario import Scenario
from tests.lab.diagnosis.units import DPH, lagged, three

MAP = """
time: {column: device_time_ns, unit: ns}
gyro: {columns: [gyro_x, gyro_y, gyro_z], unit: rad/s}
accel: {columns: [accel_x, accel_y, accel_z], unit: m/s^2}
temperature: {columns: [temperature], unit: degC}
other: {supply_voltage: {column: supply_voltage, unit: V}}
"""
EFFECT = {
    "kind": "temperature_curve",
    "driver": "supply_voltage",
    "middle": 5.0,
    "half_span": 0.1,
    "first_power": 1,
    "powers": 1,
    "coefficients": [40.0],
}


def recorded(folder: Path, seed: int) -> Path:
    """Return a table of 25 min in which the supply is switched and the temperature goes up or down."""
    random = np.random.default_rng(seed)
    levels = random.uniform(4.9, 5.1, 15).repeat(2)
    corners = np.sort(np.r_[np.arange(15) * 100.0, np.arange(1, 16) * 100.0 - 1.0])
    scenario = Scenario.model_validate(
        {
            "format": "imumon-scenario/1",
            "unit": {
                "gyro_noise": {"arw_deg_per_sqrt_h": 0.3},
                "accel_noise": {"vrw_m_per_s_per_sqrt_s": 0.001},
                "gyro_effects_deg_per_h": {"x": [EFFECT]},
            },
            "rate_hz": 0.5,
            "duration_s": 1500,
            "latitude_deg": 0,
            "chamber": {
                "start_degc": 25,
                "steps": [{"to_degc": 40 if seed % 2 else 10, "rate_degc_per_min": 1, "hold_s": 3000}],
            },
            "drivers": {
                "supply_voltage": {
                    "unit": "V",
                    "at_s": corners.tolist(),
                    "value": levels.tolist(),
                    "noise": 0.002,
                }
            },
        }
    )
    path = folder / f"{seed}.parquet"
    write_table(scenario, seed, path, lambda _: None)
    return path


@pytest.mark.long
def test_a_simulated_driver_is_found_in_a_log_and_followed_live(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    tables = [recorded(tmp_path, seed) for seed in (1, 2, 3)]
    runs = [read_runs(path, tmp_path / "map.yaml")[0] for path in tables]
    diagnosis = diagnose(runs[:2], runs[2:], sensors=("gyro",))
    said = {v.name: [claim.finding.name for claim in v.claims] for v in diagnosis.verdicts}
    assert said == {"gyro_x": ["curve(supply_voltage)"], "gyro_y": [], "gyro_z": []}
    extended_model(diagnosis).write(tmp_path / "model.yaml")

    predictor = BiasPredictor(load_model(tmp_path / "model.yaml"), ["gyro_x"])
    errors = []
    for block in iterate_table(tables[2]):
        others = {name: block[name] for name in predictor.drivers}
        predicted = predictor.process(
            block["device_time_ns"], block["segment"], block["temperature"][:, np.newaxis], None, others
        )
        errors.append(predicted.bias[:, 0] - block["true_gyro_bias_x"])
    error = np.concatenate(errors) / DEG_PER_H
    assert error.std() < 3.0  # of 20 °/h that the supply makes; the earth rate is in the mean


def test_a_scenario_without_what_drives_its_unit_is_refused() -> None:
    with pytest.raises(ValueError, match="needs supply_voltage among the drivers"):
        Scenario.model_validate(
            {
                "format": "imumon-scenario/1",
                "unit": {"gyro_effects_deg_per_h": {"x": [EFFECT]}},
                "rate_hz": 10,
                "duration_s": 60,
                "latitude_deg": 0,
                "chamber": {"start_degc": 25},
            }
        )


@pytest.mark.parametrize("filter_s", [7.0, 11.0])
def test_the_rate_of_a_driver_is_named_whatever_its_filter(filter_s: float) -> None:
    """Between the three filters that were tried, a lag with the rate beside it was named."""
    train, test = three(lambda time, _: np.zeros_like(time), 6000)
    for seed, one in enumerate((*train, *test)):
        random = np.random.default_rng(seed)
        switched = random.standard_normal(31)[np.cumsum(random.random(len(one.time_s)) < 1 / 300) % 31]
        pressure = lagged(switched, 80.0)
        late = lagged(pressure, filter_s)
        one.mean |= {"pressure": pressure, "gyro_x": one.mean["gyro_x"] + 500.0 * DPH * (pressure - late)}
    (verdict,) = diagnose(train, test).verdicts
    (claim,) = verdict.claims
    assert claim.finding.name == "rate(pressure)"
    (found,) = claim.sigmas
    error = claim.parts[0].effect.model_dump()["smoothing_s"] - filter_s
    assert abs(error) < 4.0 * found.nonlinear["smoothing_s"] < 2.0
