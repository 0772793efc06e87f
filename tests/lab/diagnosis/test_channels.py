"""What is neither gyro nor accelerometer is diagnosed as well: any recorded column at rest."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imumon.errors import ImumonError
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.runs import Run, channels_of
from tests.cli.command import imumon
from tests.lab.diagnosis.units import SAMPLES, lagged, three

MAP = """
time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: rad/s}
temperature: {columns: [temp], unit: degC}
other: {housing: {column: housing, unit: degC}}
"""


def with_columns(run: Run, seed: int) -> Run:
    """Return a run with a barometer that warms up, on another day each, and a thermometer of the housing."""
    random, n = np.random.default_rng(seed), len(run.time_s)
    warmth = 40.0 * np.exp(-run.time_s / 700.0)
    clean = {
        "pressure": (101325.0 + 50.0 * seed + 5.0 * (run.mean["temperature"] - 25.0) + warmth, 3.0),
        "housing": (lagged(run.mean["temperature"], 90.0), 0.02),
    }
    noisy = {name: values + sd * random.standard_normal(n) for name, (values, sd) in clean.items()}
    scatter = {
        name: sd**2 * SAMPLES * random.chisquare(SAMPLES - 1, n) / (SAMPLES - 1)
        for name, (_, sd) in clean.items()
    }
    mean, variance = run.mean | noisy, run.variance | scatter
    return replace(run, mean=mean, variance=variance, count=dict.fromkeys(mean, np.full(n, SAMPLES)))


def runs(seconds: int = 3000) -> tuple[list[Run], list[Run]]:
    train, test = three(lambda time, _: np.zeros_like(time), seconds)
    return [with_columns(one, seed) for seed, one in enumerate(train)], [with_columns(test[0], 9)]


@pytest.mark.long
@pytest.mark.parametrize(("sensor", "effect"), [("pressure", "warm_up"), ("housing", "thermal_lag")])
def test_a_barometer_and_a_second_thermometer_are_diagnosed(sensor: str, effect: str) -> None:
    (verdict,) = diagnose(*runs(), sensors=(sensor,), drivers=[]).verdicts
    assert verdict.name == sensor
    assert [claim.finding.name for claim in verdict.claims] == [effect]
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    assert verdict.test_before.rms > 5.0 * verdict.channel.floor.sd
    assert verdict.test_after.rms < 1.2 * verdict.channel.floor.sd


def test_what_is_diagnosed_is_no_driver_and_what_is_not_there_is_reported() -> None:
    train, test = runs(1200)
    found = diagnose(train, test, sensors=("gyro", "pressure"))
    assert "pressure" not in found.verdicts[0].search.survey.others
    with pytest.raises(ImumonError, match="'mag' is not in the training data"):
        diagnose(train, test, sensors=("mag",))


def test_a_sensor_is_its_column_or_those_of_its_axes() -> None:
    there = ("gyro_x", "gyro_z", "gyro_supply", "pressure", "mag_y")
    assert channels_of(["gyro", "pressure", "nothing"], there) == ["gyro_x", "gyro_z", "pressure"]


@pytest.mark.long
def test_the_command_diagnoses_a_column_of_the_log_and_writes_no_model(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    train, test = runs(2000)
    for name, run in zip("abc", (*train, *test), strict=True):
        random = np.random.default_rng(len(name))
        gyro = random.normal(0.0, 20.0 * DEG_PER_H, (len(run.time_s), 3))
        columns = [run.time_s, gyro, run.mean["temperature"], run.mean["housing"]]
        head = "t,gx,gy,gz,temp,housing"
        path = tmp_path / f"{name}.csv"
        np.savetxt(path, np.column_stack(columns)[::2], "%.9g", delimiter=",", header=head, comments="")
    paths = [tmp_path / f"{name}.csv" for name in "abc"]
    given = ("--map", tmp_path / "map.yaml", "--channels", "housing", "--out", tmp_path / "found")
    done = imumon("diagnose", "--train", *paths[:2], "--test", paths[2], *given)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "found" / "report.json").read_text(encoding="utf-8"))
    assert list(report["channels"]) == ["housing"]
    assert [effect["name"] for effect in report["channels"]["housing"]["effects"]] == ["thermal_lag"]
    assert (tmp_path / "found" / "report.html").exists()
    assert not (tmp_path / "found" / "model.yaml").exists()
