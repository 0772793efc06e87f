"""Several sessions on one time axis."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rerun.chunk import RrdReader

from tests.cli.command import answer, imumon


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    made = []
    for seed in (1, 2):
        folder = tmp_path_factory.mktemp("parent") / "session"  # the same name twice
        done = imumon("simulate", "bench", "--out", folder, "--duration", 3 + seed, "--seed", seed)
        assert done.returncode == 0, done.stderr
        made.append(folder)
    return made


def times_s(path: Path, timeline: str) -> dict[str, tuple[float, float]]:
    """Return first and last time of what is drawn of the angular rate x, by session."""
    found: dict[str, tuple[float, float]] = {}
    for chunk in RrdReader(str(path)).stream():
        name = str(chunk.entity_path)
        batch = chunk.to_record_batch()
        if name.endswith("gyro/0") and name.startswith("/view") and timeline in batch.schema.names:
            values = 1e-9 * np.asarray(batch.column(timeline).cast(pa.int64()))
            known = found.get(name, (np.inf, -np.inf))
            found[name] = (min(known[0], values.min()), max(known[1], values.max()))
    return found


def test_sessions_begin_at_power_on_side_by_side(sessions: list[Path], tmp_path: Path) -> None:
    result = answer("view", *sessions, "--out", tmp_path / "both.rrd")
    assert [one["name"] for one in result["sessions"]] == ["session 1", "session 2"]
    assert [one["samples"] for one in result["sessions"]] == [400, 500]
    assert all(one["outages"] == [] and one["files"]["wire.mcap"] > 0 for one in result["sessions"])
    spans = sorted(times_s(tmp_path / "both.rrd", "device_time").values())
    assert [begin for begin, _ in spans] == [0.0, 0.0]
    assert [end for _, end in spans] == pytest.approx([4.0, 5.0], abs=0.5)


def test_sessions_stand_where_the_host_clock_states(sessions: list[Path], tmp_path: Path) -> None:
    done = imumon("view", *sessions, "--align", "host", "--out", tmp_path / "both.rrd")
    assert done.returncode == 0, done.stderr
    assert "outages   none" in done.stderr
    spans = times_s(tmp_path / "both.rrd", "host_time").values()
    assert all(begin == pytest.approx(1_767_225_600, abs=1.0) for begin, _ in spans)


def test_what_is_there_is_not_overwritten_and_no_session_is_reported(
    sessions: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "both.rrd").touch()
    assert "is there already" in imumon("view", sessions[0], "--out", tmp_path / "both.rrd").stderr
    assert imumon("view", tmp_path, "--out", tmp_path / "new.rrd").returncode == 4


def test_what_is_wrong_with_a_session_is_reported_before_anything_is_shown(sessions: list[Path]) -> None:
    done = imumon("view", sessions[0], "NOPE", "--view", "web")
    assert done.returncode == 4
    assert "http://" not in done.stderr
    assert "NOPE: there is no such file or folder" in done.stderr


def test_a_name_that_is_made_is_that_of_no_other_session(sessions: list[Path], tmp_path: Path) -> None:
    shutil.copytree(sessions[0], tmp_path / "session 2")
    result = answer("view", *sessions, tmp_path / "session 2", "--out", tmp_path / "all.rrd")
    names = [one["name"] for one in result["sessions"]]
    assert names == ["session 1", "session 2", "session 2 3"]


def test_of_a_table_the_time_of_its_import_is_not_reported_as_when_it_was_recorded(
    sessions: list[Path], tmp_path: Path
) -> None:
    rows = [f"{0.01 * row:.2f},0.1,0.2,0.3" for row in range(300)]
    (tmp_path / "a.csv").write_text("\n".join(["t,x,y,z", *rows]))
    (tmp_path / "map.yaml").write_text(
        "time: {column: t, unit: s}\ngyro: {columns: [x, y, z], unit: deg/s}\naxes: FLU\n"
    )
    made = imumon("import", tmp_path / "a.csv", "--map", tmp_path / "map.yaml", "--out", tmp_path / "s")
    assert made.returncode == 0, made.stderr
    done = imumon("view", tmp_path / "s", "--out", tmp_path / "one.rrd")
    assert "recorded  3.0 s, imported 20" in done.stderr
    refused = imumon("view", tmp_path / "s", "--align", "host", "--out", tmp_path / "two.rrd")
    assert refused.returncode == 4
    assert "--align power-on" in refused.stderr
    both = imumon("view", tmp_path / "s", sessions[0], "--align", "host", "--out", tmp_path / "three.rrd")
    assert both.returncode == 0
    assert "s: has no times of a computer, and is not shown; --align power-on shows it" in both.stderr
    assert "session: has no times" not in both.stderr
