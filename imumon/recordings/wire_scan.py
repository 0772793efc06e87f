"""Takes a wire file apart piece by piece, and finds back into it behind what is damaged."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, Header, Message, Metadata
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

from imumon.errors import ImumonError, Reason
from imumon.recordings.wire_format import (
    ATTACHMENT_OP,
    BARE_CHANNEL,
    BARE_ENCODING,
    CDR,
    CHANNEL_OP,
    CHECK_OP,
    CHECK_SEQUENCE_AT,
    CHECK_SIZE,
    CHUNK_OP,
    DATA_END_OP,
    EVENT_CHANNEL,
    EVENT_ENCODING,
    EVENT_TOPIC,
    FORMAT,
    FORMATS,
    HEADER_OP,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX_OP,
    MESSAGE_OP,
    METADATA_OP,
    RECORD,
    SCHEMA_OP,
    SEQUENCE_AT,
    UNRECORDED,
    WIRE_CHANNEL,
    WIRE_ENCODING,
    WIRE_TOPIC,
    Check,
)
from imumon.recordings.wire_kernels import (
    BARE,
    EVENT,
    FOREIGN,
    HEAD,
    LONGEST_CHUNK,
    OTHER,
    WIRE,
    begins,
    gather,
    little,
    next_good,
)
from imumon.transport.reader import ByteArray, Event, EventKind, Reads

WINDOW = 1 << 16
"""How far behind a record in doubt is looked for the next good one, before the record is taken."""
KEPT_PLACES = 100
"""Damaged places of which the details are kept; all are counted."""
_BATCH_BYTES, _BATCH_READS, _BATCH_CHECKS = 1 << 16, 1 << 13, 1 << 10
"""Most that is handed on at once."""
_BEHIND = 1 << 31
"""A sequence that is so far ahead, modulo 2^32, is behind."""
_MASK = (1 << 32) - 1
_CONTENTS = {
    (WIRE_TOPIC, WIRE_ENCODING): WIRE,
    (WIRE_TOPIC, BARE_ENCODING): BARE,
    (EVENT_TOPIC, EVENT_ENCODING): EVENT,
}
_PASSED_OVER = (SCHEMA_OP, MESSAGE_INDEX_OP, ATTACHMENT_OP)
_HINT = "only wire files that imumon recorded can be replayed"
_BAD_RECORD = (McapError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)
"""What the library raises for a record that is not what its first byte says."""


@dataclass(frozen=True, slots=True)
class Place:
    """A damaged place of a wire file."""

    offset: int
    size: int
    """Where in the file, and how many bytes of the file; 0 when bytes were cut out."""
    after_ns: int
    before_ns: int
    """Unix time of the last message before and of the first one after it; 0 when there is none."""
    messages: int
    """Reads and events that are missing, as the numbers of those before and after say."""
    altered: bool
    """The messages are there, but are not as they were written: the checksum over the place differs."""

    @property
    def seconds(self) -> float:
        """Time between the messages around it."""
        return max(0, self.before_ns - self.after_ns) * 1e-9 if self.after_ns and self.before_ns else 0.0


@dataclass(slots=True)
class Damage:
    """What a wire file lacks, or has otherwise than it was written."""

    places: int = 0
    bytes: int = 0
    """Bytes of the file that are of no use."""
    bytes_altered: int = 0
    """Bytes of blocks that are read, but are not as they were written: some of their bytes are wrong."""
    messages: int = 0
    """Reads and events that are missing."""
    events: int = 0
    """Events that are there and cannot be understood."""
    seconds: float = 0.0
    """Time that the places span."""
    where: list[Place] = field(default_factory=list)
    """The first places, with their details."""

    def add(self, place: Place) -> None:
        """Count a place."""
        self.places += 1
        self.messages += place.messages
        self.seconds += place.seconds
        if place.altered:
            self.bytes_altered += place.size
        else:
            self.bytes += place.size
        if len(self.where) < KEPT_PLACES:
            self.where.append(place)


@dataclass(slots=True)
class WireSummary:
    """What a wire file held, known after it was read to its end."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_unrecorded: int = 0
    """Bytes that the recorder got and could not write, as the file says."""
    tail_bytes: int = 0
    """Bytes at the end of the file that are not a whole record, or are damaged: not of use."""
    complete: bool = False
    """The file was finished in order; False after a power failure, a kill or a full disk."""
    checksum_ok: bool | None = None
    """Whether the checksum over the file agrees; None when there is none because it was not finished."""
    last_ns: int = 0
    """Unix time of the last message."""
    damage: Damage = field(default_factory=Damage)
    """What is missing in the middle, or is not as it was written."""
    metadata: dict[str, str] = field(default_factory=dict)
    """What the recording program wanted to say."""


