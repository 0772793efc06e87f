"""What packets carry: numbers at fixed places, read through a structured type of NumPy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from imumon.blocks import ColumnArray
from imumon.columns import Column
from imumon.protocols.base import MAIN, Groups
from imumon.protocols.framing import Found
from imumon.protocols.numbers import Derived, Number, is_missing, record_type


class Layout(Protocol):
    """What packets of one kind carry."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """What `read` returns."""

    @property
    def of_column(self) -> dict[str, str]:
        """Group of each column that has one."""

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""


class Record:
    """A layout of numbers that stand at the same places in every packet.

    Parameters
    ----------
    numbers : sequence of Number
        Of several for one column the last counts.
    derived : sequence of Derived
        Columns that are computed from others, which have names that begin with "_".
    """

    def __init__(self, numbers: Sequence[Number], derived: Sequence[Derived] = ()) -> None:
        last = {item.name: item for item in numbers if item.column is not None}
        self._numbers = [*last.values()]
        self._derived = [made for made in derived if last.keys() >= {*made.sources}]
        self.of_column = {item.name: item.group for item in self._numbers if item.group}
        sent = [item.column for item in self._numbers if item.column is not None]
        for made in self._derived:
            sent += made.results
            if made.sources[0] in self.of_column:
                self.of_column |= dict.fromkeys(made.names, self.of_column[made.sources[0]])
        self.columns = tuple(column for column in sent if not column.name.startswith("_"))

    @cached_property
    def _type(self) -> np.dtype[np.void]:
        return record_type(self._numbers, max((item.end for item in self._numbers), default=1))

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        records = found.bytes(self._type.itemsize).view(self._type)[:, 0]
        columns = {item.name: item.read(records[item.name]) for item in self._numbers}
        for made in self._derived:
            for name, values in zip(made.names, made.decode(columns), strict=True):
                sent = columns.get(name)
                columns[name] = values if sent is None else np.where(is_missing(sent), values, sent)
        return columns


def groups_of(layouts: Iterable[Layout], names: Sequence[str] = (), apart: Sequence[str] = ()) -> Groups:
    """Return the groups of layouts after these; a column of several groups has that of the first layout.

    Parameters
    ----------
    layouts : iterable of Layout
        All that may come.
    names : sequence of str
        Groups that come first, behind the main one; `OTHER`: there is a stream of what has no group.
    apart : sequence of str
        Groups that never join the rows of the main one.
    """
    of_column, having = dict[str, str](), dict[str, tuple[int, ...]]()
    there = dict.fromkeys((MAIN, *names))
    for number, layout in enumerate(layouts):
        of_column = layout.of_column | of_column
        having |= {column: (*having.get(column, ()), number) for column in layout.of_column}
        there |= dict.fromkeys(layout.of_column.values())
    order = [*there]
    numbers = {column: order.index(group) for column, group in of_column.items()}
    return Groups(tuple(order), numbers, tuple(name in apart for name in order), having)
