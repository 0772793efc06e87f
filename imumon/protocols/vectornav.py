"""VectorNav VN-100 to VN-310: binary output (FA) with any mask of groups, and ASCII sentences ($VN).

Facts from the vendor's SDK and the VN-100 manual.  A binary packet is FA, a byte that lists the groups
that follow, a word for each that lists its fields, the fields, and a CRC; it has no length: that is the
sum of the fields.  So a packet with a field that nobody knows cannot be read, and is passed over.

`AngRate`, `Accel` and `Mag` are what the device's filter has left: its own estimate of the gyro bias is
already taken off.  `Uncomp...` and `Imu` are calibrated in the factory and no more; they make ``gyro``,
``accel`` and ``mag`` as soon as they come, and the others are then ``gyro_compensated`` and so on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Literal, NamedTuple

import numpy as np

from imumon.blocks import BoolArray, IntArray, SampleBlock
from imumon.columns import KNOWN
from imumon.protocols import vectornav_fields as tables
from imumon.protocols.base import LONGEST_PACKET, MAIN, ByteArray, Encoder, Timing, chosen
from imumon.protocols.checks import Checksum
from imumon.protocols.decoder import Alike
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import IMPOSSIBLE, INCOMPLETE, Found, Frame, counted_length, windows
from imumon.protocols.messages import Message, TableDecoder
from imumon.protocols.numbers import Layout, Number, Record, write
from imumon.protocols.text import LineLayout, line_frame, sentence_body

MOST_HEADER = 64
KINDS = 8
"""Headers that are looked for in all packets at once; packets with rarer ones are measured one by one."""


class Contents(NamedTuple):
    """What a binary packet holds: its fields and where each begins, and where header and fields end."""

    fields: tuple[tuple[Message, int], ...]
    header: int
    end: int

    @property
    def counters(self) -> list[int]:
        """Places of the bytes that state how long a field is."""
        return [at + tables.REPEATS[item.name][1] for item, at in self.fields if item.name in tables.REPEATS]


def read_contents(packet: bytes) -> Contents | int:
    """Return what a packet holds, or the code of why that is not known; see `framing.Lengths`."""
    try:
        return _contents(packet)
    except IndexError:
        return INCOMPLETE
    except KeyError:  # a group that nobody knows
        return IMPOSSIBLE


def _contents(packet: bytes) -> Contents | int:
    groups = [1 + bit for bit in range(7) if packet[1] >> bit & 1]
    at = 2
    if packet[1] & 0x80:
        groups += [8 + bit for bit in range(8) if packet[2] >> bit & 1]
        at = 3
    items: list[Message] = []
    for group in groups:
        left, more = tables.GROUPS[group], True
        while more:
            if at > MOST_HEADER:
                return IMPOSSIBLE
            word = packet[at] | packet[at + 1] << 8
            at += 2
            more = group != tables.COMMON and word >= 0x8000
            word &= 0xFFFF if group == tables.COMMON else 0x7FFF
            if word >> len(left):
                return IMPOSSIBLE
            items += [item for k, item in enumerate(left[:16]) if word >> k & 1 and item is not None]
            left = left[16:]
    fields, end = list[tuple[Message, int]](), at
    for item in items:
        fields.append((item, end))
        if item.name in tables.REPEATS:
            more_bytes, counter = tables.REPEATS[item.name]
            end += more_bytes * packet[end + counter]
        end += item.size
        if end + 2 > LONGEST_PACKET:
            return IMPOSSIBLE
    return Contents(tuple(fields), at, end) if items else IMPOSSIBLE


KNOWN_BITS = np.array([0] + [len(tables.GROUPS[(m & -m).bit_length()]) for m in range(1, 128)])
"""Fields of the first group that a group byte names."""
KNOWN_SECOND = 1 << tables.GNSS3 - 8
"""Groups of a second group byte."""


def _hopeless(held: ByteArray, at: IntArray) -> BoolArray:
    """Tell where the first groups show that there is no packet: most of what only looks like one."""
    rows = np.flatnonzero(at + MOST_HEADER + 4 <= len(held))
    groups, low, high = (held[at[rows] + k].astype(np.int64) for k in (1, 2, 3))
    word = low | (high & np.where(groups & 1, 0xFF, 0x7F)) << 8
    found = np.zeros(len(at), np.bool_)
    found[rows] = np.where(groups < 0x80, word >> KNOWN_BITS[groups & 0x7F] > 0, low & ~KNOWN_SECOND > 0)
    return found


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the packet at each place; see `framing.Lengths`."""
    hopeless, stream = _hopeless(held, at), held.tobytes()
    length, left = np.where(hopeless, IMPOSSIBLE, 0), np.flatnonzero(~hopeless)
    for _ in range(min(KINDS, len(at))):
        if not len(left):
            break
        packet = stream[at[left[0]] :][:LONGEST_PACKET]
        found = read_contents(packet)
        same = left == left[0]
        if isinstance(found, Contents) and not found.counters:
            whole = np.flatnonzero(at[left] + found.header <= len(held))
            heads = windows(held, at[left[whole]], found.header)
            same[whole] = np.all(heads == np.frombuffer(packet[: found.header], np.uint8), axis=1)
        length[left[same]] = _length(found)
        left = left[~same]
    for k, place in zip(left.tolist(), at[left].tolist(), strict=True):
        length[k] = _length(read_contents(stream[place : place + LONGEST_PACKET]))
    return length


