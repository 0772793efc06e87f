"""Exports of a run: tables, the main stream in the requested file and each side stream in one beside
it, or files of other programs: NumPy, MATLAB, ROS 2.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from imumon.blocks import SampleBlock, missing
from imumon.columns import KNOWN, BodyAxes, Column, ColumnType
from imumon.errors import bad_config, bad_data
from imumon.files import check_output, naming, replacing, target
from imumon.pipeline import Pipeline
from imumon.protocols.base import MAIN

from .source import Source, no_samples
from .table import CLOCKS, TableWriter, read_table

CONVERTED = (".npz", ".mat", ".mcap")
RESERVED = {"units", "file", "allow_pickle"}
"""Names that a file of NumPy or MATLAB has for something else."""
LONGEST_NAME = 63
"""Of a variable in MATLAB."""


@dataclass(frozen=True)
class Exported:
    """What was written."""

    rows: int  # of the main stream
    tables: dict[str, Path]  # of each stream that has rows
    warnings: Sequence[str] = ()  # what the format has no place for


def side_path(out: Path, stream: str) -> Path:
    """Return where the table of a stream goes: of a side stream NAME.gnss.parquet beside NAME.parquet."""
    return out if stream == MAIN else out.with_name(f"{out.stem}.{stream}{out.suffix}")


def export_run(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    source: Source,
    out: Path,
    columns: Sequence[str] | None,
) -> Exported:
    """Write what a run yields, in the format that the suffix of `out` names.

    A run with rows in side streams only has their tables.

    Raises BAD_CONFIG when a column that was chosen is not there, naming those that are, or the format has no
    place for any of it; BAD_DATA when there is no sample; OSError when the disk is full or fails; a file that
    was there before is untouched.

    `blocks`: the run over `source`, which goes through `pipeline`.
    `columns`: columns of the main table, and no others are written; None for all, and all side streams.
    """
    if out.suffix not in CONVERTED:
        return _tables(blocks, pipeline, source, out, columns)
    check_output(out, replace=True)
    with naming(out), TemporaryDirectory(prefix=".imumon-", dir=target(out).parent) as folder:
        table = Path(folder) / f"{out.stem}.parquet"
        also = CLOCKS if out.suffix == ".mcap" else ()
        made = _tables(blocks, pipeline, source, table, columns, also)
        files, left_out = convert(made.tables, Path(folder) / out.name, source.axes)
        for path in {*files.values()}:
            path.replace(target(out.with_name(path.name)))
    tables = {stream: out.with_name(path.name) for stream, path in files.items()}
    return Exported(made.rows, tables, [f"not written: {text}" for text in left_out])


def _tables(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    source: Source,
    out: Path,
    columns: Sequence[str] | None,
    also: Sequence[str] = (),
) -> Exported:
    """Write the tables; `also` are columns that come before those that were chosen, where they are there."""
    main, written, there, before = TableWriter(out, {}), dict[str, TableWriter](), dict[str, None](), 0
    wanted = [*dict.fromkeys([*also, *(columns or ())])]
    with ExitStack() as stack:
        for block in blocks:
            for stream, rows in {**(pipeline.side if columns is None else {}), MAIN: block}.items():
                if not len(rows):
                    continue
                known = source.columns(pipeline, stream)
                if columns is not None:
                    there |= dict.fromkeys(rows.columns)
                    chosen = {name: rows[name] for name in wanted if name in rows}
                    if not chosen:  # the rows come, without values, when the first of these begins
                        before += len(rows)
                        continue
                    rows = SampleBlock(
                        {k: np.concatenate([missing(before, v.dtype), v]) for k, v in chosen.items()}
                    )
                    before = 0
                    by_name = {column.name: column for column in known}
                    known = [by_name[name] for name in wanted if name in by_name]
                if stream not in written:
                    writer = main if stream == MAIN else TableWriter(side_path(out, stream), {})
                    written[stream] = stack.enter_context(writer)
                written[stream].announce(known)
                written[stream].write(rows)
        absent = [name for name in columns or () if name not in there]
        if absent and there:
            raise bad_config(
                f"no column {', '.join(absent)} in these samples", f"there are: {', '.join(there)}"
            )
        if not written:
            raise no_samples(source, pipeline)
    return Exported(main.rows, {stream: writer.path for stream, writer in written.items()})


def convert(
    tables: Mapping[str, Path], out: Path, axes: BodyAxes | None
) -> tuple[dict[str, Path], list[str]]:
    """Write Parquet tables as files of the suffix of `out`; return what was made, and what was left out.

    Raises BAD_CONFIG when a package that is needed is not installed, or the format has no place for any of
    it.

    `tables`: of each stream.  One ROS 2 bag has all streams, other formats have a file for each.
    """
    if out.suffix == ".mcap":
        from .ros2 import write_ros2

        streams, left_out = write_ros2(tables, out, axes)
        if not streams:
            raise bad_config(
                f"there is nothing to write as messages of ROS 2: {'; '.join(left_out)}",
                "leave --columns out, or name a whole vector: gyro_x,gyro_y,gyro_z",
            )
        return dict.fromkeys(streams, out), left_out
    files = {stream: side_path(out, stream) for stream in tables}
    for stream, path in tables.items():
        block, columns = read_table(path)
        if out.suffix == ".npz":
            write_npz(files[stream], block.columns, columns)
            continue
        from scipy.io import savemat

        content = {**block.columns, "units": _units(columns)}
        savemat(files[stream], content, do_compression=True, long_field_names=True, oned_as="column")
    return files, []


def write_npz(path: Path, values: Mapping[str, Any], columns: Mapping[str, Column]) -> None:
    """Write the columns, and `units`, a text in JSON.

    Raises BAD_CONFIG for a name that is `RESERVED`, and as `TableWriter`.
    """
    check_output(path, replace=True)
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, units=np.array(json.dumps(_units(columns))), **values)


def _units(columns: Mapping[str, Column]) -> dict[str, str]:
    if taken := [name for name in columns if name in RESERVED or len(name) > LONGEST_NAME]:
        raise bad_config(
            f"no column of .npz and .mat can have the name {', '.join(taken)}",
            "write .parquet or .csv, or choose others with --columns",
        )
    return {name: column.unit for name, column in columns.items()}


def read_npz(path: Path) -> tuple[SampleBlock, dict[str, Column]]:
    """Read what `convert` wrote as .npz; return the samples and the columns with their units.

    Raises BAD_DATA when it cannot be read, or was not written by imumon.
    """
    try:
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as file:
            values = {name: file[name] for name in file.files}
        units: dict[str, str] = json.loads(str(values.pop("units")))
        block, columns = SampleBlock(values), dict[str, Column]()
        for name, part in values.items():
            dtype: ColumnType = "int64" if part.dtype == np.int64 else "float64"
            description = KNOWN[name].description if name in KNOWN else ""
            columns[name] = Column(name, units[name], dtype, description)
    except Exception as error:  # damaged bytes make NumPy raise whatever there is
        raise bad_data(
            f"{path}: cannot be read as a table of imumon: {error}", "imumon export writes one"
        ) from error
    return block, columns
