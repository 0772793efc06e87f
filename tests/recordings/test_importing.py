from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import SampleBlock, join
from imumon.errors import ImumonError, Reason
from imumon.recordings import foreign
from imumon.recordings.folder import open_session
from imumon.recordings.foreign import time_parser
from imumon.recordings.importing import ImportReport, import_table
from imumon.recordings.table import iterate_samples, iterate_table, read_columns
from tests.data_folder import measured

MAP = "time: {column: t, unit: s}\ngyro: {columns: [x, y, z], unit: deg/s}\naxes: FRD\n"
HEADER = "t,x,y,z,note\n"


def run(
    folder: Path, table: str | bytes, map_text: str = MAP, name: str = "t.csv"
) -> tuple[ImportReport, SampleBlock]:
    path, map_path, out = folder / name, folder / "map.yaml", folder / "session"
    path.write_bytes(table if isinstance(table, bytes) else table.encode())
    map_path.write_text(map_text)
    report = import_table(path, map_path, out)
    return report, join(list(iterate_samples(open_session(out))))


def refused(folder: Path, table: str | bytes, map_text: str = MAP, name: str = "t.csv") -> ImumonError:
    with pytest.raises(ImumonError) as caught:
        run(folder, table, map_text, name)
    assert {entry.name for entry in folder.iterdir()} == {name, "map.yaml"}, "something was left behind"
    return caught.value


def test_a_table_becomes_a_session_in_si_units(tmp_path: Path) -> None:
    report, samples = run(tmp_path, HEADER + "0.1,180,0,-90,a\n0.2,1,2,3,b\n")
    assert (report.rows_in, report.rows_out, report.rows_dropped) == (2, 2, 0)
    assert report.columns == ("device_time_ns", "segment", "gyro_x", "gyro_y", "gyro_z")
    assert report.columns_unused == ("note",)
    assert report.span_s == pytest.approx(0.1)
    assert report.rate_hz == pytest.approx(10)
    assert samples["device_time_ns"].tolist() == [100_000_000, 200_000_000]
    assert samples["segment"].tolist() == [0, 0]
    assert samples["gyro_x"][0] == pytest.approx(np.pi)
    session = open_session(tmp_path / "session")
    assert session.state == "closed"
    assert session.metadata.axes == "FRD"
    assert session.metadata.table is not None
    assert session.metadata.table.map_yaml == MAP
    assert (session.metadata.table.file, session.metadata.table.size_bytes) == ("t.csv", 41)


@given(
    rows=st.lists(
        st.tuples(*[st.floats(allow_nan=False, allow_infinity=False, width=32)] * 3), min_size=1, max_size=60
    ),
    rows_per_part=st.integers(1, 20),
    broken=st.sets(st.integers(0, 59)),
)
@settings(max_examples=30, deadline=None)
def test_rows_out_and_rows_dropped_make_rows_in_however_the_table_is_cut(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[tuple[float, float, float]],
    rows_per_part: int,
    broken: set[int],
) -> None:
    lines = [
        "oops" if index in broken else f"{index}," + ",".join(map(repr, row))
        for index, row in enumerate(rows)
    ]
    good = [(index, row) for index, row in enumerate(rows) if index not in broken]
    table = "t,x,y,z\n" + "\n".join(lines) + "\n"
    map_text = MAP.replace("deg/s", "rad/s") + "bad_rows: drop\n"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(foreign, "ROWS_PER_PART", rows_per_part)
        if not good:
            assert "none of its" in refused(tmp_path_factory.mktemp("s"), table, map_text).seen
            return
        report, samples = run(tmp_path_factory.mktemp("s"), table, map_text)
    assert (report.rows_in, report.rows_out) == (len(rows), len(good))
    assert report.rows_dropped == len(rows) - len(good)
    assert samples["device_time_ns"].tolist() == [index * 10**9 for index, _ in good]
    assert samples.gyro is not None
    assert samples.gyro.tolist() == [list(row) for _, row in good]


