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
    again.forget_failures()
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
    results.close()
    assert not [*(tmp_path / ROWS).iterdir()]


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
