"""Tables of samples, Parquet or CSV, written and read as a stream in bounded memory.

Parquet has the unit and the meaning of each column in the metadata of its field.  CSV has plain names in its
header, so that every program reads it, and the units in a second file beside it, NAME.units.yaml.
"""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from imumon.blocks import NO_INT, SampleBlock, join, missing
from imumon.columns import KNOWN, Column, ColumnType
from imumon.config import StrictModel, dump_yaml, load_yaml
from imumon.errors import ImumonError, Reason, bad_data
from imumon.files import check_output, naming, target, write_text
from imumon.harmless import for_csv
from imumon.version import __version__

from .folder import Session

FORMAT = "imumon-table/1"
SUFFIXES = (".parquet", ".csv")
BUFFER_BYTES = 16 << 20
"""Rows are gathered to this size before they are written; it is also the size of a row group."""
ARRAY_OVERHEAD = 160
"""Bytes that an array takes besides its values; blocks of one sample are mostly that."""
READ_ROWS = 65_536
CLOCKS = ("host_time_ns", "arrival_time_ns", "device_time_ns")
"""The first that has values is the time of ROS messages: Unix time, or since power-on in a log without it."""

_ARROW = {"float64": pa.float64(), "int64": pa.int64()}
_parquet_writer = partial(pq.ParquetWriter, compression="zstd", use_dictionary=False)


class TableWriter:
    """Writes blocks to a table in a ``with`` statement, at whose end the file appears, unless with an error.

    A column may begin in any block: the rows before have no value there.  NaN and `NO_INT` become null, an
    empty cell in CSV.

    Raises BAD_CONFIG for another suffix, or when the folder of the output does not exist; OSError at the end
    when the disk is full or fails; a file that was there before is then untouched.

    `path`: output; the suffix .parquet or .csv decides the format.  An existing file is replaced on success.
    `columns`: every column that may come, in the order in which the table shall have them; only those that
        come are written (all of them when no row comes).
    """

    def __init__(self, path: Path, columns: Mapping[str, Column]) -> None:
        _check_suffix(path, Reason.BAD_CONFIG)
        check_output(path, replace=True)
        self.path = path
        self.rows = 0
        self._columns = dict(columns)
        self._buffer: list[SampleBlock] = []
        self._buffered = 0
        self._present: list[Column] = []  # columns of the part that is being written
        self._parts: list[Path] = []
        self._writer: pq.ParquetWriter

    def announce(self, columns: Iterable[Column]) -> None:
        """Set which columns may come from now on, in the order which the table shall have."""
        self._columns = {column.name: column for column in columns} | self._columns

    def write(self, block: SampleBlock) -> None:
        """Append the samples of a block.

        Raises ValueError when the block has a column that was not announced; OSError when the disk is full or
        fails.
        """
        if not len(block):
            return
        if unknown := [name for name in block.columns if name not in self._columns]:
            raise ValueError(f"columns that were not announced: {unknown}")
        self._buffer.append(block)
        self._buffered += sum(values.nbytes + ARRAY_OVERHEAD for values in block.columns.values())
        self.rows += len(block)
        if self._buffered >= BUFFER_BYTES:
            with naming(self.path):
                self._flush()

    def __enter__(self) -> "TableWriter":
        with naming(self.path):
            self._folder = TemporaryDirectory(prefix=".imumon-", dir=target(self.path).parent)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._folder:
            if kind is None:
                with naming(self.path):
                    self._flush()
                    self._writer.close()
                    self._finish()
            elif self._parts:
                with suppress(OSError):
                    self._writer.close()

    def _flush(self) -> None:
        """Write the buffer as one row group; a column that is new begins a new part."""
        block = join(self._buffer)
        self._buffer, self._buffered = [], 0
        every = self._columns.values()
        present = [one for one in every if not self.rows or one in self._present or one.name in block]
        if not self._parts or present != self._present:
            if self._parts:
                self._writer.close()
            self._present = present
            self._parts.append(Path(self._folder.name) / f"{len(self._parts)}.parquet")
            self._writer = _parquet_writer(self._parts[-1], _schema(present))
        if len(block):
            self._writer.write_table(arrow_table(block, present))

    def _finish(self) -> None:
        """Make the table of the parts: as it is when there is one, else with nulls for what came later."""
        columns, whole = self._present, self._parts[0]
        if self.path.suffix != ".parquet" or len(self._parts) > 1:
            whole = whole.with_name("whole")
            tables = (arrow_table(block, columns) for part in self._parts for block in iterate_table(part))
            if self.path.suffix == ".parquet":
                with _parquet_writer(whole, _schema(columns)) as writer:
                    for table in tables:
                        writer.write_table(table)
            else:
                _write_csv(whole, tables, [one.name for one in columns])
                units = {
                    c.name: {"unit": c.unit, "type": c.dtype, "description": c.description} for c in columns
                }
                content = {"format": FORMAT, "imumon": __version__, "columns": units}
                write_text(units_path(self.path), dump_yaml(content))
        whole.replace(target(self.path))


