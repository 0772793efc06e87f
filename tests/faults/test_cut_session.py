"""A closed session that lost half of its wire file at the boundary of a record: every command reports it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from imumon.recordings.wire import MAGIC, RECORD
from tests.cli.command import answer, imumon

REPORTED = "bytes are not in wire.mcap"


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cut") / "sessions" / "s"
    done = imumon("simulate", "bench", "--out", folder, "--duration", 20)
    assert done.returncode == 0, done.stderr
    wire = folder / "wire.mcap"
    whole, at = wire.read_bytes(), len(MAGIC)
    while at < len(whole) // 2:
        at += RECORD.size + RECORD.unpack_from(whole, at)[1]
    wire.write_bytes(whole[:at])
    return folder


@pytest.mark.long
@pytest.mark.parametrize("command", ["decode", "export", "replay", "allan", "report", "batch", "catalog"])
def test_every_command_states_how_many_bytes_are_missing(cut: Path, tmp_path: Path, command: str) -> None:
    given = {
        "decode": ["decode", cut, "--out", tmp_path / "t.csv"],
        "export": ["export", cut, "--to", "csv", "--out", tmp_path / "t.csv"],
        "replay": ["replay", cut],
        "allan": ["allan", cut],
        "report": ["report", cut, "--out", tmp_path / "r.html"],
        "batch": ["batch", "decode", cut.parent, "--out", tmp_path / "b", "--workers", 1],
        "catalog": ["catalog", cut.parent, "--results", tmp_path / "c"],
    }[command]
    assert REPORTED in imumon(*given).stderr


def test_a_recovery_goes_on_reporting_them(cut: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(cut, tmp_path / "s"))
    missing = answer("replay", folder)["recording"]["bytes_missing"]
    assert missing > 1000
    assert imumon("recover", folder).returncode == 0
    done = imumon("replay", folder, "--json")
    recording = json.loads(done.stdout)["recording"]
    assert (recording["bytes_missing"], recording["bytes_unrecorded"]) == (0, missing)
    assert recording["damage"]["where"][0]["seconds"] == pytest.approx(10.5, abs=0.6)  # and the rest of 8 KiB
    assert f"{missing:,} bytes could not be recorded" in done.stderr
