"""A table from elsewhere becomes a session: every row goes in, or is counted, or nothing is made."""

from __future__ import annotations

import hashlib
import math
import os
import shutil
import time
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
import yaml

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.config import parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.recordings.folder import SAMPLES_NAME, Session, refuse_existing
from imumon.recordings.foreign import BadRow, Part, read_foreign
from imumon.recordings.map import TableMap
from imumon.recordings.metadata import SessionMetadata, TableUsed, iso_utc, versions_in_use
from imumon.recordings.table import TableWriter

LISTED = 10
"""Bad rows that an error or a report lists; the others are counted."""


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What became of a table: rows_out + rows_dropped = rows_in."""

    rows_in: int
    rows_out: int
    rows_dropped: int
    columns: tuple[str, ...]
    """Columns of the session."""
    columns_unused: tuple[str, ...]
    """Columns of the table that the map does not name."""
    segments: int
    span_s: float
    """Time from the first to the last row, summed over the segments."""
    rate_hz: float
    """Rate that the map gives, else the mean; NaN when there is no span."""
    bad_rows: tuple[BadRow, ...]
    """The first rows that were dropped."""


def import_table(table: Path, map_path: Path, out: Path) -> ImportReport:
    """Make a session of a CSV or Parquet table; on any error nothing is left behind.

    Raises
    ------
    ImumonError
        BAD_CONFIG for a wrong map or a column that the table lacks, with file and line of the map; BAD_DATA
        for a table that cannot be read, rows that cannot be taken, or times that do not increase; EXISTS when
        the output is there already.
    """
    map_text = _read_map(map_path)
    table_map = parse_yaml(map_text, TableMap, str(map_path))
    refuse_existing(out)
    if not out.name:
        raise ImumonError(Reason.EXISTS, f"{out} is there already", "give the name of a new folder")
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        partial.mkdir(parents=True)
        report = _write_samples(table, table_map, map_path, map_text, partial / SAMPLES_NAME)
        metadata = _metadata(table, table_map, map_text, report)
        Session(partial, metadata).save(metadata)
        partial.rename(out)
    except OSError as error:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"the session {out} cannot be made: {error.strerror or error}",
            "give another folder",
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return report


@dataclass(slots=True)
class _Clock:
    """Times of the rows so far: checks that they increase, counts segments, sums the span."""

    table: Path
    segments_allowed: bool
    segment: int = 0
    span_ns: int = 0
    last: tuple[int, int] | None = None

    def segments_of(self, time_ns: IntArray, line: IntArray) -> IntArray:
        """Return the segment of each row.

        Raises
        ------
        ImumonError
            BAD_DATA at the first time that does not increase, unless it goes back and that begins a segment.
        """
        if not len(time_ns):
            return time_ns
        first = [] if self.last is None else [self.last]
        times = np.concatenate([np.array([last for last, _ in first], np.int64), time_ns])
        lines = np.concatenate([np.array([number for _, number in first], np.int64), line])
        back = times[1:] < times[:-1]
        wrong = np.flatnonzero((times[1:] == times[:-1]) | (back & (not self.segments_allowed)))
        if len(wrong):
            at = int(wrong[0])
            self._refuse(times, lines, at)
        segments = self.segment + np.concatenate([np.zeros(1 - len(first), np.int64), np.cumsum(back)])
        self.span_ns += sum((times[1:] - times[:-1])[~back].tolist())
        self.last = int(times[-1]), int(lines[-1])
        self.segment = int(segments[-1])
        return segments

    def _refuse(self, times: IntArray, lines: IntArray, at: int) -> None:
        before, after = times[at] * 1e-9, times[at + 1] * 1e-9
        same = times[at] == times[at + 1]
        hint = (
            "if the rows are evenly spaced, give rate_hz: ... in place of time"
            if same
            else "if the device or the log started anew there, add backwards: segment to time in the map"
        )
        verb = "is the same as" if same else "is before"
        raise ImumonError(
            Reason.BAD_DATA,
            f"{self.table}:{lines[at + 1]}: time {after:.9f} s {verb} {before:.9f} s of line {lines[at]}",
            hint,
        )


@dataclass(slots=True)
class _Tally:
    """Rows counted, and the first bad ones."""

    rows_in: int = 0
    rows_bad: int = 0
    listed: list[BadRow] = field(default_factory=list)

    def add(self, part: Part) -> None:
        """Count the rows of a part."""
        self.rows_in += part.rows_in
        self.rows_bad += len(part.bad)
        self.listed += part.bad[: LISTED - len(self.listed)]


def _write_samples(
    table: Path, table_map: TableMap, map_path: Path, map_text: str, out: Path
) -> ImportReport:
    sources = table_map.sources()
    names = [source.column for source in sources]
    try:
        all_names, parts = read_foreign(table, names, table_map.time, table_map.csv)
    except ImumonError as error:
        raise _with_line_of_map(error, map_path, map_text) from error
    columns = _columns(table_map)
    tally = _Tally()
    clock = _Clock(table, table_map.time is not None and table_map.time.backwards == "segment")
    with TableWriter(out, columns) as writer:
        for part in parts:
            tally.add(part)
            if not (tally.rows_bad and table_map.bad_rows == "error"):  # then it is only counted on
                writer.write(_block(part, table_map, clock))
        if tally.rows_bad and table_map.bad_rows == "error":
            raise _bad_rows_error(table, tally)
        if not writer.rows:
            raise ImumonError(Reason.BAD_DATA, f"{table}: none of its {tally.rows_in} rows can be taken")
    span_s = clock.span_ns * 1e-9
    used = {*names, *([table_map.time.column] if table_map.time else [])}
    return ImportReport(
        rows_in=tally.rows_in,
        rows_out=writer.rows,
        rows_dropped=tally.rows_bad,
        columns=tuple(columns),
        columns_unused=tuple(name for name in all_names if name not in used),
        segments=clock.segment + 1,
        span_s=span_s,
        rate_hz=table_map.rate_hz or _mean_rate(writer.rows - clock.segment - 1, span_s),
        bad_rows=tuple(tally.listed),
    )


def _mean_rate(steps: int, span_s: float) -> float:
    return steps / span_s if span_s else math.nan


def _columns(table_map: TableMap) -> dict[str, Column]:
    """Return the columns of the session with their units, in canonical order."""
    sources = table_map.sources()
    arbitrary = {source.target for source in sources if source.unit.target == "1"}
    names = {"device_time_ns", "segment", *(source.target for source in sources)}
    return {
        name: Column(name, "1", column.dtype, column.description) if name in arbitrary else column
        for name, column in KNOWN.items()
        if name in names
    }


def _block(part: Part, table_map: TableMap, clock: _Clock) -> SampleBlock:
    time_ns = _even_times(part.index, table_map.rate_hz) if part.time_ns is None else part.time_ns
    columns: dict[str, ColumnArray] = {
        "device_time_ns": time_ns,
        "segment": clock.segments_of(time_ns, part.line),
    }
    for source, values in zip(table_map.sources(), part.values, strict=True):
        columns[source.target] = source.unit.convert(values)
    return SampleBlock(columns)


def _even_times(index: IntArray, rate_hz: float | None) -> IntArray:
    """Return the times of rows at an even rate, each rounded by itself so that no error adds up.

    A row that was dropped keeps its time: the rows after it are where they would be with it.
    """
    if rate_hz is None:
        raise ValueError("a map without time has a rate")
    period_ns = 10**9 / Fraction(str(rate_hz))
    return np.array([round(row * period_ns) for row in index.tolist()], np.int64)


def _bad_rows_error(table: Path, tally: _Tally) -> ImumonError:
    shown = [f"{table}:{row.line}: {row.why}: {row.text!r}" for row in tally.listed]
    if tally.rows_bad > len(shown):
        shown.append(f"... and {tally.rows_bad - len(shown)} more")
    seen = f"{table}: {tally.rows_bad} of {tally.rows_in} rows cannot be taken; nothing was imported\n"
    return ImumonError(
        Reason.BAD_DATA,
        seen + "\n".join(shown),
        "mend the table, pass over lines before the data with csv: {skip_rows: N},"
        " or add bad_rows: drop to the map to import the others",
    )


def _with_line_of_map(error: ImumonError, map_path: Path, map_text: str) -> ImumonError:
    """Add the line of the map to an error about columns that the table lacks."""
    if error.reason is not Reason.BAD_CONFIG:
        return error
    nodes = _scalars(yaml.compose(map_text, Loader=yaml.SafeLoader))
    line = next((node.start_mark.line + 1 for node in nodes if f" {node.value!r}" in error.seen), 1)
    return ImumonError(Reason.BAD_CONFIG, f"{map_path}:{line}: {error.seen}", error.hint)


def _scalars(node: yaml.Node | None) -> list[yaml.ScalarNode]:
    if isinstance(node, yaml.ScalarNode):
        return [node]
    if isinstance(node, yaml.MappingNode):
        return [scalar for _, value in node.value for scalar in _scalars(value)]
    return [scalar for value in node.value for scalar in _scalars(value)] if node else []


def _metadata(table: Path, table_map: TableMap, map_text: str, report: ImportReport) -> SessionMetadata:
    now_ns = time.time_ns()
    with table.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return SessionMetadata(
        source="import",
        state="closed",
        created=iso_utc(now_ns),
        created_ns=now_ns,
        ended=iso_utc(now_ns),
        ended_ns=now_ns,
        device="import",
        axes=table_map.axes,
        table=TableUsed(
            file=table.name,
            size_bytes=table.stat().st_size,
            sha256=digest,
            map_yaml=map_text,
            rows_in=report.rows_in,
            rows_out=report.rows_out,
            rows_dropped=report.rows_dropped,
        ),
        versions=versions_in_use(),
        counters={"samples": report.rows_out, "segments": report.segments},
    )


def _read_map(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: is not UTF-8 text (byte {error.start})") from error
