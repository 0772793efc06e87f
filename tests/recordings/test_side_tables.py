"""The tables of a run: the main stream in one, each side stream in another beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.errors import ImumonError, Reason
from imumon.pipeline import Pipeline
from imumon.recordings.side_tables import export_run, side_path
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
