"""Tables from elsewhere, text or Parquet, read as a stream: each row is taken whole or is named as bad."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.recordings.map import TIMESTAMPS, TextFormat, TimeColumn
from imumon.recordings.units import parse_unit

ROWS_PER_PART = 20_000
CONTROL_SHARE = 0.05
"""Text has a few control codes where a serial line was disturbed; a file with more of them is not text."""
SHOWN = 160
"""Characters of a bad row that are kept."""

ParseTime = Callable[[str], int]


@dataclass(frozen=True, slots=True)
class BadRow:
    """A row that cannot be taken: its line (text) or row (Parquet), from 1, why, and what it says."""

    line: int
    why: str
    text: str


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of a table as they come.

    Parameters
    ----------
    rows_in : int
        Rows in the table, good and bad; blank lines are none.
    index : array of shape (n,)
        Number of each good row among all rows, from 0.
    line : array of shape (n,)
        Line (text) or row (Parquet) of each good row, from 1.
    time_ns : array of shape (n,), or None when the table has no time
    values : array of shape (k, n)
        The columns of data that were asked for, in the units of the table; NaN where a cell is empty.
    bad : list of BadRow
    """

    rows_in: int
    index: IntArray
    line: IntArray
    time_ns: IntArray | None
    values: FloatArray
    bad: list[BadRow]


def read_foreign(
    path: Path, columns: Sequence[str], time: TimeColumn | None, text_format: TextFormat
) -> tuple[list[str], Iterator[Part]]:
    """Return the names of all columns of a table, and its rows as a stream of parts.

    Whether it is Parquet or text is decided by the content, not by the name.

    Raises
    ------
    ImumonError
        BAD_DATA when it cannot be read; BAD_CONFIG when it lacks a column, naming those that it has.
    """
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read: {error.strerror}") from error
    if not head:
        raise ImumonError(Reason.BAD_DATA, f"{path}: is empty")
    wanted = [*columns, *([time.column] if time is not None else [])]
    if head.startswith(b"PAR1"):
        names = _parquet_names(path)
        _check_columns(path, names, wanted)
        return names, _read_parquet(path, columns, time)
    encoding = _encoding(path, head)
    names, skip = _text_names(path, encoding, text_format)
    _check_columns(path, names, wanted)
    layout = _Layout(
        text_format.delimiter,
        len(names),
        tuple(names.index(name) for name in columns),
        None if time is None else names.index(time.column),
        _as_is if time is None else time_parser(time.unit),
    )
    return names, _read_text(path, encoding, skip, layout)


def time_parser(unit: str) -> ParseTime:
    """Return a function from the text of a time to integer nanoseconds, without rounding through floats.

    The function raises ValueError for text that is no time, or out of the range of int64.
    """
    if unit == TIMESTAMPS:
        return _parse_timestamp
    factor = parse_unit(unit, "ns").factor
    scale = Decimal(factor.numerator) / Decimal(factor.denominator)

    def parse(text: str) -> int:
        try:
            value = Decimal(text) * scale
        except InvalidOperation as error:
            raise ValueError(f"time {text.strip()!r} is not a number") from error
        except ArithmeticError as error:
            raise ValueError(f"time {text.strip()!r} is out of range") from error
        if not value.is_finite() or abs(value) >= 2**63:
            raise ValueError(f"time {text.strip()!r} is out of range")
        return int(value.to_integral_value())

    return parse


_TIMESTAMP = re.compile(
    r"\s*(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(Z|UTC|[+-]\d\d:?\d\d)?\s*", re.ASCII
)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone(timedelta(0)))


def _parse_timestamp(text: str) -> int:
    """Return Unix time in ns; a time without zone is UTC."""
    match = _TIMESTAMP.fullmatch(text)
    if match is None:
        raise ValueError(f"time {text.strip()!r} is not a date with time, as 2026-01-31T12:00:00.5Z")
    date, time, fraction, zone = match.groups()
    zone = "+00:00" if zone in (None, "Z", "UTC") else zone
    since = datetime.fromisoformat(f"{date}T{time}{zone}") - _EPOCH
    time_ns = (since.days * 86_400 + since.seconds) * 10**9 + int((fraction or "").ljust(9, "0"))
    if not abs(time_ns) < 2**63:
        raise ValueError(f"time {text.strip()!r} is out of range")
    return time_ns


