"""Tables from elsewhere, text or Parquet, read as a stream: each row is taken whole or is named as bad."""

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imumon.blocks import FloatArray, IntArray
from imumon.errors import bad_data
from imumon.files import readable
from imumon.units import parse_unit

from .map import TIMESTAMPS, TableMap, TextFormat, TimeColumn
from .table import table_errors

ROWS_PER_PART = 20_000
CONTROL_SHARE = 0.05
"""Text has a few control codes where a serial line was disturbed; a file with more of them is not text."""
SHOWN = 160
"""Characters of a bad row that are kept."""
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_NO_VALUE = r"^(nan|na|n/a|null|none)?$"
_TIMESTAMP = re.compile(
    r"\s*(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(Z|UTC|[+-]\d\d:?\d\d)?\s*", re.ASCII
)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
Wrong = dict[int, str]
"""What is wrong with which row of a part."""
Rows = tuple[IntArray, Mapping[str, Any], Callable[[int], str], Wrong]
"""Rows as they stand in a table: lines, cells by column, whole texts, and those of a wrong width."""


@dataclass(frozen=True)
class BadRow:
    """A row that cannot be taken: its line (text) or row (Parquet), from 1, why, and what it holds."""

    line: int
    why: str
    text: str


@dataclass(frozen=True)
class Part:
    """Rows of a table as they come."""

    index: IntArray  # number of each good row among all rows, from 0, (n,); blank lines are none
    line: IntArray  # line (text) or row (Parquet) of each good row, from 1, (n,)
    time_ns: IntArray | None  # as the column has it, also where it wraps, (n,)
    values: FloatArray  # columns of data, in the units of the table, (k, n); NaN where a cell is empty
    bad: list[BadRow]


def read_foreign(path: Path, table_map: TableMap) -> tuple[list[str], Iterator[Part]]:
    """Return the names of all columns of a table, and its rows as a stream of parts.

    Whether it is Parquet or text is decided by the content, not by the name.

    Raises BAD_DATA when it cannot be read.
    """
    if path.exists() and not path.is_file():
        raise bad_data(f"{path}: is no file", "" if path.is_dir() else "write the table to a file first")
    with readable(path), path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise bad_data(f"{path}: is empty")
    wanted, text_format = table_map.columns(), table_map.csv
    if head.startswith(b"PAR1"):
        with table_errors(path):
            names = pq.read_schema(path).names
        rows = _parquet_rows(path, wanted)
    else:
        lines = _lines(path, _encoding(path, head), text_format)
        names = [*(text_format.columns or ())]
        if text_format.header:
            _, first = next(lines, (0, ""))
            if not first:
                raise bad_data(f"{path}: has no line of column names")
            names = [name.strip() for name in _split(first, text_format.delimiter)]
        rows = _text_rows(lines, names, text_format)
    if twice := [name for name in wanted if names.count(name) > 1]:
        raise bad_data(f"{path}: column {', '.join(map(repr, twice))} is there more than once")
    return names, _parts(path, rows, table_map)


def _parts(path: Path, tables: Iterable[Rows], table_map: TableMap) -> Iterator[Part]:
    first_row, columns = 0, [source.column for source in table_map.sources()]
    time, decimal = table_map.time, table_map.csv.decimal
    for line, cells, text_of, wrong_width in tables:
        values, wrong, times = np.empty((len(columns), len(line))), Wrong(), None
        for column, name in enumerate(columns):
            values[column], wrong_here = _numbers(path, name, cells[name], decimal)
            wrong = wrong_here | wrong
        if time is not None:
            with table_errors(path):
                times, wrong_times = _times_of(cells[time.column], time, decimal)
            wrong |= wrong_times
        wrong |= wrong_width
        good = np.setdiff1d(np.arange(len(line)), list(wrong))
        yield Part(
            index=good + first_row,
            line=line[good],
            time_ns=None if times is None else times[good],
            values=values[:, good],
            bad=[BadRow(int(line[row]), wrong[row], text_of(row)[:SHOWN]) for row in sorted(wrong)],
        )
        first_row += len(line)


# Text


