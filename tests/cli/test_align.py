from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imumon.protocols.device import load_device
from imumon.simulation.unit.scenario import load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from tests.cli.command import answer, imumon

KEYS = [
    "heading_deg",
    "heading_sd_deg",
    "estimator",
    "settled_s",
    "observable",
    "positions",
    "estimators",
    "left_out",
]


def simulated(folder: Path, name: str, seconds: float, extra: str = "") -> Path:
    """Make a session of a scenario at 50 Hz."""
    file = folder / "changed.yaml"
    file.write_text(f"format: imumon-scenario/1\nbase: {name}\n{extra}")
    length = ("--duration", seconds, "--rate", 50)
    answer("simulate", file if extra else name, "--device", "ax1", "--out", folder / name, *length)
    return folder / name


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("navigation"), "alignment", 80.0)


def align(*arguments: object) -> tuple[int, dict[str, Any]]:
    done = imumon("align", *arguments, "--json")
    result = json.loads(done.stdout)
    assert isinstance(result, dict)
    return done.returncode, result


def refused(*arguments: object) -> str:
    """Return what is said of wrong arguments, with exit code and reason."""
    done = imumon("align", *arguments)
    assert done.stdout == ""
    return f"{done.returncode} {done.stderr}"


def test_a_recorded_session_is_aligned_and_reports_it_in_json(session: Path) -> None:
    code, result = align(session, "--latitude", 36, "--until", 0.05)
    assert code == 0
    assert list(result) == KEYS
    assert result["heading_deg"] == pytest.approx(30.0, abs=0.06)
    assert result["heading_sd_deg"] < 0.05
    assert result["estimator"] == "joint"
    assert 3.0 < result["settled_s"] < 80.0
    assert result["observable"] is True
    assert list(result["estimators"]) == ["joint", "gyro_mean", "hann_mean"]
    assert result["estimators"]["joint"] == {
        "heading_deg": result["heading_deg"], "sd_deg": result["heading_sd_deg"],
    }  # fmt: skip


def test_a_sigma_that_is_not_reached_is_exit_code_1_with_the_time_to_go(session: Path) -> None:
    done = imumon("align", session, "--latitude", 36, "--until", 0.005)
    assert done.returncode == 1
    assert "no (σ ≤ 0.005°)" in done.stdout
    code, result = align(session, "--latitude", 36, "--until", 0.005)
    assert (code, result["settled_s"]) == (1, None)


def test_the_sigma_and_the_place_may_stand_in_the_pipeline_file(session: Path, tmp_path: Path) -> None:
    file = tmp_path / "place.yaml"
    file.write_text("format: imumon-pipeline/1\nlatitude_deg: 36\nalignment: {settled_deg: 1.0}\n")
    code, result = align(session, "--pipeline", file)
    assert code == 0
    coarse = result["settled_s"]
    assert coarse < align(session, "--latitude", 36, "--until", 0.045)[1]["settled_s"]


def test_gyros_that_cannot_see_the_earth_rate_give_no_north(tmp_path: Path) -> None:
    path = simulated(tmp_path, "alignment-mems", 80.0)
    code, result = align(path, "--latitude", 36)
    assert code == 1
    assert result["heading_deg"] is None
    assert result["observable"] is False
    assert all(estimate["heading_deg"] is None for estimate in result["estimators"].values())
    done = imumon("align", path, "--latitude", 36)
    assert "heading not observable" in done.stdout


def test_data_that_are_too_short_say_what_is_missing(tmp_path: Path) -> None:
    path = simulated(tmp_path, "alignment", 2.5)
    done = imumon("align", path, "--latitude", 36)
    assert done.returncode == 1
    assert "no (σ ≤ 0.05°): coarse, " in done.stdout


