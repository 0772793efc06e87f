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

from imumon.blocks import BoolArray, IntArray, SampleBlock
from imumon.columns import KNOWN
from imumon.protocols.base import MAIN, Encoder, Timing, chosen
from imumon.protocols.checksums import CRCS
from imumon.protocols.device import DeviceFile
from imumon.protocols.frame_checks import CyclicCheck
from imumon.protocols.framing import IMPOSSIBLE, INCOMPLETE, Found, Frame, counted_length, windows
from imumon.protocols.numbers import NUMBER_TYPES, Placed, Value, packed
from imumon.protocols.payload import Layout, LayoutDecoder, Record
from imumon.protocols.stream import LONGEST_PACKET, ByteArray
from imumon.protocols.text import LineLayout, Place, line_lengths, lines_right, sentence_body
from imumon.protocols.vectornav_fields import (
    COMMON,
    FILTERED,
    GROUP_NAMES,
    GROUPS,
    RECEIVERS,
    SENTENCES,
    SIDE_GROUPS,
    Item,
    size_of,
)

MOST_HEADER = 64


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
    items: list[Item] = []
    for group in groups:
        first, more = 0, group in GROUPS
        if not more:
            return IMPOSSIBLE
        while more:
            if at + 2 > len(packet):
                return INCOMPLETE
            word = int.from_bytes(packet[at : at + 2], "little")
            at += 2
            more = group != COMMON and bool(word >> 15)
            bits = [first + k for k in range(16 if group == COMMON else 15) if word >> k & 1]
            found = [GROUPS[group][bit] if bit < len(GROUPS[group]) else None for bit in bits]
            items += [item for item in found if item is not None]
            if None in found:
                return IMPOSSIBLE
            first += 16
    return Header(tuple(items), at) if items else IMPOSSIBLE


@dataclass(frozen=True, slots=True)
class Header:
    """What a header announces, in the order of the payload, and the bytes it has, FA included."""

    items: tuple[Item, ...]
    size: int

    def offsets(self, packet: ByteArray) -> list[int] | int:
        """Return where each field of a packet begins and where the last ends, or why that is not known."""
        at, places = self.size, []
        for item in self.items:
            places.append(at)
            if item.repeat:
                if at + item.counter >= len(packet):
                    return INCOMPLETE
                at += item.repeat * int(packet[at + item.counter])
            at += size_of(item)
            if at + 2 > LONGEST_PACKET:
                return IMPOSSIBLE
        return [*places, at]


_POPCOUNT = np.array([bin(byte & 0x7F).count("1") for byte in range(256)])
_WIDEST = 16
"""Bytes of a header of all groups of the first byte."""
OFTEN = 8
"""A header counts as often when it is more than this part of what is left."""


def _sizes() -> tuple[IntArray, BoolArray, BoolArray]:
    """Return by group, half of the word and its value: bytes of the fields; if all are known; if it goes on.

    Shapes (8, 2, 256).  A word goes on when its last bit or a field that counts itself is set.
    """
    sizes = np.zeros((8, 2, 256), np.int64)
    known, longer = np.zeros((8, 2, 256), np.bool_), np.zeros((8, 2, 256), np.bool_)
    for group, half, value in np.ndindex(sizes.shape):
        items = GROUPS.get(group, ())
        bits = [8 * half + k for k in range(8) if value >> k & 1]
        more = group != COMMON and 15 in bits
        found = [items[bit] if bit < len(items) else None for bit in bits if not (more and bit == 15)]
        known[group, half, value] = None not in found
        longer[group, half, value] = more or any(item is not None and item.repeat for item in found)
        sizes[group, half, value] = sum(size_of(item) for item in found if item is not None)
    return sizes, known, longer


_SIZES, _KNOWN, _LONGER = _sizes()


def _headers(held: ByteArray, at: IntArray) -> ByteArray:
    """Return the bytes of each header as its first group byte has them, and zeros, (n, 16)."""
    inside = np.all(at + _WIDEST <= len(held))
    headers = windows(held if inside else np.pad(held, (0, _WIDEST)), at, _WIDEST)
    size = 2 + 2 * _POPCOUNT[headers[:, 1]]
    return headers * (np.arange(_WIDEST) < size[:, np.newaxis])