@given(st.integers(0, 2**62))
@settings(max_examples=200, deadline=None)
def test_decimal_text_is_time_to_the_nanosecond(time_ns: int) -> None:
    seconds, fraction = divmod(time_ns, 10**9)
    assert time_parser("s")(f"{seconds}.{fraction:09d}") == time_ns
    assert time_parser("ms")(f"{time_ns // 10**6}.{time_ns % 10**6:06d}") == time_ns
    assert time_parser("ns")(str(time_ns)) == time_ns


@given(st.datetimes(datetime(1700, 1, 1), datetime(2200, 1, 1), timezones=st.just(UTC)), st.integers(0, 999))
@settings(max_examples=100, deadline=None)
def test_dates_are_time_to_the_nanosecond(moment: datetime, nanoseconds: int) -> None:
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    expected = ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000 + nanoseconds
    text = f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond:06d}{nanoseconds:03d}".rjust(29, "0")
    assert [time_parser("iso8601")(text + zone) for zone in ("", "Z", "+00:00")] == [expected] * 3
    assert time_parser("iso8601")(text + "+02:00") == expected - 7200 * 10**9


@pytest.mark.parametrize(
    "text", ["", "nan", "inf", "1e999999999", "1e999990", "-1e30", "12:00", "1,5", "abc"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="time"):
        time_parser("s")(text)


def test_a_rate_gives_even_times_that_do_not_drift(tmp_path: Path) -> None:
    rows = 30_000
    table = "x,y,z\n" + "1,2,3\n" * rows
    _, samples = run(tmp_path, table, "rate_hz: 300\n" + MAP.partition("\n")[2])
    assert samples["device_time_ns"][[1, 2, 3, rows - 1]].tolist() == [
        3_333_333,
        6_666_667,
        10_000_000,
        99_996_666_667,
    ]


def test_times_that_are_too_coarse_for_a_rate_are_reported(tmp_path: Path) -> None:
    kept = np.random.default_rng(1).random(10_000) > 0.01
    rows = "".join(f"{int(row * 1.11):d},1,2,3,\n" for row in np.flatnonzero(kept))
    report, _ = run(tmp_path, HEADER + rows, MAP.replace("unit: s", "unit: ms"))
    assert np.isnan(report.rate_hz)
    assert "give rate_hz" in " ".join(report.warnings)


def test_empty_cells_are_nan(tmp_path: Path) -> None:
    _, samples = run(tmp_path, HEADER + "0.1,,NaN,null,\n0.2,1,2,3,\n")
    assert samples.gyro is not None
    assert np.isnan(samples.gyro[0]).all()
    assert not np.isnan(samples.gyro[1]).any()


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("0.5,1,2", "3 cells, expected 5"),
        ("0.5,1,2,3,a,0.6,1,2,3,b", "10 cells, expected 5"),
        ("0.5,1,2,0.3-0.4,a", "'0.3-0.4' is not a number"),
        ("0.5,1,2,1_0,a", "'1_0' is not a number"),
        ("0.5,1,b,c,a", "'b' is not a number"),
        ("0.5,1,inf,3,a", "'inf' is not a number"),
        ("0.5,1,1e999,3,a", "'1e999' is too large"),
        (",1,2,3,a", "time '' is not a number"),
        ("1_0,1,2,3,a", "time '1_0' is not a number"),
        ("\x00\xff,1,2,3,a", "time '\\x00ÿ' is not a number"),
    ],
)
def test_a_row_that_cannot_be_taken_is_named_with_its_line(tmp_path: Path, row: str, why: str) -> None:
    table = HEADER + "0.1,1,2,3,a\n\n" + row + "\n0.7,1,2,3,a\n"
    error = refused(tmp_path, table)
    assert error.reason is Reason.BAD_DATA
    assert "1 of 3 rows cannot be taken" in error.seen
    assert f"t.csv:4: {why}" in error.seen
    assert "bad_rows: drop" in error.hint