@pytest.mark.parametrize("at_s", [1, 3, 5])
def test_a_unit_that_is_carried_about_does_not_settle_by_that(tmp_path: Path, at_s: int) -> None:
    handling = f"kind: handling, at_s: {at_s}, rounds: 8, every_s: 8, rest_s: 2, swing_deg: 20, travel_m: 0.1"
    motion = f"motion:\n  - {{{handling}}}\n"
    path = simulated(tmp_path, "alignment", 70.0, motion)
    code, result = align(path, "--latitude", 36)
    assert code == (1 if result["settled_s"] is None else 0)
    if result["settled_s"] is not None:  # before: it was at rest for some seconds
        assert result["settled_s"] <= at_s + 1.0
    if result["heading_deg"] is not None:  # it was followed
        assert abs(result["heading_deg"] - 30.0) < 4.0 * result["heading_sd_deg"]


def test_two_positions_separate_the_bias_from_the_earth_rate(tmp_path: Path) -> None:
    turn = "{kind: turn, at_s: 60, duration_s: 5, heading_deg: 180}"
    noise = "gyro_noise: {arw_deg_per_sqrt_h: 0.001}"
    bias = f"unit: {{gyro_turn_on: {{offset_deg_per_h: [2.0, 2.0, 1.0]}}, {noise}}}\n"
    path = simulated(tmp_path, "alignment", 130.0, f"{bias}motion:\n  - {turn}\n")
    code, result = align(path, "--latitude", 36, "--until", 0.3, "--positions", 2)
    assert (code, result["positions"]) == (0, 2)
    assert result["heading_deg"] == pytest.approx(210.0, abs=0.5)
    code, result = align(path, "--latitude", 36, "--until", 0.3, "--positions", 3)
    assert (code, result["settled_s"]) == (1, None)


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_at_a_pole_there_is_no_heading(session: Path, latitude: float) -> None:
    code, result = align(session, "--latitude", latitude)
    assert code == 1
    assert result["observable"] is False


def test_without_a_latitude_the_error_names_what_to_add(session: Path) -> None:
    said = refused(session)
    assert said.startswith("2 imumon: bad configuration: ")
    assert "the latitude is not known" in said
    assert "--latitude" in said


def test_a_latitude_that_does_not_exist_and_options_of_a_port_are_refused(session: Path) -> None:
    assert "range" in refused(session, "--latitude", 95)
    wrong = refused(session, "--latitude", 36, "--baud", 9600)
    assert wrong.startswith("2 ")
    assert "for a port" in wrong


def test_a_session_without_gyros_is_refused_by_name(tmp_path: Path) -> None:
    table, mapping, out = tmp_path / "accel.csv", tmp_path / "map.yaml", tmp_path / "s"
    table.write_text("ax,ay,az\n" + "0.0,0.0,-9.8\n" * 100)
    mapping.write_text("rate_hz: 100\naccel: {columns: [ax, ay, az], unit: m/s^2}\naxes: FRD\n")
    done = imumon("import", table, "--map", mapping, "--out", out)
    assert done.returncode == 0, done.stderr
    said = refused(out, "--latitude", 36)
    assert said.startswith("4 ")
    assert "there is no gyro_x, gyro_y, gyro_z" in said


def test_what_is_neither_a_session_nor_a_port_is_reported(tmp_path: Path) -> None:
    assert "neither a session nor a port" in refused(tmp_path / "nothing", "--latitude", 36)
    assert "its device must be named" in refused("/dev/ttyUSB77", "--latitude", 36)


@pytest.mark.long
def test_a_live_unit_is_aligned_through_its_port_and_recorded(tmp_path: Path) -> None:
    """In real time, so with a rough sigma."""
    file = tmp_path / "quick.yaml"
    file.write_text("format: imumon-pipeline/1\nlatitude_deg: 36\n")
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs", scenario=load_scenario("alignment")) as ahrs:
        given = ("--device", "ax1", "--pipeline", file, "--out", tmp_path / "s", "--seconds", 60)
        done = imumon("align", ahrs.port.path, *given, "--until", 2, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert list(result) == KEYS
    assert result["settled_s"] < 40.0
    assert abs(result["heading_deg"] - 30.0) < 2.0
    assert np.isfinite(result["heading_sd_deg"])
    code, again = align(tmp_path / "s")
    assert code == 0
    assert again == result