def iterate_samples(session: Session) -> Iterator[SampleBlock]:
    """Yield the samples of an imported session in order.

    Raises BAD_DATA when the table cannot be read, or is not the one that was imported.
    """
    imported = session.metadata.table
    if imported is not None:
        with table_errors(session.truth_path):
            rows = int(pq.read_metadata(session.truth_path).num_rows)
        if rows != imported.rows_out:
            raise bad_data(
                f"{session.truth_path} was changed after the import: it has {rows:,} rows, and"
                f" {imported.rows_out:,} were imported",
                f"import {imported.file} again, into another folder",
            )
    return iterate_table(session.truth_path)


@contextmanager
def table_errors(path: Path) -> Iterator[None]:
    """Raise BAD_DATA, naming the table, where it cannot be read."""
    try:
        yield
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise bad_data(f"{path}: cannot be read: {error}") from error


def iterate_table(path: Path, columns: Sequence[str] | None = None) -> Iterator[SampleBlock]:
    """Yield the samples of a table that imumon wrote, or one with the same names, in order.

    Raises BAD_DATA when the table cannot be read or has a column that is neither float nor integer.

    `columns`: only these columns, which the table must have; others are not read.
    """
    there = read_columns(path)
    schema = _schema(there.values() if columns is None else [there[name] for name in columns])
    with table_errors(path):
        for batch in _batches(path, schema):
            for start in range(0, len(batch), READ_ROWS):
                block = {}
                for field in schema:
                    values = batch.slice(start, READ_ROWS).column(field.name).cast(field.type)
                    absent = pa.scalar(NO_INT if field.type == pa.int64() else np.nan, field.type)
                    block[field.name] = values.fill_null(absent).to_numpy(zero_copy_only=False)
                yield SampleBlock(block)


def read_table(path: Path) -> tuple[SampleBlock, dict[str, Column]]:
    """Read a whole table into memory; return the samples and the columns with their units.

    Raises BAD_DATA when the table cannot be read or has a column that is neither float nor integer.
    """
    columns = read_columns(path)
    empty = SampleBlock({name: missing(0, column.dtype) for name, column in columns.items()})
    return join([empty, *iterate_table(path)]), columns


def read_columns(path: Path) -> dict[str, Column]:
    """Return the columns of a table; where the table does not state the unit, that of the known name, or "".

    Raises BAD_DATA when the table cannot be read or has a column that is neither float nor integer.
    """
    _check_suffix(path, Reason.BAD_DATA)
    with table_errors(path):
        schema = pq.read_schema(path) if path.suffix == ".parquet" else _schema(_csv_columns(path))
    if twice := [name for name, count in Counter(schema.names).items() if count > 1]:
        raise bad_data(f"{path}: column {', '.join(map(repr, twice))} is there more than once")
    columns = {}
    for field in schema:
        is_whole = pa.types.is_integer(field.type)
        if not (is_whole or pa.types.is_floating(field.type)):
            raise bad_data(f"{path}: column {field.name!r} is {field.type}, not a number")
        stated = {
            key.decode(): value.decode()
            for key, value in (field.metadata or {}).items()
            if key in (b"unit", b"description")
        }
        known = KNOWN.get(field.name) or Column(field.name, "")
        columns[field.name] = replace(known, dtype="int64" if is_whole else "float64", **stated)
    return columns


