"""A table from elsewhere becomes a session: every row goes in, or is counted, or nothing is made."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.clock.checks import Intervals
from imumon.columns import KNOWN, Column
from imumon.config import parse_yaml
from imumon.errors import bad_config, bad_data
from imumon.files import read_text
from imumon.intake import LEAST_S, SpecificForce, rate_doubts

from . import folder
from .foreign import EPOCH, BadRow, Part, read_foreign
from .map import TableMap
from .table import TableWriter

LEAST_WRAP = 64
"""A time that goes back by less than this part of its wrap has not wrapped: rows are out of order."""
LISTED = 10
"""Bad rows that an error or a report lists; the others are counted."""

_CSV = 'csv: {delimiter: ";", decimal: ",", comment: "#", skip_rows: 1}'
_LAYOUT = f"; add what fits to the map: {_CSV}; without a line of names: header: false, columns: [NAME, ...]"
_OTHERS = ", or bad_rows: drop to import the others"
_BAD_ROWS = f"mend the table, or add to the map its layout, as {_CSV}{_OTHERS}"
_BAD_TIMES = f'mend the unit or the format of time in the map, as format: "%d.%m.%Y %H:%M:%S.%f"{_OTHERS}'
_NOT_AFTER = (
    "if the device started anew there, add backwards: segment to time in the map; if times of day pass"
    " midnight, wraps_at: 86400 (s; in the unit of the time); if the clock is too coarse, give rate_hz: ..."
    " in place of time; where daylight saving ended, write UTC, or the zone (+01:00)"
)
_NO_RATE = "the times are too coarse for a rate; if no row is lost, give rate_hz: ... in place of time"


@dataclass(frozen=True)
class ImportReport:
    """What became of a table: rows_out + rows_dropped = rows_in."""

    rows_in: int
    rows_out: int
    rows_dropped: int
    columns: tuple[str, ...]  # columns of the session
    columns_unused: tuple[str, ...]  # columns of the table that the map does not name
    segments: int
    span_s: float  # time from the first to the last row, summed over the segments
    gaps_s: float  # sum of the intervals of more than 1 s and ten usual ones
    rate_hz: float  # as the map gives it, else rows per second where none is missing; NaN without a span
    bad_rows: tuple[BadRow, ...]  # the first rows that were dropped
    warnings: tuple[str, ...]  # what cannot be known of the times of the rows


def import_table(
    table: Path, map_path: Path, out: Path, made_of: Path | None = None, rows_dropped: int = 0
) -> ImportReport:
    """Make a session of a CSV or Parquet table; on any error nothing is left behind.

    Raises BAD_CONFIG for a wrong map or a column that the table lacks, with the file of the map;
    BAD_DATA for a table that cannot be read, rows that cannot be taken, or times that do not increase; EXISTS
    when the output is there already; OSError when the session cannot be written.

    `made_of`: where the table is only a step on the way: the file that it was made of.
    `rows_dropped`: how many rows of that file are not in the table.
    """
    with folder.whole_session(out) as partial:
        source = TableImport(table, map_path, rows_dropped)
        with TableWriter(partial / folder.SAMPLES_NAME, source.columns) as writer:
            for block in source.blocks():
                writer.write(block)
        report = source.report()
        now_ns, file = time.time_ns(), made_of or table
        span_ns = round(report.span_s * 1e9)
        begun = folder.SessionMetadata.begun(
            "import",
            now_ns,
            device="import",
            axes=source.map.axes,
            table=folder.TableUsed(
                file=file.name,
                size_bytes=file.stat().st_size,
                sha256=folder.fingerprint(file),
                map_yaml=source.map_text,
                rows_in=report.rows_in,
                rows_out=report.rows_out,
                rows_dropped=report.rows_dropped,
            ),
            counters={"samples": report.rows_out, "segments": report.segments, folder.SPAN: span_ns},
        )
        folder.Session(partial, begun).save(begun.closed(now_ns))
    return report


class TableImport:
    """The rows of a table from elsewhere as samples, read once; arguments, errors as of `import_table`."""

    def __init__(self, table: Path, map_path: Path, rows_dropped: int = 0) -> None:
        self.table = table
        self.map_text = read_text(map_path, hint="a map is a YAML file: imumon import --help has an example")
        self.map = parse_yaml(self.map_text, TableMap, str(map_path))
        self._names, self._parts = read_foreign(table, self.map)
        if absent := [name for name in self.map.columns() if name not in self._names]:
            layout = "" if len(absent) < len(self.map.columns()) else _LAYOUT
            if any("\ufffd" in name for name in self._names):
                layout += "; \ufffd is in place of what is not UTF-8: convert the table to UTF-8"
            raise bad_config(
                f"{map_path}: {table} has no column {', '.join(map(repr, absent))}",
                f"it has: {', '.join(map(repr, self._names))}{layout}",
            )
        self.columns = {name: KNOWN[name] for name in ("device_time_ns", "segment")}
        """Columns of the samples with their units, in canonical order."""
        for one in self.map.sources():
            column = KNOWN.get(one.target) or Column(one.target, "")
            self.columns[one.target] = replace(column, unit=one.unit.target)
        self._intervals, self._segment, self._span_ns = Intervals(rounded=True), 0, 0
        self._force = SpecificForce()
        self._last_ns = self._last_line = np.empty(0, np.int64)  # time and line of the last row, once there
        self._wrap_ns = None if self.map.time is None else self.map.time.wrap_ns
        self._counted = self._wraps = 0  # what its column of time holds, and how often that has wrapped
        self._rows_good, self._rows_bad = 0, rows_dropped
        self._listed: list[BadRow] = []

    def blocks(self) -> Iterator[SampleBlock]:
        """Yield the samples.

        Raises BAD_DATA for rows that cannot be taken, unless the map drops them, once all are counted; for
        times that do not increase; and when no row can be taken.
        """
        strict = self.map.bad_rows == "error"
        for part in self._parts:
            self._rows_good += len(part.index)
            self._rows_bad += len(part.bad)
            self._listed += part.bad[: LISTED - len(self._listed)]
            if len(part.index) and not (self._listed and strict):
                time_ns, segments = self._dated(part)
                columns: dict[str, ColumnArray] = {"device_time_ns": time_ns, "segment": segments}
                for source, values in zip(self.map.sources(), part.values, strict=True):
                    columns[source.target] = source.unit.convert(values)
                block = SampleBlock(columns)
                self._force.look(block)
                yield block
        if self._listed and strict:
            shown = [f"{self.table}:{row.line}: {row.why}: {row.text!r}" for row in self._listed]
            if self._rows_bad > len(shown):
                shown.append(f"... and {self._rows_bad - len(shown)} more")
            rows = self._rows_good + self._rows_bad
            seen = f"{self.table}: {self._rows_bad} of {rows} rows cannot be taken; nothing was imported"
            dates = all(row.why.startswith("time ") and {":", "%"} & {*row.why} for row in self._listed)
            raise bad_data("\n".join([seen, *shown]), _BAD_TIMES if dates else _BAD_ROWS)
        if not self._rows_good:
            what = f"none of its {self._rows_bad} rows can be taken" if self._rows_bad else "has no rows"
            raise bad_data(f"{self.table}: {what}")

    def report(self) -> ImportReport:
        """Return what became of the table, once its blocks were read."""
        inertial = self.map.gyro is not None or self.map.accel is not None
        rate_hz = self.map.rate_hz or self._intervals.rate_hz or math.nan
        doubts = [_NO_RATE] if self._rows_good > self._segment + 1 and math.isnan(rate_hz) else []
        doubts += [*(rate_doubts(rate_hz) if inertial else ()), *filter(None, [self._force.doubt(LEAST_S)])]
        used = {"", *self.map.columns()}
        return ImportReport(
            rows_in=self._rows_good + self._rows_bad,
            rows_out=self._rows_good,
            rows_dropped=self._rows_bad,
            columns=tuple(self.columns),
            columns_unused=tuple(name for name in self._names if name not in used),
            segments=self._segment + 1,
            span_s=self._span_ns * 1e-9,
            gaps_s=max(0.0, round(self._span_ns * 1e-9 - self._intervals.covered_s, 3)),
            rate_hz=rate_hz,
            bad_rows=tuple(self._listed),
            warnings=(*self.warnings(), *doubts),
        )

    def warnings(self) -> list[str]:
        """Return what cannot be known of the times of the rows."""
        if self._wrap_ns is None:
            return []
        wrap = f"{float(self._wrap_ns) * 1e-9:g} s"
        return [
            f"{self.table}: time wraps every {wrap}, and how often it did in a gap cannot be known: one"
            f" of {wrap} or longer comes out short by whole wraps"
        ]

    def _dated(self, part: Part) -> tuple[IntArray, IntArray]:
        """Return the times of rows in ns, and their segments.

        Raises BAD_DATA at the first time that does not increase, unless it goes back and that begins a
        segment, and for times beyond 64 bits.
        """
        try:
            times = self._times(part)
        except OverflowError:
            raise bad_data(
                f"{self.table}: its times are beyond the 292 years that a time in ns can hold",
                "check rate_hz, or wraps_at and the unit of time, in the map",
            ) from None
        time_ns, line = np.append(self._last_ns, times), np.append(self._last_line, part.line)
        steps = np.diff(time_ns)
        time = self.map.time
        wrong = steps <= 0 if time is None or time.backwards == "error" else steps == 0
        if wrong.any():
            at = int(np.argmax(wrong))
            before, after = (self._shown(int(ns)) for ns in time_ns[at : at + 2])
            what = f"time {after} is not after {before} of line {line[at]}"
            raise bad_data(f"{self.table}:{line[at + 1]}: {what}", _NOT_AFTER)
        segments = self._segment + np.cumsum(np.diff(time_ns, prepend=time_ns[:1]) < 0)[-len(times) :]
        self._span_ns += sum(steps[steps > 0].tolist())
        self._intervals.add(times, segments)
        self._last_ns, self._last_line = times[-1:], part.line[-1:]
        self._segment = int(segments[-1])
        return times, segments

    def _shown(self, time_ns: int) -> str:
        if self.map.time is None or self.map.time.format is None:
            return f"{time_ns * 1e-9:.9f} s"
        return repr((EPOCH + timedelta(microseconds=time_ns // 1000)).strftime(self.map.time.format))

    def _times(self, part: Part) -> IntArray:
        if part.time_ns is None:
            # Each is rounded by itself so that no error adds up; a row that was dropped keeps its time.
            period_ns = 10**9 / Fraction(str(self.map.rate_hz))
            return np.array([round(row * period_ns) for row in part.index.tolist()], np.int64)
        if self._wrap_ns is None:
            return part.time_ns
        steps = np.diff(part.time_ns, prepend=self._counted)
        wraps = self._wraps + np.cumsum(steps <= -float(self._wrap_ns) / LEAST_WRAP)
        self._counted, self._wraps = int(part.time_ns[-1]), int(wraps[-1])
        both = zip(part.time_ns.tolist(), wraps.tolist(), strict=True)
        return np.array([counted + round(count * self._wrap_ns) for counted, count in both], np.int64)
