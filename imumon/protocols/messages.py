"""Tables of messages: what packets with an identifier, or the fields in a packet, carry at fixed places.

A family is a table of `Message`, frames, and a `FamilyDecoder` that knows where the identifier stands.  Older
devices send shorter messages and newer ones longer: what is behind the last number that is known is passed
over, and numbers behind the end are absent.

Packets are alike when their *signature* is the same: kind, length, and the bytes that identify what they
carry.  The first packet of each signature is looked at in Python; all that are like it are read at once.
"""

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import chain
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import Column, ColumnType
from imumon.protocols.base import COMMON, MAIN, NO_GROUP, Encoder, Groups, Timing, chosen
from imumon.protocols.decoder import Decoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Found, Frame, windows
from imumon.protocols.numbers import Derived, Number, Record, known, number, vector, with_sources, write

FAMILIES = {
    "ximu3": "imumon.protocols.ximu3:XimuDecoder",
    "mavlink": "imumon.protocols.mavlink:MavlinkDecoder",
    "witmotion": "imumon.protocols.witmotion:WitMotionDecoder",
    "sbg": "imumon.protocols.sbg:SbgDecoder",
    "inertialsense": "imumon.protocols.inertialsense:InertialSenseDecoder",
    "hipnuc": "imumon.protocols.hipnuc:HipnucDecoder",
    "vectornav": "imumon.protocols.vectornav:VectorNavDecoder",
}
"""Decoder of each protocol that is a table of messages; imported when a device of it is decoded."""
MOST_LAYOUTS = 4096
"""Signatures that are remembered: so many come of random bytes alone."""
ANY_SIZE = -1
"""Size of a field that is recognised and skipped whatever its length."""
Part = tuple[Number, ...]
"""Numbers that stand one behind the other."""


def floats(columns: str | Iterable[Column], factor: float = 1.0, kind: str = "f32") -> Part:
    """Return numbers of one type, not placed yet; a canonical quantity goes by its name."""
    there = known(columns) if isinstance(columns, str) else columns
    return tuple(Number(column, kind, factor) for column in there)


def real(name: str, unit: str, description: str, kind: str = "f32", factor: float = 1.0) -> Part:
    """Return a number of a column of its own, not placed yet."""
    return (Number(number(name, unit, description), kind, factor),)


def axes(
    name: str, unit: str, description: str, factor: float = 1.0, kind: str = "f32", letters: str = "xyz"
) -> Part:
    """Return numbers of a column of its own for each axis, not placed yet."""
    return floats(vector(name, unit, description, letters), factor, kind)


def counted(name: str, description: str, kind: str, unit: str = "1") -> Part:
    """Return an integer that is a column as it is, not placed yet."""
    return (Number(Column(name, unit, "int64", description), kind),)


def gnss(prefix: str, unit: str, *names: str, kind: str = "f32", factor: float = 1.0) -> Part:
    """Return numbers of a satellite receiver, not placed yet; integers without a factor are counts."""
    dtype: ColumnType = "float64" if kind[0] == "f" or factor != 1.0 else "int64"
    columns = [(f"{prefix}_{name}", f"receiver {prefix}: {name.replace('_', ' ')}") for name in names]
    return floats([Column(name, unit, dtype, what) for name, what in columns], factor, kind)


def gap(size: int) -> Part:
    """Return so many bytes that are passed over, not placed yet."""
    return (Number(None, "u8"),) * size


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """What packets with one identifier carry, or a field of a packet."""

    name: str
    """What the device file and the counters call it."""
    size: int
    """Bytes of the payload of today's devices; `ANY_SIZE` when it is recognised and skipped."""
    numbers: Part
    """Its numbers, with their places in the payload."""
    group: str = MAIN
    """Group of its columns; times and counters have none."""
    least: int = 0
    """Bytes of the shortest payload that is read; `size` when 0."""

    @property
    def columns(self) -> list[Column]:
        """Columns of its numbers."""
        return [item.column for item in self.numbers if item.column is not None]

    def placed(self, start: int, size: int, big: bool) -> list[Number]:
        """Return the numbers of a payload that begins at `start` and has `size` bytes."""
        return [
            item._replace(
                at=start + item.at,
                group=NO_GROUP if item.name in COMMON else item.group or self.group,
                big=big,
            )
            for item in self.numbers
            if item.end <= size
        ]


def field(name: str, *parts: Part, group: str = MAIN, least: int = 0) -> Message:
    """Return a message of parts that stand one behind the other; of any size when there are none."""
    at, placed = 0, list[Number]()
    for item in chain(*parts):
        placed.append(item._replace(at=at))
        at = placed[-1].end
    return Message(name, at if placed else ANY_SIZE, tuple(placed), group, least)


@lru_cache
def _all_columns(
    messages: Sequence[Message], derived: Sequence[Derived], names: Sequence[str], apart: Sequence[str]
) -> tuple[Groups, tuple[Column, ...]]:
    """Return the groups and the columns of all messages; kept, as they take ten times as long as the rest."""
    layouts = [Record(message.placed(0, message.size, False), derived) for message in messages]
    return Groups.of([layout.of_column for layout in layouts], names, apart), tuple(
        column for layout in layouts for column in layout.columns
    )