def _as_is(text: str) -> int:
    return int(text)


def _check_columns(path: Path, names: Sequence[str], wanted: Sequence[str]) -> None:
    if absent := [name for name in wanted if name not in names]:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"{path}: has no column {', '.join(map(repr, absent))}",
            f"it has: {', '.join(map(repr, names))}",
        )
    if twice := [name for name in wanted if names.count(name) > 1]:
        raise ImumonError(
            Reason.BAD_DATA, f"{path}: column {', '.join(map(repr, twice))} is there more than once"
        )


# Text


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NO_VALUE = {"", "nan", "na", "n/a", "null", "none"}


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where in a line the cells are that are wanted."""

    delimiter: str
    width: int
    columns: tuple[int, ...]
    time: int | None
    parse_time: ParseTime

    def split(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if self.delimiter == "whitespace":
            return line.split()
        if '"' in line:
            return next(csv.reader([line], delimiter=self.delimiter))
        return line.split(self.delimiter)


@dataclass(slots=True)
class _Rows:
    """Good rows as they are parsed one by one."""

    index: list[int] = field(default_factory=list)
    line: list[int] = field(default_factory=list)
    time_ns: list[int] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)


def _encoding(path: Path, head: bytes) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    control = sum(byte < 0x20 and byte not in b"\t\n\r\f\x1b" for byte in head)
    if control > CONTROL_SHARE * len(head):
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: is neither text nor Parquet: {control} of its first {len(head)} bytes are controls",
            "a raw capture is decoded with: imumon decode FILE --device NAME",
        )
    return "utf-8-sig"


def _text_names(path: Path, encoding: str, text_format: TextFormat) -> tuple[list[str], int]:
    """Return the names of the columns, and how many lines there are before the data."""
    if text_format.columns is not None:
        return text_format.columns, text_format.skip_rows
    layout = _Layout(text_format.delimiter, 0, (), None, _as_is)
    with path.open(encoding=encoding, errors="replace") as file:
        for number, line in enumerate(islice(file, text_format.skip_rows, None), text_format.skip_rows + 1):
            if line.strip():
                return [name.strip() for name in layout.split(line.rstrip("\r\n"))], number
    raise ImumonError(Reason.BAD_DATA, f"{path}: has no line of column names")


def _read_text(path: Path, encoding: str, skip: int, layout: _Layout) -> Iterator[Part]:
    """Yield the rows of a text table; bytes that are not text become part of a bad row."""
    first_row = 0
    try:
        with path.open(encoding=encoding, errors="replace") as file:
            numbered = enumerate(islice(file, skip, None), skip + 1)
            while chunk := list(islice(numbered, ROWS_PER_PART)):
                rows = [(number, stripped) for number, line in chunk if (stripped := line.strip(" \r\n"))]
                part = _parse_at_once(rows, first_row, layout) or _parse_one_by_one(rows, first_row, layout)
                first_row += part.rows_in
                yield part
    except OSError as error:
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read: {error.strerror}") from error


def _parse_at_once(rows: list[tuple[int, str]], first_row: int, layout: _Layout) -> Part | None:
    """Parse rows that are all good and complete, ten times faster; None when they are not."""
    cells = [layout.split(line) for _, line in rows]
    if any(len(row) != layout.width for row in cells) or any("_" in line for _, line in rows):
        return None  # float() and Decimal() accept 1_000, which is no number in a table
    columns = list(zip(*cells, strict=True))
    try:
        values = np.array([list(map(float, columns[index])) for index in layout.columns], np.float64)
        times = None if layout.time is None else list(map(layout.parse_time, columns[layout.time]))
    except (ValueError, IndexError):
        return None
    if np.isinf(values).any():
        return None
    return Part(
        rows_in=len(rows),
        index=np.arange(first_row, first_row + len(rows), dtype=np.int64),
        line=np.array([number for number, _ in rows], np.int64),
        time_ns=None if times is None else np.array(times, np.int64),
        values=values,
        bad=[],
    )


def _parse_one_by_one(rows: list[tuple[int, str]], first_row: int, layout: _Layout) -> Part:
    good, bad = _Rows(), []
    for index, (number, line) in enumerate(rows, first_row):
        try:
            time_ns, values = _parse_row(line, layout)
        except (ValueError, csv.Error) as error:
            bad.append(BadRow(number, str(error), line[:SHOWN]))
            continue
        good.index.append(index)
        good.line.append(number)
        good.time_ns.append(time_ns)
        good.values.append(values)
    values_array = np.array(good.values, np.float64).reshape(-1, len(layout.columns)).T
    return Part(
        rows_in=len(rows),
        index=np.array(good.index, np.int64),
        line=np.array(good.line, np.int64),
        time_ns=None if layout.time is None else np.array(good.time_ns, np.int64),
        values=values_array,
        bad=bad,
    )


def _parse_row(line: str, layout: _Layout) -> tuple[int, list[float]]:
    cells = layout.split(line)
    if len(cells) != layout.width:
        raise ValueError(f"{len(cells)} cells, expected {layout.width}")
    time_ns = 0
    if layout.time is not None:
        text = cells[layout.time]
        if "_" in text or not text.strip():
            raise ValueError(f"time {text.strip()!r} is not a number")
        time_ns = layout.parse_time(text)
    return time_ns, [_parse_number(cells[index]) for index in layout.columns]


def _parse_number(cell: str) -> float:
    text = cell.strip()
    if text.lower() in _NO_VALUE:
        return math.nan
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"{text!r} is not a number")
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text!r} is too large")
    return value


# Parquet


def _parquet_names(path: Path) -> list[str]:
    try:
        return list(pq.read_schema(path).names)
    except (pa.ArrowException, OSError) as error:
        raise ImumonError(Reason.BAD_DATA, f"{path}: is damaged Parquet: {error}") from error


def _read_parquet(path: Path, columns: Sequence[str], time: TimeColumn | None) -> Iterator[Part]:
    """Yield the rows of a Parquet table; a row is bad when its time is absent or a value is infinite."""
    wanted = list(dict.fromkeys([*columns, *([time.column] if time is not None else [])]))
    first_row = 0
    try:
        with pq.ParquetFile(path, pre_buffer=False) as file:
            for batch in file.iter_batches(batch_size=ROWS_PER_PART, columns=wanted):
                part = _parse_batch(path, batch, columns, time, first_row)
                first_row += part.rows_in
                yield part
    except (pa.ArrowException, OSError) as error:
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read: {error}") from error


def _parse_batch(
    path: Path, batch: Any, columns: Sequence[str], time: TimeColumn | None, first_row: int
) -> Part:
    values = np.vstack([_numbers(path, name, batch.column(name)) for name in columns])
    good = ~np.isinf(values).any(axis=0)
    why = {int(row): "a value is infinite" for row in np.flatnonzero(~good)}
    time_ns = None
    if time is not None:
        times = _times(batch.column(time.column), time)
        why.update({row: text for row, text in enumerate(times) if isinstance(text, str)})
        good &= np.array([not isinstance(text, str) for text in times], bool)
        time_ns = np.array([value for row, value in enumerate(times) if good[row]], np.int64)
    rows = np.flatnonzero(good).astype(np.int64) + first_row
    bad = [
        BadRow(first_row + row + 1, why[row], str(batch.slice(row, 1).to_pylist()[0])[:SHOWN]) for row in why
    ]
    return Part(len(batch), rows, rows + 1, time_ns, values[:, good], sorted(bad, key=lambda row: row.line))


def _numbers(path: Path, name: str, column: Any) -> FloatArray:
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
        raise ImumonError(Reason.BAD_DATA, f"{path}: column {name!r} is {kind}, not a number")
    values = pc.cast(column, pa.float64(), safe=False).fill_null(math.nan)
    return np.asarray(values.to_numpy(zero_copy_only=False), np.float64)


def _times(column: Any, time: TimeColumn) -> list[int | str]:
    """Return the time of each row in ns, or what is wrong with it."""
    if pa.types.is_timestamp(column.type):
        if time.unit != TIMESTAMPS:
            return [f"time is a timestamp, so its unit is {TIMESTAMPS}, not {time.unit}"] * len(column)
        nanoseconds = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
        return ["time is absent" if value is None else value for value in nanoseconds.to_pylist()]
    parse = time_parser(time.unit)
    found: list[int | str] = []
    for value in column.to_pylist():
        try:
            found.append("time is absent" if value is None else parse(str(value)))
        except ValueError as error:
            found.append(str(error))
    return found