class Scan:
    """Takes a wire file apart as it comes.

    Reads are taken out by compiled code, as there may be hundreds a second for days; rare records are left
    to the library.  A record counts when another begins behind it; where none does, the next good one is
    searched for.
    """

    def __init__(self, path: Path) -> None:
        self.found = WireSummary()
        """What was found so far."""
        self.done = False
        """Whether nothing of use can follow."""
        self._good = False
        """Whether a record was found at all."""
        self._path = path
        self._rest = b""
        self._position = 0
        """Where in the file the rest begins."""
        self._crc = 0
        self._topics: ByteArray = np.zeros(1 << 16, np.uint8)  # by channel
        self._topics[[WIRE_CHANNEL, BARE_CHANNEL, EVENT_CHANNEL]] = WIRE, BARE, EVENT
        self._sequence = 0
        """That the next message must have; -1 when they are not numbered."""
        self._lost: int | None = None
        """Where the damage begins behind which nothing good was found yet."""
        self._open: tuple[int, int] | None = None
        """Offset and size of a damaged place behind which there was no message yet."""
        self._block = _Block()
        self._strange: list[ImumonError] = []
        """Events that are not understood: damage, or from a newer version; the next check tells."""
        self._foreign: ImumonError | None = None
        """A profile that is not ours, likewise."""
        self._at = 0
        self._waiting = False

    def begin(self, magic: bytes) -> None:
        """Take the first bytes of the file in, which tell what it is; they may be damaged."""
        if not MAGIC.startswith(magic):
            self._lost = 0
        self._position, self._crc = len(magic), zlib.crc32(magic)
        self._block.crc = self._crc
        self._block.size = len(magic)

    def feed(self, data: bytes, end: bool = False) -> Iterator[Reads | Event]:
        """Yield the items of the records that are whole by now; `end` says that no bytes follow."""
        buffer = self._rest + data
        self._at, self._waiting, self._block.begin = 0, False, 0
        yield from self._parse(buffer, np.frombuffer(buffer, np.uint8), end)
        used = memoryview(buffer)[: self._at]
        self._crc = zlib.crc32(used, self._crc)
        self._block.take(used[self._block.begin :])
        self._position += self._at
        self._rest = buffer[self._at :]

    def finish(self, size: int, last: bytes) -> None:
        """Say how a file of so many bytes ends, the last of which are given.

        Raises BAD_DATA when this is no wire file of a format that is known.
        """
        if not self._good and self._lost == 0:
            raise ImumonError(Reason.BAD_DATA, f"{self._path}: is not a wire file", _HINT)
        self._resolve(None)
        if self._lost is None:
            self._settle(0, 0)
        else:
            self.found.tail_bytes = size - self._lost
        self.found.complete = self.done and last == MAGIC

    # Records

    def _parse(self, buffer: bytes, view: ByteArray, end: bool) -> Iterator[Reads | Event]:
        while self._at < len(buffer) and not self.done and not self._waiting:
            if self._lost is not None:
                self._search(view, end)
                continue
            before = self._at
            reads = self._many(buffer, view)
            if len(reads.ends):
                yield self._counted(reads)
            elif self._at == before:
                yield from self._record(buffer, view, end)

    def _many(self, buffer: bytes, view: ByteArray) -> Reads:
        """Take out the reads whose messages follow each other from here on, and check their blocks."""
        data = np.empty(_BATCH_BYTES, np.uint8)
        ends, arrivals_ns = np.empty(_BATCH_READS, np.int64), np.empty(_BATCH_READS, np.int64)
        checks, start = np.empty(_BATCH_CHECKS, np.int64), (self._at, self._topics, self._sequence)
        n, passed, self._at = gather(view, *start, data, ends, arrivals_ns, checks)
        data.setflags(write=False)  # as what comes from a port: the decoders need one kernel for both
        if n:
            self._settle(int(arrivals_ns[0]), 0)
            self.found.last_ns = int(arrivals_ns[n - 1])
            if self._sequence >= 0:
                self._sequence = (self._sequence + n) & _MASK
        for at in checks[:passed].tolist():
            self._check(buffer, at)
        used = int(ends[n - 1]) if n else 0
        return Reads(data[:used], ends[:n], arrivals_ns[:n])

    def _counted(self, reads: Reads) -> Reads:
        self.found.reads += len(reads.ends)
        self.found.bytes += len(reads.data)
        self._good = True
        return reads

    def _record(self, buffer: bytes, view: ByteArray, end: bool) -> Iterator[Reads | Event]:
        """Take one record in, or wait for its rest, or find that it is damaged."""
        at, left = self._at, len(buffer) - self._at
        if left < HEAD and not end:
            self._waiting = True
            return
        opcode, length = RECORD.unpack_from(buffer, at) if left >= RECORD.size else (0, 0)
        after = at + RECORD.size + length
        last = end and opcode == DATA_END_OP and length == 4 and after == len(buffer)
        if not last and not begins(view, at, self._topics):
            self._lose()
            return
        whole = True if last else self._is_whole(view, opcode, after, end)
        if whole is None:
            self._waiting = True
        elif not whole:
            self._lose()
        elif opcode == MESSAGE_OP:
            yield from self._message(buffer, view, after)
        elif opcode == CHECK_OP:
            self._check(buffer, at)
            self._at = after
        else:
            try:
                items = self._rare(opcode, memoryview(buffer)[:at], buffer[at + RECORD.size : after])
            except _BAD_RECORD:
                self._lose()
            else:
                self._good = True
                self._at = after
                yield from items

    def _is_whole(self, view: ByteArray, opcode: int, after: int, end: bool) -> bool | None:
        """Tell whether the record here ends where it says; None when that cannot be told yet."""
        size = len(view)
        if after > size:
            return False if end else None
        if opcode == CHECK_OP or begins(view, after, self._topics):
            return True
        if size - after < HEAD:
            return True if end else None
        if size < after + WINDOW and not end:
            return None
        found = next_good(view, self._at + RECORD.size, after + WINDOW, self._topics)
        if found < 0:
            return True
        numbered = opcode == MESSAGE_OP and self._sequence >= 0
        follows = numbered and _sequence(view, found) == (_sequence(view, self._at) + 1) & _MASK
        return found > after and not follows

    def _message(self, buffer: bytes, view: ByteArray, after: int) -> Iterator[Reads | Event]:
        at = self._at
        _, _, channel, sequence, time_ns, _ = MESSAGE.unpack_from(buffer, at)
        if not self._number(view, after, sequence, time_ns):
            self._lose()
            return
        self._at, self.found.last_ns, self._good = after, time_ns, True
        body = buffer[at + MESSAGE.size : after]
        yield from self._payload(channel, body, time_ns)

    def _payload(self, channel: int, body: bytes, time_ns: int) -> Iterator[Reads | Event]:
        topic = self._topics[channel]
        if topic in (WIRE, BARE):
            body = body[CDR.size :] if topic == WIRE else body
            data, ends = np.frombuffer(body, np.uint8), np.array([len(body)])
            yield self._counted(Reads(data, ends, np.array([time_ns])))
        elif topic == EVENT:
            yield from self._event(body, time_ns)

    def _number(self, view: ByteArray, after: int, sequence: int, time_ns: int) -> bool:
        """Follow the numbers of the messages; return False for one that was there before."""
        if self._sequence < 0:
            self._settle(time_ns, 0)
            return True
        ahead = (sequence - self._sequence) & _MASK
        if ahead and begins(view, after, self._topics) and view[after] in (MESSAGE_OP, CHECK_OP):
            following = _sequence(view, after)
            if following == (self._sequence + 1) & _MASK:  # the number itself is damaged
                sequence, ahead = self._sequence, 0
        if ahead >= _BEHIND and sequence == 0:  # another tool wrote them without numbers
            self._sequence = -1
            return True
        if ahead >= _BEHIND and time_ns <= self.found.last_ns:
            return False
        self._settle(time_ns, ahead if ahead < _BEHIND else 0)
        self._sequence = (sequence + 1) & _MASK
        return True

    def _event(self, body: bytes, time_ns: int) -> Iterator[Event]:
        try:
            fields = json.loads(body)
            kind = fields["kind"]
            if kind == UNRECORDED:
                self.found.bytes_unrecorded += int(fields["bytes"])
            else:
                event = Event(EventKind(kind), time_ns, str(fields["detail"]))
                self.found.events += 1
                yield event
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            self._strange.append(self._error(f"event at {time_ns} ns is not understood: {body[:200]!r}"))

    def _rare(self, opcode: int, before: memoryview, body: bytes) -> Iterator[Reads | Event]:
        """Take in a rare record: header, channel, end, or a chunk if another tool rewrote the file.

        Raises ValueError when it is not what its first byte says; the library has others.
        """
        stream = ReadDataStream(BytesIO(body))
        if opcode == DATA_END_OP:
            self._end_data(before, DataEnd.read(stream).data_section_crc)
        elif opcode == HEADER_OP:
            profile = Header.read(stream).profile
            if profile not in FORMATS:
                self._foreign = self._error(f"is an MCAP file of profile {profile!r}, not {FORMAT!r}")
        elif opcode == CHANNEL_OP:
            channel = Channel.read(stream)
            if stream.count == len(body):
                self._channel(channel)
        elif opcode == METADATA_OP:
            metadata = Metadata.read(stream)
            self.found.metadata |= metadata.metadata if metadata.name == "imumon" else {}
        elif opcode == CHUNK_OP:
            return iter(self._chunk(Chunk.read(stream)))
        elif opcode not in _PASSED_OVER:
            raise ValueError("such a record does not stand here")
        if opcode in (HEADER_OP, CHANNEL_OP, METADATA_OP) and stream.count != len(body):
            raise ValueError("the fields do not fill the record")
        return iter(())

    def _channel(self, channel: Channel) -> None:
        """Note what a channel has; ours have it even where the record that says so is damaged."""
        content = _CONTENTS.get((channel.topic, channel.message_encoding))
        if content is not None or self._topics[channel.id] == OTHER:
            self._topics[channel.id] = FOREIGN if content is None else content

    def _chunk(self, chunk: Chunk) -> list[Reads | Event]:
        """Return the items of a chunk, of which the messages have no numbers to rely on."""
        if chunk.uncompressed_size > LONGEST_CHUNK:
            raise ValueError("the chunk is too long")
        items: list[Reads | Event] = []
        for inside in breakup_chunk(chunk, validate_crc=True):
            if isinstance(inside, Channel):
                self._channel(inside)
            elif isinstance(inside, Message):
                if inside.log_time >= 1 << 63:
                    raise ValueError("the time is out of range")
                self.found.last_ns = inside.log_time
                items += self._payload(inside.channel_id, inside.data, inside.log_time)
        return items

    # Damage

    def _lose(self) -> None:
        """Begin to search behind this byte, or go on when nothing came of the last good record."""
        if self._open is not None:
            self._lost, self._open = self._open[0], None
        else:
            self._lost = self._position + self._at
        self._block.damaged = True
        self._at += 1

    def _search(self, view: ByteArray, end: bool) -> None:
        """Go on to the next good record, or to the last bytes of which more must come."""
        assert self._lost is not None
        found = next_good(view, self._at, len(view), self._topics)
        if found < 0:
            self._at = max(self._at, len(view) - (0 if end else HEAD - 1))
            self._waiting = True
            return
        self._at = found
        self._open, self._lost = (self._lost, self._position + found - self._lost), None

    def _settle(self, time_ns: int, messages: int) -> None:
        """Note a damaged place, now that it is known what follows it and how many messages are missing."""
        if self._open is None and not messages:
            return
        offset, size = self._open or (self._position + self._at, 0)
        self._open, self._block.damaged = None, True
        self.found.damage.add(Place(offset, size, self.found.last_ns, time_ns, messages, altered=False))

    def _check(self, buffer: bytes, at: int) -> None:
        """Compare the block that ends here with what was written."""
        check, block = Check.unpack(buffer, at), self._block
        if check is None:  # its beginning is good, so this costs no read, and the next block begins behind it
            self.found.damage.add(
                Place(self._position + at, CHECK_SIZE, self.found.last_ns, 0, 0, altered=False)
            )
            self._resolve(None)
            self._block = _Block(begin=at + CHECK_SIZE, after_ns=self.found.last_ns)
            return
        block.take(memoryview(buffer)[block.begin : at])
        ahead = (check.sequence - self._sequence) & _MASK if self._sequence >= 0 and at == self._at else 0
        self._settle(check.time_ns, ahead if ahead < _BEHIND else 0)
        as_written = not block.damaged and (block.size, block.crc) == (check.size, check.crc)
        if not as_written and not block.damaged:
            start = self._position + at - block.size
            self.found.damage.add(Place(start, block.size, block.after_ns, check.time_ns, 0, altered=True))
        if self._sequence >= 0 and at == self._at:
            self._sequence = check.sequence
        self._resolve(as_written)
        self._good = True
        self._block = _Block(begin=at + CHECK_SIZE, after_ns=check.time_ns)

    def _end_data(self, before: memoryview, expected: int) -> None:
        self.found.checksum_ok = zlib.crc32(before, self._crc) == expected if expected else None
        self._resolve(self.found.checksum_ok)
        self.done = True

    def _error(self, seen: str) -> ImumonError:
        return ImumonError(Reason.BAD_DATA, f"{self._path}: {seen}", f"a newer imumon wrote it, or {_HINT}")

    def _resolve(self, as_written: bool | None) -> None:
        """Raise what is not understood though it is as it was written; it is damage when it is not.

        Without a check, None, an event counts as damaged, but a profile as what it says.
        """
        if self._foreign is not None and as_written is not False:
            raise self._foreign
        if self._strange and as_written:
            raise self._strange[0]
        self.found.damage.events += len(self._strange)
        self._strange, self._foreign = [], None


@dataclass(slots=True)
class _Block:
    """The bytes since the last check record, as far as they were taken in."""

    begin: int = 0
    """Where in the buffer those begin that were not taken in yet."""
    size: int = 0
    crc: int = 0
    after_ns: int = 0
    damaged: bool = False

    def take(self, data: memoryview) -> None:
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)


def _sequence(view: ByteArray, at: int) -> int:
    """Return the number of a message, or the one that a check record says of the next message."""
    return little(view, at + (SEQUENCE_AT if view[at] == MESSAGE_OP else CHECK_SEQUENCE_AT), 4)
