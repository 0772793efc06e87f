"""A run as a file of other programs: NumPy, MATLAB, ROS 2."""

from __future__ import annotations

import json
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal
from zipfile import BadZipFile

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import KNOWN, Column, ColumnType
from imumon.errors import ImumonError, Reason
from imumon.recordings.table import read_table

CONVERTED = (".npz", ".mat", ".mcap")
LONGEST_NAME = 63
"""Of a variable in MATLAB; a longer one is cut."""


def convert(
    tables: Mapping[str, Path], out: Mapping[str, Path], axes: Literal["FLU", "FRD"] | None
) -> tuple[dict[str, Path], list[str]]:
    """Write Parquet tables as files of the suffix of `out`; return what was made, and what was left out.

    Raises BAD_CONFIG when a package that is needed is not installed, or the format has no place for any of
    it.

    `tables`, `out`: of each stream.  All streams of a ROS 2 bag go to the first.
    """
    first = next(iter(out.values()))
    if first.suffix == ".mcap":
        from imumon.recordings.ros2 import write_ros2

        written = write_ros2(tables, first, axes)
        if not written.streams:
            raise ImumonError(
                Reason.BAD_CONFIG,
                f"there is nothing to write as messages of ROS 2: {'; '.join(written.left_out)}",
                "leave --columns out, or name a whole vector: gyro_x,gyro_y,gyro_z",
            )
        return dict.fromkeys(written.streams, first), written.left_out
    for stream, path in tables.items():
        block, columns = read_table(path)
        {".npz": write_npz, ".mat": _mat}[first.suffix](out[stream], dict(block.columns), columns)
    return dict(out), []


def write_npz(file: Path | BinaryIO, values: Mapping[str, Any], columns: Mapping[str, Column]) -> None:
    """Write the columns, and `units`, a text in JSON."""
    units = json.dumps({name: column.unit for name, column in columns.items()})
    np.savez_compressed(file, units=np.array(units), **values)


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
    except (OSError, ValueError, TypeError, KeyError, EOFError, BadZipFile) as error:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: cannot be read as a table of imumon: {error}",
            "imumon export writes one",
        ) from error
    return block, columns


def _mat(path: Path, values: Mapping[str, Any], columns: Mapping[str, Column]) -> None:
    """Write the columns as vectors, and the struct `units`."""
    from scipy.io import savemat

    short = {name[:LONGEST_NAME]: part for name, part in values.items()}
    units = {name[:LONGEST_NAME]: column.unit for name, column in columns.items()}
    savemat(path, {**short, "units": units}, do_compression=True, long_field_names=True, oned_as="column")
