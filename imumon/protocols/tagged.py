"""Packets that are lists of identified fields (Xbus, MIP): what their fields are, and the decoder.

====  =======================================  ==============================  =========================
      packet                                   field                           checksum
====  =======================================  ==============================  =========================
Xbus  FA, FF or 01, type, length (FF: 16 more  identifier (16 bits), size of   one byte: all but FA sum
      bits follow), fields                     the data, data                  to zero
MIP   75, 65, type, length, fields             size of the field, identifier,  two bytes: both sums of
                                               data                            Fletcher, modulo 256
====  =======================================  ==============================  =========================

Packets of one length whose field headers are the same carry the same numbers at the same places.  So the
first packet of each such layout is walked field by field, and all that are like it are read at once.

Other Xbus addresses than FF (the device on its own) and 01 are those of trackers behind an Xbus Master, which
answer only to commands; taking them for packets would make noise of every FA in damaged data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.columns import KNOWN, Column
from imumon.protocols.base import COMMON, MAIN, Groups, Timing
from imumon.protocols.frame_checks import Fletcher, Sum, Trailing
from imumon.protocols.framing import (
    IMPOSSIBLE,
    INCOMPLETE,
    NO_PACKET,
    Found,
    Frame,
    Lengths,
    counted_length,
    windows,
)
from imumon.protocols.numbers import NUMBER_TYPES, Derived, Placed, Value
from imumon.protocols.payload import LayoutDecoder, Record
from imumon.protocols.stream import ByteArray
from imumon.transport.statistics import Counters

MESSAGE, LIST, FIXED, COUNTED = range(4)
"""What a packet type is: told to the user, a list of fields, one field without header, or only counted."""

ANY_SIZE = -1
"""Size of a field that is recognised, counted and skipped whatever its length."""
LONGEST_XBUS_PAYLOAD = 2048
MOST_UNKNOWN = 64
"""Kinds of unknown fields that are counted one by one; all further ones are counted with the last."""
MOST_LAYOUTS = 4096
"""Layouts that are kept: so many come of random bytes alone."""
KIND_AT = 2
"""Place of the packet type."""
OTHER = "other"
"""Stream of packets that have nothing but fields of no group."""


def xbus_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the message at each place; see `imumon.protocols.framing.Lengths`."""
    last = len(held) - 1
    address, short, high, low = (held[np.minimum(at + k, last)].astype(np.int64) for k in (1, 3, 4, 5))
    long = high << 8 | low
    extended = short == 0xFF
    length = np.where(extended, long + 7, short + 5)
    length[extended & (long > LONGEST_XBUS_PAYLOAD)] = IMPOSSIBLE
    length[at + np.where(extended, 6, 4) > len(held)] = INCOMPLETE
    other = (address != 0xFF) & (address != 0x01)
    length[other] = np.where(at[other] + 1 < len(held), NO_PACKET, INCOMPLETE)
    return length


class Form(NamedTuple):
    """How packets and the fields in them are written."""

    name: str
    sync: bytes
    start: bytes
    """What the encoder begins a packet with."""
    lengths: Lengths
    check: Trailing
    longest: int
    """Most bytes of a payload."""
    begin: Callable[[Sequence[int]], int]
    """Place of the payload in a packet, of which at least the first four bytes are given."""
    header: int
    """Bytes of a field before its data."""
    key: Callable[[Sequence[int], int], int]
    """Key of the field whose header begins at this place of the packet."""
    size: Callable[[Sequence[int], int], int]
    """Bytes of its data."""


def _xbus_begin(packet: Sequence[int]) -> int:
    return 6 if packet[3] == 0xFF else 4


def _xbus_key(packet: Sequence[int], at: int) -> int:
    return packet[at] << 8 | packet[at + 1]


def _xbus_size(packet: Sequence[int], at: int) -> int:
    return packet[at + 2]


def _mip_begin(packet: Sequence[int]) -> int:
    del packet
    return 4


def _mip_key(packet: Sequence[int], at: int) -> int:
    return packet[KIND_AT] << 8 | packet[at + 1]


