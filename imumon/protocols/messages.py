"""Families whose packets carry an identifier and numbers at fixed places: tables of messages.

A family is a table of `Message`, frames, and a few lines that say where the identifier stands; `TableDecoder`
and `TableEncoder` do the rest.  Older devices send shorter messages and newer ones longer: what is behind the
last number that is known is passed over, and numbers behind the end are absent.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import COMMON, MAIN, Encoder, Timing
from imumon.protocols.framing import Found, Frame
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.payload import LayoutDecoder, Placed
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged import Derived, Value
from imumon.protocols.tagged_columns import count
from imumon.protocols.tagged_encoder import packed

Part = tuple[Value, int]
"""A number and where it begins in the payload."""


def part(at: int, kind: str, columns: Sequence[Column], factor: float = 1.0) -> tuple[Part, ...]:
    """Return numbers of one type, one behind the other."""
    size = NUMBER_TYPES[kind].size
    return tuple((Value(column, kind, factor), at + k * size) for k, column in enumerate(columns))


def whole(at: int, kind: str, name: str, description: str, unit: str = "1") -> tuple[Part, ...]:
    """Return an integer that is a column as it is."""
    return part(at, kind, [count(name, description, unit)])


@dataclass(frozen=True, slots=True)
class Message:
    """What packets with one identifier carry.

    Parameters
    ----------
    name : str
        What the device file and the counters call it.
    size : int
        Bytes of the payload of today's devices.
    parts : tuple of tuples of Part
        Its numbers, as `part` makes them.
    group : str
        Group of its columns; times and counters have none.
    derived : tuple of Derived
        Columns that are computed.
    least : int
        Bytes of the shortest payload that is read; `size` when 0.
    """

    name: str
    size: int
    parts: tuple[tuple[Part, ...], ...]
    group: str = MAIN
    derived: tuple[Derived, ...] = ()
    least: int = 0

    def layout(self, start: int, size: int, big: bool) -> Placed:
        """Return the layout of packets whose payload begins at `start` and has `size` bytes."""
        placed = [
            (value, start + at, self.group_of(value))
            for parts in self.parts
            for value, at in parts
            if at + NUMBER_TYPES[value.type].size <= size
        ]
        return Placed(placed, big, self.derived)

    def group_of(self, value: Value) -> str:
        """Return the group of a number."""
        return "" if value.column is None or value.column.name in COMMON else self.group


class TableDecoder(LayoutDecoder):
    """Decodes messages of a table.

    Parameters
    ----------
    frames : sequence of Frame
        Kinds of packets.
    messages : mapping of int to Message
        What each identifier means.
    timing : Timing
        How the device counts time.
    start, more : int
        Bytes before the payload; bytes of the packet besides the payload.
    big : bool
        Whether the most significant byte comes first.
    apart : sequence of str
        Groups that never join the main rows.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        messages: Mapping[int, Message],
        timing: Timing,
        start: int,
        more: int,
        big: bool = False,
        apart: Sequence[str] = (),
    ) -> None:
        groups = dict.fromkeys(message.group for message in messages.values() if message.group != MAIN)
        super().__init__(frames, timing, tuple(groups), apart)
        self._messages = dict(messages)
        self._start, self._more, self._big = start, more, big
        self._numbers: dict[tuple[int, int], int] = {}

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """Columns of all messages of the table."""
        layouts = [m.layout(self._start, m.size, self._big) for m in self._messages.values()]
        columns = {column.name: column for layout in layouts for column in layout.columns}
        return tuple((columns | self._columns).values())

    @abstractmethod
    def _keys(self, found: Found) -> IntArray:
        """Return the identifier of each packet; what is not in the table is only counted."""

    def _layout_numbers(self, found: Found) -> IntArray:
        numbers = np.full(len(found), -1, np.int64)
        both = np.column_stack([self._keys(found), found.length - self._more])
        kinds, which = np.unique(both, axis=0, return_inverse=True)
        for k, (key, size) in enumerate(kinds.tolist()):
            numbers[which.reshape(-1) == k] = self._number(key, size)
        return numbers

    def _number(self, key: int, size: int) -> int:
        """Return the number of the layout of a message with so many bytes of payload."""
        message = self._messages.get(key)
        if message is None or size < (message.least or message.size):
            return -1
        of = key, min(size, message.size)
        if of not in self._numbers:
            self._numbers[of] = self._add(message.layout(self._start, of[1], self._big))
        return self._numbers[of]


class TableEncoder(Encoder):
    """Makes the packets of a sample, one message after the other.

    Parameters
    ----------
    messages : mapping of int to Message
        What each identifier means.
    names : sequence of str
        Names of messages, in the order in which they are sent.
    wrap : callable
        Makes a packet of an identifier and a payload.
    big : bool
        Whether the most significant byte comes first.

    Raises
    ------
    ImumonError
        BAD_CONFIG when there is no such message.
    """

    def __init__(
        self,
        messages: Mapping[int, Message],
        names: Sequence[str],
        wrap: Callable[[int, bytes], bytes],
        big: bool = False,
    ) -> None:
        there = {message.name: key for key, message in messages.items()}
        for name in names:
            if name not in there:
                raise ImumonError(
                    Reason.BAD_CONFIG, f"no message {name!r}", f"there are: {', '.join(sorted(there))}"
                )
        if not names:
            raise ImumonError(Reason.BAD_CONFIG, "there is nothing to send")
        self._sent = [(there[name], messages[there[name]]) for name in names]
        self._wrap, self._big = wrap, big

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `imumon.protocols.base.Encoder`."""
        parts = [
            [self._wrap(key, row.tobytes()) for row in self._payload(message, block)]
            for key, message in self._sent
        ]
        return [b"".join(row) for row in zip(*parts, strict=True)]

    def _payload(self, message: Message, block: SampleBlock) -> ByteArray:
        columns = dict(block.columns)
        for item in message.derived:
            if all(column.name in columns for column in item.results):
                columns |= dict(zip(item.sources, item.encode(columns), strict=True))
        payload = np.zeros((len(block), message.size), np.uint8)
        rows = np.arange(len(block))
        for value, at in (one for parts in message.parts for one in parts):
            most_first = packed(message.name, value, columns, rows)
            size = NUMBER_TYPES[value.type].size
            payload[:, at : at + size] = most_first if self._big else most_first[:, ::-1]
        return payload
