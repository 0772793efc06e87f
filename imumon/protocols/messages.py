"""Families whose packets carry an identifier and numbers at fixed places: tables of messages.

A family is a table of `Message`, frames, and a `TableDecoder` that says where the identifier stands.  Older
devices send shorter messages and newer ones longer: what is behind the last number that is known is passed
over, and numbers behind the end are absent.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import Column
from imumon.protocols.base import COMMON, MAIN, Encoder, Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Frame
from imumon.protocols.layouts import Alike, Layout, LayoutDecoder, Record, groups_of
from imumon.protocols.numbers import (
    NO_GROUP,
    NUMBER_TYPES,
    Derived,
    Placed,
    Value,
    with_sources,
    write,
)
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

    def numbers(self, start: int, size: int, big: bool) -> list[Placed]:
        """Return the numbers of packets whose payload begins at `start` and has `size` bytes."""
        return [
            Placed(
                item.value,
                start + item.at,
                NO_GROUP if item.name in COMMON else item.group or self.group,
                big,
            )
            for one in self.parts
            for item in one
            if item.end <= size
        ]


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
    head: tuple[int, ...]
    """Places of the bytes that tell what a packet carries."""
    big: bool = False
    """Whether the most significant byte comes first."""
    apart: Sequence[str] = ()
    """Groups that never join the main rows."""

    def layout(self, message: Message, size: int) -> Record:
        """Return the layout of packets with so many bytes of payload."""
        return Record(message.numbers(self.start, size, self.big), message.derived)


class TableDevice(DeviceFile):
    """Device file of a family; `sends` is for its virtual twin alone."""

    family: ClassVar[TableFamily]
    sends: list[str]

    def decoder(self) -> TableDecoder:
        """Make a decoder for this device."""
        return self.family.decodes(self.family, self.rate_hz)

    def encoder(self) -> TableEncoder:
        """Make an encoder that sends what the device would send."""
        return TableEncoder(self.family, self.sends)


class TableDecoder(LayoutDecoder):
    """Decodes the messages of a family."""

    def __init__(self, family: TableFamily, rate_hz: float | None) -> None:
        self._family = family
        layouts = [family.layout(message, message.size) for message in family.messages.values()]
        super().__init__(
            family.frames,
            replace(family.timing, rate_hz=rate_hz),
            groups_of(layouts, apart=family.apart),
            [column for layout in layouts for column in layout.columns],
        )

    @abstractmethod
    def _key(self, packet: bytes) -> int:
        """Return the identifier of a packet; what is not in the table is only counted."""

    def _message(self, key: int) -> Message | None:
        """Return what an identifier means."""
        return self._family.messages.get(key)

    def _signature(self, packet: bytes) -> Sequence[int]:
        del packet
        return self._family.head

    def _layout(self, alike: Alike) -> Layout | None:
        message, size = self._message(self._key(alike.packet)), len(alike.packet) - self._family.more
        if message is None or size < (message.least or message.size):
            return None
        return self._family.layout(message, min(size, message.size))


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
        rows, parts = np.arange(len(block)), list[list[bytes]]()
        for key, message in self._sent:
            numbers = message.numbers(0, message.size, self._family.big)
            columns = with_sources(block.columns, message.derived, [item.name for item in numbers])
            payloads = write(message.name, numbers, message.size, columns, rows)
            parts.append([self._family.wrap(key, payload.tobytes()) for payload in payloads])
        return [b"".join(row) for row in zip(*parts, strict=True)]
