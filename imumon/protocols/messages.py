"""Families whose packets carry an identifier and numbers at fixed places: tables of messages.

A family is a table of `Message`, frames, and a method that says where the identifier stands: `TableFamily`.
Older devices send shorter messages and newer ones longer: what is behind the last number that is known is
passed over, and numbers behind the end are absent.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import Column
from imumon.protocols.base import COMMON, MAIN, Encoder, Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Found, Frame
from imumon.protocols.numbers import NO_GROUP, NUMBER_TYPES, Derived, Placed, Value, packed
from imumon.protocols.payload import LayoutDecoder, Record, alike
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged_columns import count

Part = tuple[Placed, ...]
"""Numbers with their places in the payload."""


def part(at: int, kind: str, columns: Sequence[Column], factor: float = 1.0, group: str = NO_GROUP) -> Part:
    """Return numbers of one type, one behind the other, of the group of the message when none is given."""
    size = NUMBER_TYPES[kind].size
    return tuple(Placed(Value(c, kind, factor), at + k * size, group) for k, c in enumerate(columns))


def whole(at: int, kind: str, name: str, description: str, unit: str = "1") -> Part:
    """Return an integer that is a column as it is."""
    return part(at, kind, [count(name, description, unit)])


@dataclass(frozen=True, slots=True)
class Message:
    """What packets with one identifier carry."""

    name: str
    """What the device file and the counters call it."""
    size: int
    """Bytes of the payload of today's devices."""
    parts: tuple[Part, ...]
    """Its numbers, as `part` makes them."""
    group: str = MAIN
    """Group of its columns; times and counters have none."""
    derived: tuple[Derived, ...] = ()
    """Columns that are computed."""
    least: int = 0
    """Bytes of the shortest payload that is read; `size` when 0."""

    @property
    def numbers(self) -> list[Placed]:
        """All numbers, with their groups."""
        return [
            item._replace(group=NO_GROUP if item.name in COMMON else item.group or self.group)
            for one in self.parts
            for item in one
        ]

    def layout(self, start: int, size: int, big: bool) -> Record:
        """Return the layout of packets whose payload begins at `start` and has `size` bytes."""
        numbers = [item._replace(at=start + item.at, big=big) for item in self.numbers if item.end <= size]
        return Record(numbers, self.derived)


@dataclass(frozen=True, slots=True)
class TableFamily:
    """A family that is a table of messages."""

    messages: Mapping[int, Message]
    """What each identifier means."""
    frames: Sequence[Frame]
    """Kinds of packets."""
    decodes: Callable[[TableFamily, float | None], TableDecoder]
    """Makes a `TableDecoder`, which says where the identifier stands."""
    wrap: Callable[[int, bytes], bytes]
    """Makes a packet of an identifier and a payload."""
    timing: Timing
    """How the devices count time."""
    start: int
    more: int
    """Bytes before the payload; bytes of the packet besides the payload."""
    big: bool = False
    """Whether the most significant byte comes first."""
    apart: Sequence[str] = ()
    """Groups that never join the main rows."""

    def decoder(self, rate_hz: float | None) -> TableDecoder:
        """Make a decoder for packets that come at this nominal rate."""
        return self.decodes(self, rate_hz)

    def encoder(self, sends: Sequence[str]) -> TableEncoder:
        """Make an encoder of the messages of these names."""
        return TableEncoder(self, sends)


class TableDevice(DeviceFile):
    """Device file of a family; `sends` is for its virtual twin alone."""

    family: ClassVar[TableFamily]
    sends: list[str]

    def decoder(self) -> TableDecoder:
        """Make a decoder for this device."""
        return self.family.decoder(self.rate_hz)

    def encoder(self) -> TableEncoder:
        """Make an encoder that sends what the device would send."""
        return self.family.encoder(self.sends)


class TableDecoder(LayoutDecoder):
    """Decodes the messages of a family."""

    def __init__(self, family: TableFamily, rate_hz: float | None) -> None:
        there = (item.group for message in family.messages.values() for item in message.numbers)
        groups = tuple(dict.fromkeys(group for group in there if group not in (MAIN, NO_GROUP)))
        super().__init__(family.frames, replace(family.timing, rate_hz=rate_hz), groups, family.apart)
        self._family = family
        self._numbers: dict[tuple[int, int], int] = {}

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """Columns of all messages of the table."""
        layouts = [m.layout(0, m.size, self._family.big) for m in self._family.messages.values()]
        columns = {column.name: column for layout in layouts for column in layout.columns}
        return tuple((columns | self._columns).values())

    @abstractmethod
    def _keys(self, found: Found) -> IntArray:
        """Return the identifier of each packet; what is not in the table is only counted."""

    def _message(self, key: int) -> Message | None:
        """Return what an identifier means."""
        return self._family.messages.get(key)

    def _layout_numbers(self, found: Found) -> IntArray:
        numbers = np.full(len(found), -1, np.int64)
        sizes = found.length - self._family.more
        kinds, which = alike(self._keys(found) << 16 | sizes.clip(0, 0xFFFF))
        for k, kind in enumerate(kinds.tolist()):
            numbers[which == k] = self._number(kind >> 16, kind & 0xFFFF)
        return numbers

    def _number(self, key: int, size: int) -> int:
        """Return the number of the layout of a message with so many bytes of payload."""
        message = self._message(key)
        if message is None or size < (message.least or message.size):
            return -1
        of = key, min(size, message.size)
        if of not in self._numbers:
            self._numbers[of] = self._add(message.layout(self._family.start, of[1], self._family.big))
        return self._numbers[of]


class TableEncoder(Encoder):
    """Makes the packets of a sample, one message after the other.

    Raises BAD_CONFIG when there is no such message.

    Parameters
    ----------
    names : sequence of str
        Names of messages, in the order in which they are sent.
    """

    def __init__(self, family: TableFamily, names: Sequence[str]) -> None:
        there = {message.name: (key, message) for key, message in family.messages.items()}
        self._sent = chosen(names, there, "message")
        self._family = family

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `imumon.protocols.base.Encoder`."""
        parts = [
            [self._family.wrap(key, row.tobytes()) for row in self._payload(message, block)]
            for key, message in self._sent
        ]
        return [b"".join(row) for row in zip(*parts, strict=True)]

    def _payload(self, message: Message, block: SampleBlock) -> ByteArray:
        columns = dict(block.columns)
        for made in message.derived:
            if all(column.name in columns for column in made.results):
                columns |= dict(zip(made.sources, made.encode(columns), strict=True))
        payload, rows = np.zeros((len(block), message.size), np.uint8), np.arange(len(block))
        for item in message.numbers:
            most_first = packed(message.name, item.value, columns, rows)
            payload[:, item.at : item.end] = most_first if self._family.big else most_first[:, ::-1]
        return payload
