"""``imumon diagnose`` as a user or a program meets it."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from imumon.models.model import load_model
from tests.cli.command import MAP, imumon
from tests.data_folder import measured
from tests.lab.diagnosis.test_diagnose import lag
from tests.lab.diagnosis.units import three


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write three runs of a lagging unit, a sample every other second, as tables with a map."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    train, test = three(lag)
    for name, run in zip(("a", "b", "c"), (*train, *test), strict=True):
        gyro = run.mean["gyro_x"]
        other = np.random.default_rng(0).normal(0.0, 1e-5, (len(gyro), 2))
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack([run.time_s - 0.5, gyro, other, run.mean["temperature"]])[::2],
            "%.12g",
            delimiter=",",
            header="t,gx,gy,gz,temp",
            comments="",
        )
    return folder


@pytest.mark.long
def test_tables_are_diagnosed_into_report_page_and_model(tables: Path) -> None:
    paths = [tables / f"{name}.csv" for name in "abc"]
    out = tables / "found"
    done = imumon(
        "diagnose", "--train", *paths[:2], "--test", paths[2], "--map", tables / "map.yaml", "--out", out
    )
    assert done.returncode == 0, done.stderr
    assert "thermal_lag: " in done.stderr
    content = json.loads((out / "report.json").read_text(encoding="utf-8"))
    gyro = content["channels"]["gyro_x"]
    assert [effect["name"] for effect in gyro["effects"]] == ["thermal_lag"]
    assert gyro["after"]["test_rms"] < 0.5 * gyro["before"]["test_rms"]
    assert content["channels"]["gyro_y"]["effects"] == []
    page = (out / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=.https?:", page)
    model = load_model(out / "model.yaml")
    assert [effect.name for effect in model.channels["gyro_x"].effects] == ["thermal_lag"]
    assert [run.session for run in model.trained_on] == ["a.csv", "b.csv"]


def test_a_diagnosis_that_fails_leaves_no_folder_behind_and_takes_none_away(
    tables: Path, tmp_path: Path
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    for out in (tmp_path / "new" / "found", there):
        done = imumon("diagnose", "--train", tables / "no-such.csv", "--out", out)
        assert done.returncode == 4, done.stderr
    assert list(tmp_path.iterdir()) == [there]


def test_the_next_command_reads_the_recordings_as_this_one_did(tables: Path, tmp_path: Path) -> None:
    given = ["--train", tables / "a.csv", "--channels", "gyro_x, gyro_y"]
    given += ["--map", tables / "map.yaml", "--at-rest"]
    out = tmp_path / "found here"
    done = imumon("diagnose", *given, "--out", out)
    assert done.returncode == 0, done.stderr
    again = shlex.join(["imumon", "diagnose", *map(str, given), "--test", "NEW", "--out", str(out)])
    assert again in done.stderr
    (step,) = json.loads((out / "report.json").read_text(encoding="utf-8"))["next"]
    assert step["command"] == again


def test_two_things_declared_are_refused(tables: Path) -> None:
    done = imumon(
        "diagnose",
        "--train",
        tables / "a.csv",
        "--declared",
        "polynomial 3",
        "--model",
        "m.yaml",
        "--out",
        tables / "no",
    )
    assert done.returncode == 2
    assert "--model and --declared" in done.stderr


@pytest.mark.parametrize("declared", ["cubic", "polynomial 99", ""])
def test_a_declared_model_that_is_none_is_refused(tables: Path, declared: str) -> None:
    done = imumon("diagnose", "--train", tables / "a.csv", "--declared", declared, "--out", tables / "no")
    assert done.returncode == 2
    assert "polynomial N" in done.stderr


@pytest.mark.long
def test_the_chamber_cycle_is_never_made_worse(tmp_path: Path) -> None:
    folder = measured("chamber-cycle")
    lines = (folder / "cooling-heating.csv").read_text(encoding="utf-8").splitlines()
    head, rows = lines[0], lines[1:]
    cut = int(0.65 * len(rows))
    for name, part in (("first", rows[:cut]), ("rest", rows[cut:])):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *part]) + "\n", encoding="utf-8")
    done = imumon(
        "diagnose",
        "--train",
        tmp_path / "first.csv",
        "--test",
        tmp_path / "rest.csv",
        "--map",
        folder / "map.yaml",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 0, done.stderr
    channels = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["channels"]
    for name, found in channels.items():
        assert found["after"]["test_rms"] <= found["before"]["test_rms"], name
    x = channels["gyro_x"]
    assert x["after"]["test_rms"] < 0.5 * x["before"]["test_rms"]
    assert [effect["name"] for effect in x["effects"]] == ["step"]
    assert not x["in_model_file"]
    assert channels["gyro_y"]["unexplained"]


@pytest.mark.long
def test_the_worked_case_of_the_page_is_what_the_command_prints(tmp_path: Path) -> None:
    docs = Path(__file__).parents[2] / "docs"
    pages = (docs / "closing-the-loop.md", docs / "appendix" / "closing-the-loop-details.md")
    shown = [
        line
        for page in pages
        for line in page.read_text(encoding="utf-8").splitlines()
        if line.startswith("gyro_") and "white floors become" in line
    ]
    sessions = [tmp_path / f"S{seed}" for seed in (1, 2, 3)]
    for seed, session in enumerate(sessions, 1):
        done = imumon("simulate", "crs05-ramp-lag", "--rate", "10", "--seed", str(seed), "--out", session)
        assert done.returncode == 0, done.stderr
    assumed = ("--declared", "polynomial 5 + offset", "--channels", "gyro")
    out = tmp_path / "found"
    done = imumon("diagnose", "--train", *sessions[:2], "--test", sessions[2], *assumed, "--out", out)
    assert done.returncode == 0, done.stderr
    printed = " ".join(done.stderr.split())
    assert [line[:6] for line in shown] == ["gyro_y", "gyro_x", "gyro_y", "gyro_z"]
    for line in shown:
        assert " ".join(line.removesuffix(", ...").split()) in printed
    page = pages[0].read_text(encoding="utf-8")
    (error,) = [line for line in page.splitlines() if line.startswith("error of ")]
    assert " ".join(error.split()) in printed
    done = imumon("plan", out, "--out", tmp_path / "next")
    assert done.returncode == 0, done.stderr
    (planned,) = [
        line for line in pages[1].read_text(encoding="utf-8").splitlines() if line.startswith("1  gyro_")
    ]
    assert " ".join(planned.split()) in " ".join(done.stderr.split())
