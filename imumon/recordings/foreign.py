"""Tables from elsewhere, text or Parquet, read as a stream: each row is taken whole or is named as bad."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.files import readable
from imumon.recordings.map import TIMESTAMPS, TextFormat, TimeColumn
from imumon.recordings.time_text import not_a_number, time_parser

ROWS_PER_PART = 20_000
CONTROL_SHARE = 0.05
"""Text has a few control codes where a serial line was disturbed; a file with more of them is not text."""
SHOWN = 160
"""Characters of a bad row that are kept."""


@dataclass(frozen=True, slots=True)
class BadRow:
    """A row that cannot be taken: its line (text) or row (Parquet), from 1, why, and what it says."""

    line: int
    why: str
    text: str


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of a table as they come."""

    rows_in: int
    """Rows in the table, good and bad; blank lines are none."""
    index: IntArray
    """Number of each good row among all rows, from 0, (n,)."""
    line: IntArray
    """Line (text) or row (Parquet) of each good row, from 1, (n,)."""
    time_ns: IntArray | None
    """As the column says it, also where it wraps, (n,)."""
    values: FloatArray
    """The columns of data that were asked for, in the units of the table, (k, n); NaN where a cell is
    empty."""
    bad: list[BadRow]


def read_foreign(
    path: Path, columns: Sequence[str], time: TimeColumn | None, text_format: TextFormat
) -> tuple[list[str], Iterator[Part]]:
    """Return the names of all columns of a table, and its rows as a stream of parts.

    Whether it is Parquet or text is decided by the content, not by the name.

    Raises BAD_DATA when it cannot be read; BAD_CONFIG when it lacks a column, naming those that it has.
    """
    with readable(path), path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise ImumonError(Reason.BAD_DATA, f"{path}: is empty")
    wanted = [*columns, *([time.column] if time is not None else [])]
    if head.startswith(b"PAR1"):
        names = _parquet_names(path)
        _check_columns(path, names, wanted)
        return names, _read_parquet(path, columns, time)
    encoding = _encoding(path, head)
    text_format = _by_first_line(path, encoding, text_format)
    names, skip = _text_names(path, encoding, text_format)
    _check_columns(path, names, wanted)
    columns_at = [names.index(name) for name in wanted]
    layout = _Layout(
        text_format.delimiter,
        len(names),
        columns_at,
        text_format.decimal,
        text_format.comment,
        has_dates=time is not None and time.unit == TIMESTAMPS,
    )
    return names, _read_text(path, encoding, skip, layout, time)


DELIMITERS = (";", "\t", ",", "|")
"""What a table with a single column may really be divided by."""


def _check_columns(path: Path, names: Sequence[str], wanted: Sequence[str]) -> None:
    if absent := [name for name in wanted if name not in names]:
        hint = ""
        if other := [mark for mark in DELIMITERS if len(names) == 1 and mark in names[0]]:
            hint = f'; in the map: csv: {{delimiter: "{other[0]}"}}'
        elif names and all(re.match(_NUMBER, name) for name in names):
            hint = "; if these are the first row: csv: {header: false, columns: [NAME, ...]}"
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"{path}: has no column {', '.join(map(repr, absent))}",
            f"it has: {', '.join(map(repr, names))}{hint}",
        )
    if twice := [name for name in wanted if names.count(name) > 1]:
        raise ImumonError(
            Reason.BAD_DATA, f"{path}: column {', '.join(map(repr, twice))} is there more than once"
        )


# Text


_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
_NO_VALUE = r"^(nan|na|n/a|null|none)?$"


