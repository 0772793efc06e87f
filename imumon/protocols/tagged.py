"""Packets that are lists of identified fields (Xbus, MIP): decoder and encoder.

====  =======================================  ==============================  =========================
      packet                                   field                           checksum
====  =======================================  ==============================  =========================
Xbus  FA; address FF or 01; type; length (FF:  identifier (16 bits), size of   one byte: all but FA sum
      16 more bits follow); fields             the data, data                  to zero
MIP   75; 65; type; length; fields             size of the field, identifier,  two bytes: both sums of
                                               data                            Fletcher, modulo 256
====  =======================================  ==============================  =========================

Other Xbus addresses than FF (the device on its own) and 01 are those of trackers behind an Xbus Master, which
answer only to commands; taking them for packets would make noise of every FA in damaged data.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, IntArray, SampleBlock
from imumon.errors import bad_config

from .base import OTHER, ByteArray, Encoder
from .decoder import Layouts
from .framing import IMPOSSIBLE, INCOMPLETE, NO_PACKET, Checksum, Found, Frame, counted_lengths
from .messages import Message, Placed, TableDecoder
from .numbers import Number, is_missing, with_sources, write

LONGEST_XBUS_PAYLOAD = 2048  # bytes that are believed, assumed
TYPE_AT = 2  # place of the packet type
HEADER, LONG_HEADER = 4, 6  # bytes before the payload, and where an Xbus message has more than 254 of it
Field = tuple[int, int, int]  # its key, where its data begin, and their bytes
_SUM = Checksum("sum8-negated", first=1)
_FLETCHER = Checksum("fletcher16-256")


def xbus_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the message at each place; see `imumon.protocols.framing.Lengths`."""
    last = len(held) - 1  # read in the place of what has not come: such lengths are replaced below
    address, short, high, low = (held[np.minimum(at + k, last)].astype(np.int64) for k in (1, 3, 4, 5))
    long = high << 8 | low
    is_long = short == 0xFF
    header = np.where(is_long, LONG_HEADER, HEADER)
    length = header + np.where(is_long, long, short) + 1  # the checksum
    length[is_long & (long > LONGEST_XBUS_PAYLOAD)] = IMPOSSIBLE
    length[at + header > len(held)] = INCOMPLETE
    other = (address != 0xFF) & (address != 0x01)
    length[other] = np.where(at[other] + 1 < len(held), NO_PACKET, INCOMPLETE)
    return length


def _start(packet: bytes) -> int:
    # Of the payload: only Xbus, of which FA is the first byte, has a long header.
    return LONG_HEADER if packet[0] == 0xFA and packet[3] == 0xFF else HEADER


def xbus_message(packet_type: int, payload: bytes) -> bytes:
    """Return an Xbus message without its checksum."""
    size = len(payload)
    length = [size] if size < 0xFF else [0xFF, size >> 8, size & 0xFF]
    return bytes([0xFA, 0xFF, packet_type, *length]) + payload


class Form(NamedTuple):
    """How packets and the fields in them are written."""

    frame: Frame
    check: Checksum
    longest: int  # bytes of a payload
    message: Callable[[int, bytes], bytes]  # of a type and a payload, without its checksum
    field_header_size: int  # bytes of a field before its data; 0: the payload is one field, of key 0
    read_field_header: Callable[[bytes, int], tuple[int, int]]  # key and size of one at a place of a packet
    write_field_header: Callable[[int, int], bytes]  # of a field with a key and so many bytes

    def payload(self, packet: bytes) -> bytes:
        """Return what is between header and checksum."""
        return packet[_start(packet) : -self.check.size]

    def fields(self, packet: bytes) -> list[Field]:
        """Return the fields of a packet; the last may end behind it."""
        at, end = _start(packet), len(packet) - self.check.size
        if not self.field_header_size:
            return [(0, at, end - at)]
        found = list[Field]()
        while at + self.field_header_size <= end:
            key, size = self.read_field_header(packet, at)
            if size < 0:
                break
            found.append((key, at + self.field_header_size, size))
            at += self.field_header_size + size
        return found

    def packed(self, packet_type: int, fields: Sequence[tuple[int, bytes]]) -> bytes:
        """Return a packet of fields, without its checksum: of its type, and of their keys and data."""
        payload = b"".join(self.write_field_header(key, len(data)) + data for key, data in fields)
        return self.message(packet_type, payload)

    def sealed(self, packet_type: int, *fields: tuple[int, bytes]) -> bytes:
        """Return a packet of fields."""
        return self.check.sealed(self.packed(packet_type, fields))


