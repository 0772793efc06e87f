"""Tables of fields for protocols whose packets carry identified fields, and the decoder they make."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.compiled import alone, filled, record
from imumon.protocols.base import CAPACITY, COMMON, MAIN, CompiledDecoder, Groups, Timing
from imumon.protocols.numbers import NUMBER_TYPES, Derived, Value
from imumon.protocols.tagged_kernel import (
    ANY_SIZE,
    LOG_FULL,
    ROWS_FULL,
    SHAPES,
    CompiledField,
    CompiledValue,
    Rows,
    ShortArray,
    State,
    Table,
    scan_packets,
)


@dataclass(frozen=True, slots=True)
class Field:
    """A field as it comes: identifier, name, what is in it, and with which others it belongs together.

    Without values it may have any size.  A field of no group (times, counters) goes with the others of its
    packet.
    """

    key: int
    name: str
    values: tuple[Value, ...] = ()
    group: str = MAIN

    @property
    def size(self) -> int:
        """Bytes of data, or `ANY_SIZE`."""
        return sum(NUMBER_TYPES[value.type].size for value in self.values) if self.values else ANY_SIZE

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the values."""
        return tuple(value.column for value in self.values if value.column is not None)


OTHER = "other"
"""Stream of packets that have nothing but fields of no group."""


class FieldTable:
    """The fields of a protocol, compiled for the kernel.

    Parameters
    ----------
    fields : sequence of Field
        In the order in which their columns appear.  Several may have the same key and differ in size.
    derived : sequence of Derived
        Columns that are computed.  A column whose name begins with "_" is only a source of such.
    apart : collection of str
        Groups that are streams of their own from the beginning.
    """

    def __init__(
        self, fields: Sequence[Field], derived: Sequence[Derived] = (), apart: Collection[str] = ()
    ) -> None:
        self.fields = tuple(fields)
        self.derived = tuple(derived)
        places: dict[str, int] = {}
        self.columns: dict[str, Column] = {}
        self.float_count, self.int_count = 0, 2  # the first integer columns: time of arrival, groups
        for column in (column for field in fields for column in field.columns):
            if column.name in places:
                continue
            self.columns[column.name] = column
            if column.dtype == "float64":
                places[column.name] = self.float_count
                self.float_count += 1
            else:
                places[column.name] = ~self.int_count
                self.int_count += 1
        self.places = places
        self.groups = self._group(apart)
        self._compiled: dict[int, Table] = {}

    def _group(self, apart: Collection[str]) -> Groups:
        """Return the groups of the columns; a column of fields of several groups has that of the first."""
        there = dict.fromkeys(field.group for field in self.fields if field.group)
        names = tuple(dict.fromkeys((MAIN, *there, OTHER)))
        of_column: dict[str, int] = {}
        for field in self.fields:
            for column in field.columns if field.group else ():
                if column.name not in COMMON:
                    of_column.setdefault(column.name, names.index(field.group))
        for derived in self.derived:
            group = of_column.get(derived.sources[0])
            for column in derived.results if group is not None else ():
                of_column.setdefault(column.name, group or 0)
        return Groups(names, of_column, tuple(name in apart for name in names))

    def compiled(self, framing: int) -> Table:
        """Return fields and values for the kernel, which only reads them."""
        if framing not in self._compiled:
            self._compiled[framing] = self._compile(framing)
        return self._compiled[framing]

    def _compile(self, framing: int) -> Table:
        field_of: ShortArray = np.full(1 << 16, -1, np.int16)
        bits = {name: 1 << number for number, name in enumerate(self.groups.names)}
        fields: list[CompiledField] = []
        values: list[CompiledValue] = []
        for number, field in enumerate(self.fields):
            first, offset = len(values), 0
            for value in field.values:
                kind = NUMBER_TYPES[value.type]
                if value.column is not None:
                    place = self.places[value.column.name]
                    values.append(CompiledValue(kind.code, kind.size, offset, place, value.factor))
                offset += kind.size
            other, bit = int(field_of[field.key]), bits.get(field.group, 0)
            fields.append(CompiledField(field.size, first, len(values), other, bit))
            field_of[field.key] = number
        return Table(framing, field_of, filled(CompiledField, fields), filled(CompiledValue, values))


@dataclass(frozen=True, slots=True)
class _Seen:
    """Which fields have come (a byte each), and what that means for the columns."""

    key: bytes
    stored: tuple[Column, ...]
    derived: tuple[Derived, ...]
    shown: tuple[Column, ...]


