"""VectorNav VN-100 to VN-310: binary output (FA) with any mask of groups, and ASCII sentences ($VN).

Facts from the vendor's SDK and the VN-100 manual.  A binary packet is FA, a byte that says which groups
follow, a word for each that says which of its fields, the fields, and a CRC; it has no length: that is the
sum of the fields.  So a packet with a field that nobody knows cannot be read, and is passed over.

`AngRate`, `Accel` and `Mag` are what the device's filter has left: its own estimate of the gyro bias is
already taken off.  `Uncomp...` and `Imu` are calibrated in the factory and no more; they make ``gyro``,
``accel`` and ``mag`` as soon as they come, and the others are then ``gyro_compensated`` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import KNOWN
from imumon.protocols.base import LONGEST_PACKET, MAIN, ByteArray, Encoder, Timing, chosen
from imumon.protocols.checks import Checksum
from imumon.protocols.decoder import Alike, Decoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import IMPOSSIBLE, INCOMPLETE, Found, Frame, counted_length, windows
from imumon.protocols.layouts import Layout, Record, groups_of
from imumon.protocols.messages import Message
from imumon.protocols.numbers import Number, write
from imumon.protocols.text import LineLayout, line_frame, sentence_body
from imumon.protocols.vectornav_fields import (
    COMMON,
    FILTERED,
    GROUP_NAMES,
    GROUPS,
    RECEIVERS,
    REPEATS,
    SENTENCES,
    SIDE_GROUPS,
)

MOST_HEADER = 64
KINDS = 8
"""Headers that are looked for in all packets at once; packets with rarer ones are measured one by one."""


def read_header(packet: bytes) -> Header | int:
    """Return what the header of a packet announces, or the code of why it is none; see `Lengths`."""
    groups: list[int] = []
    at = 1
    for first in (1, 8):
        if at >= len(packet):
            return INCOMPLETE
        groups += [first + bit for bit in range(7) if packet[at] >> bit & 1]
        at += 1
        if not packet[at - 1] & 0x80:
            break
    else:
        return IMPOSSIBLE
    items: list[Message] = []
    for group in groups:
        left, more = GROUPS.get(group, ()), group in GROUPS
        if not more:
            return IMPOSSIBLE
        while more:
            if at + 2 > len(packet):
                return INCOMPLETE
            word = packet[at] | packet[at + 1] << 8
            at += 2
            more = group != COMMON and word >= 0x8000
            word &= 0xFFFF if group == COMMON else 0x7FFF
            if word >> len(left):
                return IMPOSSIBLE
            items += [item for k, item in enumerate(left[:16]) if word >> k & 1 and item is not None]
            left = left[16:]
    return Header(tuple(items), at) if items else IMPOSSIBLE


@dataclass(frozen=True, slots=True)
class Header:
    """What a header announces, in the order of the payload, and the bytes it has, FA included."""

    items: tuple[Message, ...]
    size: int

    def offsets(self, packet: bytes) -> list[int] | int:
        """Return where each field of a packet begins and where the last ends, or why that is not known."""
        at, places = self.size, []
        for item in self.items:
            places.append(at)
            if item.name in REPEATS:
                more, counter = REPEATS[item.name]
                if at + counter >= len(packet):
                    return INCOMPLETE
                at += more * packet[at + counter]
            at += item.size
            if at + 2 > LONGEST_PACKET:
                return IMPOSSIBLE
        return [*places, at]


def _length(packet: bytes) -> int:
    """Return the length of a packet, or why it is none; see `imumon.protocols.framing.Lengths`."""
    header = read_header(packet[:MOST_HEADER])
    if isinstance(header, int):
        return header
    offsets = header.offsets(packet)
    return offsets if isinstance(offsets, int) else offsets[-1] + 2


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    length, left, stream = np.zeros(len(at), np.int64), np.arange(len(at)), held.tobytes()
    for _ in range(min(KINDS, len(at))):
        if not len(left):
            break
        packet = stream[at[left[0]] :][:LONGEST_PACKET]
        header = read_header(packet[:MOST_HEADER])
        same = left == left[0]
        if isinstance(header, Header) and not REPEATS.keys() & {item.name for item in header.items}:
            whole = np.flatnonzero(at[left] + header.size <= len(held))
            heads = windows(held, at[left[whole]], header.size)
            same[whole] = np.all(heads == np.frombuffer(packet[: header.size], np.uint8), axis=1)
        length[left[same]] = _length(packet)
        left = left[~same]
    for k, place in zip(left.tolist(), at[left].tolist(), strict=True):
        length[k] = _length(stream[place : place + LONGEST_PACKET])
    return length


XMODEM = Checksum("crc16-xmodem", first=1, big=True)


def _sentence(text: str) -> tuple[str, list[str]] | None:
    """Return header and fields of a line that is right, else None: torn lines may have a sum that fits."""
    body = sentence_body(text.rstrip("\r\n"), XMODEM)
    if body is None or not body.isascii():
        return None
    name, *fields = body[3:].split(",")
    values = SENTENCES.get(name)
    if values is not None:
        if fields and fields[-1][:1] in ("S", "T") and len(fields) > len(values):
            fields = fields[: len(values)]  # the appendix with status or time
        if len(fields) != len(values) or "_" in body or _floats(fields) is None:
            return None
    return name, fields


def _floats(fields: Sequence[str]) -> list[float] | None:
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None


def _numbers_of(text: str) -> list[float] | None:
    read = _sentence(text)
    return None if read is None else _floats(read[1])


BINARY, SENTENCE = 0, 2
"""Numbers of their frames."""


class VectorNavDecoder(Decoder):
    """Decodes binary outputs with any fields and ASCII sentences, mixed as they may come."""

    def __init__(self, rate_hz: float | None = None) -> None:
        frames = (
            Frame("binary", b"\xfa", _lengths, XMODEM),
            Frame("split", b"\xfb\x00", counted_length(4, 2, 8, LONGEST_PACKET), XMODEM),
            line_frame("ascii", b"$VN", _sentence),
        )
        there = [item for items in GROUPS.values() for item in items if item is not None and item.columns]
        layouts = [Record(item.placed(0, item.size, False)) for item in there]
        groups = groups_of(layouts, SIDE_GROUPS, apart=tuple(RECEIVERS.values()))
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        super().__init__(frames, timing, groups)
        self._factory: frozenset[str] = frozenset()
        """Quantities that have come as they were calibrated in the factory."""

    def _layout_numbers(self, found: Found) -> IntArray:
        """Number the layouts; where calibrated quantities begin, the filtered ones step back."""
        all_alike = list(self._alike(found))
        numbers = np.full(len(found), -1, np.int64)
        for alike in all_alike:
            new = _factory(self._numbers_of(alike)) - self._factory
            if new:
                self._factory |= new
                self._numbers.clear()
                for earlier in all_alike:
                    numbers[earlier.rows[earlier.rows > alike.rows[0]]] = self._number(earlier)
            numbers[alike.rows] = self._number(alike)
        return numbers

    def _signature(self, packet: bytes) -> Sequence[int]:
        if packet[:1] == b"$":
            return range(6)
        header = read_header(packet[:MOST_HEADER])
        if packet[0] != 0xFA or isinstance(header, int):
            return ()
        offsets = header.offsets(packet)
        assert not isinstance(offsets, int)
        counters = [
            at + REPEATS[item.name][1]
            for item, at in zip(header.items, offsets, strict=False)
            if item.name in REPEATS
        ]
        return [*range(header.size), *counters]

    def _numbers_of(self, alike: Alike) -> list[Number]:
        """Return the numbers of packets; those of a sentence are in its order."""
        if alike.frame == SENTENCE:
            values = SENTENCES.get(alike.packet[3:6].decode("ascii", "replace"), ())
            return [value._replace(group=MAIN) for value in values]
        header = read_header(alike.packet[:MOST_HEADER])
        if alike.frame != BINARY or isinstance(header, int):
            return []
        offsets = header.offsets(alike.packet)
        assert not isinstance(offsets, int)
        return [
            n
            for item, at in zip(header.items, offsets, strict=False)
            for n in item.placed(at, item.size, False)
        ]

    def _layout(self, alike: Alike) -> Layout | None:
        numbers = _renamed(self._numbers_of(alike), self._factory)
        if alike.frame == SENTENCE:
            self._tell(alike.packet.decode("ascii", "replace"))
            layout: Layout = LineLayout(_numbers_of, numbers)
        else:
            layout = Record(numbers)
        if "gyro_x" in layout.of_column and "gyro" not in self._factory:
            self._warn(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU"
            )
        return layout if layout.columns else None

    def _tell(self, line: str) -> None:
        """Say what a sentence says that is not data."""
        read = _sentence(line)
        assert read is not None
        if read[0] == "ERR":
            self._say(f"the device reports error {', '.join(read[1])}")
        elif read[0] not in SENTENCES:
            self._say(f"sentence $VN{read[0]} is counted and not read")


def _factory(numbers: Sequence[Number]) -> frozenset[str]:
    """Return of which quantities there are numbers as they were calibrated in the factory."""
    names = {number.name for number in numbers}
    return frozenset(base for base in FILTERED if f"{base}_x" in names)


def _renamed(numbers: Sequence[Number], factory: frozenset[str]) -> list[Number]:
    """Return the numbers; those of the filter have the plain names where nothing comes as calibrated."""
    bases = {*FILTERED} - factory
    plain = {f"{base}_compensated_{axis}": f"{base}_{axis}" for base in bases for axis in "xyz"}
    return [
        number._replace(column=KNOWN[plain[number.name]]) if number.name in plain else number
        for number in numbers
    ]


PLACES = {
    f"{GROUP_NAMES[group]}.{item.name}": (group, bit)
    for group, items in GROUPS.items()
    for bit, item in enumerate(items)
    if item is not None and item.columns
}
"""Group and bit of the fields that are read, by GROUP.FIELD."""


class VectorNavEncoder(Encoder):
    """Makes binary packets of one output.

    Raises BAD_CONFIG when there is no such field.

    Fields are GROUP.FIELD, as ``Imu.UncompGyro``; they are sent in the order of their bits.
    """

    def __init__(self, names: Sequence[str]) -> None:
        words: dict[int, int] = {}
        numbers = list[Number]()
        for group, bit in sorted(chosen(names, PLACES, "field")):
            words[group] = words.get(group, 0) | 1 << bit
        groups = sum(1 << group - 1 for group in words if group < 8)
        self._header = bytes([0xFA, groups]) + b"".join(word.to_bytes(2, "little") for word in words.values())
        self._size = len(self._header)
        for group, bit in sorted(PLACES[name] for name in names):
            item = GROUPS[group][bit]
            assert item is not None
            numbers += item.placed(self._size, item.size, False)
            self._size += item.size
        self._numbers = _renamed(numbers, _factory(numbers))

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; see `imumon.protocols.base.Encoder`."""
        blank = self._header + bytes(self._size - len(self._header))
        packets = write("binary output", self._numbers, blank, block.columns, len(block))
        return [packet.tobytes() for packet in XMODEM.sealed_rows(packets)]


class VectorNavDevice(DeviceFile):
    """Device file of a VectorNav; `sends` is for its virtual twin alone."""

    protocol: Literal["vectornav"]
    sends: list[str]

    def decoder(self) -> VectorNavDecoder:
        """Make a decoder for this device."""
        return VectorNavDecoder(self.rate_hz)

    def encoder(self) -> VectorNavEncoder:
        """Make an encoder that sends what the device would send."""
        return VectorNavEncoder(self.sends)
