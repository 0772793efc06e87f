"""VectorNav VN-100 to VN-310: binary output (FA) with any mask of groups, and ASCII sentences ($VN).

Facts from the vendor's SDK and the VN-100 manual.  A binary packet is FA, a byte that lists the groups
that follow, a word for each that lists its fields, the fields, and a CRC; it has no length: that is the
sum of the fields.  So a packet with a field that is not known cannot be read, and is passed over.

`AngRate`, `Accel` and `Mag` are what the device's filter has left: its own estimate of the gyro bias is
already taken off.  `Uncomp...` and `Imu` are calibrated in the factory and no more; they make ``gyro``,
``accel`` and ``mag`` as soon as they come, and the others are then ``gyro_compensated`` and so on.
"""

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import NamedTuple

import numpy as np

from imumon.blocks import IntArray
from imumon.columns import KNOWN
from imumon.protocols import vectornav_fields as tables
from imumon.protocols.base import LONGEST_PACKET, MAIN, ByteArray, Encoder, Timing, chosen
from imumon.protocols.framing import IMPOSSIBLE, INCOMPLETE, Checksum, Found, Frame, counted_length, windows
from imumon.protocols.messages import Alike, Message, TableDecoder, field
from imumon.protocols.numbers import Number, Record
from imumon.protocols.text import line_frame, sentence_body, texts

MOST_HEADER = 64


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
        return _contents(packet) if packet[0] == 0xFA else IMPOSSIBLE
    except IndexError:
        return INCOMPLETE


def _contents(packet: bytes) -> Contents | int:
    groups = [1 + bit for bit in range(7) if packet[1] >> bit & 1]
    at = 2
    if packet[1] & 0x80:
        groups += [8 + bit for bit in range(8) if packet[2] >> bit & 1]
        at = 3
    items: list[Message] = []
    for group in groups:
        if group not in tables.GROUP_NAMES:
            return IMPOSSIBLE
        first, more = 0, True
        while more:
            if at > MOST_HEADER:
                return IMPOSSIBLE
            word = packet[at] | packet[at + 1] << 8
            at += 2
            more = group != tables.COMMON and word >= 0x8000
            word &= 0xFFFF if group == tables.COMMON else 0x7FFF
            places = [(group, first + k) for k in range(16) if word >> k & 1]
            if not tables.BY_PLACE.keys() >= {*places}:
                return IMPOSSIBLE
            items += map(tables.BY_PLACE.__getitem__, places)
            first += 16
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


def _in_word(group: int, bit: int) -> tuple[int, int, int]:
    """Return bytes of a field, whether it is not known, and whether its length depends on what follows."""
    if bit == 15 and group != tables.COMMON:
        return 0, 0, 1  # another word follows
    item = tables.BY_PLACE.get((group, bit))
    return (0, 1, 0) if item is None else (item.size, 0, item.name in tables.REPEATS)


