"""Tables of messages: what packets with an identifier, or the fields in a packet, carry at fixed places.

A family is a table of `Message`, frames, and a `FamilyDecoder` that knows where the identifier stands.  Older
devices send shorter messages and newer ones longer: what is behind the last number that is known is passed
over, and numbers behind the end are absent.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pkgutil import resolve_name

from imumon.blocks import SampleBlock
from imumon.columns import Column
from imumon.protocols.base import COMMON, MAIN, NO_GROUP, Encoder, Groups, Timing, chosen
from imumon.protocols.decoder import Alike, Decoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Frame
from imumon.protocols.numbers import Derived, Layout, Number, Record, count, known, with_sources, write

FAMILIES = {
    "ximu3": "imumon.protocols.ximu3:XimuDecoder",
    "mavlink": "imumon.protocols.mavlink:MavlinkDecoder",
    "witmotion": "imumon.protocols.witmotion:WitMotionDecoder",
    "sbg": "imumon.protocols.sbg:SbgDecoder",
    "inertialsense": "imumon.protocols.inertialsense:InertialSenseDecoder",
    "hipnuc": "imumon.protocols.hipnuc:HipnucDecoder",
}
"""Decoder of each protocol that is a table of messages; imported when a device of it is decoded."""
ANY_SIZE = -1
"""Size of a field that is recognised and skipped whatever its length."""
Part = tuple[Number, ...]
"""Numbers with their places in the payload."""


def part(at: int, kind: str, columns: str | Sequence[Column], factor: float = 1.0, group: str = "") -> Part:
    """Return numbers of one type, one behind the other.

    `kind` is one of `NUMBER_TYPES`; `factor` leads to the unit of the column.  A canonical quantity goes by
    its name.  Without a group the numbers are of that of the message.
    """
    there = known(columns) if isinstance(columns, str) else columns
    size = Number(None, kind).end
    return tuple(Number(c, kind, factor, at=at + k * size, group=group) for k, c in enumerate(there))


def floats(columns: str | Iterable[Column], factor: float = 1.0, kind: str = "f32") -> Part:
    """Return numbers of one type, not placed yet; a canonical quantity goes by its name."""
    there = known(columns) if isinstance(columns, str) else columns
    return tuple(Number(column, kind, factor) for column in there)


def counted(name: str, description: str, kind: str, unit: str = "1") -> Number:
    """Return an integer that is a column as it is, not placed yet."""
    return Number(count(name, description, unit), kind)


def whole(at: int, kind: str, name: str, description: str, unit: str = "1") -> Part:
    """Return an integer that is a column as it is."""
    return part(at, kind, [count(name, description, unit)])


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """What packets with one identifier carry, or a field of a packet."""

    name: str
    """What the device file and the counters call it."""
    size: int
    """Bytes of the payload of today's devices."""
    parts: tuple[Part, ...]
    """Its numbers, as `part` makes them."""
    group: str = MAIN
    """Group of its columns; times and counters have none."""
    least: int = 0
    """Bytes of the shortest payload that is read; `size` when 0."""

    @property
    def columns(self) -> list[Column]:
        """Columns of its numbers."""
        return [item.column for one in self.parts for item in one if item.column is not None]

    def placed(self, start: int, size: int, big: bool) -> list[Number]:
        """Return the numbers of a payload that begins at `start` and has `size` bytes."""
        return [
            item._replace(
                at=start + item.at,
                group=NO_GROUP if item.name in COMMON else item.group or self.group,
                big=big,
            )
            for one in self.parts
            for item in one
            if item.end <= size
        ]


def field(name: str, numbers: Iterable[Number], group: str = MAIN) -> Message:
    """Return a field of numbers that stand one behind the other; of any size when there are none."""
    at, placed = 0, list[Number]()
    for number in numbers:
        placed.append(number._replace(at=at))
        at = placed[-1].end
    return Message(name, at if placed else ANY_SIZE, (tuple(placed),), group)


@lru_cache
def _all_columns(
    messages: Sequence[Message], derived: Sequence[Derived], names: Sequence[str], apart: Sequence[str]
) -> tuple[Groups, tuple[Column, ...]]:
    """Return the groups and the columns of all messages; kept, as they take ten times as long as the rest."""
    layouts = [Record(message.placed(0, message.size, False), derived) for message in messages]
    return Groups.of([layout.of_column for layout in layouts], names, apart), tuple(
        column for layout in layouts for column in layout.columns
    )


class TableDecoder(Decoder):
    """Decodes packets that hold messages of a table.

    `messages` are all that may come; `names` and `apart` as for `Groups.of`.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        timing: Timing,
        messages: Iterable[Message],
        derived: Sequence[Derived] = (),
        names: Sequence[str] = (),
        apart: Sequence[str] = (),
        big: bool = False,
    ) -> None:
        groups, possible = _all_columns(*map(tuple, (messages, derived, names, apart)))
        super().__init__(frames, timing, groups, possible)
        self._derived, self._big = derived, big

    @abstractmethod
    def _contents(self, packet: bytes) -> list[tuple[Message, int, int]]:
        """Return the messages in a packet that are in the table, and where each begins and its size."""

    def _layout(self, alike: Alike) -> Layout | None:
        there = self._contents(alike.packet)
        numbers = [item for message, at, size in there for item in message.placed(at, size, self._big)]
        layout = Record(numbers, self._derived)
        return layout if layout.columns else None


class FamilyDecoder(TableDecoder):
    """Decodes packets that are each a message of a table; a subclass is the table of a family."""

    messages: Mapping[int, Message]
    """What each identifier means."""
    frames: Sequence[Frame]
    """Kinds of packets."""
    timing: Timing
    """How the devices count time."""
    start: int
    more: int
    """Bytes before the payload; bytes of the packet besides the payload."""
    head: Sequence[int]
    """Places of the bytes that identify what a packet carries."""
    big: bool = False
    """Whether the most significant byte comes first."""
    apart: Sequence[str] = ()
    """Groups that never join the main rows."""
    derived: Sequence[Derived] = ()
    """Columns that are computed."""

    def __init__(self, rate_hz: float | None = None) -> None:
        timing = replace(self.timing, rate_hz=rate_hz)
        messages = self.messages.values()
        super().__init__(self.frames, timing, messages, self.derived, apart=self.apart, big=self.big)

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


class TableEncoder(Encoder):
    """Makes the packets of a sample, one message after the other.

    Raises BAD_CONFIG when there is no such message.

    `names`: those of messages, in the order in which they are sent.
    """

    def __init__(self, family: FamilyDecoder, names: Sequence[str]) -> None:
        self._sent = chosen(names, family.named(names), "message")
        self._family = family

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `imumon.protocols.base.Encoder`."""
        parts = list[list[bytes]]()
        for key, message in self._sent:
            numbers = message.placed(0, message.size, self._family.big)
            columns = with_sources(block.columns, self._family.derived, [item.name for item in numbers])
            payloads = write(message.name, numbers, bytes(message.size), columns, len(block))
            parts.append([self._family.wrap(key, payload.tobytes()) for payload in payloads])
        return [b"".join(row) for row in zip(*parts, strict=True)]


class TableDevice(DeviceFile):
    """Device file of a family; `sends` is for its virtual twin alone."""

    sends: list[str]

    def decoder(self) -> FamilyDecoder:
        """Make a decoder for this device."""
        family: type[FamilyDecoder] = resolve_name(FAMILIES[self.protocol])
        return family(self.rate_hz)

    def encoder(self) -> TableEncoder:
        """Make an encoder that sends what the device would send."""
        return TableEncoder(self.decoder(), self.sends)