def _alike(headers: ByteArray) -> tuple[IntArray, IntArray]:
    """Return numbers of different headers, and which of these each is.

    A stream has few kinds of packets, so they are told apart one after the other; of what is rare by then
    some may be the same.
    """
    words = headers.view(np.uint64)
    which, left, different = np.zeros(len(headers), np.int64), np.arange(len(headers)), list[int]()
    often = True
    while often and len(left):
        first, before = int(left[0]), len(left)
        equal = (words[left, 0] == words[first, 0]) & (words[left, 1] == words[first, 1])
        which[left[equal]] = len(different)
        different.append(first)
        left = left[~equal]
        often = before - len(left) > before // OFTEN
    which[left] = len(different) + np.arange(len(left))
    return np.array([*different, *left.tolist()], np.int64), which


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the packet at each place; see `imumon.protocols.framing.Lengths`."""
    headers = _headers(held, at)
    different, which = _alike(headers)
    length, size, alone = _announced(headers[different])
    length, size, alone = length[which], size[which], alone[which]
    for k in np.flatnonzero(alone | (at + size > len(held))).tolist():
        packet = held[at[k] :]
        length[k] = _length(packet, read_header(packet[:MOST_HEADER].tobytes()))
    return length


def _announced(headers: ByteArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Return length of the packets, bytes of the headers, and which have to be read one by one.

    Those are headers with a second group byte or word, and with fields that count themselves.
    """
    rows = np.arange(len(headers))
    place, length = np.full(len(headers), 2), np.zeros(len(headers), np.int64)
    good, alone = headers[:, 1] != 0, headers[:, 1] >= 0x80
    announced = int(np.bitwise_or.reduce(headers[:, 1])) if len(headers) else 0
    for group in (group for group in range(1, 8) if announced >> group - 1 & 1):
        there = headers[:, 1] >> (group - 1) & 1 != 0
        for half in range(2):
            word = headers[rows, np.minimum(place, _WIDEST - 1)]
            length += np.where(there, _SIZES[group, half, word], 0)
            good &= ~there | _KNOWN[group, half, word]
            alone |= there & _LONGER[group, half, word]
            place += there
    return np.where(good & (length > 0), place + length + 2, IMPOSSIBLE), place, good & alone


def _length(packet: ByteArray, header: Header | int) -> int:
    if isinstance(header, int):
        return header
    offsets = header.offsets(packet)
    return offsets if isinstance(offsets, int) else offsets[-1] + 2


XMODEM = CyclicCheck(CRCS["crc16-xmodem"], first=1, big=True)


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
        if len(fields) != len(values) or any(_real(text) is None for text in fields):
            return None
    return name, fields


def _real(text: str) -> float | None:
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None


def _numbers_of(text: str) -> list[float] | None:
    read = _sentence(text)
    return None if read is None else [float(field) for field in read[1]]


BINARY, SENTENCE = 0, 2
"""Numbers of their frames."""


class VectorNavDecoder(LayoutDecoder):
    """Decodes binary outputs with any fields and ASCII sentences, mixed as they may come."""

    def __init__(self, rate_hz: float | None = None) -> None:
        frames = (
            Frame("binary", b"\xfa", _lengths, XMODEM),
            Frame("split", b"\xfb\x00", counted_length(4, 2, 8, LONGEST_PACKET), XMODEM),
            Frame("ascii", b"$VN", line_lengths(after_end=False), lines_right(_sentence)),
        )
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        super().__init__(frames, timing, SIDE_GROUPS, apart=tuple(RECEIVERS.values()))
        # Some quantities are in fields of two groups: which counts is not for the order of the packets.
        for item in (item for items in GROUPS.values() for item in items if item is not None and item.group):
            group = (MAIN, *SIDE_GROUPS).index(item.group)
            self._of_column |= {
                v.column.name: group
                for v in item.values
                if v.column is not None and v.column.name not in self._of_column
            }
        self._kinds: dict[bytes, int] = {}
        self._known: list[_Kind] = []
        self._factory: frozenset[str] = frozenset()
        self._numbers: dict[tuple[int, frozenset[str]], int] = {}

    def _layout_numbers(self, found: Found) -> IntArray:
        kinds = self._kinds_of(found)
        numbers = np.full(len(found), -1, np.int64)
        begin = 0
        firsts = sorted(zip(*np.unique(kinds, return_index=True)[::-1], strict=True))
        for first, kind in [(int(f), int(k)) for f, k in firsts if k >= 0] + [(len(found), -1)]:
            new = frozenset() if kind < 0 else self._known[kind].factory - self._factory
            if new or kind < 0:
                numbers[begin:first] = self._numbered(kinds[begin:first])
                self._factory |= new
                begin = first
        return numbers

    def _kinds_of(self, found: Found) -> IntArray:
        """Return the number of the kind of each packet, its header; -1: one that is only counted."""
        kinds = np.full(len(found), -1, np.int64)
        binary = np.flatnonzero(found.frame == BINARY)
        first, same = _alike(_headers(found.held, found.at[binary]))
        of_header = np.array([self._kind(found, k) for k in binary[first].tolist()], np.int64)
        kinds[binary] = of_header[same]
        alone = np.array([self._known[k].alone for k in of_header.tolist()], np.bool_)[same]
        for k in [*binary[alone].tolist(), *np.flatnonzero(found.frame == SENTENCE).tolist()]:
            kinds[k] = self._kind(found, k)
        return kinds

    def _kind(self, found: Found, k: int) -> int:
        """Return the number of the kind of one packet."""
        packet = found.held[found.at[k] : found.at[k] + found.length[k]]
        if found.frame[k] == SENTENCE:
            key = packet[:6].tobytes()
            if key not in self._kinds:
                self._tell(packet.tobytes().decode("ascii", "replace"))
            placed = [(value, 0, MAIN) for value in SENTENCES.get(key[3:].decode("ascii", "replace"), ())]
            return self._known_kind(key, placed, alone=False)
        header = read_header(packet[:MOST_HEADER].tobytes())
        assert not isinstance(header, int)
        repeats = any(item.repeat for item in header.items)
        key = packet[: header.size].tobytes() + (len(packet).to_bytes(2, "big") if repeats else b"")
        if key in self._kinds:
            return self._kinds[key]
        offsets = header.offsets(packet)
        assert not isinstance(offsets, int)
        placed = []
        for item, at in zip(header.items, offsets[:-1], strict=True):
            for value in item.values:
                placed.append((value, at, item.group))
                at += NUMBER_TYPES[value.type].size
        alone = repeats or packet[1] >= 0x80 or header.size != 2 + 2 * int(_POPCOUNT[packet[1]])
        return self._known_kind(key, placed, alone)

    def _known_kind(self, key: bytes, placed: Sequence[tuple[Value, int, str]], alone: bool) -> int:
        if key not in self._kinds:
            there = {value.column.name for value, _, _ in placed if value.column is not None}
            factory = frozenset(base for base in FILTERED if f"{base}_x" in there)
            self._kinds[key] = len(self._known)
            self._known.append(_Kind(tuple(placed), factory, alone, key[:1] != b"\xfa"))
        return self._kinds[key]

    def _numbered(self, kinds: IntArray) -> IntArray:
        """Return the number of the layout of each kind, as what is known of the stream has it."""
        numbers = np.full(len(kinds), -1, np.int64)
        for kind in np.unique(kinds[kinds >= 0]).tolist():
            key = kind, self._factory
            if key not in self._numbers:
                self._numbers[key] = self._layout(self._known[kind])
            numbers[kinds == kind] = self._numbers[key]
        return numbers

    def _layout(self, kind: _Kind) -> int:
        """Add the layout of a kind of packet; return its number, or -1 when it has nothing for a row."""
        alone = [base for base in FILTERED if base not in self._factory | kind.factory]
        placed = [(_without_suffix(value, alone), at, group) for value, at, group in kind.placed]
        layout: Layout = Record([Placed(*item) for item in placed])
        if kind.text:
            places = [Place(v.column, v.factor) for v, _, _ in placed if v.column is not None]
            layout = LineLayout(_numbers_of, places)
        if "gyro_x" in layout.of_column and "gyro" in alone:
            self._warn(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU"
            )
        return self._add(layout) if layout.columns else -1

    def _tell(self, line: str) -> None:
        """Say what a sentence says that is not data."""
        read = _sentence(line)
        assert read is not None
        if read[0] == "ERR":
            self._say(f"the device reports error {', '.join(read[1])}")
        elif read[0] not in SENTENCES:
            self._say(f"sentence $VN{read[0]} is counted and not read")