@pytest.mark.parametrize(
    ("time", "why"),
    [
        ('format: "%H:%M:%S.%f"', "not as '%H:%M:%S.%f'"),
        ("unit: iso8601", "not a date with time"),
        ("unit: s", "not a number"),
    ],
)
def test_a_time_in_another_form_gets_a_hint_about_the_time(tmp_path: Path, time: str, why: str) -> None:
    error = refused(tmp_path, HEADER + "12:00:01,1,2,3,a\n", MAP.replace("unit: s", time))
    assert f"time '12:00:01' is {why}" in error.seen
    assert "the unit or the format of time" in error.hint
    assert "csv:" not in error.hint


@pytest.mark.parametrize(
    ("first", "remedy"), [("sep=,", "skip_rows: 1"), ("# made by", 'comment: "#"'), ("a;b", 'decimal: ","')]
)
def test_a_table_whose_first_line_has_no_names_gets_the_layouts(
    tmp_path: Path, first: str, remedy: str
) -> None:
    table = f"{first}\nt,x,y,z\n0.1,1,2,3\n"
    hint = refused(tmp_path, table).hint
    assert remedy in hint
    assert "without a line of names: header: false" in hint
    run(tmp_path, table, MAP + "csv: {skip_rows: 1}\n")


def test_a_gap_is_reported_with_its_length(tmp_path: Path) -> None:
    def rows(first: int, last: int) -> str:
        return "".join(f"{row / 100},1,2,3,\n" for row in range(first, last))

    report, _ = run(tmp_path, HEADER + rows(0, 500) + rows(2499, 3000))
    assert report.gaps_s == pytest.approx(20.0, abs=1e-3)
    (tmp_path / "whole").mkdir()
    whole, _ = run(tmp_path / "whole", HEADER + rows(0, 3000))
    assert whole.gaps_s == 0.0


def test_an_error_lists_the_first_bad_rows_and_counts_all(tmp_path: Path) -> None:
    error = refused(tmp_path, HEADER + "0.1,1,2,3,a\n" + "oops\n" * 50_000)
    assert "50000 of 50001 rows" in error.seen
    assert "... and 49990 more" in error.seen
    assert len(error.seen.splitlines()) == 12


def test_dropped_rows_are_reported_and_stored(tmp_path: Path) -> None:
    report, samples = run(tmp_path, HEADER + "0.1,1,2,3,a\noops\n0.3,1,2,3,a\n", MAP + "bad_rows: drop\n")
    assert (report.rows_in, report.rows_out, report.rows_dropped) == (3, 2, 1)
    assert [(row.line, row.text) for row in report.bad_rows] == [(3, "oops")]
    assert samples["device_time_ns"].tolist() == [100_000_000, 300_000_000]
    table = open_session(tmp_path / "session").metadata.table
    assert table is not None
    assert (table.rows_in, table.rows_out, table.rows_dropped) == (3, 2, 1)


@pytest.mark.parametrize("rows_per_part", [1, 2, 100])
def test_times_that_do_not_increase_are_refused_with_their_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_part: int
) -> None:
    monkeypatch.setattr(foreign, "ROWS_PER_PART", rows_per_part)
    drop = MAP + "bad_rows: drop\n"
    error = refused(tmp_path, HEADER + "0.1,1,2,3,\n0.3,1,2,3,\n0.2,1,2,3,\n", drop)
    assert "t.csv:4: time 0.200000000 s is not after 0.300000000 s of line 3" in error.seen
    assert "backwards: segment" in error.hint
    error = refused(tmp_path, HEADER + "0.1,1,2,3,\n0.1,1,2,3,\n")
    assert "t.csv:3: time 0.100000000 s is not after 0.100000000 s of line 2" in error.seen
    assert "rate_hz" in error.hint


DAY = MAP.replace("unit: s}", 'format: "%H:%M:%S.%f"}')
NIGHT = HEADER + "23:59:59.990,1,2,3,\n00:00:00.010,1,2,3,\n00:00:00.030,1,2,3,\n"


def test_a_time_of_day_that_passes_midnight_is_quoted_or_wraps(tmp_path: Path) -> None:
    error = refused(tmp_path, NIGHT, DAY)
    assert "t.csv:3: time '00:00:00.010000' is not after '23:59:59.990000' of line 2" in error.seen
    assert "wraps_at: 86400" in error.hint
    _, samples = run(tmp_path, NIGHT, DAY.replace('f"}', 'f", wraps_at: 86400}'))
    assert (samples["device_time_ns"] / 1e7).tolist() == [8_639_999, 8_640_001, 8_640_003]