def _mip_size(packet: Sequence[int], at: int) -> int:
    return packet[at] - 2


XBUS = Form(
    name="Xbus",
    sync=b"\xfa",
    start=b"\xfa\xff",
    lengths=xbus_lengths,
    check=Sum(first=1, negated=True),
    longest=LONGEST_XBUS_PAYLOAD,
    begin=_xbus_begin,
    header=3,
    key=_xbus_key,
    size=_xbus_size,
)
MIP = Form(
    name="MIP",
    sync=b"\x75\x65",
    start=b"\x75\x65",
    lengths=counted_length(3, 1, 6, 261),
    check=Fletcher(),
    longest=255,
    begin=_mip_begin,
    header=2,
    key=_mip_key,
    size=_mip_size,
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


class FieldTable:
    """The fields of a protocol.

    Parameters
    ----------
    fields : sequence of Field
        Several may have the same key and differ in size.
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
        self.columns = {column.name: column for field in reversed(fields) for column in field.columns}
        self.groups = self._group(apart)
        self._of_key: dict[int, list[Field]] = {}
        for field in fields:
            self._of_key.setdefault(field.key, []).append(field)

    def find(self, key: int, size: int) -> Field | None:
        """Return the field with this key and so many bytes; None when there is none."""
        fields = reversed(self._of_key.get(key, ()))
        return next((field for field in fields if field.size in (size, ANY_SIZE)), None)

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


class _Contents(NamedTuple):
    """What is in packets that are alike."""

    layout: int
    """Number of their layout; -1: nothing for a row."""
    known: tuple[Field, ...]
    unknown: tuple[tuple[int, int], ...]
    """Key and size of fields that the table lacks."""


class TaggedDecoder(LayoutDecoder):
    """Decodes packets of identified fields by a table; a row for each packet that carries a known one.

    Parameters
    ----------
    table : FieldTable
        With a role FIXED, its first field is the whole payload.
    form : Form
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
        form: Form,
        roles: Mapping[int, int],
        type_names: Mapping[int, str],
        timing: Timing,
    ) -> None:
        super().__init__([Frame(form.name, form.sync, form.lengths, form.check, fits=self._fits)], timing)
        self.table = table
        self.groups = table.groups
        self._form = form
        self._type_names = type_names
        self._roles = np.full(256, MESSAGE, np.int64)
        self._roles[list(roles)] = list(roles.values())
        self._is_data = (self._roles == LIST) | (self._roles == FIXED)
        self._types = np.zeros(256, np.int64)
        self._contents: dict[tuple[int, ...], _Contents] = {}
        self._known: Counter[Field] = Counter()
        self._unknown: Counter[tuple[int, int]] = Counter()
        self.wrong_length = 0
        """Bytes of the latest payload that did not fit the one field of a packet."""

    # What is in a packet

    def _walk(self, packet: Sequence[int]) -> tuple[list[tuple[int, int, int]], list[int], bool]:
        """Return key, place and size of each field, where headers are, and if the fields fill the payload."""
        form = self._form
        at, end = form.begin(packet), len(packet) - form.check.size
        places = [*range(KIND_AT, at)]
        if self._roles[packet[KIND_AT]] == FIXED:
            only = self.table.fields[0]
            return [(only.key, at, end - at)], places, end - at == only.size
        fields = []
        while at + form.header <= end and (size := form.size(packet, at)) >= 0:
            places += range(at, at + form.header)
            fields.append((form.key(packet, at), at + form.header, size))
            at += form.header + size
        return fields, places, at == end

    def _alike(self, found: Found) -> Iterator[tuple[IntArray, list[int], list[tuple[int, int, int]], bool]]:
        """Yield the rows of packets whose headers are the same, their first packet, and what `_walk` says."""
        left = np.arange(len(found))
        while len(left):
            size = int(found.length[left[0]])
            packet = found.held[found.at[left[0]] :][:size].tolist()
            fields, places, fills = self._walk(packet)
            same = found.length[left] == size
            heads = windows(found.held, found.at[left[same]], size)[:, places]
            same[same] = np.all(heads == np.array(packet, np.uint8)[places], axis=1)
            yield left[same], packet, fields, fills
            left = left[~same]

    def _fits(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell of packets with a right checksum whether their payload is what their type says."""
        fits = np.ones(len(at), np.bool_)
        data = np.flatnonzero(self._is_data[held[at + KIND_AT]])
        for rows, packet, fields, fills in self._alike(Found(held, at[data], length[data], data)):
            fits[data[rows]] = fills
            if not fills and self._roles[packet[KIND_AT]] == FIXED:
                self.wrong_length = fields[0][2]
        return fits

    def _layout_numbers(self, found: Found) -> IntArray:
        kind = found.held[found.at + KIND_AT]
        numbers = np.full(len(found), -1, np.int64)
        self._types += np.bincount(kind, minlength=256)
        for row in np.flatnonzero(self._roles[kind] == MESSAGE).tolist():
            message = found.held[found.at[row] :][: found.length[row]]
            begin = self._form.begin(message[:4].tolist())
            for text in self._describe(int(kind[row]), message[begin : -self._form.check.size].tobytes()):
                self._say(text)
        if len(self._contents) > MOST_LAYOUTS:
            self._contents.clear()
            self._forget_layouts()
        data = np.flatnonzero(self._is_data[kind])
        for rows, packet, fields, _ in self._alike(found.only(data)):
            contents = self._contents_of(fields, packet[KIND_AT])
            numbers[data[rows]] = contents.layout
            for known in contents.known:
                self._known[known] += len(rows)
            for unknown in contents.unknown:
                is_counted = unknown in self._unknown or len(self._unknown) < MOST_UNKNOWN
                self._unknown[unknown if is_counted else next(reversed(self._unknown))] += len(rows)
        return numbers

    def _contents_of(self, fields: Sequence[tuple[int, int, int]], kind: int) -> _Contents:
        signature = (kind, *(number for field in fields for number in field))
        if signature not in self._contents:
            self._contents[signature] = self._new_contents(fields)
        return self._contents[signature]

    def _new_contents(self, fields: Sequence[tuple[int, int, int]]) -> _Contents:
        """Work out what packets with these fields carry; of several numbers for a column the last counts."""
        names = self.table.groups.names
        placed: dict[str, Placed] = {}
        known, unknown, bits = list[Field](), list[tuple[int, int]](), 0
        for key, at, size in fields:
            field = self.table.find(key, size)
            if field is None:
                unknown.append((key, size))
                continue
            known.append(field)
            bits |= 1 << names.index(field.group) if field.group else 0
            for value in field.values:
                if value.column is not None:
                    placed[value.column.name] = Placed(value, at, field.group, big=True)
                at += NUMBER_TYPES[value.type].size
        layout = -1
        if placed:
            layout = self._add_layout(
                Record([*placed.values()], self.table.derived), bits or 1 << len(names) - 1
            )
        return _Contents(layout, tuple(known), tuple(unknown))

    # What is said of it

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        """Say in words what a message that is not data tells the user, if anything."""
        del kind, payload
        return ()

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data, and what of it is not understood."""
        for (key, size), _ in self.unknown_fields().items():
            self._say(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
        return super().notices()

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def _type_name(self, kind: int) -> str:
        return self._type_names.get(kind, f"0x{kind:02X}")

    def unknown_fields(self) -> dict[tuple[int, int], int]:
        """Return how often fields came that the table lacks, by identifier and size."""
        self._settle()
        return dict(self._unknown)

    def received_fields(self) -> dict[Field, int]:
        """Return how often each known field came, those that did not left out."""
        self._settle()
        return dict(self._known)

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """Time of arrival and the columns of all fields of the protocol."""
        return (KNOWN["arrival_time_ns"], *self.table.columns.values())

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        counts = super().counters()
        named = {self._type_name(kind): n for kind, n in enumerate(self._types.tolist()) if n}
        return replace(counts, packets_by_type=named)
