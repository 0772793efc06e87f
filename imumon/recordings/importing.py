"""A table from elsewhere becomes a session: every row goes in, or is counted, or nothing is made."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from imumon.blocks import ColumnArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.config import parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import read_text
from imumon.magnitudes import rate_doubts
from imumon.recordings.folder import SAMPLES_NAME, Session, fingerprint, whole_session
from imumon.recordings.foreign import BadRow, Part, read_foreign
from imumon.recordings.map import TableMap
from imumon.recordings.metadata import SPAN, SessionMetadata, TableUsed
from imumon.recordings.row_times import RowTimes
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
    """Rate that the map gives, else rows per second where none is missing; NaN when there is no span."""
    bad_rows: tuple[BadRow, ...]
    """The first rows that were dropped."""
    warnings: tuple[str, ...]
    """What cannot be known of the times of the rows."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What a table was made of, and how many rows of that are not in it."""

    path: Path
    rows_dropped: int


def import_table(table: Path, map_path: Path, out: Path, origin: Origin | None = None) -> ImportReport:
    """Make a session of a CSV or Parquet table; on any error nothing is left behind.

    Raises BAD_CONFIG for a wrong map or a column that the table lacks, with the file of the map;
    BAD_DATA for a table that cannot be read, rows that cannot be taken, or times that do not increase; EXISTS
    when the output is there already; OSError when the session cannot be written.

    Parameters
    ----------
    origin : Origin, optional
        Where the table is only a step on the way.
    """
    with whole_session(out) as partial:
        source = TableImport(table, map_path)
        with TableWriter(partial / SAMPLES_NAME, source.columns) as writer:
            for block in source.blocks():
                writer.write(block)
        report = source.report()
        if origin is not None:
            dropped = origin.rows_dropped
            report = replace(
                report, rows_in=report.rows_in + dropped, rows_dropped=report.rows_dropped + dropped
            )
        metadata = _metadata(source, report, table if origin is None else origin.path)
        Session(partial, metadata).save(metadata)
    return report


class TableImport:
    """The rows of a table from elsewhere as samples, read once, and what became of them.

    Raises BAD_CONFIG for a wrong map or a column that the table lacks, with the file of the map;
    BAD_DATA for a table that cannot be read.
    """

    def __init__(self, table: Path, map_path: Path) -> None:
        self.table = table
        self.map_text = read_text(map_path)
        self.map = parse_yaml(self.map_text, TableMap, str(map_path))
        names = [source.column for source in self.map.sources()]
        try:
            self._names, self._parts = read_foreign(table, names, self.map.time, self.map.csv)
        except ImumonError as error:
            where = f"{map_path}: " if error.reason is Reason.BAD_CONFIG else ""
            raise ImumonError(error.reason, f"{where}{error.seen}", error.hint) from error
        self.columns = _columns(self.map)
        """Columns of the samples with their units, in canonical order."""
        self._times = RowTimes(table, self.map)
        self._rows_in = self._rows_out = self._rows_bad = 0
        self._listed: list[BadRow] = []

    def blocks(self) -> Iterator[SampleBlock]:
        """Yield the samples.

        Raises BAD_DATA for rows that cannot be taken, unless the map drops them, once all are counted; for
        times that do not increase; and when no row can be taken.
        """
        strict = self.map.bad_rows == "error"
        for part in self._parts:
            self._rows_in += part.rows_in
            self._rows_bad += len(part.bad)
            self._listed += part.bad[: LISTED - len(self._listed)]
            if not (self._rows_bad and strict):
                self._rows_out += len(part.index)
                yield _block(part, self.map, self._times)
        if self._rows_bad and strict:
            raise self._bad_rows_error()
        if not self._rows_out:
            raise ImumonError(Reason.BAD_DATA, f"{self.table}: none of its {self._rows_in} rows can be taken")

    def report(self) -> ImportReport:
        """Return what became of the table, once its blocks were read."""
        span_s = self._times.span_ns * 1e-9
        inertial = self.map.gyro is not None or self.map.accel is not None
        rate_hz = self.map.rate_hz or self._times.intervals.rate_hz or math.nan
        used = {source.column for source in self.map.sources()}
        used |= {self.map.time.column} if self.map.time else set()
        return ImportReport(
            rows_in=self._rows_in,
            rows_out=self._rows_out,
            rows_dropped=self._rows_bad,
            columns=tuple(self.columns),
            columns_unused=tuple(name for name in self._names if name not in used),
            segments=self._times.segment + 1,
            span_s=span_s,
            rate_hz=rate_hz,
            bad_rows=tuple(self._listed),
            warnings=(*self.warnings(), *(rate_doubts(rate_hz) if inertial else ())),
        )

    def warnings(self) -> list[str]:
        """Return what cannot be known of the times of the rows, once the blocks were read."""
        return self._times.warnings()

    def _bad_rows_error(self) -> ImumonError:
        shown = [f"{self.table}:{row.line}: {row.why}: {row.text!r}" for row in self._listed]
        if self._rows_bad > len(shown):
            shown.append(f"... and {self._rows_bad - len(shown)} more")
        seen = f"{self.table}: {self._rows_bad} of {self._rows_in} rows cannot be taken; nothing was imported"
        return ImumonError(
            Reason.BAD_DATA,
            "\n".join([seen, *shown]),
            "mend the table, pass over lines before the data with csv: {skip_rows: N}"
            ' and comments with csv: {comment: "#"}, read decimal commas with csv: {decimal: ","},'
            " or add bad_rows: drop to the map to import the others",
        )


def _columns(table_map: TableMap) -> dict[str, Column]:
    """Return the columns of the session with their units, in canonical order."""
    columns = {name: KNOWN[name] for name in ("device_time_ns", "segment")}
    for source in table_map.sources():
        column = KNOWN.get(source.target) or Column(source.target, "")
        columns[source.target] = replace(column, unit=source.unit.target)
    return columns


def _block(part: Part, table_map: TableMap, times: RowTimes) -> SampleBlock:
    time_ns, segments = times.take(part)
    columns: dict[str, ColumnArray] = {"device_time_ns": time_ns, "segment": segments}
    for source, values in zip(table_map.sources(), part.values, strict=True):
        columns[source.target] = source.unit.convert(values)
    return SampleBlock(columns)


def _metadata(source: TableImport, report: ImportReport, file: Path) -> SessionMetadata:
    now_ns = time.time_ns()
    begun = SessionMetadata.begun(
        "import",
        now_ns,
        device="import",
        axes=source.map.axes,
        table=TableUsed(
            file=file.name,
            size_bytes=file.stat().st_size,
            sha256=fingerprint(file),
            map_yaml=source.map_text,
            rows_in=report.rows_in,
            rows_out=report.rows_out,
            rows_dropped=report.rows_dropped,
        ),
        counters={
            "samples": report.rows_out,
            "segments": report.segments,
            SPAN: round(report.span_s * 1e9),
        },
    )
    return begun.closed(now_ns)