def _length(found: Contents | int) -> int:
    return found if isinstance(found, int) else found.end + 2


XMODEM = Checksum("crc16-xmodem", first=1, big=True)


def _sentence(text: str) -> tuple[str, list[str], list[float]] | None:
    """Return header, fields, numbers of a line that is right, else None: torn ones may have a fitting sum."""
    body = sentence_body(text.rstrip("\r\n"), XMODEM)
    if body is None or not body.isascii():
        return None
    name, *fields = body[3:].split(",")
    if name not in tables.SENTENCES:
        return name, fields, []
    size = len(tables.SENTENCES[name])
    if len(fields) > size and fields[-1][:1] in ("S", "T"):
        fields = fields[:size]  # the appendix with status or time
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        return None
    return (name, fields, numbers) if len(fields) == size and "_" not in body else None


def _numbers_in(text: str) -> list[float] | None:
    read = _sentence(text)
    return None if read is None else read[2]


SENTENCE = 2
"""Number of their kind."""


class VectorNavDecoder(TableDecoder):
    """Decodes binary outputs with any fields and ASCII sentences, mixed as they may come."""

    def __init__(self, rate_hz: float | None = None) -> None:
        frames = (
            Frame({b"\xfa": "binary"}, _lengths, XMODEM),
            Frame({b"\xfb\x00": "split"}, counted_length(4, 2, 8, LONGEST_PACKET), XMODEM),
            line_frame({b"$VN": "ascii"}, _sentence),
        )
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        super().__init__(
            frames,
            timing,
            [item for items in tables.GROUPS.values() for item in items if item is not None],
            names=tables.SIDE_GROUPS,
            apart=(*tables.RECEIVERS.values(),),
        )
        for name in ("roll", "pitch"):  # alignment calls its own otherwise where a device may send these
            del self._possible[name]
        self._factory: frozenset[str] = frozenset()
        """Quantities that have come as they were calibrated in the factory."""

    def _by_layout(self, found: Found) -> Iterable[tuple[Layout, IntArray]]:
        """Yield the layouts; where calibrated quantities begin, the filtered ones step back."""
        start = 0
        for alike in self._alike(found):
            new = _factory(self._numbers_of(alike)) - self._factory
            if new:
                first = int(alike.rows[0])
                yield from self._of_rows(found, start, first)
                start, self._factory = first, self._factory | new
                self._layouts.clear()
        yield from self._of_rows(found, start, len(found))

    def _of_rows(self, found: Found, start: int, stop: int) -> Iterable[tuple[Layout, IntArray]]:
        """Yield the layouts of some of the packets."""
        for layout, rows in super()._by_layout(found.only(np.arange(start, stop))):
            yield layout, rows + start

    def _signature(self, packet: bytes) -> Sequence[int]:
        if packet[:1] == b"$":
            return range(6)
        found = read_contents(packet) if packet[0] == 0xFA else IMPOSSIBLE
        return () if isinstance(found, int) else [*range(found.header), *found.counters]

    def _contents(self, packet: bytes) -> list[tuple[Message, int, int]]:
        found = read_contents(packet) if packet[0] == 0xFA else IMPOSSIBLE
        return [] if isinstance(found, int) else [(item, at, item.size) for item, at in found.fields]

    def _numbers_of(self, alike: Alike) -> list[Number]:
        """Return the numbers of packets; those of a sentence are in its order."""
        if alike.kind == SENTENCE:
            values = tables.SENTENCES.get(alike.packet[3:6].decode("ascii", "replace"), ())
            return [value._replace(group=MAIN) for value in values]
        return [n for item, at, size in self._contents(alike.packet) for n in item.placed(at, size, False)]

    def _layout(self, alike: Alike) -> Layout | None:
        numbers = _renamed(self._numbers_of(alike), self._factory)
        if alike.kind == SENTENCE:
            self._report_sentence(alike.packet.decode("ascii", "replace"))
            layout: Layout = LineLayout(_numbers_in, numbers)
        else:
            layout = Record(numbers)
        if "gyro_x" in layout.of_column and "gyro" not in self._factory:
            self._warn(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU"
            )
        return layout if layout.columns else None

    def _report_sentence(self, line: str) -> None:
        """Report a sentence that is not data."""
        read = _sentence(line)
        assert read is not None
        if read[0] == "ERR":
            self._report(f"the device reports error {', '.join(read[1])}")
        elif read[0] not in tables.SENTENCES:
            self._report(f"sentence $VN{read[0]} is counted and not read")


