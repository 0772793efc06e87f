"""The next experiment: what it promises, a diagnosis of the simulated unit finds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imumon.cli import run as command
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.planning import profiles
from imumon.lab.diagnosis.report import write_report
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.thermal import chamber_temperature
from tests.lab.diagnosis.units import lagged, three


@pytest.fixture(scope="module")
def open_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report that cannot tell rate, lag and dead time apart: the lag is as short as a block."""
    folder = tmp_path_factory.mktemp("report")
    train, test = three(lambda _, t: 60.0 * (t - lagged(t, 25.0)), 4000)
    write_report(diagnose(train, test), folder / "report.json")
    return folder


@pytest.mark.long
def test_a_plan_separates_what_was_not_told_apart_and_its_files_play(
    open_report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["plan", str(open_report), "--out", str(tmp_path), "--json"]) == 0
    (plan,) = json.loads(capsys.readouterr().out)["questions"]
    assert plan["channel"] == "gyro_x"
    assert len(plan["answers"]) > 1
    assert plan["expected_evidence_bic"] > plan["needed_bic"]
    assert plan["needed_bic"] < plan["reached_bic"] <= plan["expected_evidence_bic"]
    course = np.loadtxt(tmp_path / "1-chamber.csv", delimiter=",", skiprows=1)
    scenarios = [load_scenario(path) for path in sorted(tmp_path.glob("*.yaml"))]
    assert len(scenarios) == len(plan["answers"])
    time = np.linspace(0.0, course[-1, 0], 50)
    for scenario in scenarios:
        assert scenario.duration_s == pytest.approx(plan["hours"] * 3600)
        expected = np.interp(time, course[:, 0], course[:, 1])
        assert chamber_temperature(scenario.chamber, time) == pytest.approx(expected, abs=0.1)
        assert len(SimulatedUnit(scenario, 1).samples(10)) == 10


def test_what_no_experiment_separates_is_reported_and_no_file_is_written(
    open_report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["plan", str(open_report), "--out", str(tmp_path), "--hours", "0.9", "--json"]) == 0
    (plan,) = json.loads(capsys.readouterr().out)["questions"]
    assert plan["profile"] is None
    assert "no experiment that was tried decides" in plan["why_not"]
    assert "in BIC that are needed" in plan["why_not"]
    assert plan["files"] == []
    assert not list(tmp_path.iterdir())


def test_a_plan_states_how_long_it_takes_and_when_the_time_is_up_what_was_best_so_far(
    open_report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imumon.lab.diagnosis.planning.TIME_UP_S", 0.0)
    assert command(["plan", str(open_report), "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().err
    assert "questions that are open: 1; the search takes at most about 3 min" in shown
    assert "no experiment that was tried decides" in shown
    assert "after 0 s no further one was tried" in shown


def test_every_course_is_tried_once_and_lasts_at_most_as_long_as_is_requested() -> None:
    found = profiles(10.0, 40.0, 1.0, 300.0, 4.0 * 3600.0, poses=False)
    assert len({(one.title, one.duration_s) for one in found}) == len(found)
    assert [one.duration_s for one in found] == sorted(one.duration_s for one in found)
    assert found[-1].duration_s <= 4.0 * 3600.0


def test_without_a_question_there_is_no_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train, test = three(lambda time, _: 0.0 * time, 3000)
    write_report(diagnose(train, test), tmp_path / "report.json")
    assert command(["plan", str(tmp_path), "--out", str(tmp_path / "plan")]) == 0
    assert "no question open" in capsys.readouterr().err


def test_what_is_no_report_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "report.json").write_text(json.dumps({"format": "something else"}))
    assert command(["plan", str(tmp_path), "--out", str(tmp_path / "plan")]) != 0
    assert "report.json" in capsys.readouterr().err


def test_files_of_an_earlier_plan_are_named(
    open_report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "2-drift.yaml").touch()
    assert command(["plan", str(open_report), "--out", str(tmp_path), "--hours", "0.9"]) == 0
    assert f"{tmp_path / '2-drift.yaml'} is of an earlier plan" in capsys.readouterr().err


def test_a_report_without_white_noise_is_refused(
    open_report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended in a ZeroDivisionError."""
    content = json.loads((open_report / "report.json").read_text(encoding="utf-8"))
    content["channels"]["gyro_x"]["noise_floor_rms"] = 0
    (tmp_path / "report.json").write_text(json.dumps(content), encoding="utf-8")
    assert command(["plan", str(tmp_path), "--out", str(tmp_path / "plan")]) == 2
    assert "noise_floor_rms" in capsys.readouterr().err