def _lines(path: Path, encoding: str, text_format: TextFormat) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that is neither blank nor a comment; what is no text is replaced."""
    comment = text_format.comment
    with readable(path), path.open(encoding=encoding, errors="replace") as file:
        for number, line in enumerate(file, 1):
            text = line.strip(" \r\n")
            if number > text_format.skip_rows and text and not (comment and text.startswith(comment)):
                yield number, text


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == "whitespace":
        return line.split()
    if '"' in line:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=delimiter))
    return line.split(delimiter)


def _text_rows(lines: Iterator[tuple[int, str]], names: list[str], text_format: TextFormat) -> Iterator[Rows]:
    width = len(names)
    while rows := list(islice(lines, ROWS_PER_PART)):
        numbers, texts = zip(*rows, strict=True)
        cells, wrong = list[list[str]](), Wrong()
        for at, line in enumerate(texts):
            row = _split(line, text_format.delimiter)
            if len(row) == width + 1 and not row[-1]:  # a delimiter behind the last cell
                row.pop()
            if len(row) != width:
                wrong[at] = f"{len(row)} cells, expected {width}"
                row = [""] * width
            cells.append(row)
        columns = dict(zip(names, map(pa.array, zip(*cells, strict=True)), strict=True))
        yield np.array(numbers, np.int64), columns, texts.__getitem__, wrong


def _encoding(path: Path, head: bytes) -> str:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    control = sum(byte < 0x20 and byte not in b"\t\n\r\f\x1b" for byte in head)
    if control > CONTROL_SHARE * len(head):
        raise bad_data(
            f"{path}: is neither text nor Parquet: {control} of its first {len(head)} bytes are controls",
            "a raw capture is decoded with: imumon decode FILE --device NAME",
        )
    return "utf-8-sig"


def _numbers(path: Path, name: str, cells: Any, decimal: str) -> tuple[FloatArray, Wrong]:
    """Return the numbers of a column, NaN where there is none, and what is wrong with which cells."""
    import pyarrow.compute as pc  # 30 ms, for tables of others only

    kind, numbers, wrong = cells.type, cells, Wrong()
    if pa.types.is_string(kind):
        cells = pc.utf8_trim_whitespace(cells.fill_null(""))
        plain = pc.replace_substring(cells, decimal, ".")
        is_number = pc.match_substring_regex(plain, _NUMBER)
        numbers = pc.utf8_ltrim(pc.if_else(is_number, plain, "nan"), "+")
        fine = pc.or_(is_number, pc.match_substring_regex(pc.utf8_lower(cells), _NO_VALUE))
        wrong = dict.fromkeys(np.flatnonzero(~np.asarray(fine)).tolist(), "is not a number")
    elif not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
        raise bad_data(f"{path}: column {name!r} is {kind}, not a number")
    values = np.asarray(pc.cast(numbers, pa.float64(), safe=False).fill_null(math.nan), np.float64)
    wrong |= dict.fromkeys(np.flatnonzero(np.isinf(values)).tolist(), "is too large")
    return values, {row: f"{cells[row].as_py()!r} {why}" for row, why in wrong.items()}


# Times


def time_parser(unit: str, date_format: str | None = None) -> Callable[[str], int]:
    """Return a function from the text of a time to integer nanoseconds, without rounding through floats.

    The function raises ValueError for text that is no time, or out of the range of int64.
    """

    def parse(text: str) -> int:
        try:
            if date_format is not None:
                moment = datetime.strptime(text.strip(), date_format)
                # Without a date it is in the year 1900.
                time_ns = _of_date(moment.replace(year=1970) if moment.year == 1900 else moment)
            elif unit == TIMESTAMPS:
                time_ns = _of_timestamp(text)
            elif "_" in text:  # which Decimal accepts, but no table means
                raise ValueError
            else:
                exact = (Decimal(text) * scale).to_integral_value()
                time_ns = int(exact) if abs(exact) < 2**63 else 2**63  # int of 1e999990 does not end
        except (ValueError, InvalidOperation) as error:
            raise ValueError(f"time {text.strip()!r} is not {expected}") from error
        except ArithmeticError:
            time_ns = 2**63
        if not abs(time_ns) < 2**63:
            raise ValueError(f"time {text.strip()!r} is out of range")
        return time_ns

    if date_format is not None:
        expected = f"as {date_format!r}"
    elif unit == TIMESTAMPS:
        expected = "a date with time, as 2026-01-31T12:00:00.5Z"
    else:
        expected, factor = "a number", parse_unit(unit, "ns").factor
        scale = Decimal(factor.numerator) / Decimal(factor.denominator)
    return parse


def _of_timestamp(text: str) -> int:
    """Return Unix time in ns; a time without zone is UTC."""
    match = _TIMESTAMP.fullmatch(text)
    if match is None:
        raise ValueError(text)
    date, time, fraction, zone = match.groups()
    zone = "+00:00" if zone in (None, "Z", "UTC") else zone
    return _of_date(datetime.fromisoformat(f"{date}T{time}{zone}")) + int((fraction or "").ljust(9, "0"))


def _of_date(moment: datetime) -> int:
    return (moment.replace(tzinfo=moment.tzinfo or UTC) - EPOCH) // timedelta(microseconds=1) * 1000


def _times_of(cells: Any, time: TimeColumn, decimal: str) -> tuple[IntArray, Wrong]:
    """Return times in ns, (n,), and what is wrong with which of them."""
    import pyarrow.compute as pc

    texts: list[str | None] = pc.cast(cells, pa.string()).to_pylist()
    parse, wrap_ns = time_parser(time.unit, time.format), time.wrap_ns
    decimal = "." if time.unit == TIMESTAMPS else decimal
    found, wrong = np.zeros(len(texts), np.int64), Wrong()
    for row, text in enumerate(texts):
        try:
            time_ns = parse("" if text is None else text.replace(decimal, "."))
        except ValueError as error:
            wrong[row] = "time is absent" if text is None else str(error)
            continue
        found[row] = time_ns
        if wrap_ns is not None and not 0 <= time_ns < wrap_ns:
            wrong[row] = f"time {text!r} is not from 0 to below {time.wraps_at:g}, where it wraps"
    return found, wrong


# Parquet


def _parquet_rows(path: Path, wanted: Sequence[str]) -> Iterator[Rows]:
    first_row = 0
    with table_errors(path), pq.ParquetFile(path, pre_buffer=False) as file:
        for batch in file.iter_batches(batch_size=ROWS_PER_PART, columns=wanted):
            line = np.arange(len(batch), dtype=np.int64) + first_row + 1
            cells = {name: batch.column(name) for name in wanted}

            def text_of(row: int, batch: Any = batch) -> str:
                return str(batch.slice(row, 1).to_pylist()[0])

            yield line, cells, text_of, {}
            first_row += len(batch)