IN_WORD = {group: np.array([_in_word(group, bit) for bit in range(16)], float) for group in range(1, 8)}
"""For each bit of the word of a group what `_in_word` returns, (16, 3); reals are multiplied faster."""
NOT_KNOWN_SECOND = 0xFF & ~(1 << tables.GNSS3 - 8)
"""Bits of a second group byte that are not documented."""


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the packet at each place; see `framing.Lengths`."""
    groups, second = (np.append(held, np.zeros(2, np.uint8))[at + k] for k in (1, 2))
    place, total = at + 2, np.zeros((len(at), 3))
    is_cut = place > len(held)
    for group, in_word in IN_WORD.items():
        there = np.flatnonzero(groups >> group - 1 & 1)
        is_cut[there] |= place[there] + 2 > len(held)
        there = there[~is_cut[there] & (total[there, 2] == 0.0)]
        bits = np.unpackbits(windows(held, place[there], 2), axis=1, bitorder="little")
        total[there] += bits.astype(np.float64) @ in_word
        place[there] += 2
    size, unknown, more = total.astype(np.int64).T
    length = np.where(is_cut, INCOMPLETE, place - at + size + 2)
    length[(unknown > 0) | (~is_cut & (size == 0)) | (length > LONGEST_PACKET)] = IMPOSSIBLE
    hopeless = (groups > 0x7F) & (second & NOT_KNOWN_SECOND > 0) & (at + MOST_HEADER + 4 <= len(held))
    length[hopeless] = IMPOSSIBLE
    for k in np.flatnonzero(np.where(groups > 0x7F, ~hopeless, (more > 0) & (unknown == 0))).tolist():
        found = read_contents(held[at[k] : at[k] + LONGEST_PACKET].tobytes())
        length[k] = found.end + 2 if isinstance(found, Contents) else found
    return length


XMODEM = Checksum("crc16-xmodem", first=1, big=True)


def body_of(line: str) -> str | None:
    """Return what a sentence has before its checksum, of eight bits or a CRC, or None when that is wrong."""
    body = sentence_body(line.rstrip("\r\n"), XMODEM)
    return body if body is not None and body.isascii() else None


def _sentence(text: str) -> tuple[str, list[str], list[float]] | None:
    """Return header, fields, numbers of a line that is right, else None: torn ones may have a fitting sum."""
    body = body_of(text)
    if body is None:
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


SENTENCE = 2
"""Number of their kind."""


PLACES = {
    f"{tables.GROUP_NAMES[group]}.{item.name}": (group, bit)
    for (group, bit), item in tables.BY_PLACE.items()
    if group < 8 and bit < 15 and item.columns
}
"""Group and bit of the fields that can be sent, by GROUP.FIELD: those that need no second byte or word."""


def words_of(names: Iterable[str]) -> dict[int, int]:
    """Return for each group of fields, in order, the word with their bits; raises as `chosen`."""
    words: dict[int, int] = {}
    for group, bit in sorted(chosen([*names], PLACES, "field")):
        words[group] = words.get(group, 0) | 1 << bit
    return words


def header_of(groups: int, words: Iterable[int]) -> bytes:
    """Return how a packet begins that has these groups, bits from the first on, and words."""
    return bytes([0xFA, groups & 0xFF]) + b"".join(word.to_bytes(2, "little") for word in words)


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


class VectorNavDecoder(TableDecoder):
    """Decodes binary outputs with any fields and ASCII sentences, mixed as they may come."""

    frames = (
        Frame({b"\xfa": "binary"}, _lengths, XMODEM),
        Frame({b"\xfb\x00": "split"}, counted_length(4, 2, 8, LONGEST_PACKET), XMODEM),
        line_frame({b"$VN": "ascii"}, _sentence),
    )
    timing = Timing(tick_ns=Fraction(1))
    messages = tables.BY_PLACE
    names, apart = tables.SIDE_GROUPS, (*tables.RECEIVERS.values(),)

    def __init__(self, rate_hz: float | None = None) -> None:
        super().__init__(rate_hz)
        for name in ("roll", "pitch"):  # alignment calls its own otherwise where a device may send these
            del self._possible[name]
        self._factory: frozenset[str] = frozenset()
        """Quantities that have come as they were calibrated in the factory."""

    def _by_layout(self, found: Found) -> Iterable[tuple[Record, IntArray]]:
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

    def _of_rows(self, found: Found, start: int, stop: int) -> Iterable[tuple[Record, IntArray]]:
        for layout, rows in super()._by_layout(found.only(np.arange(start, stop))):
            yield layout, rows + start

    def _signature(self, packet: bytes) -> Sequence[int]:
        if packet[:1] == b"$":
            return range(8)
        found = read_contents(packet)
        return () if isinstance(found, int) else [*range(found.header), *found.counters]

    def _contents(self, packet: bytes) -> list[tuple[Message, int, int]]:
        found = read_contents(packet)
        return [] if isinstance(found, int) else [(item, at, item.size) for item, at in found.fields]

    def _numbers_of(self, alike: Alike) -> list[Number]:
        """Return the numbers of packets; those of a sentence are in its order."""
        if alike.key[0] == SENTENCE:
            values = tables.SENTENCES.get(alike.packet[1:8].decode().strip(), ())
            return [v._replace(type="f64", at=8 + 8 * k, group=MAIN) for k, v in enumerate(values)]
        return [n for item, at, size in self._contents(alike.packet) for n in item.placed(at, size, False)]

    def _layout(self, alike: Alike) -> Record | None:
        layout = Record(_renamed(self._numbers_of(alike), self._factory))
        if "gyro_x" in layout.of_column and "gyro" not in self._factory:
            self._report(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU",
                is_warning=True,
            )
        return layout if layout.columns else None

    def _plain(self, found: Found) -> Found:
        """Return sentences as records of their name and numbers; those that are no data are reported."""
        rows = np.flatnonzero(found.kind == SENTENCE)
        records = dict[int, bytes]()
        for row, line in zip(
            rows.tolist(), texts(found.held, found.at[rows], found.length[rows]), strict=True
        ):
            read = _sentence(line)
            assert read is not None
            name, words, numbers = read
            records[row] = f"${name:<7}"[:8].encode() + array("d", numbers).tobytes()
            if name == "ERR":
                self._report(f"the device reports error {', '.join(words)}")
            elif name not in tables.SENTENCES:
                self._report(f"sentence $VN{name} is counted and not read")
        return found.replaced(records)

    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of one binary output of fields GROUP.FIELD, sent in the order of their bits."""
        words = words_of(names)
        header = header_of(sum(1 << group - 1 for group in words), words.values())
        places = sorted({PLACES[name] for name in names})
        sent = field("binary output", *(tables.BY_PLACE[place].numbers for place in places))
        renamed = replace(sent, numbers=tuple(_renamed(sent.numbers, _factory(sent.numbers))))
        return Encoder(partial(self._encode, lambda payload: XMODEM.sealed(header + payload), renamed))
