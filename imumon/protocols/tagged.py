"""Tables of fields for protocols whose packets carry identified fields, and the decoder they make."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.protocols.base import (
    CAPACITY,
    CHECKSUM_ERRORS,
    COMMON,
    IN_PACKETS,
    LENGTH_ERRORS,
    MAIN,
    PACKETS,
    RECEIVED,
    ROWS,
    SKIPPED,
    ByteArray,
    Counters,
    Decoder,
    Groups,
    Timing,
)
from imumon.protocols.kernel import NUMBER_TYPES
from imumon.protocols.tagged_kernel import (
    ANY_SIZE,
    FIELDS,
    LOG_FULL,
    LOG_SIZE,
    LOGGED,
    ROLES,
    TYPES,
    UNKNOWN,
    UNKNOWN_KINDS,
    ShortArray,
    scan_packets,
)

MOST_NOTICES = 1000
"""Different notices that a decoder gives at the most; more would be a stream of rubbish."""


@dataclass(frozen=True, slots=True)
class Value:
    """A number in a field: its column (None: passed over), its type, and the factor to the unit."""

    column: Column | None
    type: str
    factor: float = 1.0


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


Columns = Mapping[str, ColumnArray]


@dataclass(frozen=True, slots=True)
class Derived:
    """Columns computed from others (a time from a date, a quaternion from a matrix), and back to encode."""

    sources: tuple[str, ...]
    results: tuple[Column, ...]
    decode: Callable[[Columns], list[ColumnArray]]
    encode: Callable[[Columns], list[ColumnArray]]


NO_GROUP = ""
"""Group of times and counters."""
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
        self._compile()

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

    def _compile(self) -> None:
        """Write fields and values into arrays."""
        self.field_of: ShortArray = np.full(1 << 16, -1, np.int16)
        self.compiled_fields: IntArray = np.zeros((len(self.fields), 5), np.int64)
        rows: list[tuple[int, int, int, int]] = []
        factors: list[float] = []
        for number, field in enumerate(self.fields):
            first, offset = len(rows), 0
            for value in field.values:
                kind = NUMBER_TYPES[value.type]
                if value.column is not None:
                    rows.append((kind.code, kind.size, offset, self.places[value.column.name]))
                    factors.append(value.factor)
                offset += kind.size
            other = self.field_of[field.key]
            bit = 1 << self.groups.names.index(field.group) if field.group else 0
            self.compiled_fields[number] = (field.size, first, len(rows) - first, other, bit)
            self.field_of[field.key] = number
        self.compiled_values: IntArray = np.array(rows, np.int64).reshape(-1, 4)
        self.factors: FloatArray = np.array(factors, np.float64)


@dataclass(frozen=True, slots=True)
class _Seen:
    """Which fields have come (a byte each), and what that means for the columns."""

    key: bytes
    stored: tuple[Column, ...]
    derived: tuple[Derived, ...]
    shown: tuple[Column, ...]


class TaggedDecoder(Decoder):
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
        self._framing = framing
        self._type_names = type_names
        self._state = np.zeros(FIELDS + len(table.fields), np.int64)
        for kind, role in roles.items():
            self._state[ROLES + kind] = role
        self._log: ByteArray = np.zeros(LOG_SIZE, np.uint8)
        self._floats: FloatArray = np.full((table.float_count, CAPACITY), np.nan)
        self._ints: IntArray = np.full((table.int_count, CAPACITY), NO_INT, np.int64)
        self._said: dict[str, bool] = {}
        self._seen = _Seen(b"", (), (), (KNOWN["arrival_time_ns"],))

    def discard(self) -> None:
        """Forget the rows decoded since the last call."""
        for column in self._look().stored:
            self._cells(column, int(self._state[ROWS]))[:] = NO_INT if column.dtype == "int64" else np.nan
        super().discard()

    def _scan(self, chunk: ByteArray, arrival_ns: int, final: bool) -> None:
        table = self.table
        while True:
            scan_packets(
                chunk,
                arrival_ns,
                final,
                self._framing,
                self._held,
                self._held_arrival,
                self._state,
                self._log,
                table.field_of,
                table.compiled_fields,
                table.compiled_values,
                table.factors,
                self._floats,
                self._ints,
            )
            if not self._state[LOGGED]:
                return
            self._read_log()
            if not self._state[LOG_FULL]:
                return
            chunk = chunk[:0]

    def _read_log(self) -> None:
        log = self._log[: self._state[LOGGED]].tobytes()
        self._state[LOGGED] = 0
        while log:
            kind, size = log[0], int.from_bytes(log[1:3], "big")
            for text in self._describe(kind, log[3 : 3 + size]):
                self._say(text)
            log = log[3 + size :]

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        """Say in words what a message that is not data tells the user, if anything."""
        del kind, payload
        return ()

    def _say(self, text: str) -> None:
        """Keep a notice unless it was given before."""
        if len(self._said) < MOST_NOTICES:
            self._said.setdefault(text, False)

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data, and what of it is not understood."""
        for (key, size), _ in self.unknown_fields().items():
            self._say(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
        new = [text for text, given in self._said.items() if not given]
        self._said.update(dict.fromkeys(new, True))
        return new

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def unknown_fields(self) -> dict[tuple[int, int], int]:
        """Return how often fields came that the table lacks, by identifier and size."""
        state = self._state
        slots = state[UNKNOWN : UNKNOWN + 3 * state[UNKNOWN_KINDS]].reshape(-1, 3)
        return {(int(key), int(size)): int(count) for key, size, count in slots}

    def seen_fields(self) -> dict[Field, int]:
        """Return how often each known field came, those that did not left out."""
        counts = self._state[FIELDS:]
        return {self.table.fields[i]: int(counts[i]) for i in np.flatnonzero(counts)}

    def _look(self) -> _Seen:
        """Return what follows from the fields that have come; worked out anew only when there are more."""
        key = (self._state[FIELDS:] > 0).tobytes()
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

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        state = self._state
        kinds = np.flatnonzero(state[TYPES:ROLES])
        return Counters(
            bytes_received=int(state[RECEIVED]),
            bytes_in_packets=int(state[IN_PACKETS]),
            bytes_skipped=int(state[SKIPPED]),
            packets=int(state[PACKETS]),
            checksum_errors=int(state[CHECKSUM_ERRORS]),
            length_errors=int(state[LENGTH_ERRORS]),
            packets_by_type={self._type_name(int(kind)): int(state[TYPES + kind]) for kind in kinds},
        )

    def _type_name(self, kind: int) -> str:
        return self._type_names.get(kind, f"0x{kind:02X}")

    def _rows(self) -> SampleBlock:
        n = int(self._state[ROWS])
        seen = self._look()
        found: dict[str, ColumnArray] = {"arrival_time_ns": self._ints[0, :n].copy()}
        for column in seen.stored:
            values = self._cells(column, n)
            found[column.name] = values.copy()
            values[:] = NO_INT if column.dtype == "int64" else np.nan
        for derived in seen.derived:
            for column, values in zip(derived.results, derived.decode(found), strict=True):
                found[column.name] = _fill(found.get(column.name), values)
        return SampleBlock({column.name: found[column.name] for column in seen.shown})

    def _packet_groups(self) -> IntArray:
        groups = self._ints[1, : int(self._state[ROWS])].copy()
        groups[groups == 0] = 1 << (len(self.table.groups.names) - 1)
        return groups

    def _cells(self, column: Column, n: int) -> ColumnArray:
        """Return a view of the first n values of a column; where nothing was written they are missing."""
        place = self.table.places[column.name]
        return self._floats[place, :n] if place >= 0 else self._ints[~place, :n]


def _fill(values: ColumnArray | None, others: ColumnArray) -> ColumnArray:
    """Return values, with others where they are missing."""
    if values is None:
        return others
    return np.where(np.isnan(values) if values.dtype == np.float64 else values == NO_INT, others, values)
