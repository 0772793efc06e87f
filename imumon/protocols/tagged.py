"""Packets that are lists of identified fields (Xbus, MIP): what their fields are, decoder and encoder.

====  =======================================  ==============================  =========================
      packet                                   field                           checksum
====  =======================================  ==============================  =========================
Xbus  FA, FF or 01, type, length (FF: 16 more  identifier (16 bits), size of   one byte: all but FA sum
      bits follow), fields                     the data, data                  to zero
MIP   75, 65, type, length, fields             size of the field, identifier,  two bytes: both sums of
                                               data                            Fletcher, modulo 256
====  =======================================  ==============================  =========================

Packets of one length whose field headers are the same carry the same numbers at the same places.

Other Xbus addresses than FF (the device on its own) and 01 are those of trackers behind an Xbus Master, which
answer only to commands; taking them for packets would make noise of every FA in damaged data.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import COMMON, MAIN, Encoder, Groups, Timing
from imumon.protocols.frame_checks import Fletcher, Sum, Trailing
from imumon.protocols.framing import (
    IMPOSSIBLE,
    INCOMPLETE,
    NO_PACKET,
    Found,
    Frame,
    Lengths,
    counted_length,
)
from imumon.protocols.layouts import Alike, Layout, LayoutDecoder, Record
from imumon.protocols.numbers import (
    NUMBER_TYPES,
    Derived,
    Placed,
    Value,
    is_missing,
    with_sources,
    write,
)
from imumon.protocols.stream import ByteArray
from imumon.transport.statistics import Counters

ANY_SIZE = -1
"""Size of a field that is recognised and skipped whatever its length."""
LONGEST_XBUS_PAYLOAD = 2048
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
    lengths: Lengths
    check: Trailing
    longest: int
    """Most bytes of a payload."""
    start: Callable[[int, int], bytes]
    """Makes what is before the payload, of the packet type and the bytes of the payload."""
    begin: Callable[[bytes], int]
    """Place of the payload in a packet, of which at least the first four bytes are given."""
    header: int
    """Bytes of a field before its data."""
    head: Callable[[int, int], bytes]
    """Makes these bytes, of the key of the field and the bytes of its data."""
    field: Callable[[bytes, int], tuple[int, int]]
    """Key of the field whose header begins at this place of the packet, and the bytes of its data."""


def _xbus_start(kind: int, size: int) -> bytes:
    return bytes([0xFA, 0xFF, kind, *([0xFF, size >> 8, size & 0xFF] if size >= 0xFF else [size])])


def _xbus_begin(packet: bytes) -> int:
    return 6 if packet[3] == 0xFF else 4


def _xbus_head(key: int, size: int) -> bytes:
    return bytes([key >> 8, key & 0xFF, size])


def _xbus_field(packet: bytes, at: int) -> tuple[int, int]:
    return packet[at] << 8 | packet[at + 1], packet[at + 2]


def _mip_start(kind: int, size: int) -> bytes:
    return bytes([0x75, 0x65, kind, size])


def _mip_begin(packet: bytes) -> int:
    del packet
    return 4


def _mip_head(key: int, size: int) -> bytes:
    return bytes([size + 2, key & 0xFF])


def _mip_field(packet: bytes, at: int) -> tuple[int, int]:
    return packet[KIND_AT] << 8 | packet[at + 1], packet[at] - 2


XBUS = Form("Xbus", b"\xfa", xbus_lengths, Sum(first=1, negated=True), LONGEST_XBUS_PAYLOAD,
            _xbus_start, _xbus_begin, 3, _xbus_head, _xbus_field)  # fmt: skip
MIP = Form("MIP", b"\x75\x65", counted_length(3, 1, 6, 261), Fletcher(), 255,
           _mip_start, _mip_begin, 2, _mip_head, _mip_field)  # fmt: skip


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

    def placed(self, at: int) -> list[Placed]:
        """Return the numbers of a field whose data begin here."""
        found = []
        for value in self.values:
            found.append(Placed(value, at, self.group, big=True))
            at += NUMBER_TYPES[value.type].size
        return found


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
        sent = {column.name: column for field in fields for column in field.columns}
        made = [column for item in derived if sent.keys() >= {*item.sources} for column in item.results]
        self.columns = [column for column in (*sent.values(), *made) if not column.name.startswith("_")]
        there = dict.fromkeys(field.group for field in fields if field.group)
        names = tuple(dict.fromkeys((MAIN, *there, OTHER)))
        of_column: dict[str, int] = {}
        for field in fields:
            for column in field.columns if field.group else ():
                if column.name not in COMMON:
                    of_column.setdefault(column.name, names.index(field.group))
        for item in derived:
            if item.sources[0] in of_column:
                results = dict.fromkeys((c.name for c in item.results), of_column[item.sources[0]])
                of_column |= results | of_column
        self.groups = Groups(names, of_column, tuple(name in apart for name in names))
        self._of_size = {(field.key, field.size): field for field in fields}

    def find(self, key: int, size: int) -> Field | None:
        """Return the field with this key and so many bytes; None when there is none."""
        return self._of_size.get((key, size)) or self._of_size.get((key, ANY_SIZE))


class TaggedDecoder(LayoutDecoder):
    """Decodes packets of identified fields by a table; a row for each packet that carries a known one.

    Parameters
    ----------
    table : FieldTable
        What the fields mean.
    form : Form
        XBUS or MIP.
    data : collection of int
        Types of packets that carry data.
    type_names : mapping of int to str
        Names of the packet types; those not named are shown as numbers.
    timing : Timing
        How the device counts time.
    counted : collection of int
        Types that are only counted; those that are neither are messages.
    bare : bool
        Whether a packet has no field headers: its payload is the first field of the table.
    """

    def __init__(
        self,
        table: FieldTable,
        form: Form,
        data: Collection[int],
        type_names: Mapping[int, str],
        timing: Timing,
        counted: Collection[int] = (),
        bare: bool = False,
    ) -> None:
        frame = Frame(form.name, form.sync, form.lengths, form.check, fits=self._fits)
        super().__init__([frame], timing, table.groups, table.columns)
        self.table = table
        self._form, self._type_names, self._bare = form, type_names, bare
        self._is_data = np.isin(np.arange(256), [*data])
        self._is_message = ~self._is_data & ~np.isin(np.arange(256), [*counted])
        self._types = np.zeros(256, np.int64)
        self._known: set[Field] = set()
        self.wrong_length = 0
        """Bytes of the latest payload that did not fit the one field of a packet."""

    def _split(self, packet: bytes) -> tuple[list[tuple[int, int, int]], list[int], bool]:
        """Return key, place and size of each field, where headers are, and if the fields fill the payload."""
        form = self._form
        at, end = form.begin(packet), len(packet) - form.check.size
        places = [*range(KIND_AT, at)]
        if self._bare:
            only = self.table.fields[0]
            return [(only.key, at, end - at)], places, end - at == only.size
        fields = []
        while at + form.header <= end:
            key, size = form.field(packet, at)
            if size < 0:
                break
            places += range(at, at + form.header)
            fields.append((key, at + form.header, size))
            at += form.header + size
        return fields, places, at == end

    def _signature(self, packet: bytes) -> Sequence[int]:
        return self._split(packet)[1]

    def _fits(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell of packets with a right checksum whether their payload is what their type says."""
        fits = np.ones(len(at), np.bool_)
        data = np.flatnonzero(self._is_data[held[at + KIND_AT]])
        for alike in self._alike(Found(held, at[data], length[data], np.zeros(len(data), np.int64))):
            fields, _, fills = self._split(alike.packet)
            fits[data[alike.rows]] = fills
            if self._bare and not fills:
                self.wrong_length = fields[0][2]
        return fits

    def _layout_numbers(self, found: Found) -> IntArray:
        kind = found.held[found.at + KIND_AT]
        numbers = np.full(len(found), -1, np.int64)
        self._types += np.bincount(kind, minlength=256)
        for row in np.flatnonzero(self._is_message[kind]).tolist():
            message = found.held[found.at[row] :][: found.length[row]].tobytes()
            payload = message[self._form.begin(message) : -self._form.check.size]
            for text in self._describe(int(kind[row]), payload):
                self._say(text)
        data = np.flatnonzero(self._is_data[kind])
        numbers[data] = super()._layout_numbers(found.only(data))
        return numbers

    def _layout(self, alike: Alike) -> Layout | None:
        """Work out what packets with these fields carry; of several numbers for a column the last counts."""
        numbers = list[Placed]()
        for key, at, size in self._split(alike.packet)[0]:
            field = self.table.find(key, size)
            if field is None:
                self._say(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
                continue
            self._known.add(field)
            numbers = field.placed(at)[::-1] + numbers
        return Record(numbers, self.table.derived) if any(item.name for item in numbers) else None

    @property
    def _no_group(self) -> int:
        return 1 << len(self.table.groups.names) - 1

    # What is said of it

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        """Say in words what a message that is not data tells the user, if anything."""
        del kind, payload
        return ()

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def _type_name(self, kind: int) -> str:
        return self._type_names.get(kind, f"0x{kind:02X}")

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        counts = super().counters()
        named = {self._type_name(kind): n for kind, n in enumerate(self._types.tolist()) if n}
        return replace(counts, packets_by_type=named)


class TaggedEncoder(Encoder):
    """Makes one Xbus or MIP packet per row.

    Raises BAD_CONFIG when a field has no values to encode or the packet becomes too long.

    Parameters
    ----------
    fields : sequence of Field
        What a packet carries, in this order.  A field of which a row has no value is left out.
    derived : sequence of Derived
        How columns that are not sent are turned into those that are.
    form : Form
        XBUS or MIP.
    kind : int
        Packet type.
    bare : bool
        Whether fields have no headers; then all are sent.
    """

    def __init__(
        self, fields: Sequence[Field], derived: Sequence[Derived], form: Form, kind: int, bare: bool = False
    ) -> None:
        if empty := [field.name for field in fields if not field.values]:
            raise ImumonError(Reason.BAD_CONFIG, f"{', '.join(empty)}: carries nothing that can be encoded")
        longest = sum((0 if bare else form.header) + field.size for field in fields)
        if longest > form.longest:
            raise ImumonError(Reason.BAD_CONFIG, f"a packet with these fields has {longest} bytes, too many")
        self._fields, self._derived = tuple(fields), tuple(derived)
        self._form, self._kind, self._bare = form, kind, bare

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return a packet for each row, of fields that have a value; see `imumon.protocols.base.Encoder`."""
        sent = [column.name for field in self._fields for column in field.columns]
        columns = with_sources(block.columns, self._derived, sent)
        present = np.column_stack([self._present(field, columns, len(block)) for field in self._fields])
        packets: list[bytes] = [b""] * len(block)
        patterns, which = np.unique(present, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(which.reshape(-1) == number)
            fields = [field for field, there in zip(self._fields, pattern, strict=True) if there]
            for row, packet in zip(rows, self._packets(fields, columns, rows), strict=True):
                packets[row] = packet.tobytes()
        return packets

    def _present(self, field: Field, columns: Mapping[str, ColumnArray], n: int) -> BoolArray:
        """Tell in which rows there is something to send; a field without any column is sent as zero."""
        found = [~is_missing(columns[column.name]) for column in field.columns if column.name in columns]
        if self._bare or not found:
            return np.ones(n, np.bool_)
        return np.asarray(np.any(found, axis=0))

    def _packets(
        self, fields: Sequence[Field], columns: Mapping[str, ColumnArray], rows: IntArray
    ) -> ByteArray:
        """Return packets of these fields, (n, size)."""
        heads = [b"" if self._bare else self._form.head(field.key, field.size) for field in fields]
        start = self._form.start(self._kind, sum(len(h) + f.size for h, f in zip(heads, fields, strict=True)))
        fixed, numbers = bytearray(start), list[Placed]()
        for head, field in zip(heads, fields, strict=True):
            numbers += field.placed(len(fixed) + len(head))
            fixed += head + bytes(field.size)
        bodies = write("packet", numbers, len(fixed), columns, rows) | np.frombuffer(fixed, np.uint8)
        return self._form.check.sealed_rows(bodies)