XBUS = Form(
    Frame({b"\xfa": "Xbus"}, xbus_lengths, _SUM),
    _SUM,
    LONGEST_XBUS_PAYLOAD,
    xbus_message,
    field_header_size=3,
    read_field_header=lambda packet, at: (packet[at] << 8 | packet[at + 1], packet[at + 2]),
    write_field_header=lambda key, size: bytes([key >> 8, key & 0xFF, size]),
)
XBUS_DATA = XBUS._replace(field_header_size=0, write_field_header=lambda *_: b"")  # MTData
MIP = Form(
    Frame({b"\x75\x65": "MIP"}, partial(counted_lengths, 3, 1, HEADER + 2, HEADER + 257), _FLETCHER),
    _FLETCHER,
    255,
    lambda packet_type, payload: bytes([*b"\x75\x65", packet_type, len(payload)]) + payload,
    field_header_size=2,
    # The size is that of the whole field; the same identifier is another field in another type of packet.
    read_field_header=lambda packet, at: (packet[TYPE_AT] << 8 | packet[at + 1], packet[at] - 2),
    write_field_header=lambda key, size: bytes([size + 2, key & 0xFF]),
)


class TaggedDecoder(TableDecoder):
    """Decodes packets of identified fields by a table; a row for each packet that carries a known one."""

    form: Form
    data: Sequence[int]
    """Types of packets that carry data: others are messages."""
    type_names: Mapping[int, str] = {}  # others have their number
    side_groups = (OTHER,)
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
        for key, at, size in self.form.fields(packet):
            message = self._field(key, size)
            if message is not None:
                found.append((message, at, size))
            else:
                self._report(f"field {self._field_name(key)} of {size} bytes is not known and is passed over")
        return found

    def _signature(self, packet: bytes) -> Sequence[int]:
        headers = (range(at - self.form.field_header_size, at) for _, at, _ in self.form.fields(packet))
        return [*range(TYPE_AT, _start(packet)), *chain(*headers)]

    def _is_filled(self, packet: bytes) -> bool:
        """Return whether the fields of a packet end where its payload ends."""
        sizes = [self.form.field_header_size + size for _, _, size in self.form.fields(packet)]
        return sum(sizes) == len(self.form.payload(packet))

    def _fit(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Return whether the payload of packets with a right checksum is what their type states."""
        fit = np.ones(len(at), np.bool_)
        data = np.flatnonzero(np.isin(held[at + TYPE_AT], self.data))
        # Packets that are alike are tested once; their kind is 0, as there is one frame.
        for _, rows, packet in self._alike(Found(held, at[data], length[data], np.zeros_like(data))):
            fit[data[rows]] = self._is_filled(packet)
        return fit

    def _by_layout(self, found: Found) -> Layouts:
        types = found.held[found.at + TYPE_AT]
        self._types += np.bincount(types, minlength=256)
        is_data = np.isin(types, self.data)
        for row in np.flatnonzero(~is_data).tolist():
            packet = found.held[found.at[row] :][: found.length[row]].tobytes()
            for text in self._describe(packet[TYPE_AT], self.form.payload(packet)):
                self._report(text)
        data = np.flatnonzero(is_data)
        for layout, rows in super()._by_layout(found.only(data)):
            yield layout, data[rows]

    def _describe(self, _packet_type: int, _payload: bytes) -> Iterable[str]:
        """Return in words what a message that is not data reports to the user, if anything."""
        return ()

    def _field_name(self, key: int) -> str:
        return f"0x{key:04X}"

    def _by_type(self) -> dict[str, int]:
        counts = enumerate(self._types.tolist())
        return {self.type_names.get(number, f"0x{number:02X}"): count for number, count in counts}

    def field_encoder(self, packet_type: int, fields: Sequence[tuple[int, Message]]) -> Encoder:
        """Return an encoder of one packet per row; raises BAD_CONFIG when the packet becomes too long.

        `fields` have their keys.  A field of which a row has no value is left out.
        """
        longest = sum(self.form.field_header_size + field.size for _, field in fields)
        if longest > self.form.longest:
            raise bad_config(f"a packet with these fields has {longest} bytes, too many")
        return Encoder(partial(self._encode_fields, packet_type, fields))

    def _encode_fields(
        self, packet_type: int, fields: Sequence[tuple[int, Message]], block: SampleBlock
    ) -> list[bytes]:
        form, names = self.form, [column.name for _, field in fields for column in field.columns]
        columns = with_sources(block.columns, self.derived, names)
        present = np.ones((len(block), len(fields)), np.bool_)
        for k, (_, field) in enumerate(fields):
            there = [~is_missing(columns[c.name]) for c in field.columns if c.name in columns]
            if there:  # a field without any column is sent as zero
                present[:, k] = np.any(there, axis=0)
        packets = [b""] * len(block)
        for pattern in np.unique(present, axis=0):
            rows = np.flatnonzero(np.all(present == pattern, axis=1))
            sent = [fields[k] for k in np.flatnonzero(pattern).tolist()]
            blank = form.packed(packet_type, [(key, bytes(field.size)) for key, field in sent])
            at, numbers = _start(blank), list[Number]()
            for _, field in sent:
                at += form.field_header_size
                numbers += field.placed(at, field.size, big=True)
                at += field.size
            of_rows = {name: values[rows] for name, values in columns.items()}
            sealed = form.check.sealed_rows(write("packet", numbers, blank, of_rows, len(rows)))
            for row, packet in zip(rows, sealed, strict=True):
                packets[row] = packet.tobytes()
        return packets
