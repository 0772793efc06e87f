from __future__ import annotations

import errno
import fcntl
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imumon.recordings.folder import open_session
from imumon.recordings.wire import BLOCK_BYTES
from imumon.recordings.wire_reader import WireReader
from tests.cli.command import answer, imumon
from tests.faults.damage import zero_sector

NAMES = ("wire.mcap", "session.yaml")


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session as a kill leaves it: no footer, state open, no counters, a view that was cut."""
    folder = tmp_path_factory.mktemp("broken") / "s"
    done = imumon("simulate", "bench", "--out", folder, "--duration", 20)
    assert done.returncode == 0, done.stderr
    wire = folder / "wire.mcap"
    content = wire.read_bytes()
    wire.write_bytes(content[: len(content) * 3 // 4])
    text = (folder / "session.yaml").read_text()
    (folder / "session.yaml").write_text(text.replace("state: closed", "state: open"))
    (folder / "view.rrd").write_bytes(b"RRF2 cut")
    return folder


@pytest.fixture
def killed(broken: Path, tmp_path: Path) -> Path:
    """A killed session that a test may change."""
    return Path(shutil.copytree(broken, tmp_path / "s"))


@pytest.fixture(scope="module")
def recovered(broken: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A killed session that was recovered, and what was said."""
    folder = Path(shutil.copytree(broken, tmp_path_factory.mktemp("recovered") / "s"))
    return folder, answer("recover", folder)


def test_a_killed_session_is_finished_and_the_originals_stay(
    broken: Path, recovered: tuple[Path, dict[str, Any]]
) -> None:
    killed, result = recovered
    before = {name: (broken / name).read_bytes() for name in NAMES}
    reader = WireReader(killed / "wire.mcap")
    assert list(reader) == list(WireReader(broken / "wire.mcap"))
    assert reader.summary.complete
    assert reader.summary.checksum_ok
    session = open_session(killed)
    assert (session.state, session.metadata.views) == ("closed", ["view.rrd"])
    assert session.metadata.counters["bytes_received"] == reader.summary.bytes
    assert session.metadata.counters["samples"] > 1000
    assert (killed / "view.rrd").read_bytes() == b"RRF2 cut"
    assert {name: (killed / f"{name}.original").read_bytes() for name in NAMES} == before
    assert sorted(result["originals"]) == sorted(str(killed / f"{name}.original") for name in NAMES)
    assert not list(killed.glob("*partial*"))


def test_before_that_it_replays_and_that_it_was_not_closed_is_reported(broken: Path) -> None:
    done = imumon("replay", broken, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["packets"] > 1000
    assert told["identical_to_live"] is None
    assert "not closed" in done.stderr


def test_a_second_recovery_does_nothing(recovered: tuple[Path, dict[str, Any]]) -> None:
    killed, _ = recovered
    before = {path.name: (path.stat().st_mtime_ns, path.stat().st_size) for path in killed.iterdir()}
    done = imumon("recover", killed)
    assert "nothing was written" in done.stderr
    assert {path.name: (path.stat().st_mtime_ns, path.stat().st_size) for path in killed.iterdir()} == before


def test_what_damage_took_is_reported_before_and_after_the_recovery(killed: Path) -> None:
    content = bytearray((killed / "wire.mcap").read_bytes())
    zero_sector(content, np.random.default_rng(3))
    (killed / "wire.mcap").write_bytes(content)
    items = list(WireReader(killed / "wire.mcap"))
    told = answer("replay", killed)["recording"]
    assert told["damage"]["messages"] > 10
    assert 4096 < told["damage"]["bytes"] < 3 * BLOCK_BYTES
    assert "is damaged in 1 place" in imumon("export", killed, "--to", "csv").stderr
    assert answer("decode", killed, "--out", killed / "t.csv")["recording"] == told
    assert answer("recover", killed)["before"]["damage"]["messages"] == told["damage"]["messages"]
    reader = WireReader(killed / "wire.mcap")
    assert list(reader) == items
    again = answer("replay", killed)["recording"]
    assert again["bytes_unrecorded"] == 0
    assert again["damage"]["messages"] == told["damage"]["messages"]
    assert "reads or events missing" in imumon("export", killed, "--to", "csv").stderr
    assert "nothing was written" in imumon("recover", killed).stderr


def test_a_session_that_is_being_recorded_is_left_alone(killed: Path) -> None:
    descriptor = os.open(killed / "wire.mcap", os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        done = imumon("recover", killed)
    finally:
        os.close(descriptor)
    assert done.returncode == 3
    assert "is being recorded" in done.stderr
    assert not (killed / "wire.mcap.original").exists()


def test_a_disk_that_fails_leaves_all_as_it_was(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path.name: path.read_bytes() for path in killed.iterdir()}

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("imumon.recordings.wire.os.write", full)
    done = imumon("recover", killed)
    assert done.returncode == 2
    assert "No space left" in done.stderr
    assert {path.name: path.read_bytes() for path in killed.iterdir()} == before


@pytest.mark.parametrize("full", [False, True])
def test_a_disk_without_links_keeps_copies(killed: Path, monkeypatch: pytest.MonkeyPatch, full: bool) -> None:
    before = {path.name: path.read_bytes() for path in killed.iterdir()}

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    def fill(_: Path, to: Path) -> None:
        to.write_bytes(b"the first bytes")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    if full:
        monkeypatch.setattr("imumon.run.recovery.shutil.copy2", fill)
    done = imumon("recover", killed)
    assert done.returncode == (2 if full else 0)
    after = {path.name: path.read_bytes() for path in killed.iterdir()}
    if full:
        assert after == before
    else:
        assert after["wire.mcap.original"] == before["wire.mcap"]
        assert open_session(killed).state == "closed"