class Alike(NamedTuple):
    """Packets of one signature: their rows, the number of their kind, and the first of them."""

    rows: IntArray
    kind: int
    packet: bytes
    key: tuple[int, int, bytes]
    """The signature: kind, length, and the bytes that identify what is in the packet."""


class TableDecoder(Decoder):
    """Decodes packets that hold messages of a table; a subclass is the table of a family."""

    frames: Sequence[Frame]
    """Kinds of packets."""
    timing: Timing
    """How the devices count time."""
    messages: Mapping[Any, Message]
    """All that may come, by what identifies it."""
    derived: Sequence[Derived] = ()
    """Columns that are computed."""
    names: Sequence[str] = ()
    apart: Sequence[str] = ()
    """As for `Groups.of`."""
    big: bool = False
    """Whether the most significant byte comes first."""

    def __init__(self, rate_hz: float | None = None) -> None:
        table = (tuple(self.messages.values()), *map(tuple, (self.derived, self.names, self.apart)))
        self._layouts: dict[tuple[int, int, bytes], Record | None] = {}
        super().__init__(self.frames, replace(self.timing, rate_hz=rate_hz), *_all_columns(*table))

    @abstractmethod
    def _signature(self, packet: bytes) -> Sequence[int]:
        """Return the places of the bytes that identify what is in a packet."""

    @abstractmethod
    def _contents(self, packet: bytes) -> list[tuple[Message, int, int]]:
        """Return the messages in a packet that are in the table, and where each begins and its size."""

    def _layout(self, alike: Alike) -> Record | None:
        """Return what packets of a signature carry; None: nothing for a row."""
        there = self._contents(alike.packet)
        numbers = [item for message, at, size in there for item in message.placed(at, size, self.big)]
        layout = Record(numbers, self.derived)
        return layout if layout.columns else None

    def _alike(self, found: Found) -> Iterator[Alike]:
        """Yield the packets by their signatures, in the order of the first of each."""
        left = np.arange(len(found))
        while len(left):
            one = int(left[0])
            kind, size = int(found.kind[one]), int(found.length[one])
            packet = found.held[found.at[one] :][:size].tobytes()
            places = [*self._signature(packet)]
            same = (found.length[left] == size) & (found.kind[left] == kind)
            key = bytes(packet[k] for k in places)
            if places:
                heads = windows(found.held, found.at[left[same]], max(places) + 1)[:, places]
                same[same] = np.all(heads == np.frombuffer(key, np.uint8), axis=1)
            yield Alike(left[same], kind, packet, (kind, size, key))
            left = left[~same]

    def _by_layout(self, found: Found) -> Iterable[tuple[Record, IntArray]]:
        if len(self._layouts) > MOST_LAYOUTS:
            self._layouts.clear()
        for alike in self._alike(found):
            if alike.key not in self._layouts:
                self._layouts[alike.key] = self._layout(alike)
            layout = self._layouts[alike.key]
            if layout is not None:
                yield layout, alike.rows

    @abstractmethod
    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of messages or fields in this order; raises BAD_CONFIG when one is not there."""


class FamilyDecoder(TableDecoder):
    """Decodes packets that are each a message of a table."""

    start: int
    more: int
    """Bytes before the payload; bytes of the packet besides the payload."""
    head: Sequence[int]
    """Places of the bytes that identify what a packet carries."""

    @abstractmethod
    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a packet of an identifier and a payload."""

    @abstractmethod
    def _key(self, packet: bytes) -> int:
        """Return the identifier of a packet; what is not in the table is only counted."""

    def named(self, names: Sequence[str]) -> dict[str, tuple[int, Message]]:
        """Return identifier and contents of messages by name: of all, or of these and others."""
        del names
        return {message.name: (key, message) for key, message in self.messages.items()}

    def _message(self, key: int) -> Message | None:
        """Return what an identifier means."""
        return self.messages.get(key)

    def _signature(self, packet: bytes) -> Sequence[int]:
        del packet
        return self.head

    def _contents(self, packet: bytes) -> list[tuple[Message, int, int]]:
        message, size = self._message(self._key(packet)), len(packet) - self.more
        if message is None or size < (message.least or message.size):
            return []
        return [(message, self.start, min(size, message.size))]

    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of messages; see `TableDecoder.encoder`."""
        sent = chosen(names, self.named(names), "message")
        return Encoder(*(partial(self._encode, *one) for one in sent))

    def _encode(self, key: int, message: Message, block: SampleBlock) -> list[bytes]:
        numbers = message.placed(0, message.size, self.big)
        columns = with_sources(block.columns, self.derived, [item.name for item in numbers])
        payloads = write(message.name, numbers, bytes(message.size), columns, len(block))
        return [self.wrap(key, payload.tobytes()) for payload in payloads]


class TableDevice(DeviceFile):
    """Device file of a family; `sends` is for its virtual twin alone."""

    sends: list[str]

    def decoder(self) -> TableDecoder:
        """Make a decoder for this device."""
        family: type[TableDecoder] = resolve_name(FAMILIES[self.protocol])
        return family(self.rate_hz)

    def encoder(self) -> Encoder:
        """Make an encoder that sends what the device would send."""
        return self.decoder().encoder(self.sends)