def test_a_whole_date_does_not_wrap(tmp_path: Path) -> None:
    dates = MAP.replace("unit: s}", 'format: "%d.%m.%Y %H:%M:%S", wraps_at: 86400}')
    assert "is not from 0 to below 86400" in str(
        refused(tmp_path, HEADER + "1.2.2026 23:59:59,1,2,3,\n", dates)
    )


def test_columns_without_a_name_are_not_listed(tmp_path: Path) -> None:
    report, _ = run(tmp_path, "t\tx\ty\tz\ta\t\n0.5\t1\t2\t3\t4\t\n", MAP + 'csv: {delimiter: "\\t"}')
    assert report.columns_unused == ("a",)


def test_a_header_that_is_not_utf_8_is_named(tmp_path: Path) -> None:
    error = refused(tmp_path, "t,x (°),y,z\n0.5,1,2,3\n".encode("latin-1"), MAP.replace("[x,", '["x (°)",'))
    assert "convert the table to UTF-8" in error.hint


@pytest.mark.parametrize("rows_per_part", [1, 2, 3, 100])
def test_a_time_that_goes_back_begins_a_segment_when_the_map_allows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_part: int
) -> None:
    monkeypatch.setattr(foreign, "ROWS_PER_PART", rows_per_part)
    table = HEADER + "".join(f"{time},1,2,3,\n" for time in (5, 6, 7, 1, 2, 0, 4))
    report, samples = run(tmp_path, table, MAP.replace("unit: s}", "unit: s, backwards: segment}"))
    assert samples["segment"].tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert report.segments == 3
    assert report.span_s == pytest.approx(2 + 1 + 4)
    assert open_session(tmp_path / "session").metadata.duration_s == pytest.approx(2 + 1 + 4)


@pytest.mark.parametrize(
    ("table", "extra"),
    [
        ("t;x;y;z\n0.5;1;2;3\n", 'csv: {delimiter: ";"}'),
        ("t\tx\ty\tz\n0.5\t1\t2\t3\n", 'csv: {delimiter: "\\t"}'),
        ("  t   x y z\n 0.5  1   2 3\n", "csv: {delimiter: whitespace}"),
        ("banner, banner\n\nt,x,y,z\n0.5,1,2,3\n", "csv: {skip_rows: 1}"),
        ("0.5,1,2,3\n", "csv: {header: false, columns: [t, x, y, z]}"),
        ('"t","x","y","z"\r\n"0.5","1","2","3"\r\n', ""),
        ("\ufefft, x, y, z\n0.5, 1, 2, 3", ""),
        ("# made by\nt,x,y,z\n# a, b\n0.5,1,2,3\n #,1,2,3\n", 'csv: {comment: "#"}'),
        ("t,x,y,z\n0.5,1,2,3,\n", ""),
        ("t,x,y,z,\n0.5,1,2,3,\n", ""),
        ('t,x,y,z\n0.5,"1",2,3,\n', ""),
        ("sep=;\nt;x;y;z\n0,5;1;2;3\n", 'csv: {delimiter: ";", decimal: ",", skip_rows: 1}'),
    ],
)
def test_text_comes_in_many_layouts(tmp_path: Path, table: str, extra: str) -> None:
    report, samples = run(tmp_path, table, MAP.replace("deg/s", "rad/s") + extra)
    assert (report.rows_in, report.rows_out) == (1, 1)
    assert samples["device_time_ns"].tolist() == [500_000_000]
    assert samples.gyro is not None
    assert samples.gyro.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("# a comment", "t.csv:3: 1 cells, expected 4: '# a comment'"),
        ("0.6,1,2,3,4", "t.csv:3: 5 cells, expected 4"),
        ("0.6,1,2,3,,", "t.csv:3: 6 cells, expected 4"),
    ],
)
def test_a_line_that_the_map_does_not_name_a_comment_is_a_row(tmp_path: Path, line: str, why: str) -> None:
    error = refused(tmp_path, f"t,x,y,z\n0.5,1,2,3\n{line}\n")
    assert why in error.seen
    assert 'comment: "#"' in error.hint


