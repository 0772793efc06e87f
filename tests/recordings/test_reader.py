"""One reader: the same samples whether they were imported, read with a map, or written by imumon."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from imumon.blocks import SampleBlock, join
from imumon.columns import KNOWN
from imumon.errors import ImumonError, Reason
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.pipeline import Estimator
from imumon.protocols.device import DeviceFile
from imumon.recordings.importing import import_table
from imumon.recordings.source import Recording, no_stages, open_recording
from imumon.recordings.table import TableWriter

N = 500
MAP = "rate_hz: 10\naxes: FRD\ngyro: {columns: [gx, gy, gz], unit: rad/s}\n"


def rest(_: DeviceFile | None) -> list[Estimator]:
    return [RestDetector()]


@pytest.fixture
def table(tmp_path: Path) -> Path:
    values = np.random.default_rng(0).normal(size=(N, 3))
    np.savetxt(tmp_path / "t.csv", values, "%.17g", delimiter=",", header="gx,gy,gz", comments="")
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    return tmp_path / "t.csv"


def samples(recording: Recording) -> SampleBlock:
    return join(list(recording.blocks()))


def test_a_table_with_its_map_is_what_its_import_is(table: Path, tmp_path: Path) -> None:
    import_table(table, tmp_path / "map.yaml", tmp_path / "session")
    with_map = open_recording(table, map_path=tmp_path / "map.yaml")
    session = open_recording(tmp_path / "session")
    one, other = samples(with_map), samples(session)
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        np.testing.assert_array_equal(one[name], other[name])
    assert (with_map.source.axes, session.source.axes) == ("FRD", "FRD")
    assert session.source.truth.name == "samples.parquet"
    assert session.sha256() != with_map.sha256()


def test_stages_add_columns_but_not_those_that_a_table_has(table: Path, tmp_path: Path) -> None:
    judged = open_recording(table, rest, tmp_path / "map.yaml")
    block = samples(judged)
    assert "at_rest" in block
    written = tmp_path / "own.parquet"
    told = block.with_columns({"at_rest": np.arange(N) % 2})
    known = KNOWN | {column.name: column for column in RestDetector().columns}
    with TableWriter(written, known) as writer:
        writer.write(told)
    again = samples(open_recording(written, rest))
    np.testing.assert_array_equal(again["at_rest"], told["at_rest"])


def test_a_table_without_segment_is_one_segment(tmp_path: Path) -> None:
    block = SampleBlock({"device_time_ns": np.arange(N) * 10**7, "gyro_x": np.ones(N)})
    with TableWriter(tmp_path / "t.parquet", KNOWN) as writer:
        writer.write(block)
    assert not samples(open_recording(tmp_path / "t.parquet"))["segment"].any()


@pytest.mark.parametrize(
    ("name", "said"),
    [("none", "no such file or folder"), ("note.txt", "neither a session nor a table"), ("t.csv", "a map")],
)
def test_what_is_no_recording_is_refused(table: Path, name: str, said: str) -> None:
    table.with_name("note.txt").write_text("hello", encoding="utf-8")
    with pytest.raises(ImumonError, match=said) as caught:
        open_recording(table.with_name(name), no_stages)
    assert caught.value.reason is Reason.BAD_DATA


def test_times_as_floats_that_are_absent_cost_their_rows_only(tmp_path: Path) -> None:
    times = np.arange(N) * 1e7
    times[[0, 1, 300]] = np.nan
    table = pa.table(
        {
            "device_time_ns": times,
            "segment": np.where(np.arange(N) == 400, np.nan, 0.0),
            "gyro_x": np.arange(float(N)),
        }
    )
    pq.write_table(table, tmp_path / "t.parquet")
    recording = open_recording(tmp_path / "t.parquet")
    block = samples(recording)
    assert block["gyro_x"].tolist() == [row for row in range(N) if row not in (0, 1, 300, 400)]
    assert any("rows whose time does not go on (4 in all)" in text for text in recording.warnings())
