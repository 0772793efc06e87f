"""Tables of messages: what packets with an identifier, or the fields in a packet, carry at fixed places.

A family is a table of `Message`, frames, and a `FamilyDecoder` that finds the identifier.  Older
devices send shorter messages and newer ones longer: what is behind the last number that is known is passed
over, and numbers behind the end are absent.

Packets are alike when their *signature* is the same: kind, length, and the bytes that identify what they
carry.  The first packet of each signature is examined in Python; all that are like it are read at once.
"""

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import pi
from pkgutil import resolve_name
from typing import Any

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import Column, ColumnType
from imumon.geodesy import STANDARD_GRAVITY

from .base import MAIN, Encoder, Groups, Timing, chosen
from .decoder import Decoder, Layouts
from .device import FAMILIES, DeviceFile
from .framing import Found, Frame, windows
from .numbers import NUMBER_TYPES, Derived, Number, Record, known, with_sources, write

MOST_LAYOUTS = 4096
"""Signatures whose layouts are kept: with more, which damaged data make, all begin anew.  Assumed."""
Part = tuple[Number, ...]
"""Numbers that stand one behind the other."""

FACTORS = {
    "pi": pi, "deg": pi / 180, "g": STANDARD_GRAVITY, "gauss": 100.0, "kPa": 1000.0, "hPa": 100.0,
}  # fmt: skip
"""Factors to the units of imumon: from deg to rad, g to m/s^2, gauss to uT, kPa and hPa to Pa; and pi."""
AXES = {"xyz": "xyz", "wxyz": "wxyz", "3x3": [f"{i}{j}" for i in "123" for j in "123"]}
"""Ends of the columns of a vector, a quaternion, a matrix."""
# KEY NAME [GROUP] >=LEAST: NUMBERS
_ROW = re.compile(r"(\S+) (\S+)(?: \[(\w*)\])?(?: >=(\d+))?:\s+(.*)", re.DOTALL)


def part(text: str) -> Part:
    """Read numbers that stand one behind the other, with bars between them; they are not placed yet.

    - ``gyro i16*deg/16``: a canonical column, or several that come together; the type of the numbers, their
      factors (`FACTORS` or numbers) and an offset, as in ``u8+2000``
    - ``ned_xyz f32 m/s velocity north, east, down``: columns of its own, with their unit and meaning;
      integers stay integers with whole factors, as ``*2``; ``*1.0`` makes them real numbers
    - ``gnss:latitude,longitude f64 deg``: columns of a receiver
    - ``12``: so many bytes that are passed over
    """
    found = list[Number]()
    for item in filter(None, map(str.strip, text.split("|"))):
        name, *more = item.split(maxsplit=3)
        if not more:
            found += (Number(None, "u8"),) * int(name)
            continue
        kind = re.split("[*/+]", more[0])[0]
        scale = re.findall("([*/+])([^*/+]+)", more[0])  # pairs of a sign and a term
        factor, offset = 1.0, 0.0
        for sign, term in scale:
            value = FACTORS.get(term) or float(term)
            if sign == "+":
                offset = value
            else:
                factor = factor * value if sign == "*" else factor / value
        stays_whole = all(sign != "/" and term.isdecimal() for sign, term in scale)
        columns = _columns(name, more[1:], "int64" if kind[0] in "ui" and stays_whole else "float64")
        found += (Number(column, kind, factor, offset) for column in columns)
    return tuple(found)


def _columns(name: str, more: Sequence[str], dtype: ColumnType) -> Iterable[Column]:
    """Return the columns of an item of a table; `more`: unit and meaning, where it has them."""
    prefix, _, ends = name.rpartition(":")
    if prefix:
        for end in ends.split(","):
            yield Column(f"{prefix}_{end}", more[0], dtype, f"receiver {prefix}: {end.replace('_', ' ')}")
    elif not more:
        yield from known(name)
    else:
        unit, what = more
        stem, _, axes = name.rpartition("_")
        if axes in AXES:
            for axis in AXES[axes]:
                yield Column(f"{stem}_{axis}", unit, dtype, f"{what}, {axis}")
        else:
            yield Column(name, unit, dtype, what)


def rows(text: str, usual: str = MAIN) -> Iterator[tuple[str, str, Part, str, int]]:
    """Yield what rows ``KEY NAME [GROUP] >=LEAST: NUMBERS`` of a table state; see `Message` and `part`.

    A line that is indented goes on with the one before.  `usual`: group where none is stated.
    """
    for row in re.split(r"\n(?=\S)", text.strip()):
        found = _ROW.fullmatch(row)
        assert found is not None, row
        key, name, group, least, numbers = found.groups()
        yield key, name, part(numbers), usual if group is None else group, int(least or 0)


def table(text: str, usual: str = MAIN) -> dict[int, "Message"]:
    """Return the messages of a table by their keys, numbers or letters; `usual`: group of most of them."""
    return {
        int(key, 0) if key[0].isdecimal() else ord(key): Message(name, numbers, group, least)
        for key, name, numbers, group, least in rows(text, usual)
    }


@dataclass(frozen=True, eq=False)
class Message:
    """What packets with one identifier carry, or a field of a packet."""

    name: str  # what the device file and the counters call it
    numbers: Part
    group: str = MAIN  # of its columns; times and counters have none
    least: int = 0  # bytes of the shortest payload that is read; 0: `size`

    @cached_property
    def size(self) -> int:
        """Bytes of the payload of today's devices."""
        return sum(NUMBER_TYPES[item.type].size for item in self.numbers)

    @property
    def columns(self) -> list[Column]:
        """Columns of its numbers."""
        return [item.column for item in self.numbers if item.column is not None]

    def placed(self, start: int, size: int, big: bool) -> list[Number]:
        """Return the numbers of a payload that begins at `start` and has `size` bytes."""
        at, numbers = start, list[Number]()
        for item in self.numbers:
            numbers.append(item._replace(at=at, group=item.group or self.group, big=big))
            at = numbers[-1].end
        return [number for number in numbers if number.end <= start + size]


