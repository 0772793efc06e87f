"""``imumon magnetometer`` as a user or a program meets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from imumon.blocks import SampleBlock
from imumon.models.model import load_model
from tests.cli.command import imumon
from tests.lab.calibration.test_magnetometer import HARD, RATE_HZ, figure_eight
from tests.lab.calibration.test_magnetometer_axes import turns

MAP = """
time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: rad/s}
accel: {columns: [ax, ay, az], unit: m/s^2}
mag: {columns: [mx, my, mz], unit: uT}
"""


def imported(folder: Path, *, over: bool) -> Path:
    """Make a session of a figure-eight by the real command."""
    block, _ = figure_eight(1, over=over, swing=(1.2, 1.0, 3.0) if over else (0.1, 0.1, 1.0))
    zeros = {f"gyro_{a}": np.zeros(len(block)) for a in "xyz"}
    return session_of(block.with_columns(zeros), folder)


def session_of(block: SampleBlock, folder: Path) -> Path:
    t = np.arange(len(block)) / RATE_HZ
    columns = [t, *(block[f"{s}_{a}"] for s in ("gyro", "accel", "mag") for a in "xyz")]
    table, map_path = folder / "table.csv", folder / "map.yaml"
    header = "t,gx,gy,gz,ax,ay,az,mx,my,mz"
    np.savetxt(table, np.column_stack(columns), "%.17g", delimiter=",", header=header, comments="")
    map_path.write_text(MAP, encoding="utf-8")
    done = imumon("import", table, "--map", map_path, "--out", folder / "session")
    assert done.returncode == 0, done.stderr
    return folder / "session"


def test_a_figure_eight_becomes_part_of_the_model(tmp_path: Path) -> None:
    session, out, plot = imported(tmp_path, over=True), tmp_path / "unit.yaml", tmp_path / "mag.png"
    done = imumon("magnetometer", session, "--out", out, "--plot", plot, "--json")
    assert done.returncode == 0, done.stderr
    report, model = json.loads(done.stdout), load_model(out)
    assert model.magnetometer is not None
    assert report["hard_iron"] == model.magnetometer.hard_iron
    np.testing.assert_allclose(model.magnetometer.hard_iron, HARD, atol=0.1)
    assert model.magnetometer.session == "session"
    assert report["axes_off_deg"] is None
    assert "not checked" in done.stderr
    with Image.open(plot) as picture:
        assert np.asarray(picture.convert("L")).std() > 10.0
    again = imumon("magnetometer", session, "--model", out, "--out", tmp_path / "more.yaml")
    assert again.returncode == 0, again.stderr
    assert load_model(tmp_path / "more.yaml") == model
    # A replay takes it, and has a heading with a sigma.
    table = tmp_path / "samples.csv"
    done = imumon("replay", session, "--model", out, "--out", table, "--columns", "attitude_estimate_north")
    assert done.returncode == 0, done.stderr
    assert "not calibrated" not in done.stderr


@pytest.mark.long
def test_too_little_turned_is_refused(tmp_path: Path) -> None:
    done = imumon("magnetometer", imported(tmp_path, over=False), "--out", tmp_path / "unit.yaml")
    assert done.returncode == 4
    assert "of the directions" in done.stderr
    assert "next: turn the" in done.stderr
    assert not (tmp_path / "unit.yaml").exists()


def test_axes_that_are_not_the_gyros_are_refused(tmp_path: Path) -> None:
    block = turns(1, np.eye(3), RATE_HZ)
    session, out = session_of(block, tmp_path), tmp_path / "unit.yaml"
    done = imumon("magnetometer", session, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["axes_off_deg"] < 2.0
    assert "the gyros', turned against them by" in done.stderr
    swapped = block.with_columns({"mag_x": block["mag_y"], "mag_y": block["mag_x"], "mag_z": -block["mag_z"]})
    (tmp_path / "other").mkdir()
    done = imumon("magnetometer", session_of(swapped, tmp_path / "other"), "--out", tmp_path / "no.yaml")
    assert done.returncode == 4
    assert "+y, +x, -z or" in done.stderr
    assert not (tmp_path / "no.yaml").exists()


@pytest.mark.parametrize("name", ["out", "plot"])
def test_nothing_is_overwritten(tmp_path: Path, name: str) -> None:
    there = tmp_path / "there"
    there.write_text("mine", encoding="utf-8")
    options = {"out": tmp_path / "new.yaml", name: there}
    done = imumon("magnetometer", tmp_path, *(part for k, v in options.items() for part in (f"--{k}", v)))
    assert done.returncode == 2
    assert there.read_text(encoding="utf-8") == "mine"
