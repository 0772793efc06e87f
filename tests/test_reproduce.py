"""The scripts that make the figures of the docs still run: each imports, and small runs go to their end."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

import matplotlib
import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "scripts" / "reproduce"
COMMANDS = sorted(path.name for path in FOLDER.iterdir() if path.is_file() and os.access(path, os.X_OK))

QUICK = (
    "ablation", "alignment", "attitude", "bias_race", "field", "random_error", "rest_detector", "smoothing",
    "tczupt", "temperature_rate", "thermal_calibration",
)  # fmt: skip
SMALL: dict[str, list[str]] = {
    "allan_terms": ["1"],
    "bias_sigma": ["--seeds", "1", "--only", "tactical"],
    "moving_bias": ["--seeds", "1", "--only", "rover", "--minutes", "3"],
    "alignment_site": ["1", "--only", "0.03"],
    "thermometers": ["--seeds", "1", "--kinds", "white 0.25 step, 10 Hz", "--holds", "60", "--part", "bias"],
    **{name: ["--quick"] for name in QUICK},
}
"""Arguments of a run of some seconds."""
FORKING = "closing_the_loop"
"""Starts processes of its own, as this one with the threads of other tests must not."""


def planted(folder: Path, python: str) -> Path:
    """Return a tree with the scripts, whose docs may be written, where this text is Python."""
    for name in ("configs", "tests"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    for name in ("appendix", "figures"):
        (folder / "docs" / name).mkdir(parents=True)
    program = folder / ".venv" / "bin" / "python"
    program.parent.mkdir(parents=True)
    program.write_text(f"#!/bin/sh\n{python}\n")
    program.chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree whose Python says what it would run."""
    return planted(tmp_path_factory.mktemp("tree"), "printf '%s\\n' \"$@\"")


@pytest.fixture
def scripts(tree: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the scripts, which may be imported, and leave settings as they were."""
    folder = tree / "scripts" / "reproduce"
    monkeypatch.syspath_prepend(folder)
    with matplotlib.rc_context(), patch.dict(os.environ):
        yield folder


def run(*command: str | Path) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_script_imports(scripts: Path) -> None:
    names = sorted(path.stem for path in scripts.glob("*.py"))
    assert names
    for name in names:
        import_module(name)


@pytest.mark.parametrize("name", SMALL)
def test_a_small_run_goes_to_its_end(
    name: str, scripts: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = run(scripts / name, *SMALL[name]).splitlines()
    assert arguments[1:] == SMALL[name]
    monkeypatch.setattr(sys, "argv", arguments)
    runpy.run_path(arguments[0], run_name="__main__")
    assert re.search(r"\d", capsys.readouterr().out)


def test_a_small_run_in_processes_of_its_own(tmp_path: Path) -> None:
    tree = planted(tmp_path, f'exec "{sys.executable}" "$@"')
    assert re.search(r"\d", run(tree / "scripts" / "reproduce" / FORKING, "--quick"))


def test_every_script_is_started_by_a_command_of_its_own() -> None:
    assert {*SMALL, FORKING} == set(COMMANDS)
    for name in COMMANDS:
        assert list(FOLDER.glob(f"{name}*.py")), name