class TaggedDecoder(CompiledDecoder):
    """Decodes Xbus or MIP by a table of fields; a row for each packet that carries a known one.

    Parameters
    ----------
    table : FieldTable
        With a role FIXED, its first field is the whole payload.
    framing : int
        XBUS or MIP.
    roles : mapping of int to int
        What each packet type is; those not named are messages.
    type_names : mapping of int to str
        Names of the packet types; those not named are shown as numbers.
    timing : Timing
        How the device counts time.
    """

    def __init__(
        self,
        table: FieldTable,
        framing: int,
        roles: Mapping[int, int],
        type_names: Mapping[int, str],
        timing: Timing,
    ) -> None:
        super().__init__()
        self.timing = timing
        self.table = table
        self.groups = table.groups
        self._type_names = type_names
        self._state = record(State, **SHAPES)
        self._states = alone(self._state)
        for kind, role in roles.items():
            self._state.roles[kind] = role
        self._compiled = table.compiled(framing)
        floats = np.zeros((table.float_count, CAPACITY + 1))
        ints = np.zeros((table.int_count, CAPACITY + 1), np.int64)
        self._decoded = Rows(floats, ints, np.zeros(len(table.fields), np.int64))
        self._seen = _Seen(b"", (), (), (KNOWN["arrival_time_ns"],))

    def _scan(self, final: bool) -> bool:
        while True:
            end = scan_packets(final, self._streams, self._states, self._compiled, self._decoded)
            if end != LOG_FULL:
                return bool(end == ROWS_FULL)
            self._read_log()

    def _read_log(self) -> None:
        log = self._state.log[: self._state.logged].tobytes()
        self._state.logged = 0
        while log:
            kind, size = log[0], int.from_bytes(log[1:3], "big")
            for text in self._describe(kind, log[3 : 3 + size]):
                self._say(text)
            log = log[3 + size :]

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        """Say in words what a message that is not data tells the user, if anything."""
        del kind, payload
        return ()

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data, and what of it is not understood."""
        self._read_log()
        for (key, size), _ in self.unknown_fields().items():
            self._say(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
        return super().notices()

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def unknown_fields(self) -> dict[tuple[int, int], int]:
        """Return how often fields came that the table lacks, by identifier and size."""
        state = self._state
        kinds = slice(state.unknown_kinds)
        keys, sizes = state.unknown_key[kinds].tolist(), state.unknown_size[kinds].tolist()
        return dict(zip(zip(keys, sizes, strict=True), state.unknown_count[kinds].tolist(), strict=True))

    def seen_fields(self) -> dict[Field, int]:
        """Return how often each known field came, those that did not left out."""
        counts = self._decoded.seen
        return {self.table.fields[i]: int(counts[i]) for i in np.flatnonzero(counts)}

    def _look(self) -> _Seen:
        """Return what follows from the fields that have come; worked out anew only when there are more."""
        key = (self._decoded.seen > 0).tobytes()
        if key != self._seen.key:
            names = {column.name for field in self.seen_fields() for column in field.columns}
            stored = tuple(column for name, column in self.table.columns.items() if name in names)
            derived = tuple(item for item in self.table.derived if names.issuperset(item.sources))
            shown = {column.name: column for column in stored if not column.name.startswith("_")}
            for column in (column for item in derived for column in item.results):
                shown.setdefault(column.name, column)
            self._seen = _Seen(key, stored, derived, (KNOWN["arrival_time_ns"], *shown.values()))
        return self._seen

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all fields of the protocol."""
        return (KNOWN["arrival_time_ns"], *self.table.columns.values())

    @property
    def columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all fields that have come so far."""
        return self._look().shown

    def _packets_by_type(self) -> dict[str, int]:
        counts = self._state.types
        return {self._type_name(int(kind)): int(counts[kind]) for kind in np.flatnonzero(counts)}

    def _type_name(self, kind: int) -> str:
        return self._type_names.get(kind, f"0x{kind:02X}")

    def _rows(self, n: int) -> SampleBlock:
        seen = self._look()
        found: dict[str, ColumnArray] = {"arrival_time_ns": self._decoded.ints[0, :n].copy()}
        for column in seen.stored:
            values = self._cells(column, n)
            found[column.name] = values.copy()
            values[:] = NO_INT if column.dtype == "int64" else np.nan
        for derived in seen.derived:
            for column, values in zip(derived.results, derived.decode(found), strict=True):
                found[column.name] = _fill(found.get(column.name), values)
        return SampleBlock({column.name: found[column.name] for column in seen.shown})

    def _packet_groups(self, n: int) -> IntArray:
        groups = self._decoded.ints[1, :n].copy()
        groups[groups == 0] = 1 << (len(self.table.groups.names) - 1)
        return groups

    def _cells(self, column: Column, n: int) -> ColumnArray:
        """Return a view of the first n values of a column; where nothing was written they are missing."""
        place = self.table.places[column.name]
        return self._decoded.floats[place, :n] if place >= 0 else self._decoded.ints[~place, :n]


def _fill(values: ColumnArray | None, others: ColumnArray) -> ColumnArray:
    """Return values, with others where they are missing."""
    if values is None:
        return others
    return np.where(np.isnan(values) if values.dtype == np.float64 else values == NO_INT, others, values)
