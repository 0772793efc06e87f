"""The scripts that make the figures of the docs still run: each imports, and small runs go to their end."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "scripts" / "reproduce"

QUICK = (
    "alignment", "bias_race", "closing_the_loop", "field", "random_error", "rest_detector", "smoothing",
    "tczupt", "temperature_rate", "thermal_calibration",
)  # fmt: skip
SMALL: dict[str, list[str]] = {
    "allan_terms": ["1"],
    "bias_sigma": ["--seeds", "1", "--only", "tactical"],
    "alignment_site": ["1", "--only", "quiet"],
    "thermometers": ["--seeds", "1", "--kinds", "white 0.25 step, 10 Hz", "--holds", "60"],
    **{name: ["--quick"] for name in QUICK},
}
"""Arguments of a run of some seconds."""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A tree with the scripts, whose docs may be written."""
    for name in ("configs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    for name in ("appendix", "figures"):
        (tmp_path / "docs" / name).mkdir(parents=True)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    return tmp_path


def run(command: list[str | Path], folder: Path) -> str:
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{folder}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_script_imports() -> None:
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    assert names
    run([sys.executable, "-c", f"import {', '.join(names)}"], FOLDER)


@pytest.mark.parametrize("name", SMALL)
def test_a_small_run_goes_to_its_end(name: str, tree: Path) -> None:
    assert re.search(r"\d", run([tree / "scripts" / "reproduce" / name, *SMALL[name]], tree))


def test_every_script_is_started_by_a_command_of_its_own() -> None:
    commands = {path.name for path in FOLDER.iterdir() if path.is_file() and os.access(path, os.X_OK)}
    assert set(SMALL) <= commands
    for name in commands:
        assert list(FOLDER.glob(f"{name}*.py")), name
