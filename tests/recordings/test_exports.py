"""The tables of a run: the main stream in one, each side stream in another beside it."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from imumon.blocks import SampleBlock
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Pipeline
from imumon.recordings.exports import export_run, side_path
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import read_table
from tests.protocols.wire import mtdata2_gnss, mtdata2_inertial


def _export(
    path: Path, data: bytes, out: Path, columns: list[str] | None = None
) -> tuple[int, dict[str, Path]]:
    path.write_bytes(data)
    source = open_source(path, "xsens")
    pipeline = Pipeline(source.device)
    made = export_run(run_over(source.items, pipeline), pipeline, source, out, columns)
    return made.rows, made.tables


def _stream(inertial: int, gnss: int) -> bytes:
    main = [mtdata2_inertial(k, 100 * k, 0.5) for k in range(inertial)]
    side = [mtdata2_gnss(None, 100 * k, 250 * k) for k in range(gnss)]
    return b"".join(main + side)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_each_stream_has_a_table_with_its_units(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"drive{suffix}"
    rows, tables = _export(tmp_path / "raw.bin", _stream(30, 4), out)
    assert rows == 30
    assert tables == {"imu": out, "gnss": tmp_path / f"drive.gnss{suffix}"}
    main, _ = read_table(out)
    gnss, columns = read_table(side_path(out, "gnss"))
    assert "gnss_latitude" not in main
    np.testing.assert_allclose(gnss["gnss_time_of_week"], [0.0, 0.25, 0.5, 0.75])
    assert columns["gnss_latitude"].unit == "deg"


def test_a_run_of_side_streams_alone_has_their_tables(tmp_path: Path) -> None:
    out = tmp_path / "drive.parquet"
    rows, tables = _export(tmp_path / "raw.bin", _stream(0, 4), out)
    assert rows == 0
    assert tables == {"gnss": tmp_path / "drive.gnss.parquet"}
    assert not out.exists()


def test_chosen_columns_are_those_of_the_main_table(tmp_path: Path) -> None:
    out = tmp_path / "drive.parquet"
    _, tables = _export(tmp_path / "raw.bin", _stream(30, 4), out, ["gyro_x"])
    assert tables == {"imu": out}
    with pytest.raises(ImumonError, match="no column gnss_latitude") as error:
        _export(tmp_path / "raw.bin", _stream(30, 4), out, ["gnss_latitude"])
    assert error.value.reason is Reason.BAD_CONFIG


def test_nothing_at_all_is_an_error_and_leaves_no_file(tmp_path: Path) -> None:
    out = tmp_path / "drive.parquet"
    with pytest.raises(ImumonError, match="no samples"):
        _export(tmp_path / "raw.bin", b"no packet", out)
    assert list(tmp_path.glob("drive*")) == []


def block(start: int, stop: int, *names: str) -> SampleBlock:
    count = np.arange(start, stop)
    floats = {name: count.astype(np.float64) for name in names}
    return SampleBlock({"device_time_ns": count * 10_000_000, **floats})


def export_blocks(
    blocks: Iterable[SampleBlock],
    out: Path,
    columns: list[str] | None,
    known: Callable[[], Iterable[Column]] = KNOWN.values,
) -> int:
    """Export blocks of a run whose columns are known as they come."""
    source: Any = SimpleNamespace(path=out, columns=lambda *_: [*known()])
    return export_run(blocks, Pipeline(None), source, out, columns).rows


def test_only_the_columns_that_were_requested_are_exported_in_that_order(tmp_path: Path) -> None:
    blocks = [block(0, 5, "gyro_x"), block(5, 9, "gyro_x", "latitude")]
    assert export_blocks(blocks, tmp_path / "t.csv", ["latitude", "device_time_ns"]) == 9
    assert (tmp_path / "t.csv").read_text().splitlines()[:2] == ["latitude,device_time_ns", ",0"]
    assert export_blocks(blocks, tmp_path / "u.csv", None) == 9
    assert (tmp_path / "u.csv").read_text().startswith("device_time_ns,gyro_x,latitude\n")


def test_rows_before_a_chosen_column_begins_are_there_without_it(tmp_path: Path) -> None:
    blocks = [block(0, 5, "gyro_x"), block(5, 9, "gyro_x", "latitude"), block(9, 11, "gyro_x", "latitude")]
    assert export_blocks(blocks, tmp_path / "t.parquet", ["latitude"]) == 11
    samples, _ = read_table(tmp_path / "t.parquet")
    np.testing.assert_array_equal(samples["latitude"], [*[np.nan] * 5, *range(5, 11)])


def test_a_column_that_becomes_known_late_stands_where_it_belongs(tmp_path: Path) -> None:
    blocks = [block(0, 5, "gyro_x"), block(5, 9, "gyro_x", "latitude")]
    came: list[SampleBlock] = []

    def known() -> list[Column]:
        names = {name for part in came for name in part.columns}
        return [KNOWN[name] for name in ("device_time_ns", "latitude", "gyro_x") if name in names]

    def stream() -> Iterator[SampleBlock]:
        for part in blocks:
            came.append(part)
            yield part

    for columns, header in (
        (["gyro_x", "latitude"], "gyro_x,latitude"),
        (None, "device_time_ns,latitude,gyro_x"),
    ):
        came.clear()
        export_blocks(stream(), tmp_path / "t.csv", columns, known)
        assert (tmp_path / "t.csv").read_text().splitlines()[0] == header


@pytest.mark.parametrize("name", ["gyro_y", "nonsense"])
def test_a_column_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path, name: str) -> None:
    with pytest.raises(ImumonError, match=f"no column {name}.*\n.*device_time_ns, gyro_x") as caught:
        export_blocks([block(0, 5, "gyro_x")], tmp_path / "t.csv", ["gyro_x", name])
    assert caught.value.reason is Reason.BAD_CONFIG
    assert not list(tmp_path.iterdir())


def test_no_samples_make_no_table(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match="no samples") as caught:
        export_blocks([], tmp_path / "t.csv", None)
    assert caught.value.reason is Reason.BAD_DATA
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_full_disk_is_named_and_leaves_the_old_table(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "Error writing bytes to file. Detail: ...")

    out = tmp_path / f"t{suffix}"
    out.write_text("old")
    block = SampleBlock({"gyro_x": np.zeros(3)})
    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        export_blocks([block], out, None, lambda: [KNOWN["gyro_x"]])
    assert caught.value.filename == str(out)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert out.read_text() == "old"
