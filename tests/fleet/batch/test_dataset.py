from __future__ import annotations

from pathlib import Path

import duckdb
import polars as pl
import pytest

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.fleet.batch.dataset import RESULTS, ROWS, BatchOptions, Dataset
from imumon.fleet.batch.tasks import Channels, failure

ALLAN = BatchOptions(command="allan")


def row(session: str, channel: str) -> dict[str, object]:
    return {"session": session, "channel": channel, "angle_random_walk": 1e-3}


def test_what_was_written_is_there_again(tmp_path: Path) -> None:
    first = Dataset(tmp_path / "out", ALLAN)
    first.add([row("a", "gyro_x"), row("a", "gyro_y")])
    first.write()
    first.add([failure("b", "bad data", "too short")])
    first.close()
    again = Dataset(tmp_path / "out", ALLAN)
    assert set(again.done()) == {"a", "b"}
    assert (again.done()["b"]["reason"], again.done()["b"]["error"]) == ("bad data", "too short")
    assert len(again.parts) == 2
    assert again.left({"a": None, "b": None, "c": None}, retry=False) == ["c"]
    assert again.left({"b": None}, retry=True) == ["b"]
    assert set(again.done()) == {"a"}
    again.add([row("b", "gyro_x")])
    again.close()
    names = f"{tmp_path}/out/{ROWS}/*.parquet"
    found = duckdb.sql(f"select session, count(*) from '{names}' group by all order by all")
    assert found is not None
    assert found.fetchall() == [("a", 2), ("b", 1)]
    assert pl.read_parquet(names)["angle_random_walk"].to_list() == [1e-3] * 3


def test_what_was_not_whole_is_no_part(tmp_path: Path) -> None:
    Dataset(tmp_path, ALLAN).close()
    (tmp_path / ROWS / "part-000001.parquet.partial").write_bytes(b"PAR1")
    results = Dataset(tmp_path, ALLAN)
    assert results.parts == []
    results.add([row("a", "gyro_x")])
    results.close()
    assert [path.name for path in (tmp_path / ROWS).iterdir()] == ["part-000001.parquet"]


def test_two_programs_do_not_add_to_one_folder(tmp_path: Path) -> None:
    first = Dataset(tmp_path, ALLAN)
    with pytest.raises(ImumonError) as caught:
        Dataset(tmp_path, ALLAN)
    assert caught.value.reason is Reason.BUSY
    first.close()
    Dataset(tmp_path, ALLAN).close()


def test_another_command_needs_another_folder(tmp_path: Path) -> None:
    Dataset(tmp_path, ALLAN).close()
    with pytest.raises(ImumonError, match=r"batch\.yaml"):
        Dataset(tmp_path, BatchOptions(command="decode"))
    Dataset(tmp_path, ALLAN).close()


def test_every_command_has_its_columns() -> None:
    assert set(RESULTS) == {"decode", "replay", "allan", "calibrate", "diagnose"}


def test_rows_have_the_moment_at_which_a_session_began_to_the_nanosecond(tmp_path: Path) -> None:
    begun = 1_767_225_600_123_456_789
    results = Dataset(tmp_path, ALLAN)
    results.add([row("a", "gyro_x") | {"begun": begun}])
    results.write()
    assert results.done()["a"]["begun"] == begun
    assert [found["begun"] for found in results.rows(["a", "b"])["a"]] == [begun]
    assert results.rows([]) == {}
    results.close()


def test_ctrl_c_behind_the_writing_of_a_file_doubles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, replace = Dataset(tmp_path, ALLAN), Path.replace

    def interrupted(self: Path, target: Path) -> Path:
        monkeypatch.undo()
        replace(self, target)
        raise KeyboardInterrupt

    results.add([row("a", "gyro_x")])
    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        results.write()
    results.close()
    assert pl.read_parquet(f"{tmp_path}/{ROWS}/*.parquet")["session"].to_list() == ["a"]


def test_a_damaged_file_of_results_is_named_with_what_to_do(tmp_path: Path) -> None:
    results = Dataset(tmp_path, ALLAN)
    results.add([row("a", "gyro_x")])
    results.write()
    (part,) = results.parts
    part.write_bytes(part.read_bytes()[:-20])
    for use in (results.done, lambda: results.rows(["a"]), lambda: results.left({"a": None}, retry=False)):
        with pytest.raises(ImumonError, match="is damaged\nremove it") as caught:
            use()
        assert caught.value.reason is Reason.BAD_DATA
    results.close()


@pytest.mark.parametrize("cuts", [[], [1000], [1000, 1001], [1, 2, 1500]])
def test_hours_do_not_depend_on_the_division_into_blocks(cuts: list[int]) -> None:
    import numpy as np

    times = np.arange(1000) * 10_000_000
    times = np.concatenate([times, times + 3600 * 10**9])
    channels = Channels()
    for part in np.split(times, cuts):
        segment = np.zeros(len(part), np.int64)
        channels.add(SampleBlock({"device_time_ns": part, "segment": segment, "gyro_x": np.ones(len(part))}))
    (found,) = channels.rows()
    assert found["duration_s"] == pytest.approx(2 * 9.99)


def test_moments_of_parts_are_those_of_the_whole() -> None:
    import numpy as np

    values = 1e6 + np.random.default_rng(0).standard_normal(1000)
    values[::7] = np.nan
    channels = Channels()
    for part in np.split(values, [1, 2, 400, 400]):
        times = np.zeros(len(part), np.int64)
        channels.add(SampleBlock({"device_time_ns": times, "segment": times, "gyro_x": part}))
    known = values[np.isfinite(values)]
    (found,) = channels.rows()
    assert found["samples"] == len(known)
    assert found["mean"] == pytest.approx(known.mean(), rel=1e-14)
    assert found["sd"] == pytest.approx(known.std(ddof=1), rel=1e-9)
    assert (found["least"], found["greatest"]) == (known.min(), known.max())