@dataclass(frozen=True, slots=True)
class _Layout:
    """How many cells a line has, what is between them, and which are wanted: the data, then the time."""

    delimiter: str
    width: int
    wanted: list[int]
    decimal: str = "."
    comment: str | None = None
    has_dates: bool = False
    """Whether the time is no number."""

    def is_row(self, line: str) -> bool:
        """Return whether a line is neither blank nor a comment."""
        return bool(line) and not (self.comment and line.startswith(self.comment))

    def split(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if self.delimiter == "whitespace":
            return line.split()
        if '"' in line:
            return next(csv.reader([line], delimiter=self.delimiter))
        return line.split(self.delimiter)

    def bare(self, line: str) -> str:
        """Return a line without quotes, with one delimiter between cells and none behind the last."""
        if self.delimiter == "whitespace" or '"' in line:
            try:
                cells = self.split(line)
            except csv.Error:
                return line
            line = self.between.join(cell.replace(self.between, " ").replace("\n", " ") for cell in cells)
        ends = line.endswith(self.between) and line.count(self.between) == self.width
        return line[:-1] if ends else line

    @property
    def between(self) -> str:
        """The one character that is between the cells of a bare line."""
        return " " if self.delimiter == "whitespace" else self.delimiter


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


def _by_first_line(path: Path, encoding: str, text_format: TextFormat) -> TextFormat:
    """Return the layout of a table whose first line may be ``sep=;``, as for Excel; the map comes first."""
    with path.open(encoding=encoding, errors="replace") as file:
        match = _SEPARATOR.fullmatch(file.readline().rstrip("\r\n"))
    if match is None:
        return text_format
    delimiter = text_format.delimiter if "delimiter" in text_format.model_fields_set else match[1]
    return text_format.model_copy(update={"delimiter": delimiter, "skip_rows": max(1, text_format.skip_rows)})


def _text_names(path: Path, encoding: str, text_format: TextFormat) -> tuple[list[str], int]:
    """Return the names of the columns, and how many lines there are before the data."""
    if text_format.columns is not None:
        return text_format.columns, text_format.skip_rows
    layout = _Layout(text_format.delimiter, 0, [], comment=text_format.comment)
    with path.open(encoding=encoding, errors="replace") as file:
        for number, line in enumerate(islice(file, text_format.skip_rows, None), text_format.skip_rows + 1):
            if layout.is_row(line.strip()):
                return [name.strip() for name in layout.split(line.rstrip("\r\n"))], number
    raise ImumonError(Reason.BAD_DATA, f"{path}: has no line of column names")


def _read_text(
    path: Path, encoding: str, skip: int, layout: _Layout, time: TimeColumn | None
) -> Iterator[Part]:
    """Yield the rows of a text table; bytes that are not text become part of a bad row."""
    first_row = 0
    with readable(path), path.open(encoding=encoding, errors="replace") as file:
        numbered = enumerate(islice(file, skip, None), skip + 1)
        while chunk := list(islice(numbered, ROWS_PER_PART)):
            rows = [
                (number, stripped) for number, line in chunk if layout.is_row(stripped := line.strip(" \r\n"))
            ]
            if rows:
                yield _text_part(rows, first_row, layout, time)
            first_row += len(rows)


def _text_part(rows: list[tuple[int, str]], first_row: int, layout: _Layout, time: TimeColumn | None) -> Part:
    cells, why = _cells([line for _, line in rows], layout)
    whole = np.array([row for row in range(len(rows)) if row not in why], np.int64)
    values = np.full((len(layout.wanted) - (time is not None), len(rows)), np.nan)
    for at in range(len(values)):
        values[at, whole], wrong = _numbers_of_text(cells.column(at))
        for row, text in wrong.items():
            why.setdefault(int(whole[row]), text)
    times = None
    if time is not None:
        found = _texts_as_times(cells.column(len(values)).to_pylist(), time)
        times = dict(zip(whole.tolist(), found.values(), strict=True))
    lines = np.array([number for number, _ in rows], np.int64)
    return _part(first_row, lines, times, values, why, lambda row: rows[row][1])


def _cells(lines: list[str], layout: _Layout) -> tuple[Any, dict[int, str]]:
    """Return the wanted cells of lines that have as many as they should, and what is wrong with others."""
    wrong: dict[int, str] = {}

    def pass_over(row: Any) -> str:
        wrong[row.number - 1] = f"{row.actual_columns} cells, expected {row.expected_columns}"
        return "skip"

    data = "\n".join(layout.bare(line) for line in lines).encode()
    names = [str(at) for at in range(layout.width)]
    wanted = [names[at] for at in layout.wanted]
    cells = pa_csv.read_csv(
        pa.BufferReader(data),
        pa_csv.ReadOptions(use_threads=False, block_size=len(data) + 1, column_names=names),
        pa_csv.ParseOptions(
            delimiter=layout.between,
            quote_char=False,
            ignore_empty_lines=False,
            invalid_row_handler=pass_over,
        ),
        pa_csv.ConvertOptions(
            column_types=dict.fromkeys(wanted, pa.string()),
            include_columns=list(dict.fromkeys(wanted)),
            strings_can_be_null=False,
        ),
    )
    chosen = cells.select(wanted).combine_chunks()
    if layout.decimal != ".":
        numbers = chosen.columns[:-1] if layout.has_dates else chosen.columns
        points = [pc.replace_substring(column, layout.decimal, ".") for column in numbers]
        points += chosen.columns[len(points) :]
        chosen = pa.table(points, names=wanted)
    return chosen, wrong


def _numbers_of_text(column: Any) -> tuple[FloatArray, dict[int, str]]:
    """Return the numbers of a column, NaN where there is none, and what is wrong with which cells."""
    text = pc.utf8_trim_whitespace(column)
    number = pc.match_substring_regex(text, _NUMBER)
    bare = pc.utf8_ltrim(pc.if_else(number, text, "nan"), "+")
    values = np.asarray(pc.cast(bare, pa.float64()).to_numpy(), np.float64)
    fine = pc.or_(number, pc.match_substring_regex(pc.utf8_lower(text), _NO_VALUE))
    odd, large = np.flatnonzero(~fine.to_numpy()), np.flatnonzero(np.isinf(values))
    wrong = {row: not_a_number(text[row].as_py()) for row in odd.tolist()}
    wrong |= {row: f"{text[row].as_py()!r} is too large" for row in large.tolist()}
    return values, wrong


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
    why = dict.fromkeys(np.flatnonzero(np.isinf(values).any(axis=0)).tolist(), "a value is infinite")
    times = None if time is None else _times(batch.column(time.column), time)
    line = np.arange(len(batch), dtype=np.int64) + first_row + 1
    return _part(first_row, line, times, values, why, lambda row: str(batch.slice(row, 1).to_pylist()[0]))


def _numbers(path: Path, name: str, column: Any) -> FloatArray:
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
        raise ImumonError(Reason.BAD_DATA, f"{path}: column {name!r} is {kind}, not a number")
    values = pc.cast(column, pa.float64(), safe=False).fill_null(math.nan)
    return np.asarray(values.to_numpy(zero_copy_only=False), np.float64)


def _times(column: Any, time: TimeColumn) -> Times:
    if pa.types.is_timestamp(column.type):
        if time.unit != TIMESTAMPS:
            wrong = f"time is a timestamp, so its unit is {TIMESTAMPS}, not {time.unit}"
            return dict.fromkeys(range(len(column)), wrong)
        nanoseconds = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64()).to_pylist()
        found = ("time is absent" if value is None else value for value in nanoseconds)
        return dict(enumerate(found))
    return _texts_as_times([None if value is None else str(value) for value in column.to_pylist()], time)


