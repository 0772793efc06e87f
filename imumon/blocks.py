"""SampleBlock: n samples as a struct of arrays, the only thing that flows down the pipeline."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ColumnArray = npt.NDArray[Any]
Columns = Mapping[str, ColumnArray]
"""By their names, (n,) each."""


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """Samples in order of arrival, one array per column.

    Raises ValueError when the arrays differ in length.

    Parameters
    ----------
    columns : mapping of str to array, each of shape (n,)
        float64 or int64, named and in the units of `imumon.columns.KNOWN`.  Not to be written to.
    """

    columns: Columns

    def __repr__(self) -> str:
        """Return the size in a line."""
        return f"<SampleBlock: {len(self):,} rows of {len(self.columns)} columns>"

    def __post_init__(self) -> None:
        """Check that all columns have the same length."""
        lengths = {len(values) for values in self.columns.values()}
        if len(lengths) > 1:
            raise ValueError(f"columns of different length in one block: {sorted(lengths)}")

    def __len__(self) -> int:
        """Return the number of samples."""
        return next((len(values) for values in self.columns.values()), 0)

    def __contains__(self, name: object) -> bool:
        """Return whether there is a column of this name."""
        return name in self.columns

    def __getitem__(self, name: str) -> ColumnArray:
        """Return the column of this name, shape (n,)."""
        return self.columns[name]

    @property
    def gyro(self) -> FloatArray | None:
        """Angular rate in rad/s, (n, 3), or None."""
        return self.vector("gyro")

    @property
    def accel(self) -> FloatArray | None:
        """Specific force in m/s², (n, 3), or None."""
        return self.vector("accel")

    @property
    def mag(self) -> FloatArray | None:
        """Magnetic field, (n, 3), or None."""
        return self.vector("mag")

    @property
    def temperature(self) -> FloatArray | None:
        """Temperature in °C, (n, 1) or (n, 3) when there is one per axis, or None."""
        if "temperature" in self.columns:
            return self.columns["temperature"][:, None]
        return self.vector("temperature")

    @property
    def quaternion(self) -> FloatArray | None:
        """Reported attitude w, x, y, z, body to reference, (n, 4), or None."""
        return self.vector("q", "wxyz")

    def vector(self, name: str, axes: str = "xyz") -> FloatArray | None:
        """Return ``name_x, name_y, ...`` stacked to (n, len(axes)), or None when one is missing."""
        names = [f"{name}_{axis}" for axis in axes]
        return self.stacked(names) if all(column in self.columns for column in names) else None

    def stacked(self, names: Sequence[str]) -> FloatArray:
        """Return columns side by side, (n, len(names)); NaN where there is no such column."""
        stacked = np.full((len(self), len(names)), np.nan)
        for j, name in enumerate(names):
            if name in self.columns:
                stacked[:, j] = self.columns[name]
        return stacked

    def with_columns(self, extra: Columns) -> "SampleBlock":
        """Return a block that has these columns as well (or instead, where the name exists)."""
        return SampleBlock({**self.columns, **extra})

    def rows(self, start: int, stop: int) -> "SampleBlock":
        """Return samples start..stop as views."""
        return self.kept(slice(start, stop))

    def kept(self, keep: BoolArray | IntArray | slice) -> "SampleBlock":
        """Return the samples to keep."""
        return SampleBlock({name: values[keep] for name, values in self.columns.items()})


NO_INT = int(np.iinfo(np.int64).min)
"""Stands for "not sent" in an int64 column within imumon; tables write it as null, `with_nan` as NaN."""


def missing(n: int, dtype: npt.DTypeLike) -> ColumnArray:
    """Return n missing values: NaN, or `NO_INT` for integers."""
    return np.full(n, NO_INT if np.dtype(dtype) == np.int64 else np.nan)


def nan_for_missing(values: ColumnArray) -> ColumnArray:
    """Return a column as users get it: integers of which some are missing as float64, those as NaN."""
    if values.dtype != np.int64 or not (absent := values == NO_INT).any():
        return values
    return np.where(absent, np.nan, values)


def with_nan(block: SampleBlock) -> SampleBlock:
    """Return a block whose missing integers are NaN; columns that lack nothing are the same arrays."""
    return SampleBlock({name: nan_for_missing(values) for name, values in block.columns.items()})


def join(blocks: Sequence[SampleBlock]) -> SampleBlock:
    """Join blocks in order; a column that only some have is `missing` in the others."""
    if len(blocks) == 1:
        return blocks[0]
    types = {name: block[name].dtype for block in blocks for name in block.columns}
    return SampleBlock(
        {
            name: np.concatenate(
                [block[name] if name in block else missing(len(block), dtype) for block in blocks]
            )
            for name, dtype in types.items()
        }
    )