@pytest.mark.parametrize(
    ("date_format", "text"),
    [
        ("%d.%m.%Y %H:%M:%S.%f", "31.01.2026 12:00:01.123456"),
        ("%m/%d/%y %I:%M:%S,%f %p", "01/31/26 12:00:01,123456 PM"),
        ("%H:%M:%S.%f %d-%m-%Y", "12:00:01.123456 31-01-2026"),
        ("%Y%m%dT%H%M%S.%f%z", "20260131T130001.123456+0100"),
    ],
)
def test_dates_have_the_format_of_the_map(tmp_path: Path, date_format: str, text: str) -> None:
    dates = MAP.replace("unit: s", f'format: "{date_format}"')
    table = f"t;x;y;z\n{text};1,5;2;3\n"
    _, samples = run(tmp_path, table, dates + 'csv: {delimiter: ";", decimal: ","}')
    assert samples["gyro_x"].tolist() == pytest.approx([np.radians(1.5)])
    expected = int(datetime(2026, 1, 31, 12, 0, 1, tzinfo=UTC).timestamp()) * 10**9 + 123_456_000
    assert samples["device_time_ns"].tolist() == [expected]


def test_a_date_in_another_format_is_a_row_that_cannot_be_taken(tmp_path: Path) -> None:
    dates = MAP.replace("unit: s", 'format: "%d.%m.%Y %H:%M:%S.%f"')
    table = "t,x,y,z\n31.01.2026 12:00:01.5,1,2,3\n01/31/2026 12:00:02.5,1,2,3\n32.01.2026 12:00:03.5,1,2,3\n"
    error = refused(tmp_path, table, dates)
    assert "2 of 3 rows" in error.seen
    assert "t.csv:3: time '01/31/2026 12:00:02.5' is not as '%d.%m.%Y %H:%M:%S.%f'" in error.seen
    assert "t.csv:4: time '32.01.2026 12:00:03.5'" in error.seen


@pytest.mark.parametrize("date_format", ["%d.%m.%Y %Q", "%d.%m.%Y %H %H", "%"])
def test_a_format_that_python_does_not_know_is_refused_in_words(tmp_path: Path, date_format: str) -> None:
    dates = MAP.replace("unit: s", f'format: "{date_format}"')
    error = refused(tmp_path, HEADER + "31.01.2026 12:00:01.5,1,2,3,a\n", dates)
    assert "map.yaml:1: time.format: " in error.seen


def test_text_in_utf_16_is_read(tmp_path: Path) -> None:
    report, _ = run(tmp_path, (HEADER + "0.5,1,2,3,µ\n").encode("utf-16"))
    assert report.rows_out == 1


@pytest.mark.parametrize(
    ("time", "unit"),
    [
        (pa.array([0.505697, 1.011383]), "s"),
        (pa.array([505697, 1011383]), "us"),
        (pa.array([505697000, 1011383000], pa.timestamp("ns")), "iso8601"),
        (pa.array([505697, 1011383], pa.timestamp("us", "UTC")), "iso8601"),
        (pa.array(["0.505697", "1.011383"]), "s"),
    ],
)
def test_parquet_is_read_with_any_kind_of_time(tmp_path: Path, time: pa.Array, unit: str) -> None:
    table = pa.table(
        {"t": time, "x": pa.array([1, None]), "y": [1.5, 2.5], "z": pa.array([1, 2], pa.int16())}
    )
    pq.write_table(table, tmp_path / "in.parquet")
    content = (tmp_path / "in.parquet").read_bytes()
    _, samples = run(tmp_path, content, MAP.replace("unit: s", f"unit: {unit}"), "in.parquet")
    assert samples["device_time_ns"].tolist() == [505_697_000, 1_011_383_000]
    assert np.isnan(samples["gyro_x"][1])
    assert samples["gyro_z"].tolist() == pytest.approx([np.pi / 180, 2 * np.pi / 180])


