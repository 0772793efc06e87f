"""What commands write: never over a recording, whole or not at all, and only what was said to be written."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from imumon.recordings.table import read_columns
from imumon.recordings.wire import WireWriter
from tests.cli.command import MAP, answer, imumon


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two simulated sessions, an imported one, and a raw capture."""
    folder = tmp_path_factory.mktemp("made")
    for name in "ab":
        answer("simulate", "bench", "--out", folder / name, "--duration", 1)
    (folder / "log.csv").write_text("t,gx,gy,gz,temp\n" + "".join(f"0.{i:02},1,2,3,20\n" for i in range(50)))
    (folder / "map.yaml").write_text(MAP)
    answer("import", folder / "log.csv", "--map", folder / "map.yaml", "--out", folder / "c")
    return folder


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(
    "arguments",
    [
        "export a --to mcap --out b/wire.mcap",
        "export a --to mcap --out b/wire",
        "export a --to mcap --out a/../b/wire.mcap",
        "decode a --out b/wire.mcap",
        "replay a --out b/wire.mcap",
        "export a --to parquet --out c/samples.parquet",
        "export a --to parquet --out a/truth.parquet",
        "export a --to parquet --out b/samples.parquet",
        "simulate bench --duration 1 --out b/truth.parquet",
        "allan a --noise-out b/session.yaml",
    ],
)
def test_no_table_replaces_the_recording_of_another_session(made: Path, arguments: str) -> None:
    before = _contents(made)
    done = imumon(*arguments.split(), cwd=made)
    assert done.returncode == 2
    assert "is a session, whose" in done.stderr
    assert "nothing was overwritten" in done.stderr
    assert _contents(made) == before


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("-", "the output is no file"),
        ("/dev/stdout", "/dev/stdout"),
        ("b", "b: the output is a folder"),
        ("x.parquet", "name it x.csv"),
    ],
)
def test_a_suffix_is_added_to_a_bare_name_only(made: Path, out: str, said: str) -> None:
    before = _contents(made)
    done = imumon("export", "a", "--to", "csv", "--out", out, cwd=made)
    assert done.returncode == 2
    assert said in done.stderr
    assert _contents(made) == before


def test_a_bare_name_gets_the_suffix_and_a_link_stays(made: Path, tmp_path: Path) -> None:
    assert answer("export", made / "a", "--to", "csv", "--out", tmp_path / "run.1")["out"].endswith(
        "run.1.csv"
    )
    for kind in ("parquet", "npz"):
        link, real = tmp_path / f"link.{kind}", tmp_path / f"real.{kind}"
        real.touch()
        link.symlink_to(real.name)
        answer("export", made / "a", "--to", kind, "--out", link)
        assert link.is_symlink()
        assert real.stat().st_size > 1000


def test_an_imported_table_that_was_changed_is_noticed(made: Path, tmp_path: Path) -> None:
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "session.yaml").write_bytes((made / "c" / "session.yaml").read_bytes())
    answer("export", made / "a", "--to", "parquet", "--out", tmp_path / "other.parquet")
    (tmp_path / "other.parquet").rename(tmp_path / "c" / "samples.parquet")
    for arguments in (["replay", "c"], ["export", "c", "--to", "csv"], ["decode", "c", "--out", "t.csv"]):
        done = imumon(*arguments, cwd=tmp_path)
        assert done.returncode == 4
        assert "was changed after the import: it has 100 rows, and 50 were imported" in done.stderr


def test_a_bag_has_the_times_and_is_reported_to_hold_only_what_it_holds(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    done = imumon("export", made / "a", "--to", "mcap", "--columns", "gyro_x", "--out", out)
    assert done.returncode == 2
    assert "of its columns alone no message can be made" in done.stderr
    assert not list(tmp_path.iterdir())
    answer("export", made / "a", "--to", "mcap", "--columns", "gyro_x,gyro_y,gyro_z", "--out", out)
    assert out.stat().st_size > 10_000  # 100 messages of 300 bytes
    asked = tmp_path / "run.parquet"
    answer("export", made / "a", "--to", "parquet", "--columns", "gyro_x", "--out", asked)
    assert [*read_columns(asked)] == ["gyro_x"]


def test_a_simulation_that_meets_a_full_disk_leaves_nothing_and_can_be_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "new" / "s"
    with monkeypatch.context() as patched:
        patched.setattr(WireWriter, "flush", full)
        done = imumon("simulate", "bench", "--out", out, "--duration", 1)
    assert done.returncode == 2
    assert f"imumon: {out}: No space left on device\nmake room" in done.stderr
    assert not list(tmp_path.iterdir())
    answer("simulate", "bench", "--out", out, "--duration", 1)


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".mcap", ".html"])
def test_a_full_disk_is_reported_of_the_file_that_was_given(
    made: Path, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / f"run{suffix}"
    out.write_text("old")
    monkeypatch.setattr("imumon.recordings.exports.convert", full)
    monkeypatch.setattr(os, "fsync", full)
    what = ["report", made / "c"] if suffix == ".html" else ["decode", made / "a"]
    done = imumon(*what, "--out", out)
    assert done.returncode == 2
    assert f"imumon: {out}: No space left on device\nmake room" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert out.read_text() == "old"


def test_a_report_of_what_is_not_there_reports_it(tmp_path: Path) -> None:
    done = imumon("report", "NOPE", "--out", "r.html", cwd=tmp_path)
    assert done.returncode == 4
    assert "NOPE is neither a session nor one unit of which there are sessions in sessions" in done.stderr