@dataclass(frozen=True, slots=True)
class _Kind:
    """Packets with one header: their numbers, and which quantities they have as calibrated in the factory."""

    placed: tuple[tuple[Value, int, str], ...]
    factory: frozenset[str]
    alone: bool
    """Whether other packets may have the same first bytes."""
    text: bool


def _without_suffix(value: Value, bases: Sequence[str]) -> Value:
    """Return the number for the column without "compensated" when it is of one of these."""
    name = "" if value.column is None else value.column.name
    base, _, axis = name.partition("_compensated_")
    return Value(KNOWN[f"{base}_{axis}"], value.type, value.factor) if axis and base in bases else value


class VectorNavEncoder(Encoder):
    """Makes binary packets of one output.

    Raises BAD_CONFIG when there is no such field.

    Parameters
    ----------
    names : sequence of str
        GROUP.FIELD, for example ``Imu.UncompGyro``; sent in the order of their bits.
    """

    def __init__(self, names: Sequence[str]) -> None:
        places = {
            f"{GROUP_NAMES[group]}.{item.name}": (group, bit, item)
            for group, items in GROUPS.items()
            for bit, item in enumerate(items)
            if item is not None and item.values
        }
        sent = sorted(chosen(names, places, "field"), key=lambda place: place[:2])
        words: dict[int, int] = {}
        for group, bit, _ in sent:
            words[group] = words.get(group, 0) | 1 << bit
        groups = sum(1 << group - 1 for group in words if group < 8)
        header = bytes([0xFA, groups]) + b"".join(word.to_bytes(2, "little") for word in words.values())
        self._header = np.frombuffer(header, np.uint8)
        factory = {base for base in FILTERED for *_, item in sent if f"{base}_x" in _names(item)}
        bases = [base for base in FILTERED if base not in factory]
        self._values = [_without_suffix(value, bases) for *_, item in sent for value in item.values]

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; see `imumon.protocols.base.Encoder`."""
        rows = np.arange(len(block))
        parts = [packed("binary output", v, block.columns, rows)[:, ::-1] for v in self._values]
        packets = np.concatenate([np.tile(self._header, (len(block), 1)), *parts], axis=1)
        return [packet.tobytes() for packet in XMODEM.sealed_rows(packets)]


def _names(item: Item) -> set[str]:
    return {value.column.name for value in item.values if value.column is not None}


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