def units_path(path: Path) -> Path:
    """Return the path of the units of a CSV table: NAME.units.yaml beside NAME.csv."""
    return path.with_suffix(".units.yaml")


class _UnitsColumn(StrictModel):
    unit: str
    type: ColumnType
    description: str = ""


class _UnitsFile(StrictModel):
    format: Literal["imumon-table/1"]
    imumon: str
    columns: dict[str, _UnitsColumn]


def _csv_columns(path: Path) -> list[Column]:
    with path.open(encoding="utf-8-sig") as file:
        names = next(csv.reader(file), [])
    if not names:
        raise bad_data(f"{path}: cannot be read: it is empty")
    units = units_path(path)
    units_of = load_yaml(units, _UnitsFile).columns if units.is_file() else {}
    own = {name: Column(name, of.unit, of.type, of.description) for name, of in units_of.items()}
    return [own.get(name) or KNOWN.get(name) or Column(name, "") for name in names]


def _check_suffix(path: Path, reason: Reason) -> None:
    if path.suffix not in SUFFIXES:
        raise ImumonError(
            reason,
            f"{path}: a table cannot have the suffix {path.suffix!r}",
            f"use {' or '.join(SUFFIXES)}; imumon export also writes .npz, .mat and .mcap",
        )


def _schema(columns: Iterable[Column]) -> Any:
    fields = [
        pa.field(
            column.name,
            _ARROW[column.dtype],
            metadata={"unit": column.unit, "description": column.description},
        )
        for column in columns
    ]
    return pa.schema(fields, metadata={"imumon": __version__, "format": FORMAT})


def arrow_table(block: SampleBlock, columns: Iterable[Column]) -> Any:
    """Return a pyarrow table with these columns; missing values are null, a field's metadata has the unit."""
    schema, arrays = _schema(columns), []
    for field in schema:
        values = block.columns.get(field.name, missing(len(block), field.type.to_pandas_dtype()))
        # pyarrow.array does the same once it has imported pandas, 0.3 s, to see whether this is a series.
        there = values != NO_INT if values.dtype == np.int64 else ~np.isnan(values)
        bits = None if there.all() else pa.py_buffer(np.packbits(there, bitorder="little"))
        content = pa.py_buffer(np.ascontiguousarray(values, field.type.to_pandas_dtype()))
        arrays.append(pa.Array.from_buffers(field.type, len(values), [bits, content]))
    return pa.Table.from_arrays(arrays, schema=schema)


def _batches(path: Path, schema: Any) -> Iterator[Any]:
    if path.suffix == ".parquet":
        with pq.ParquetFile(path, pre_buffer=False) as file:
            yield from file.iter_batches(batch_size=READ_ROWS, columns=schema.names)
        return
    options = pa_csv.ConvertOptions(
        column_types={field.name: field.type for field in schema},
        include_columns=schema.names,
        null_values=["", "nan", "NaN"],
    )
    with pa_csv.open_csv(path, convert_options=options) as reader:
        yield from reader


def _write_csv(path: Path, tables: Iterable[Any], names: Sequence[str]) -> None:
    """Write numbers as the shortest text that reads back the same; whole floats keep their ".0"."""
    import pyarrow.compute as pc  # 50 ms, for CSV only

    options = pa_csv.WriteOptions(include_header=False, quoting_style="none")
    with path.open("wb") as file:
        file.write(",".join(map(for_csv, names)).encode() + b"\n")
        for table in tables:
            texts = []
            for values in map(table.column, names):
                text = values.cast(pa.string())
                if values.type == pa.float64():
                    bare = pc.invert(pc.match_substring_regex(text, "[.eni]"))
                    text = pc.if_else(bare, pc.binary_join_element_wise(text, ".0", ""), text)
                texts.append(text)
            pa_csv.write_csv(pa.Table.from_arrays(texts, names=names), file, options)
