"""Numbers at fixed places of a packet, read and written through a structured type of NumPy."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, missing
from imumon.columns import KNOWN, Column
from imumon.protocols.base import MAIN, ONLY_CORRECTED, Groups, Packets, Timing
from imumon.protocols.epochs import GENERATION
from imumon.protocols.framing import Found, Frame, FramedDecoder
from imumon.protocols.numbers import NUMBER_TYPES, WRAPPING, Derived, Placed, is_missing, record_type
from imumon.protocols.stream import ByteArray


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
    numbers : sequence of Placed
        Of several for one column the first counts.
    derived : sequence of Derived
        Columns that are computed from others, which have names that begin with "_".
    size : int
        Bytes of the packets; 0: up to the last number.
    """

    def __init__(self, numbers: Sequence[Placed], derived: Sequence[Derived] = (), size: int = 0) -> None:
        first: dict[str, Placed] = {}
        for item in numbers:
            if item.value.column is not None:
                first.setdefault(item.name, item)
        self._numbers = [*first.values()]
        self._derived = [item for item in derived if first.keys() >= set(item.sources)]
        self.of_column = {name: item.group for name, item in first.items() if item.group}
        for made in self._derived:
            if made.sources[0] in self.of_column:
                self.of_column |= dict.fromkeys(
                    (c.name for c in made.results), self.of_column[made.sources[0]]
                )
        sent = [item.value.column for item in self._numbers if item.value.column is not None]
        shown = [*sent, *(column for item in self._derived for column in item.results)]
        self.columns = tuple(column for column in shown if not column.name.startswith("_"))
        self.beyond: set[str] = set()
        """Columns of which values came that no column of integers holds: they are missing."""
        self._wide = {
            item.name
            for item in self._numbers
            if NUMBER_TYPES[item.value.type].size == 8 and NUMBER_TYPES[item.value.type].integer
            if item.value.column is not None and item.value.column.dtype == "int64"
            if item.name not in WRAPPING
        }
        self._size = size or max((item.end for item in self._numbers), default=1)
        self._type = record_type(self._numbers, self._size)

    def complaints(self) -> list[str]:
        """Return what is to be said of columns that do not hold all that was sent."""
        return [
            f"{name}: numbers beyond 64 bits with a sign are missing in the table;"
            " two columns of u32 have all the bits"
            for name in sorted(self.beyond)
        ]

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        return self.columns_of(found.bytes(self._size))

    def columns_of(self, packets: ByteArray) -> dict[str, ColumnArray]:
        """Return a value a packet for each column, of the bytes of the packets, (n, size)."""
        records = packets.view(self._type)[:, 0]
        columns = {item.name: item.read(records[item.name]) for item in self._numbers}
        for name in self._wide - self.beyond:
            if np.any(columns[name] == NO_INT):
                self.beyond.add(name)
        for made in self._derived:
            for column, values in zip(made.results, made.decode(columns), strict=True):
                sent = columns.get(column.name)
                columns[column.name] = values if sent is None else np.where(is_missing(sent), values, sent)
        return columns


_ORDER = {name: place for place, name in enumerate(KNOWN)}


def _place(name: str) -> tuple[int, str]:
    """Return what columns are sorted by: the canonical ones first, in their order."""
    return _ORDER.get(name, len(_ORDER)), name


def alike(values: IntArray) -> tuple[IntArray, IntArray]:
    """Return the different values, and which of them each is; where all are the same, nothing is sorted."""
    if len(values) and np.all(values == values[0]):
        return values[:1], np.zeros(len(values), np.int64)
    different, which = np.unique(values, return_inverse=True)
    return different, which.reshape(-1)


class LayoutDecoder(FramedDecoder):
    """Decodes packets by layouts; a row for each that has one.

    Parameters
    ----------
    frames : sequence of Frame
        Kinds of packets.
    timing : Timing
        How the device counts time.
    group_names : sequence of str
        Groups besides the main one, and of these apart those that never join its rows.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        timing: Timing,
        group_names: Sequence[str] = (),
        apart: Sequence[str] = (),
    ) -> None:
        super().__init__(frames)
        self.timing = timing
        names = (MAIN, *group_names)
        self._of_column: dict[str, int] = {}
        self.groups = Groups(names, self._of_column, tuple(name in apart for name in names))
        self._layouts: list[Layout] = []
        self._group_bits: list[int] = []
        self._columns: dict[str, Column] = {"arrival_time_ns": KNOWN["arrival_time_ns"]}
        self._sent: dict[str, Column] = {}
        """Columns of the packets that came so far."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all layouts that have come so far."""
        self._search(final=False)
        return tuple(self._columns[name] for name in sorted(self._columns, key=_place))

    def take_packets(self) -> Packets:
        """Return the packets decoded since the last call, with all columns that have come so far."""
        packets = super().take_packets()
        block = packets.block
        self._sent |= {name: self._columns[name] for name in block.columns}
        columns = {
            name: block[name] if name in block else missing(len(block), self._sent[name].dtype)
            for name in sorted(self._sent, key=_place)
        }
        return Packets(SampleBlock(columns), packets.groups)

    def warnings(self) -> list[str]:
        """Return, once each, why numbers are not fit for an estimate; see `Decoder.warnings`."""
        corrected = "gyro_compensated_x" in self._columns and "gyro_x" not in self._columns
        if corrected and sum(self._by_frame) >= GENERATION:
            self._warn(ONLY_CORRECTED)
        for layout in self._layouts:
            for text in layout.complaints() if isinstance(layout, Record) else ():
                self._warn(text)
        return super().warnings()

    @abstractmethod
    def _layout_numbers(self, found: Found) -> IntArray:
        """Return which layout each packet has, as `add` numbers them; -1: nothing for a row."""

    def _plain(self, found: Found) -> Found:
        """Return the packets as the layouts have them, where they are sent in another form."""
        return found

    def _add(self, layout: Layout) -> int:
        """Add a layout; return its number."""
        names = self.groups.names if self.groups else ()
        for name, group in layout.of_column.items():
            self._of_column.setdefault(name, names.index(group))
        bits = sum(1 << names.index(group) for group in {*layout.of_column.values()})
        return self._add_layout(layout, bits or 1)

    def _add_layout(self, layout: Layout, group_bits: int) -> int:
        """Add a layout whose packets have something of these groups; return its number."""
        for column in layout.columns:
            self._columns.setdefault(column.name, column)
        self._layouts.append(layout)
        self._group_bits.append(group_bits)
        return len(self._layouts) - 1

    def _forget_layouts(self) -> None:
        """Begin to number layouts anew; the columns stay."""
        self._layouts.clear()
        self._group_bits.clear()

    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        found = self._plain(found)
        numbers = self._layout_numbers(found)
        rows = np.flatnonzero(numbers >= 0)
        numbers = numbers[rows]
        columns: dict[str, ColumnArray] = {"arrival_time_ns": arrival_ns[rows]}
        groups = np.ones(len(rows), np.int64)
        for number in np.flatnonzero(np.bincount(numbers)).tolist():
            mine = np.flatnonzero(numbers == number)
            layout = self._layouts[number]
            groups[mine] = self._group_bits[number]
            values = layout.read(found.only(rows[mine]))
            for column in layout.columns:
                if len(mine) == len(rows):
                    columns[column.name] = values[column.name]
                    continue
                if column.name not in columns:
                    columns[column.name] = missing(len(rows), column.dtype)
                columns[column.name][mine] = values[column.name]
        return Packets(SampleBlock(columns), groups)
