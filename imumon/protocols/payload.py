"""Numbers at fixed places of a packet, read and written through a structured type of NumPy."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock, missing
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import MAIN, Groups, Packets, Timing
from imumon.protocols.framing import Found, Frame, FramedDecoder
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged import Derived, Value
from imumon.protocols.tagged_encoder import packed


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


class Placed:
    """A layout of numbers that stand at the same places in every packet.

    Parameters
    ----------
    values : sequence of (Value, int, str)
        Numbers, where each begins in the packet, and the group that it belongs to.  Of several numbers for
        one column the first counts.
    big : bool
        Whether the most significant byte comes first.
    derived : sequence of Derived
        Columns that are computed from others, which have names that begin with "_".
    """

    def __init__(
        self, values: Sequence[tuple[Value, int, str]], big: bool = False, derived: Sequence[Derived] = ()
    ) -> None:
        names: dict[str, tuple[Value, int]] = {}
        self.of_column: dict[str, str] = {}
        for value, at, group in values:
            if value.column is not None and value.column.name not in names:
                names[value.column.name] = value, at
                if group:
                    self.of_column[value.column.name] = group
        self._derived = [item for item in derived if names.keys() >= set(item.sources)]
        for item in self._derived:
            if item.sources[0] in self.of_column:
                group = self.of_column[item.sources[0]]
                self.of_column |= {column.name: group for column in item.results}
        sent = [value.column for value, _ in names.values() if value.column is not None]
        shown = [*sent, *(column for item in self._derived for column in item.results)]
        self.columns = tuple(column for column in shown if not column.name.startswith("_"))
        self._values = [value for value, _ in names.values()]
        self._big = big
        formats: list[tuple[str, int] | str] = []
        for value in self._values:
            kind = NUMBER_TYPES[value.type]
            letter = "f" if not kind.integer else "i" if kind.signed or kind.size == 8 else "u"
            formats.append(("u1", 3) if kind.size == 3 else f"{'>' if big else '<'}{letter}{kind.size}")
        self._size = max((at + NUMBER_TYPES[value.type].size for value, at in names.values()), default=1)
        offsets = [at for _, at in names.values()]
        self._type = np.dtype(
            {"names": list(names), "formats": formats, "offsets": offsets, "itemsize": self._size}
        )

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        records = found.bytes(self._size).view(self._type)[:, 0]
        columns = {
            name: self._scaled(value, records[name])
            for name, value in zip(self._type.names or (), self._values, strict=True)
        }
        for item in self._derived:
            made = item.decode(columns)
            columns |= {column.name: values for column, values in zip(item.results, made, strict=True)}
        return columns

    def _scaled(self, value: Value, raw: ColumnArray) -> ColumnArray:
        assert value.column is not None
        kind = NUMBER_TYPES[value.type]
        if kind.size == 3:
            raw = _of_three_bytes(raw, self._big, kind.signed)
        if value.column.dtype == "int64":
            if kind.integer:
                return raw.astype(np.int64) * int(value.factor)
            with np.errstate(invalid="ignore"):  # a clock that is not a number becomes the least integer
                return np.rint(raw.astype(np.float64) * value.factor).astype(np.int64)
        with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
            result: FloatArray = raw.astype(np.float64)
        return result if value.factor == 1.0 else result * value.factor


def _of_three_bytes(three: ColumnArray, big: bool, signed: bool) -> IntArray:
    """Return integers of three bytes, (n, 3), which NumPy lacks."""
    high, middle, low = three.astype(np.int64).T[:: 1 if big else -1]
    whole: IntArray = high << 16 | middle << 8 | low
    return whole - ((whole >> 23) << 24) if signed else whole


_ORDER = {name: place for place, name in enumerate(KNOWN)}


def _place(name: str) -> tuple[int, str]:
    """Return what columns are sorted by: the canonical ones first, in their order."""
    return _ORDER.get(name, len(_ORDER)), name


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
        self._said: dict[str, bool] = {}
        self._warned: dict[str, bool] = {}

    @property
    def columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all layouts that have come so far."""
        self._search(final=False)
        return tuple(self._columns[name] for name in sorted(self._columns, key=_place))

    def take_packets(self) -> Packets:
        """Return the packets decoded since the last call; chunks do not change the order of columns."""
        packets = super().take_packets()
        names = sorted(packets.block.columns, key=_place)
        return Packets(SampleBlock({name: packets.block[name] for name in names}), packets.groups)

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
        for column in layout.columns:
            self._columns.setdefault(column.name, column)
        self._layouts.append(layout)
        self._group_bits.append(sum(1 << names.index(group) for group in {*layout.of_column.values()}) or 1)
        return len(self._layouts) - 1

    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        found = self._plain(found)
        numbers = self._layout_numbers(found)
        rows = np.flatnonzero(numbers >= 0)
        numbers = numbers[rows]
        columns: dict[str, ColumnArray] = {"arrival_time_ns": arrival_ns[rows]}
        groups = np.ones(len(rows), np.int64)
        for number in np.unique(numbers).tolist():
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

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data."""
        return _once(self._said)

    def warnings(self) -> list[str]:
        """Return, once each, why numbers are not fit for an estimate."""
        return _once(self._warned)

    def _say(self, text: str) -> None:
        self._said.setdefault(text, False)

    def _warn(self, text: str) -> None:
        self._warned.setdefault(text, False)


def _once(said: dict[str, bool]) -> list[str]:
    """Return the texts that were not given before."""
    new = [text for text, given in said.items() if not given]
    said.update(dict.fromkeys(new, True))
    return new


def written(values: Sequence[Value], block: SampleBlock, where: str, big: bool = False) -> ByteArray:
    """Return the numbers of each row one behind the other, (n, bytes); a column that is not there is zero.

    Raises
    ------
    ImumonError
        BAD_DATA when a value does not fit the number that carries it; BAD_CONFIG when there are no values.
    """
    if not values:
        raise ImumonError(Reason.BAD_CONFIG, f"{where}: there is nothing to send")
    rows = np.arange(len(block))
    parts = [packed(where, value, block.columns, rows) for value in values]
    return np.concatenate([part if big else part[:, ::-1] for part in parts], axis=1)
