"""Packets that are lists of identified fields (Xbus, MIP): decoder and encoder.

====  =======================================  ==============================  =========================
      packet                                   field                           checksum
====  =======================================  ==============================  =========================
Xbus  FA, FF or 01, type, length (FF: 16 more  identifier (16 bits), size of   one byte: all but FA sum
      bits follow), fields                     the data, data                  to zero
MIP   75, 65, type, length, fields             size of the field, identifier,  two bytes: both sums of
                                               data                            Fletcher, modulo 256
====  =======================================  ==============================  =========================

Other Xbus addresses than FF (the device on its own) and 01 are those of trackers behind an Xbus Master, which
answer only to commands; taking them for packets would make noise of every FA in damaged data.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, IntArray, SampleBlock
from imumon.errors import bad_config

from .base import OTHER, ByteArray, Encoder
from .decoder import Layouts
from .framing import IMPOSSIBLE, INCOMPLETE, NO_PACKET, Checksum, Found, Frame, counted_length
from .messages import Message, Placed, TableDecoder
from .numbers import is_missing, with_sources, write

LONGEST_XBUS_PAYLOAD = 2048
KIND_AT = 2
"""Place of the packet type."""

Place = tuple[int, int, int]
"""Key of a field, where its data begin, and their bytes."""


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


def _begin(packet: bytes) -> int:
    return 6 if packet[0] == 0xFA and packet[3] == 0xFF else 4


def xbus_message(kind: int, payload: bytes) -> bytes:
    """Return an Xbus message without its checksum."""
    size = len(payload)
    return bytes([0xFA, 0xFF, kind, *([0xFF, size >> 8, size & 0xFF] if size >= 0xFF else [size])]) + payload


class Form(NamedTuple):
    """How packets and the fields in them are written."""

    frame: Frame
    check: Checksum
    message: Callable[[int, bytes], bytes]
    """Returns a packet of a type and a payload, without its checksum."""
    longest: int
    """Most bytes of a payload."""
    header: int
    """Bytes of a field before its data: 3 as Xbus, 2 as MIP; 0: the payload is one field, of key 0."""

    def payload(self, packet: bytes) -> bytes:
        """Return what is between header and checksum."""
        return packet[_begin(packet) : -self.check.size]

    def places(self, packet: bytes) -> list[Place]:
        """Return the fields of a packet; the last may end behind it."""
        at, end, found = _begin(packet), len(packet) - self.check.size, list[Place]()
        if not self.header:
            return [(0, at, end - at)]
        while at + self.header <= end:
            high, size = (
                (packet[at], packet[at + 2]) if self.header == 3 else (packet[KIND_AT], packet[at] - 2)
            )
            if size < 0:
                break
            found.append((high << 8 | packet[at + 1], at + self.header, size))
            at += self.header + size
        return found

    def packed(self, kind: int, fields: Sequence[tuple[int, bytes]]) -> bytes:
        """Return a packet of fields, without its checksum: of its type, and of their keys and data."""
        payload = b""
        for key, data in fields:
            heads = (b"", bytes([len(data) + 2, key & 0xFF]), bytes([key >> 8, key & 0xFF, len(data)]))
            payload += heads[max(self.header - 1, 0)] + data
        return self.message(kind, payload)

    def sealed(self, kind: int, *fields: tuple[int, bytes]) -> bytes:
        """Return a packet of fields."""
        return self.check.sealed(self.packed(kind, fields))


_SUM, _FLETCHER = Checksum("sum8-negated", first=1), Checksum("fletcher16-256")
XBUS = Form(Frame({b"\xfa": "Xbus"}, xbus_lengths, _SUM), _SUM, xbus_message, LONGEST_XBUS_PAYLOAD, 3)
XBUS_DATA = XBUS._replace(header=0)
MIP_FRAME = Frame({b"\x75\x65": "MIP"}, counted_length(3, 1, 6, 261), _FLETCHER)
MIP = Form(MIP_FRAME, _FLETCHER, lambda kind, data: bytes([*b"\x75\x65", kind, len(data)]) + data, 255, 2)


class TaggedDecoder(TableDecoder):
    """Decodes packets of identified fields by a table; a row for each packet that carries a known one."""

    form: Form
    data: Sequence[int]
    """Types of packets that carry data: others are messages."""
    type_names: Mapping[int, str] = {}
    """Names of the packet types."""
    names = (OTHER,)
    big = True

    def __init__(self) -> None:
        self._types = np.zeros(256, np.int64)
        self.frames = [replace(self.form.frame, fits=self._fit)]
        super().__init__()

    @abstractmethod
    def _field(self, key: int, size: int) -> Message | None:
        """Return the field with this key and so many bytes; None when there is none."""

    def _contents(self, packet: bytes) -> Placed:
        found = []
        for key, at, size in self.form.places(packet):
            field = self._field(key, size)
            if field is not None:
                found.append((field, at, size))
            else:
                self._report(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
        return found

    def _signature(self, packet: bytes) -> Sequence[int]:
        header, begin = self.form.header, _begin(packet)
        heads = (range(at - header, at) for _, at, _ in self.form.places(packet))
        return [*range(KIND_AT, begin), *(place for head in heads for place in head)]

    def _is_filled(self, packet: bytes) -> bool:
        """Return whether the fields of a packet end where its payload ends."""
        fields = self.form.places(packet)
        end = sum(fields[-1][1:]) if fields else _begin(packet)
        return end == len(packet) - self.form.check.size

    def _fit(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Return whether the payload of packets with a right checksum is what their type states."""
        fit = np.ones(len(at), np.bool_)
        data = np.flatnonzero(np.isin(held[at + KIND_AT], self.data))
        for _, rows, packet in self._alike(Found(held, at[data], length[data], np.zeros_like(data))):
            fit[data[rows]] = self._is_filled(packet)
        return fit

    def _by_layout(self, found: Found) -> Layouts:
        kind = found.held[found.at + KIND_AT]
        self._types += np.bincount(kind, minlength=256)
        is_data = np.isin(kind, self.data)
        for row in np.flatnonzero(~is_data).tolist():
            packet = found.held[found.at[row] :][: found.length[row]].tobytes()
            for text in self._describe(int(kind[row]), self.form.payload(packet)):
                self._report(text)
        data = np.flatnonzero(is_data)
        return ((layout, data[rows]) for layout, rows in super()._by_layout(found.only(data)))

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        """Return in words what a message that is not data reports to the user, if anything."""
        del kind, payload
        return ()

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def _type_name(self, kind: int) -> str:
        return self.type_names.get(kind, f"0x{kind:02X}")

    def _by_type(self) -> dict[str, int]:
        return {self._type_name(kind): n for kind, n in enumerate(self._types.tolist())}

    def field_encoder(self, kind: int, fields: Sequence[tuple[int, Message]]) -> Encoder:
        """Return an encoder of one packet per row; raises BAD_CONFIG when the packet becomes too long.

        `kind` is the packet type, `fields` have their keys.  A field of which a row has no value is left out.
        """
        longest = sum(self.form.header + field.size for _, field in fields)
        if longest > self.form.longest:
            raise bad_config(f"a packet with these fields has {longest} bytes, too many")
        return Encoder(partial(self._encode_fields, kind, fields))

    def _encode_fields(
        self, kind: int, fields: Sequence[tuple[int, Message]], block: SampleBlock
    ) -> list[bytes]:
        form, names = self.form, [column.name for _, field in fields for column in field.columns]
        columns = with_sources(block.columns, self.derived, names)
        present = np.ones((len(block), len(fields)), np.bool_)
        for k, (_, field) in enumerate(fields):
            there = [~is_missing(columns[c.name]) for c in field.columns if c.name in columns]
            if there:  # a field without any column is sent as zero
                present[:, k] = np.any(there, axis=0)
        packets = [b""] * len(block)
        patterns, which = np.unique(present, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(which.reshape(-1) == number)
            sent = [fields[k] for k in np.flatnonzero(pattern).tolist()]
            blank = form.packed(kind, [(key, bytes(field.size)) for key, field in sent])
            places = form.places(blank + bytes(form.check.size))
            numbers = [
                number
                for (_, field), (_, at, size) in zip(sent, places, strict=False)
                for number in field.placed(at, size, big=True)
            ]
            of_rows = {name: values[rows] for name, values in columns.items()}
            sealed = form.check.sealed_rows(write("packet", numbers, blank, of_rows, len(rows)))
            for row, packet in zip(rows, sealed, strict=True):
                packets[row] = packet.tobytes()
        return packets