def test_parquet_rows_that_cannot_be_taken_are_named(tmp_path: Path) -> None:
    table = pa.table({"t": [0.1, None, 0.3], "x": [1.0, 2.0, np.inf], "y": [1.0] * 3, "z": [1.0] * 3})
    pq.write_table(table, tmp_path / "t.parquet")
    error = refused(tmp_path, (tmp_path / "t.parquet").read_bytes(), name="t.parquet")
    assert "2 of 3 rows" in error.seen
    assert "t.parquet:2: time is absent" in error.seen
    assert "t.parquet:3: inf is too large" in error.seen


def test_a_column_that_the_table_lacks_is_named_with_the_map(tmp_path: Path) -> None:
    error = refused(tmp_path, "t,x,y\n0.5,1,2\n")
    assert error.reason is Reason.BAD_CONFIG
    assert "map.yaml: " in error.seen
    assert "t.csv has no column 'z'" in error.seen
    assert error.hint == "it has: 't', 'x', 'y'"  # the layout is right
    error = refused(tmp_path, "t;x;y;z\n0.5;1;2;3\n")
    assert 'csv: {delimiter: ";", ' in error.hint


@pytest.mark.parametrize(
    ("table", "seen"),
    [
        (b"", "is empty"),
        (b"\xfa\xff\x00\x01" * 100, "neither text nor Parquet"),
        (b"PAR1 and no more", "cannot be read"),
        (b"\n\n", "no line of column names"),
        (b"t,x,y,z,z\n0.5,1,2,3,4\n", "'z' is there more than once"),
        (b"t,x,y,z\n", "has no rows"),
    ],
)
def test_a_file_that_is_no_table_is_bad_data(tmp_path: Path, table: bytes, seen: str) -> None:
    error = refused(tmp_path, table)
    assert error.reason is Reason.BAD_DATA
    assert seen in error.seen


def test_an_existing_session_is_not_overwritten(tmp_path: Path) -> None:
    run(tmp_path, HEADER + "0.5,1,2,3,\n")
    with pytest.raises(ImumonError) as caught:
        run(tmp_path, HEADER + "0.5,1,2,3,\n")
    assert caught.value.reason is Reason.EXISTS


def test_the_chamber_cycle_is_imported_row_for_row(tmp_path: Path) -> None:
    folder = measured("chamber-cycle")
    report = import_table(folder / "cooling-heating.csv", folder / "map.yaml", tmp_path / "s")
    samples = join(list(iterate_samples(open_session(tmp_path / "s"))))
    plain = np.loadtxt(folder / "cooling-heating.csv", delimiter=",", skiprows=1)
    assert report.rows_in == report.rows_out == len(samples) == len(plain)
    assert samples["device_time_ns"].tolist() == np.rint(plain[:, 0] * 1e9).astype(int).tolist()
    assert samples.gyro is not None
    assert samples.accel is not None
    assert samples.temperature is not None
    read = np.hstack([samples.gyro, samples.accel, samples.temperature])
    assert read.tobytes() == np.ascontiguousarray(plain[:, 1:]).tobytes()


@pytest.mark.parametrize(
    ("name", "rows", "bad"), [("cold", 3258, [1, 9, 3258]), ("hot", 6537, [1, 2, 13, 6537])]
)
def test_a_terminal_log_with_faults_is_refused_until_the_map_drops_them(
    tmp_path: Path, name: str, rows: int, bad: list[int]
) -> None:
    map_path = tmp_path / "map.yaml"
    text = (
        "rate_hz: 100\naccel: {columns: [ax, ay, az], unit: g}\ngyro: {columns: [gx, gy, gz], unit: deg/s}\n"
        "temperature: {columns: [temp], unit: degC}\n"
        "csv: {header: false, columns: [temp, ax, ay, az, gx, gy, gz]}\n"
    )
    map_path.write_text(text)
    table = measured(f"two-levels/{name}.csv")
    with pytest.raises(ImumonError, match=f"{len(bad)} of {rows} rows") as caught:
        import_table(table, map_path, tmp_path / "s")
    assert "PuTTY log" in caught.value.seen
    map_path.write_text(text + "bad_rows: drop\n")
    report = import_table(table, map_path, tmp_path / "s")
    assert [row.line for row in report.bad_rows] == bad
    assert report.rows_out + report.rows_dropped == report.rows_in == rows
    samples = join(list(iterate_samples(open_session(tmp_path / "s"))))
    assert samples.temperature is not None
    expected = (13, 14) if name == "cold" else (46, 50)
    assert expected[0] < samples.temperature.mean() < expected[1]


