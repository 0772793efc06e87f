"""Samples in memory, and what other programs make of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, overload

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray, SampleBlock, nan_for_missing, with_nan
from imumon.columns import Column
from imumon.files import as_path
from imumon.protocols.base import MAIN
from imumon.recordings.exports import side_path, write_npz
from imumon.recordings.table import TableWriter, arrow_table

TIMES = {"host_time_ns": "datetime64[ns]", "device_time_ns": "timedelta64[ns]"}
"""Columns that date a row, the better first, and NumPy's type of such times."""


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Samples in memory, with the unit of every column.

    A missing value is NaN; an integer column that lacks values is float64, a complete one is int64.

    Parameters
    ----------
    table : SampleBlock
        The samples, n of them, as the pipeline has them.
    columns : mapping of str to Column
        Unit, type and meaning of each column, in the order of a table.
    side : mapping of str to Samples
        The side streams of the device, such as a receiver, by name.
    """

    _table: SampleBlock
    columns: Mapping[str, Column]
    side: "Mapping[str, Samples]" = field(default_factory=dict)

    def __repr__(self) -> str:
        side = f", side streams {', '.join(self.side)}" if self.side else ""
        return f"<imumon.Samples: {len(self):,} rows of {len(self.columns)} columns{side}>"

    def __len__(self) -> int:
        return len(self._table)

    @overload
    def __getitem__(self, key: str) -> ColumnArray: ...

    @overload
    def __getitem__(self, key: slice) -> "Samples": ...

    def __getitem__(self, key: str | slice) -> "ColumnArray | Samples":
        """Return a column, shape (n,), or the rows of a slice as views; side streams stay whole."""
        if isinstance(key, slice):
            return Samples(self._table.kept(key), self.columns, self.side)
        return nan_for_missing(self._table[key])

    def __contains__(self, name: object) -> bool:
        return name in self._table

    @property
    def block(self) -> SampleBlock:
        """All columns as a block, for a stage or a pipeline."""
        return with_nan(self._table)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column."""
        return {name: column.unit for name, column in self.columns.items()}

    def to_numpy(self, *names: str) -> FloatArray:
        """Return these columns, or all, side by side as float64, shape (n, number of columns)."""
        return np.column_stack([np.asarray(self[name], np.float64) for name in names or self.columns])

    def to_arrow(self) -> Any:
        """Return a pyarrow table; missing values are null, unit and meaning stand in the fields' metadata."""
        return arrow_table(self._table, self.columns.values())

    def to_pandas(self) -> Any:
        """Return a pandas data frame indexed by time; ``attrs["units"]`` has the units.  Needs pandas.

        The index `time` is the host time (UTC), or the device time (timedelta) where no host time is known.
        The column `device_time` is the device time as timedelta.
        """
        import pandas as pd

        frame = self.to_arrow().to_pandas()
        times = self._times()
        if "device_time_ns" in times and "device_time" not in frame:
            frame.insert(0, "device_time", times["device_time_ns"])
        if "host_time_ns" in times:
            frame.index = pd.DatetimeIndex(times["host_time_ns"], tz="UTC", name="time")
        elif times:
            frame.index = pd.TimedeltaIndex(times["device_time_ns"], name="time")
        frame.attrs["units"] = self.units
        return frame

    def to_polars(self) -> Any:
        """Return a polars data frame.  Needs polars."""
        import polars

        return polars.from_arrow(self.to_arrow())

    def to_xarray(self) -> Any:
        """Return an xarray dataset over the dimension ``time``, units as attributes.  Needs xarray.

        The coordinate `time` is the host time (UTC), or the device time where no host time is known; the
        dimension is `sample` where neither is.
        """
        import xarray

        times = self._times()
        dimension = "time" if times and "time" not in self.columns else "sample"
        values = {}
        for name, column in self.columns.items():
            array = self[name]
            # Written as the integers that were sent, although NaN makes them floats in memory.
            gaps = array.dtype != self._table[name].dtype
            encoding = {"dtype": "int64", "_FillValue": NO_INT} if gaps else {}
            values[name] = xarray.Variable(dimension, array, {"units": column.unit}, encoding)
        coordinates = {}
        if dimension == "time":
            coordinates["time"] = (dimension, next(iter(times.values())))
        if "device_time_ns" in times and "device_time" not in self.columns:
            coordinates["device_time"] = (dimension, times["device_time_ns"])
        return xarray.Dataset(values, coordinates)

    def write(self, path: str | Path) -> None:
        """Write a table that `read` reads back; side streams go beside it, as NAME.STREAM.parquet.

        Raises BAD_CONFIG for a suffix other than .parquet, .csv and .npz, or without the folder; EXISTS when
        it would replace a file of a session; OSError when the disk is full or fails.  An existing file is
        replaced.
        """
        out = as_path(path)
        for stream, part in {MAIN: self, **self.side}.items():
            place = side_path(out, stream)
            if out.suffix == ".npz":
                write_npz(place, part._table.columns, part.columns)
            else:
                with TableWriter(place, part.columns) as table:
                    table.write(part._table)

    def _times(self) -> dict[str, Any]:
        """Return the columns `TIMES` as NumPy's times, but those that are absent or wholly missing."""
        there = {name: self._table[name] for name in TIMES if name in self._table}
        return {
            name: values.view(TIMES[name])  # a missing integer is the number that means NaT
            for name, values in there.items()
            if values.dtype == np.int64 and not (len(values) and (values == NO_INT).all())
        }