# Both


Times = dict[int, int | str]
"""The time of rows in ns, or what is wrong with it, by the number of the row."""


def _texts_as_times(texts: Sequence[str | None], time: TimeColumn) -> Times:
    parse, wrap_ns = time_parser(time.unit, time.format), time.wrap_ns

    def time_of(text: str | None) -> int | str:
        if text is None:
            return "time is absent"
        try:
            time_ns = parse(text)
        except ValueError as error:
            return str(error)
        if wrap_ns is not None and not 0 <= time_ns < wrap_ns:
            return f"time {text!r} is not from 0 to below {time.wraps_at:g}, where it wraps"
        return time_ns

    return dict(enumerate(map(time_of, texts)))


def _part(
    first_row: int,
    line: IntArray,
    times: Times | None,
    values: FloatArray,
    why: dict[int, str],
    text_of: Callable[[int], str],
) -> Part:
    """Return the rows that can be taken, and those that cannot: what is wrong with the time comes first."""
    time_of = times or {}
    wrong = why | {row: text for row, text in time_of.items() if isinstance(text, str)}
    good = np.setdiff1d(np.arange(len(line)), list(wrong))
    return Part(
        rows_in=len(line),
        index=good + first_row,
        line=line[good],
        time_ns=None if times is None else np.array([time_of[row] for row in good.tolist()], np.int64),
        values=values[:, good],
        bad=[BadRow(int(line[row]), wrong[row], text_of(row)[:SHOWN]) for row in sorted(wrong)],
    )
