"""What packets carry: numbers at fixed places, read through a structured type of NumPy.

Packets are alike when their *signature* is the same: kind, length, and the bytes that say what they carry.
The first packet of each signature is looked at in Python; all that are like it are read at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, missing
from imumon.columns import KNOWN, Column
from imumon.protocols.base import MAIN, ONLY_CORRECTED, Groups, Packets, Timing
from imumon.protocols.epochs import GENERATION
from imumon.protocols.framing import Decoder, Found, Frame, windows
from imumon.protocols.numbers import WRAPPING, Derived, Placed, is_missing, record_type

MOST_LAYOUTS = 4096
"""Signatures that are remembered: so many come of random bytes alone."""


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
    """

    def __init__(self, numbers: Sequence[Placed], derived: Sequence[Derived] = ()) -> None:
        first = {item.name: item for item in reversed(numbers) if item.value.column is not None}
        self._numbers = [*reversed(first.values())]
        self._derived = [item for item in derived if first.keys() >= {*item.sources}]
        self.of_column = {item.name: item.group for item in self._numbers if item.group}
        sent = [item.value.column for item in self._numbers if item.value.column is not None]
        for made in self._derived:
            sent += made.results
            if made.sources[0] in self.of_column:
                names = (column.name for column in made.results)
                self.of_column |= dict.fromkeys(names, self.of_column[made.sources[0]])
        self.columns = tuple(column for column in sent if not column.name.startswith("_"))
        self.beyond: set[str] = set()
        """Columns of which values came that no column of integers holds: they are missing."""
        self._wide = [
            item.name
            for item in self._numbers
            if item.value.type in ("u64", "i64") and item.name not in WRAPPING
        ]
        self._type = record_type(self._numbers, max((item.end for item in self._numbers), default=1))

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        records = found.bytes(self._type.itemsize).view(self._type)[:, 0]
        columns = {item.name: item.read(records[item.name]) for item in self._numbers}
        self.beyond.update(name for name in self._wide if np.any(columns[name] == NO_INT))
        for made in self._derived:
            for column, values in zip(made.results, made.decode(columns), strict=True):
                sent = columns.get(column.name)
                columns[column.name] = values if sent is None else np.where(is_missing(sent), values, sent)
        return columns


def groups_of(layouts: Iterable[Layout], names: Sequence[str] = (), apart: Sequence[str] = ()) -> Groups:
    """Return the groups of layouts after these; a column of several groups has that of the first layout.

    Parameters
    ----------
    layouts : iterable of Layout
        All that may come.
    names : sequence of str
        Groups that come first, behind the main one.
    apart : sequence of str
        Groups that never join the rows of the main one.
    """
    of_column: dict[str, str] = {}
    there = dict.fromkeys((MAIN, *names))
    for layout in layouts:
        of_column = layout.of_column | of_column
        there |= dict.fromkeys(layout.of_column.values())
    order = [*there]
    numbers = {column: order.index(group) for column, group in of_column.items()}
    return Groups(tuple(order), numbers, tuple(name in apart for name in order))


_ORDER = {name: place for place, name in enumerate(KNOWN)}


def _place(name: str) -> tuple[int, str]:
    """Return what columns are sorted by: the canonical ones first, in their order."""
    return _ORDER.get(name, len(_ORDER)), name


class Alike(NamedTuple):
    """Packets of one signature: their rows, the number of their frame, and the first of them."""

    rows: IntArray
    frame: int
    packet: bytes
    key: tuple[int, int, bytes]
    """The signature: frame, length, and the bytes that say what is in the packet."""


class LayoutDecoder(Decoder):
    """Decodes packets by layouts; a row for each that has one.

    Parameters
    ----------
    frames : sequence of Frame
        Kinds of packets.
    timing : Timing
        How the device counts time.
    groups : Groups, optional
        Groups of all columns that may come; none where each packet is a row.
    possible : iterable of Column
        All columns that may come.
    """

    _remedy = ""
    """What to send besides rates that the device has corrected."""

    def __init__(
        self, frames: Sequence[Frame], timing: Timing, groups: Groups | None, possible: Iterable[Column]
    ) -> None:
        super().__init__(frames)
        self.timing, self.groups = timing, groups
        self._layouts: list[Layout] = []
        self._group_bits: list[int] = []
        self._numbers: dict[tuple[int, int, bytes], int] = {}
        arrival = {"arrival_time_ns": KNOWN["arrival_time_ns"]}
        self._possible = arrival | {column.name: column for column in possible}
        self._columns = dict(arrival)
        self._sent: dict[str, Column] = {}
        """Columns of the packets that came so far."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all layouts that have come so far."""
        self._search(final=False)
        return tuple(self._columns[name] for name in sorted(self._columns, key=_place))

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """All columns that may ever come."""
        return tuple((self._possible | self._columns).values())

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
            self._warn(ONLY_CORRECTED + self._remedy)
        for name in sorted({name for one in self._layouts if isinstance(one, Record) for name in one.beyond}):
            self._warn(
                f"{name}: numbers beyond 64 bits with a sign are missing in the table;"
                " two columns of u32 have all the bits"
            )
        return super().warnings()

    def _signature(self, packet: bytes) -> Sequence[int]:
        """Return the places of the bytes that say what is in a packet."""
        raise NotImplementedError

    def _layout(self, alike: Alike) -> Layout | None:
        """Return what packets of a signature carry; None: nothing for a row."""
        raise NotImplementedError

    def _plain(self, found: Found) -> Found:
        """Return the packets as the layouts have them, where they are sent in another form."""
        return found

    def _alike(self, found: Found) -> Iterator[Alike]:
        """Yield the packets by their signatures, in the order of the first of each."""
        left = np.arange(len(found))
        while len(left):
            one = int(left[0])
            frame, size = int(found.frame[one]), int(found.length[one])
            packet = found.held[found.at[one] :][:size].tobytes()
            places = [*self._signature(packet)]
            same = (found.length[left] == size) & (found.frame[left] == frame)
            key = b""
            if places:
                heads = windows(found.held, found.at[left[same]], max(places) + 1)[:, places]
                key = bytes(packet[k] for k in places)
                same[same] = np.all(heads == np.frombuffer(key, np.uint8), axis=1)
            yield Alike(left[same], frame, packet, (frame, size, key))
            left = left[~same]

    def _layout_numbers(self, found: Found) -> IntArray:
        """Return which layout each packet has, as `_add` numbers them; -1: nothing for a row."""
        numbers = np.full(len(found), -1, np.int64)
        for alike in self._alike(found):
            numbers[alike.rows] = self._number(alike)
        return numbers

    def _number(self, alike: Alike) -> int:
        """Return the number of the layout of packets of one signature."""
        if alike.key not in self._numbers:
            layout = self._layout(alike)
            self._numbers[alike.key] = -1 if layout is None else self._add(layout)
        return self._numbers[alike.key]

    def _add(self, layout: Layout) -> int:
        """Add a layout; return its number."""
        names = () if self.groups is None else self.groups.names
        for column in layout.columns:
            self._columns.setdefault(column.name, column)
        self._layouts.append(layout)
        bits = sum(1 << names.index(group) for group in {*layout.of_column.values()} if names)
        self._group_bits.append(bits or self._no_group)
        return len(self._layouts) - 1

    @property
    def _no_group(self) -> int:
        """Bit of the group of packets that have nothing of any group."""
        return 1

    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        if len(self._numbers) > MOST_LAYOUTS:
            for known in (self._numbers, self._layouts, self._group_bits):
                known.clear()
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