def _factory(numbers: Sequence[Number]) -> frozenset[str]:
    """Return of which quantities there are numbers as they were calibrated in the factory."""
    names = {number.name for number in numbers}
    return frozenset(base for base in tables.FILTERED if f"{base}_x" in names)


def _renamed(numbers: Sequence[Number], factory: frozenset[str]) -> list[Number]:
    """Return the numbers; those of the filter have the plain names where nothing comes as calibrated."""
    bases = {*tables.FILTERED} - factory
    plain = {f"{base}_compensated_{axis}": f"{base}_{axis}" for base in bases for axis in "xyz"}
    return [
        number._replace(column=KNOWN[plain[number.name]]) if number.name in plain else number
        for number in numbers
    ]


PLACES = {
    f"{tables.GROUP_NAMES[group]}.{item.name}": (group, bit)
    for group, items in tables.GROUPS.items()
    for bit, item in enumerate(items[:15])
    if group < 8 and item is not None and item.columns
}
"""Group and bit of the fields that can be sent, by GROUP.FIELD: those that need no second byte or word."""


def words_of(names: Iterable[str]) -> dict[int, int]:
    """Return for each group of fields, in order, the word with their bits.

    Raises BAD_CONFIG when there is no such field.
    """
    words: dict[int, int] = {}
    for group, bit in sorted(chosen([*names], PLACES, "field")):
        words[group] = words.get(group, 0) | 1 << bit
    return words


def header_of(groups: int, words: Iterable[int]) -> bytes:
    """Return how a packet begins that has these groups, bits from the first on, and words."""
    return bytes([0xFA, groups & 0xFF]) + b"".join(word.to_bytes(2, "little") for word in words)


class VectorNavEncoder(Encoder):
    """Makes binary packets of one output.

    Raises BAD_CONFIG when there is no such field.

    Fields are GROUP.FIELD, as ``Imu.UncompGyro``; they are sent in the order of their bits.
    """

    def __init__(self, names: Sequence[str]) -> None:
        words, numbers = words_of(names), list[Number]()
        header = header_of(sum(1 << group - 1 for group in words), words.values())
        size = len(header)
        for group, bit in sorted({PLACES[name] for name in names}):
            item = tables.GROUPS[group][bit]
            assert item is not None
            numbers += item.placed(size, item.size, False)
            size += item.size
        self._numbers, self._blank = _renamed(numbers, _factory(numbers)), header.ljust(size, b"\0")

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; see `imumon.protocols.base.Encoder`."""
        packets = write("binary output", self._numbers, self._blank, block.columns, len(block))
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
