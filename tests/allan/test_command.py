"""``imumon allan`` as a user or a program meets it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from imumon.allan.recording import CHANNELS
from imumon.blocks import SampleBlock
from imumon.columns import KNOWN, Column
from imumon.recordings.importing import import_table
from imumon.recordings.table import TableWriter
from imumon.run.setup import parse_setup
from tests.allan.simulated import noise
from tests.cli.command import imumon

N, INTERVAL_S = 40_000, 0.02
WHITE = 3e-4
"""rad/s/√Hz, 1 deg/√min: a coarse sensor, yet one that exists; more is taken for vibration.  It walks by
1.9 °/h in a second; three times as much is now and then taken for a turn."""


def allan(*arguments: object) -> subprocess.CompletedProcess[str]:
    return imumon("allan", *arguments)


def write(path: Path, columns: dict[str, Any]) -> Path:
    known = [KNOWN.get(name, Column(name, "1", "int64")) for name in columns]
    with TableWriter(path, {column.name: column for column in known}) as writer:
        writer.write(SampleBlock(columns))
    return path


def columns(walk: float = 0.1, n: int = N) -> dict[str, Any]:
    made: dict[str, Any] = {
        "device_time_ns": np.arange(n) * round(INTERVAL_S * 1e9),
        "segment": np.zeros(n, np.int64),
        "temperature": np.full(n, 25.0),
    }
    for seed, name in enumerate(CHANNELS):
        size = WHITE * (1 + seed)
        made[name] = noise(seed, n, INTERVAL_S, white=size, walk=walk * size) + (
            9.81 if name == "accel_z" else 0
        )
    return made


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = columns()
    keep = np.ones(N, bool)
    keep[[5000, 5001, 20_000]] = False
    path = tmp_path_factory.mktemp("allan") / "rest.parquet"
    return write(path, {name: values[keep] for name, values in made.items()})


@pytest.fixture(scope="module")
def done(table: Path) -> subprocess.CompletedProcess[str]:
    folder = table.parent
    return allan(
        table, "--json", "--plot", folder / "a.png", "--noise-out", folder / "noise.yaml",
        "--kalibr", folder / "imu.yaml",
    )  # fmt: skip


@pytest.mark.long
def test_json_has_curve_and_terms_of_every_channel(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert list(found) == list(CHANNELS)
    for seed, name in enumerate(CHANNELS):
        channel = found[name]
        assert len(channel["tau_s"]) == len(channel["oadev"]) == len(channel["mdev"])
        assert channel["tau_s"][:2] == pytest.approx([INTERVAL_S, 2 * INTERVAL_S])
        assert channel["unit"] == ("rad/s" if name.startswith("gyro") else "m/s^2")
        white = channel["angle_random_walk"]
        assert abs(white["value"] - WHITE * (1 + seed)) < 4 * white["sd"]
        assert channel["quantization"] is None
        assert 50 < channel["longest_tau_s"] < N * INTERVAL_S / 4
        assert channel["samples_missing"] == 3
    assert found["gyro_x"]["angle_random_walk"]["unit"] == "rad/sqrt(s)"
    assert found["gyro_x"]["rate_random_walk"]["unit"] == "rad/s/sqrt(s)"
    assert "2 gaps, 3 of" in done.stderr
    assert "moved during" not in done.stderr


def test_the_written_files_say_the_same(done: subprocess.CompletedProcess[str], table: Path) -> None:
    found = json.loads(done.stdout)
    text = (table.parent / "noise.yaml").read_text()
    section = yaml.safe_load(text)["noise"]
    read = parse_setup(text, "noise.yaml").noise
    assert text.splitlines()[2] == "format: imumon-pipeline/1"
    assert read.gyro is not None
    assert read.gyro.angle_random_walk_rad_per_sqrt_s == section["gyro"]["angle_random_walk_rad_per_sqrt_s"]
    assert read.accel is not None
    gyro = section["gyro"]["angle_random_walk_rad_per_sqrt_s"]
    truth = [found[f"gyro_{axis}"]["angle_random_walk"]["value"] for axis in "xyz"]
    assert gyro == pytest.approx(truth, rel=1e-5)
    assert section["gyro"]["quantization_rad"] == [None, None, None]
    kalibr = yaml.safe_load((table.parent / "imu.yaml").read_text())
    assert kalibr["gyroscope_noise_density"] == max(gyro)
    walks = [found[f"accel_{axis}"]["rate_random_walk"]["value"] for axis in "xyz"]
    assert kalibr["accelerometer_random_walk"] == pytest.approx(max(walks), rel=1e-5)
    assert kalibr["update_rate"] == pytest.approx(50)
    assert set(kalibr) == {
        "accelerometer_noise_density", "accelerometer_random_walk", "gyroscope_noise_density",
        "gyroscope_random_walk", "rostopic", "update_rate",
    }  # fmt: skip
    with Image.open(table.parent / "a.png") as picture:
        assert picture.size[0] > picture.size[1] > 400


def test_people_read_degrees_and_hours(tmp_path: Path) -> None:
    shown = allan(write(tmp_path / "t.parquet", columns(n=N // 3))).stdout
    assert "°/√h" in shown
    assert "°/h/√h" in shown
    row = next(line for line in shown.splitlines() if "angle random walk" in line)
    value = float(row.split()[4].split("(")[0])
    assert value == pytest.approx(np.rad2deg(WHITE) * 60, rel=0.02)
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize("said", ["at_rest", "nothing"])
def test_motion_is_reported_with_its_share(tmp_path: Path, said: str) -> None:
    n = N // 2
    made = columns(0.03, n)  # with more walk, a bias may leave its law while it moves, and look like a turn
    moving = slice(5000, 7000)
    made["gyro_x"][moving] += 0.3 * np.sin(np.arange(2000) * INTERVAL_S)
    if said == "at_rest":
        made["at_rest"] = np.ones(n, np.int64)
        made["at_rest"][moving] = 0
    done = allan(write(tmp_path / "t.parquet", made))
    assert done.returncode == 0
    share = float(done.stderr.split("moved during ")[1].split("%")[0])
    assert share == pytest.approx(10.0, abs=0.05 if said == "at_rest" else 1.5)


def test_a_short_recording_in_motion_gets_both_reasons_and_what_to_do(tmp_path: Path) -> None:
    made = columns(n=round(22 / INTERVAL_S))
    time_s = np.arange(len(made["gyro_x"])) * INTERVAL_S
    made["gyro_x"] += 0.3 * np.sin(time_s) * (time_s < 14.0)
    errors = allan(write(tmp_path / "t.csv", made)).stderr
    assert "the unit moved during" in errors
    assert "record it lying still" in errors
    assert "22 s are too short for bias instability and drift: record for" in errors


def test_a_session_is_read_like_a_table(tmp_path: Path) -> None:
    made = columns(n=4000)
    names = ["gyro_x", "gyro_y", "gyro_z"]
    rows = np.column_stack([np.arange(4000) * INTERVAL_S, *(made[name] for name in names)])
    header = ",".join(["t", *names])
    np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header=header, comments="")
    (tmp_path / "map.yaml").write_text(
        "time: {column: t, unit: s}\ngyro: {columns: [gyro_x, gyro_y, gyro_z], unit: rad/s}\n"
    )
    import_table(tmp_path / "t.csv", tmp_path / "map.yaml", tmp_path / "session")
    done = allan(tmp_path / "session", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert list(found) == names
    assert found["gyro_x"]["samples"] == 4000
    assert "there is no temperature" in done.stderr
    refused = allan(tmp_path / "session", "--kalibr", tmp_path / "k.yaml")
    assert refused.returncode == 4
    assert "accelerometer" in refused.stderr


def test_thermal_drift_is_reported(tmp_path: Path) -> None:
    made = columns(n=5000)
    made["temperature"] = np.linspace(20, 24, 5000)
    assert "the temperature moved between 20.0 and 24.0" in allan(write(tmp_path / "t.csv", made)).stderr


def test_what_has_no_even_rate_is_refused_with_the_reason(tmp_path: Path) -> None:
    made = columns(n=5000)
    rng = np.random.default_rng(0)
    made["device_time_ns"] = np.cumsum(rng.integers(1_000_000, 100_000_000, 5000))
    done = allan(write(tmp_path / "t.parquet", made))
    assert done.returncode == 4
    assert "even rate" in done.stderr
    assert "resampled" in done.stderr


def test_too_little_data_is_refused(tmp_path: Path) -> None:
    done = allan(write(tmp_path / "t.parquet", columns(n=10)))
    assert done.returncode == 4
    assert done.stdout == ""


def test_a_table_without_imu_is_refused(tmp_path: Path) -> None:
    done = allan(write(tmp_path / "t.parquet", {"pressure": np.zeros(100)}))
    assert done.returncode == 4
    assert "device_time_ns" in done.stderr
