from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.recordings import table
from imumon.recordings.table import TableWriter, iterate_table, read_table

SUFFIXES = [".parquet", ".csv"]


def block(start: int, stop: int, *names: str) -> SampleBlock:
    count = np.arange(start, stop)
    return SampleBlock(
        {
            "device_time_ns": count * 10_000_000,
            **{name: count.astype(KNOWN[name].dtype) / 1 if name != "status" else count for name in names},
        }
    )


def columns_equal(left: SampleBlock, right: SampleBlock) -> bool:
    return list(left.columns) == list(right.columns) and all(
        left[name].dtype == right[name].dtype and left[name].tobytes() == right[name].tobytes()
        for name in left.columns
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(
    floats=st.lists(st.floats(allow_nan=False), min_size=1, max_size=30),
    integers=st.lists(st.integers(-(2**63), 2**63 - 1), min_size=30, max_size=30),
    absent=st.sets(st.integers(0, 29)),
)
@settings(max_examples=40, deadline=None)
def test_every_number_is_read_back_as_it_was_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory,
    suffix: str,
    floats: list[float],
    integers: list[int],
    absent: set[int],
) -> None:
    path = tmp_path_factory.mktemp("table") / f"t{suffix}"
    values = np.array(floats)
    values[[index for index in absent if index < len(values)]] = np.nan
    written = SampleBlock(
        {"packet_counter": np.array(integers[: len(values)], np.int64), "gyro_x": values.copy()}
    )
    with TableWriter(path, KNOWN) as writer:
        writer.write(written)
    back, _ = read_table(path)
    assert columns_equal(back, written)


def test_csv_is_what_python_itself_writes_for_a_float(tmp_path: Path) -> None:
    values = [1.0, -0.0, 0.1, 1e22, 1e15, 1e16, 123456789.0, 5e-324, 1e-7, math.inf, 100000.0, math.nan]
    path = tmp_path / "t.csv"
    with TableWriter(path, KNOWN) as writer:
        counter = np.array([*range(11), NO_INT])
        writer.write(SampleBlock({"packet_counter": counter, "gyro_x": np.array(values)}))
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["packet_counter", "gyro_x"]
    assert [float(row[1]).hex() for row in rows[1:-1]] == [value.hex() for value in values[:-1]]
    assert all(set(row[1]) & set(".en") for row in rows[1:-1]), "a float must look like a float"
    assert rows[-1] == ["", ""]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("buffer_bytes", [1, 10**9])
def test_a_column_that_begins_late_has_no_value_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, buffer_bytes: int
) -> None:
    monkeypatch.setattr(table, "BUFFER_BYTES", buffer_bytes)
    path = tmp_path / f"t{suffix}"
    with TableWriter(path, KNOWN) as writer:
        writer.write(block(0, 5, "gyro_x"))
        writer.write(block(5, 9, "gyro_x", "latitude"))
        writer.write(block(9, 10, "status"))
    assert writer.rows == 10
    back, columns = read_table(path)
    assert list(columns) == ["device_time_ns", "gyro_x", "latitude", "status"]
    assert back["device_time_ns"].tolist() == (np.arange(10) * 10_000_000).tolist()
    assert back["latitude"][5:9].tolist() == [5, 6, 7, 8]
    assert np.isnan(back["latitude"][[0, 4, 9]]).all()
    assert back["status"].tolist() == [NO_INT] * 9 + [9]
    assert np.isnan(back["gyro_x"][9])
    expected = {path.name} | ({"t.units.yaml"} if suffix == ".csv" else set())
    assert {entry.name for entry in tmp_path.iterdir()} == expected


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_units_come_with_the_table(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    known = {**KNOWN, "mag_x": Column("mag_x", "1", description="field, arbitrary units")}
    with TableWriter(path, known) as writer:
        writer.write(block(0, 2, "gyro_x", "mag_x"))
    _, columns = read_table(path)
    assert columns["gyro_x"] == KNOWN["gyro_x"]
    assert columns["device_time_ns"] == KNOWN["device_time_ns"]
    assert columns["mag_x"] == known["mag_x"]
    if suffix == ".parquet":
        schema = pq.read_schema(path)
        assert schema.field("gyro_x").metadata[b"unit"] == b"rad/s"
        assert b"imumon" in schema.metadata
    else:
        told = yaml.safe_load((tmp_path / "t.units.yaml").read_text())
        assert told["columns"]["gyro_x"]["unit"] == "rad/s"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_error_leaves_the_old_table_and_nothing_else(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    path.write_text("old")
    with pytest.raises(ValueError, match="not announced"), TableWriter(path, KNOWN) as writer:  # noqa: PT012  # the first write is part of what fails
        writer.write(block(0, 5, "gyro_x"))
        writer.write(SampleBlock({"nonsense": np.zeros(3)}))
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_table_without_rows_has_its_columns(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    with TableWriter(path, {name: KNOWN[name] for name in ("device_time_ns", "gyro_x")}) as writer:
        writer.write(SampleBlock({}))
    back, columns = read_table(path)
    assert list(columns) == list(back.columns) == ["device_time_ns", "gyro_x"]
    assert len(back) == 0


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_a_table_is_read_in_blocks_of_any_size(
    tmp_path: Path, suffix: str, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "READ_ROWS", rows)
    path = tmp_path / f"t{suffix}"
    with TableWriter(path, KNOWN) as writer:
        writer.write(block(0, 50, "gyro_x"))
    blocks = list(iterate_table(path))
    assert max(len(part) for part in blocks) == min(rows, 50)
    assert np.concatenate([part["gyro_x"] for part in blocks]).tolist() == list(range(50))


@pytest.mark.parametrize("name", ["t.xlsx", "t", "none/t.csv"])
def test_an_output_that_cannot_be_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ImumonError) as caught:
        TableWriter(tmp_path / name, KNOWN)
    assert caught.value.reason is Reason.BAD_CONFIG


def test_a_table_that_cannot_be_read_is_bad_data(tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(b"PAR1 but no more")
    (tmp_path / "t.csv").write_text("gyro_x\n1.5\nnot a number\n")
    for name in ("t.parquet", "t.csv", "none.csv"):
        with pytest.raises(ImumonError, match="cannot be read") as caught:
            read_table(tmp_path / name)
        assert caught.value.reason is Reason.BAD_DATA


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_two_columns_of_one_name_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    if suffix == ".csv":
        path.write_text("gyro_x,gyro_y,gyro_x\n1.5,2.5,3.5\n")
    else:
        names = ["gyro_x", "gyro_y", "gyro_x"]
        pq.write_table(pa.Table.from_arrays([pa.array([1.5])] * 3, names=names), path)
    with pytest.raises(ImumonError, match="column 'gyro_x' is there more than once") as caught:
        read_table(path)
    assert caught.value.reason is Reason.BAD_DATA


def test_blocks_of_one_sample_do_not_pile_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "BUFFER_BYTES", 10_000)
    with TableWriter(tmp_path / "t.parquet", KNOWN) as writer:
        for index in range(100):
            writer.write(block(index, index + 1, "gyro_x"))
    assert pq.ParquetFile(tmp_path / "t.parquet").num_row_groups == 4
