"""What a person at a terminal sees of long work, and a program does not."""

from __future__ import annotations

import io
import os
import pty
import subprocess
from pathlib import Path

import pytest

from imumon.cli import progress
from imumon.recordings.source import recorded_bytes
from tests.cli.command import IMUMON, imumon
from tests.waiting import LIMIT_S


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("progress") / "session"
    assert imumon("simulate", "bench", "--out", folder, "--duration", 20).returncode == 0
    return folder


def on_a_terminal(*arguments: object) -> tuple[str, str]:
    """Return standard output and what a terminal at standard error shows."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [IMUMON, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(theirs)
    shown = b""
    try:
        while data := os.read(ours, 1 << 16):
            shown += data
    except OSError:  # Linux says so that the other side is closed
        pass
    os.close(ours)
    out, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, shown
    return out.decode(), shown.decode()


def test_a_terminal_shows_how_much_is_left(session: Path, tmp_path: Path) -> None:
    _, shown = on_a_terminal("decode", session, "--out", tmp_path / "a.parquet")
    assert "reading session" in shown
    assert "%" in shown


def test_nothing_is_shown_beside_json_or_of_short_work_without_a_terminal(
    session: Path, tmp_path: Path
) -> None:
    out, shown = on_a_terminal("decode", session, "--out", tmp_path / "a.parquet", "--json")
    assert out.startswith("{")
    assert "reading session" not in shown
    done = imumon("decode", session, "--out", tmp_path / "b.parquet")
    assert "reading session" not in done.stderr


def test_without_a_terminal_long_work_states_from_time_to_time_how_far_it_has_come(
    session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[str] = []
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    monkeypatch.setattr(progress, "log", lambda _, text: lines.append(text))
    monkeypatch.setattr("sys.stderr", io.StringIO())
    total = recorded_bytes(session)
    assert total
    for quiet in (False, True):
        with progress.reading_bar([session], quiet=quiet) as now:
            now.count(total // 2)
            now("trying curves for gyro_x")
    assert lines == ["reading session: 50%", "trying curves for gyro_x"]


def test_long_work_is_announced_with_its_time_and_short_work_is_not(
    monkeypatch: pytest.MonkeyPatch, session: Path
) -> None:
    lines: list[str] = []
    monkeypatch.setattr(progress, "log", lambda _, text: lines.append(text))
    for expected_s in (4.0, 21.0, 200.0, 7000.0):
        progress.announce("reading", 13500, 6750.0, expected_s, quiet=False)
        progress.announce("reading", 13500, 6750.0, expected_s, quiet=True)
        progress.announce("reading", 0, 0.0, expected_s, quiet=False)
    assert lines == [f"reading 13,500 samples of 6,750 s: about {text}" for text in ("20 s", "3 min", "2 h")]
    assert progress.size_of([session])[0] == 2000


def test_simulate_announces_only_what_takes_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.cli.progress.WORTH_LOGGING_S", 0.0)
    options = ["crs05-ramp", "--duration", 1, "--out"]
    assert "simulating 100 samples of 1 s: about 1 s" in imumon("simulate", *options, tmp_path / "a").stderr
    assert "about" not in imumon("simulate", *options, tmp_path / "b", "--json").stderr
