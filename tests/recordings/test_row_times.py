"""Times of tables from elsewhere that wrap, and local times over a change of daylight saving."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.errors import ImumonError
from imumon.recordings import foreign
from imumon.recordings.importing import ImportReport, TableImport, import_table
from imumon.recordings.source import open_recording
from imumon.recordings.table import read_table

WRAPPING = "time: {column: t, unit: UNIT, wraps_at: AT}\npressure: {columns: [p], unit: Pa}\n"
DATES = "time: {column: t, unit: iso8601}\npressure: {columns: [p], unit: Pa}\n"
BERLIN = ZoneInfo("Europe/Berlin")
SPRING, AUTUMN = datetime(2026, 3, 29, 0, 50), datetime(2026, 10, 25, 0, 50)
"""Ten minutes before the clocks of Berlin are put forward and back, in UTC."""


def run(folder: Path, times: Sequence[object], map_text: str) -> tuple[ImportReport, list[int], list[int]]:
    """Return the report, the times in ns and the segments of a table with these times."""
    (folder / "map.yaml").write_text(map_text)
    (folder / "t.csv").write_text("t,p\n" + "".join(f"{time},1\n" for time in times))
    report = import_table(folder / "t.csv", folder / "map.yaml", folder / "session")
    samples, _ = read_table(folder / "session" / "samples.parquet")
    return report, samples["device_time_ns"].tolist(), samples["segment"].tolist()


@given(
    start=st.integers(0, 65535),
    steps=st.lists(st.integers(1, 64512), max_size=40),
    rows_per_part=st.integers(1, 15),
    broken=st.sets(st.integers(0, 40)),
)
@settings(max_examples=60, deadline=None)
def test_a_count_that_wraps_goes_on(
    tmp_path_factory: pytest.TempPathFactory,
    start: int,
    steps: list[int],
    rows_per_part: int,
    broken: set[int],
) -> None:
    true_ms = np.cumsum([start, *steps])
    kept = true_ms[:1].tolist()  # a bad row may not make a gap as long as a wrap
    said = [str(start)]
    for row, time in enumerate(true_ms[1:].tolist(), 1):
        bad = row in broken and row + 1 < len(true_ms) and true_ms[row + 1] - kept[-1] <= 64512
        said.append("oops" if bad else str(time % 65536))
        kept += [] if bad else [time]
    text = WRAPPING.replace("UNIT", "ms").replace("AT", "65536") + "bad_rows: drop\n"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(foreign, "ROWS_PER_PART", rows_per_part)
        report, times, segments = run(tmp_path_factory.mktemp("s"), said, text)
    assert times == [time * 10**6 for time in kept]
    assert set(segments) == {0}
    assert report.span_s == pytest.approx((kept[-1] - kept[0]) * 1e-3)


@given(st.integers(1, 400), st.sampled_from([("s/32768", 1000), ("s/30", 7), ("us/3", 0.1)]))
@settings(max_examples=30, deadline=None)
def test_wraps_of_a_fraction_of_a_nanosecond_do_not_add_up(
    tmp_path_factory: pytest.TempPathFactory, rows: int, clock: tuple[str, float]
) -> None:
    unit, wraps_at = clock
    text = WRAPPING.replace("UNIT", unit).replace("AT", str(wraps_at))
    wrap = Fraction(str(wraps_at))
    counts = [wrap * row * Fraction(7, 10) for row in range(rows)]
    report, times, _ = run(
        tmp_path_factory.mktemp("s"), [f"{float(count % wrap):.12f}" for count in counts], text
    )
    unit_ns = {"s/32768": Fraction(10**9, 32768), "s/30": Fraction(10**9, 30), "us/3": Fraction(1000, 3)}[
        unit
    ]
    assert report.rows_out == rows
    assert max(abs(time - count * unit_ns) for time, count in zip(times, counts, strict=True)) <= 1


def test_what_a_gap_may_hide_is_reported_once(tmp_path: Path) -> None:
    text = WRAPPING.replace("UNIT", "ms").replace("AT", "65536")
    report, times, _ = run(tmp_path, [65000, 65500, 464, 30464, 30964], text)
    assert times[-1] == 96_500 * 10**6
    (said,) = report.warnings
    assert "wraps every 65.536 s" in said
    assert "one of 65.536 s or longer comes out short by whole wraps" in said
    recording = open_recording(tmp_path / "t.csv", map_path=tmp_path / "map.yaml")
    assert sum(map(len, recording.blocks())) == 5
    assert recording.warnings() == [said]


def test_a_count_that_is_not_below_its_wrap_is_a_bad_row(tmp_path: Path) -> None:
    text = WRAPPING.replace("UNIT", "ms").replace("AT", "65536")
    with pytest.raises(ImumonError) as caught:
        run(tmp_path, [1, 65536, -1], text)
    assert "t.csv:3: time '65536' is not from 0 to below 65536, where it wraps" in caught.value.seen
    assert "t.csv:4: time '-1' is not from 0" in caught.value.seen


@pytest.mark.parametrize("rows_per_part", [2, 20_000])
def test_rows_that_are_out_of_order_are_no_wrap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_part: int
) -> None:
    monkeypatch.setattr(foreign, "ROWS_PER_PART", rows_per_part)
    with pytest.raises(ImumonError, match=r"t.csv:5: time .* is not after .* of line 4"):
        run(tmp_path, [65000, 1000, 1200, 1100, 1300], WRAPPING.replace("UNIT", "ms").replace("AT", "65536"))


def test_a_count_that_stands_still_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match="is not after"):
        run(tmp_path, [1, 5, 5], WRAPPING.replace("UNIT", "ms").replace("AT", "10"))


def test_wraps_beyond_64_bits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match="292 years"):
        run(tmp_path, [5e8, 1, 5e8, 1, 5e8, 1] * 12, WRAPPING.replace("UNIT", "s").replace("AT", "1e9"))


@pytest.mark.parametrize(
    ("time", "why"),
    [
        ("unit: iso8601, wraps_at: 60", "dates do not wrap"),
        ("unit: ms, wraps_at: 60, backwards: segment", "a restart cannot be distinguished"),
        ("unit: ms, wraps_at: 0", "greater than 0"),
        ("unit: s, wraps_at: 1e10", "no time that 64 bits hold"),
        ("unit: ns, wraps_at: 0.5", "no time that 64 bits hold"),
    ],
)
def test_a_map_with_a_wrap_that_cannot_be_is_refused(tmp_path: Path, time: str, why: str) -> None:
    with pytest.raises(ImumonError, match=why):
        run(tmp_path, [0], f"time: {{column: t, {time}}}\npressure: {{columns: [p], unit: Pa}}\n")


@pytest.mark.parametrize(("step_s", "said"), [(20.0, 1), (2e-5, 1), (0.01, 0)])
def test_a_rate_of_no_inertial_sensor_is_reported(tmp_path: Path, step_s: float, said: int) -> None:
    table, map_path = tmp_path / "t.csv", tmp_path / "map.yaml"
    table.write_text("t,x,y,z\n" + "".join(f"{step_s * k:.6f},0.1,0.2,9.8\n" for k in range(50)))
    map_path.write_text("time: {column: t, unit: s}\naccel: {columns: [x, y, z], unit: m/s^2}\n")
    imported = TableImport(table, map_path)
    assert sum(len(block) for block in imported.blocks()) == 50
    report = imported.report()
    assert len(report.warnings) == said
    assert all("is the unit of the time right?" in text for text in report.warnings)


def test_local_time_that_is_put_back_is_refused_with_what_to_do(tmp_path: Path) -> None:
    times = [f"2026-10-25T02:59:{second}" for second in (58, 59)] + ["2026-10-25T02:00:00"]
    with pytest.raises(ImumonError, match=r"t.csv:4: time") as caught:
        run(tmp_path, times, DATES)
    assert "write UTC, or the zone (+01:00)" in caught.value.hint


def test_the_rate_is_that_of_the_rows_without_gaps_and_restarts(tmp_path: Path) -> None:
    times = [*range(0, 1000, 10), *range(60_000, 61_000, 10), *range(0, 1000, 10)]
    stamp = "time: {column: t, unit: ms, backwards: segment}\npressure: {columns: [p], unit: Pa}\n"
    report, _, _ = run(tmp_path, times, stamp)
    assert report.rate_hz == pytest.approx(100.0)
    assert report.span_s == pytest.approx(61.98)
