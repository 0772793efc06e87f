from __future__ import annotations

import fcntl
import os
from pathlib import Path

import numpy as np
import pytest

from imumon.recordings.folder import open_session
from imumon.recordings.wire_reader import WireReader
from tests.cli.command import answer, imumon
from tests.faults.damage import zero_sector


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A session as a kill leaves it: no footer, state open, no counters, a view that was cut."""
    done = imumon("simulate", "bench", "--out", tmp_path / "s", "--duration", 20)
    assert done.returncode == 0, done.stderr
    wire = tmp_path / "s" / "wire.mcap"
    content = wire.read_bytes()
    wire.write_bytes(content[: len(content) * 3 // 4])
    text = (tmp_path / "s" / "session.yaml").read_text()
    (tmp_path / "s" / "session.yaml").write_text(text.replace("state: closed", "state: open"))
    (tmp_path / "s" / "view.rrd").write_bytes(b"RRF2 cut")
    return tmp_path / "s"


def test_a_killed_session_is_finished_and_the_originals_stay(killed: Path) -> None:
    names = ("wire.mcap", "session.yaml", "view.rrd")
    before = {name: (killed / name).read_bytes() for name in names}
    items = list(WireReader(killed / "wire.mcap"))
    result = answer("recover", killed)
    reader = WireReader(killed / "wire.mcap")
    assert list(reader) == items
    assert reader.summary.complete
    assert reader.summary.checksum_ok
    session = open_session(killed)
    assert (session.state, session.metadata.views) == ("closed", ["view.rrd"])
    assert session.metadata.counters["bytes_received"] == reader.summary.bytes
    assert session.metadata.counters["samples"] > 1000
    assert (killed / "view.rrd").stat().st_size > 10_000
    assert {(killed / f"{name}.original").read_bytes() for name in names} == set(before.values())
    assert sorted(result["originals"]) == sorted(str(killed / f"{name}.original") for name in names)
    assert not list(killed.glob("*partial*")) + list(killed.glob("recovering*"))


def test_a_second_recovery_does_nothing(killed: Path) -> None:
    answer("recover", killed)
    before = {path.name: (path.stat().st_mtime_ns, path.stat().st_size) for path in killed.iterdir()}
    done = imumon("recover", killed)
    assert "nothing was written" in done.stderr
    assert {path.name: (path.stat().st_mtime_ns, path.stat().st_size) for path in killed.iterdir()} == before


def test_what_damage_took_is_said_before_and_after_the_recovery(killed: Path) -> None:
    content = bytearray((killed / "wire.mcap").read_bytes())
    zero_sector(content, np.random.default_rng(3))
    (killed / "wire.mcap").write_bytes(content)
    items = list(WireReader(killed / "wire.mcap"))
    told = answer("replay", killed)["recording"]
    assert told["damage"]["messages"] > 10
    assert 4096 <= told["damage"]["bytes"] < 5000
    assert "is damaged in 1 place" in imumon("export", killed, "--to", "csv").stderr
    assert answer("decode", killed, "--out", killed / "t.csv")["recording"] == told
    assert answer("recover", killed)["before"]["damage"]["messages"] == told["damage"]["messages"]
    reader = WireReader(killed / "wire.mcap")
    assert list(reader) == items
    assert reader.summary.bytes_unrecorded == told["damage"]["bytes"]
    assert not answer("replay", killed)["recording"]["damage"]["places"]


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