def test_a_further_column_keeps_its_name_and_unit(tmp_path: Path) -> None:
    table, table_map = tmp_path / "log.csv", tmp_path / "map.yaml"
    rows = "\n".join(f"{i / 10},{i},{5 + i / 100}" for i in range(20))
    table.write_text(f"t,gx,bat\n{rows}\n")
    table_map.write_text(
        "time: {column: t, unit: s}\npressure: {columns: [gx], unit: hPa}\n"
        "other: {supply_voltage: {column: bat, unit: V}}\n"
    )
    import_table(table, table_map, tmp_path / "session")
    columns = read_columns(tmp_path / "session" / "samples.parquet")
    assert columns["supply_voltage"].unit == "V"
    (block,) = iterate_table(tmp_path / "session" / "samples.parquet")
    assert block["supply_voltage"][-1] == 5.19


@pytest.mark.parametrize(("unit", "reported"), [("g", False), ("m/s^2", True)])
def test_a_force_that_is_not_gravity_is_reported_with_its_unit(
    tmp_path: Path, unit: str, reported: bool
) -> None:
    table = "t,x,y,z\n" + "".join(f"{second},0,0.01,1\n" for second in range(300)) + "301,0,0,1e300\n"
    text = f"time: {{column: t, unit: s}}\naccel: {{columns: [x, y, z], unit: {unit}}}\n"
    report, _ = run(tmp_path, table, text)
    assert any("scale and unit right" in warning for warning in report.warnings) is reported


def test_decimal_commas(tmp_path: Path) -> None:
    table = (HEADER + "0.1,180,0,-90,a\n0.2,1,2.5,3,b\n").replace(",", ";").replace(".", ",")
    error = refused(tmp_path, table, 'csv: {delimiter: ";"}\n' + MAP)
    assert 'decimal: ","' in error.hint
    german, plain = tmp_path / "german", tmp_path / "plain"
    german.mkdir()
    plain.mkdir()
    _, samples = run(german, table, 'csv: {delimiter: ";", decimal: ","}\n' + MAP)
    _, expected = run(plain, HEADER + "0.1,180,0,-90,a\n0.2,1,2.5,3,b\n")
    for name, values in expected.columns.items():
        np.testing.assert_array_equal(samples[name], values)


def test_a_rate_too_slow_for_64_bits_is_refused(tmp_path: Path) -> None:
    error = refused(tmp_path, HEADER + "0,1,2,3,a\n" * 2, "rate_hz: 1e-12\n" + MAP.partition("\n")[2])
    assert "292 years" in error.seen


def test_a_pipe_is_refused_before_a_row_is_lost(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "t.csv")
    (tmp_path / "map.yaml").write_text(MAP)
    with pytest.raises(ImumonError, match="is no file") as caught:
        import_table(tmp_path / "t.csv", tmp_path / "map.yaml", tmp_path / "session")
    assert (caught.value.reason, caught.value.hint) == (
        Reason.BAD_DATA,
        "write the table to a file first",
    )


@pytest.mark.parametrize(
    "time",
    [pa.array([{"s": 1}, {"s": 2}]), pa.array([[1], [2]]), pa.array([b"\xff\xfe", b"\xfd"], pa.binary())],
)
def test_a_time_of_another_kind_is_bad_data(tmp_path: Path, time: pa.Array) -> None:
    pq.write_table(pa.table({"t": time, "x": [1, 2], "y": [1, 2], "z": [1, 2]}), tmp_path / "t.parquet")
    error = refused(tmp_path, (tmp_path / "t.parquet").read_bytes(), name="t.parquet")
    assert error.reason is Reason.BAD_DATA
    assert "t.parquet" in error.seen
