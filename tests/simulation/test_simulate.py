from __future__ import annotations

from pathlib import Path

from imumon.recordings.folder import TRUTH_NAME, open_session
from imumon.recordings.table import read_table
from tests.cli.command import answer, imumon


def test_a_session_is_made_with_the_truth_beside_it(tmp_path: Path) -> None:
    result = answer(
        "simulate", "crs05-ramp", "--device", "ax1", "--out", tmp_path / "s", "--duration", 3, "-s", 2
    )
    assert result["samples"] == 300
    session = open_session(tmp_path / "s")
    assert session.metadata.source == "simulation"
    assert session.metadata.port is not None
    assert session.metadata.port.settings["seed"] == 2
    assert len(read_table(tmp_path / "s" / TRUTH_NAME)[0]) == 300


def test_a_table_takes_the_axes_of_a_device_and_another_rate(tmp_path: Path) -> None:
    answer("simulate", "crs05-ramp", "--out", tmp_path / "frd.parquet", "--duration", 1, "--rate", 50)
    answer(
        "simulate",
        "crs05-ramp",
        "--out",
        tmp_path / "flu.csv",
        "--duration",
        1,
        "--rate",
        50,
        "--device",
        "xsens",
    )
    frd, flu = read_table(tmp_path / "frd.parquet")[0], read_table(tmp_path / "flu.csv")[0]
    assert len(frd) == len(flu) == 50
    assert frd["accel_z"].mean() < -9.5
    assert flu["accel_z"].mean() > 9.5


def test_a_scenario_in_a_file_with_an_error_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("format: imumon-scenario/1\nbase: crs05-ramp\nrate_hz: -3\n")
    done = imumon("simulate", path, "--out", tmp_path / "s")
    assert done.returncode == 2
    assert "mine.yaml:3: rate_hz" in done.stderr
    assert not (tmp_path / "s").exists()
