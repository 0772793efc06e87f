"""``imumon calibrate`` as a user or a program meets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.columns import Column
from imumon.models.model import load_model
from imumon.recordings.table import TableWriter, read_table
from tests.cli.command import MAP, imumon
from tests.data_folder import measured
from tests.lab.calibration.records import DEG_H, few_steps, samples, soak, true_bias


def imported(folder: Path, temperature: FloatArray) -> Path:
    """Make a session of a simulated table by the real command."""
    block = samples(temperature)
    columns = [block["device_time_ns"] * 1e-9, *(block[f"gyro_{a}"] for a in "xyz"), block["temperature"]]
    table, map_path = folder / "table.csv", folder / "map.yaml"
    np.savetxt(table, np.column_stack(columns), "%.17g", delimiter=",", header="t,gx,gy,gz,temp", comments="")
    map_path.write_text(MAP, encoding="utf-8")
    done = imumon("import", table, "--map", map_path, "--out", folder / "session")
    assert done.returncode == 0, done.stderr
    return folder / "session"


def write_truth(session: Path, temperature: FloatArray) -> None:
    """Put the truth of a simulated table beside the session that was made of it."""
    bias, n = true_bias(temperature), len(temperature)
    still = np.zeros(n)
    columns = {
        "device_time_ns": read_table(session / "samples.parquet")[0]["device_time_ns"],
        **{f"gyro_bias_{axis}": bias[:, at] for at, axis in enumerate("xyz")},
        **{f"rate_{axis}": still for axis in "xyz"},
        **{f"temperature{suffix}": temperature for suffix in ("", "_x", "_y", "_z")},
        "at_rest": np.ones(n, np.int64),
    }
    with TableWriter(session / "truth.parquet", {}) as table:
        table.announce(
            [
                Column(name, "1", "int64" if values.dtype == np.int64 else "float64")
                for name, values in columns.items()
            ]
        )
        table.write(SampleBlock(columns))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return imported(tmp_path_factory.mktemp("calibrated"), soak(300.0)[::5])


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that is soon read, and gives no model."""
    return imported(tmp_path_factory.mktemp("short"), np.linspace(20.0, 23.0, 750))


@pytest.mark.long
def test_a_session_becomes_a_model(session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few_steps(monkeypatch)
    out = tmp_path / "model.yaml"
    picture, export = tmp_path / "model.png", ("--export", "ardupilot", "--imu", "1")
    done = imumon(
        "calibrate", session, "--out", out, "--plot", picture, "--serial", "SN 7", "--json", *export
    )
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    report, model = json.loads(done.stdout), load_model(out)
    assert model.serial == "SN 7"
    assert report["channels"]["gyro_x"]["curve"] in report["channels"]["gyro_x"]["held_out_rms"]
    assert report["channels"]["gyro_x"]["temperature_column"] == "temperature_estimate"
    t = np.linspace(-19.0, 47.0, 100)
    for j, axis in enumerate("xyz"):
        error = model.channels[f"gyro_{axis}"].value(t) - true_bias(t)[:, j]
        assert np.sqrt(np.mean(error**2)) < 8 * DEG_H
    written = Path(report["parameters"])
    assert written == out.with_suffix(".param")
    assert "INS_TCAL2_GYR1_X," in written.read_text()
    again = imumon("calibrate", session, "--out", out)
    assert again.returncode == 2
    assert "is there already" in again.stderr


@pytest.mark.long
def test_the_table_for_people_marks_what_is_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few_steps(monkeypatch)
    temperature = soak(300.0)[:3600:4]
    session = imported(tmp_path, temperature)
    write_truth(session, temperature)
    done = imumon("calibrate", session, session, "--out", tmp_path / "model.yaml", "--truth")
    assert done.returncode == 0, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("  error of gyro_bias_")]
    assert len(errors) == 3
    assert all("°/h rms" in line and "σ rms, at most" in line for line in errors)
    rows = [line for line in done.stdout.splitlines() if line.startswith("gyro_")]
    assert len(rows) == 3
    assert all(row.count("*") == 1 and "°/h" in row for row in rows)
    assert "WARN" in done.stderr
    assert "earth rate" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--latitude", 41), 2, "there is no heading"),
        (("--latitude", 91, "--heading", 0), 2, "91"),
        (("--latitude", "nan"), 2, "not a number"),
    ],
)
def test_wrong_options_end_with_2(
    short: Path, tmp_path: Path, arguments: tuple[object, ...], code: int, said: str
) -> None:
    done = imumon("calibrate", short, "--out", tmp_path / "model.yaml", *arguments)
    assert done.returncode == code
    assert said in done.stderr
    assert not (tmp_path / "model.yaml").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("calibrate", "--out", "m.param", "--export", "ardupilot"),
        ("calibrate", "--out", "m.png", "--plot", "m.png"),
        ("magnetometer", "--out", "m.png", "--plot", "../here/m.png"),
    ],
)
def test_two_outputs_in_one_file_are_refused(short: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    command, *options = arguments
    done = imumon(command, short, *options, cwd=folder)
    assert done.returncode == 2
    assert "two of the outputs are the same file" in done.stderr
    assert not list(folder.iterdir())


def test_what_cannot_give_a_model_ends_with_4_and_no_file(short: Path, tmp_path: Path) -> None:
    done = imumon("calibrate", short, "--out", tmp_path / "model.yaml")
    assert done.returncode == 4
    assert "a model needs 5" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "model.yaml").exists()


def test_a_folder_that_is_not_there_is_reported(short: Path, tmp_path: Path) -> None:
    done = imumon("calibrate", short, "--out", tmp_path / "no" / "model.yaml")
    assert done.returncode == 2
    assert "there is no folder" in done.stderr
    assert imumon("calibrate", tmp_path / "nothing", "--out", tmp_path / "m.yaml").returncode == 4


@pytest.mark.long
def test_a_measured_chamber_cycle_gives_a_model_that_admits_its_residual(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few_steps(monkeypatch)
    table = measured("chamber-cycle/cooling-heating.csv")
    done = imumon("import", table, "--map", table.with_name("map.yaml"), "--out", tmp_path / "session")
    assert done.returncode == 0, done.stderr
    out = tmp_path / "model.yaml"
    done = imumon("calibrate", tmp_path / "session", "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    model = load_model(out)
    assert set(model.channels) == {f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"}
    assert 0.1 < np.rad2deg(model.channels["gyro_x"].residual_sd) < 0.3
    low, high = model.channels["gyro_x"].temperature_range_degc
    assert low < -17
    assert high > 73