Placed = list[tuple[Message, int, int]]  # messages in a packet, where each begins, and its size
Signature = tuple[int, int, bytes]
"""Kind and length of a packet, and the bytes that identify what is in it."""


class TableDecoder(Decoder):
    """Decodes packets that hold messages of a table; a subclass is the table of a family."""

    frames: Sequence[Frame]
    timing: Timing
    messages: Mapping[Any, Message]  # all that may come, by what identifies it
    derived: Sequence[Derived] = ()
    side_groups: Sequence[str] = ()
    apart: Sequence[str] = ()
    """Groups that come first behind the main one, and those that never join its rows; see `Groups.of`."""
    big: bool = False  # whether the most significant byte comes first

    def __init__(self) -> None:
        self._layouts: dict[Signature, Record | None] = {}
        every = [
            Record(message.placed(0, message.size, self.big), self.derived)
            for message in self.messages.values()
        ]
        groups = Groups.of([layout.group_of for layout in every], self.side_groups, self.apart)
        possible = [column for layout in every for column in layout.columns]
        super().__init__(self.frames, self.timing, groups, possible)

    @abstractmethod
    def _signature(self, packet: bytes) -> Sequence[int]:
        """Return the places of the bytes that identify what is in a packet."""

    @abstractmethod
    def _contents(self, packet: bytes) -> Placed:
        """Return the messages in a packet that are in the table."""

    def _numbers(self, packet: bytes) -> list[Number]:
        """Return the numbers of the messages in a packet, in their places."""
        there = self._contents(packet)
        return [item for message, at, size in there for item in message.placed(at, size, self.big)]

    def _layout(self, packet: bytes) -> Record | None:
        """Return what packets of a signature carry; None: nothing for a row."""
        layout = Record(self._numbers(packet), self.derived)
        return layout if layout.columns else None

    def _alike(self, found: Found) -> Iterator[tuple[Signature, IntArray, bytes]]:
        """Yield each signature as it first comes, the rows of all its packets, and the first of these."""
        is_left = np.ones(len(found), np.bool_)
        while is_left.any():
            first = int(np.argmax(is_left))
            kind, size = int(found.kind[first]), int(found.length[first])
            packet = found.held[found.at[first] :][:size].tobytes()
            places = [*self._signature(packet)]
            rows = np.flatnonzero(is_left & (found.length == size) & (found.kind == kind))
            if places:
                # Packets with the bytes of the first at its places have these places, too.
                heads = windows(found.held, found.at[rows], max(places) + 1)[:, places]
                rows = rows[np.all(heads == heads[0], axis=1)]
            is_left[rows] = False
            yield (kind, size, bytes(packet[k] for k in places)), rows, packet

    def _by_layout(self, found: Found) -> Layouts:
        if len(self._layouts) > MOST_LAYOUTS:
            self._layouts.clear()
        for signature, rows, packet in self._alike(found):
            if signature not in self._layouts:
                self._layouts[signature] = self._layout(packet)
            layout = self._layouts[signature]
            if layout is not None:
                yield layout, rows

    @abstractmethod
    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of messages or fields in this order; raises BAD_CONFIG when one is not there."""

    def _encode(self, wrap: Callable[[bytes], bytes], message: Message, block: SampleBlock) -> list[bytes]:
        """Return packets of a message; `wrap` makes one of a payload."""
        numbers = message.placed(0, message.size, self.big)
        columns = with_sources(block.columns, self.derived, [item.name for item in numbers])
        payloads = write(message.name, numbers, bytes(message.size), columns, len(block))
        return [wrap(payload.tobytes()) for payload in payloads]


class FamilyDecoder(TableDecoder):
    """Decodes packets that are each a message of a table."""

    start: int  # bytes before the payload
    overhead: int  # bytes of the packet besides the payload
    head: Sequence[int]
    """Places of the bytes that identify what a packet carries."""

    @abstractmethod
    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a packet of an identifier and a payload."""

    @abstractmethod
    def _key(self, packet: bytes) -> int:
        """Return the identifier of a packet, called once a signature; what is in no table is counted."""

    def _message(self, key: int) -> Message | None:
        return self.messages.get(key)

    def _signature(self, _packet: bytes) -> Sequence[int]:
        return self.head

    def _contents(self, packet: bytes) -> Placed:
        message = self._message(self._key(packet))
        size = len(packet) - self.overhead
        if message is None or size < (message.least or message.size):
            return []
        return [(message, self.start, min(size, message.size))]

    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of messages; see `TableDecoder.encoder`."""
        there = {message.name: (key, message) for key, message in self.messages.items()}
        sent = chosen(names, there, "message")
        return Encoder(*(partial(self._encode, partial(self.wrap, key), message) for key, message in sent))


class TableDevice(DeviceFile):
    """Device file of a family; `sends` is for its virtual twin alone."""

    sends: list[str]

    def decoder(self) -> TableDecoder:
        """Make a decoder for this device."""
        family: type[TableDecoder] = resolve_name(FAMILIES[self.protocol])
        return family()

    def encoder(self) -> Encoder:
        """Make an encoder that sends what the device would send."""
        return self.decoder().encoder(self.sends)
