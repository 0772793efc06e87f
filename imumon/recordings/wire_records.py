"""The records of a wire file: from the bytes of one after the other to reads and events."""

from __future__ import annotations

import json
import struct
from collections.abc import Generator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Header, Message, Metadata
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
    SEQUENCE_MASK,
    UNRECORDED,
    WIRE_CHANNEL,
    WIRE_ENCODING,
    WIRE_TOPIC,
)
from imumon.recordings.wire_summary import Place, WireSummary
from imumon.transport.reader import Event, EventKind, Reads

WIRE, BARE, EVENT, FOREIGN = "reads in CDR", "reads alone", "events", "something of another program"
_CONTENTS = {
    (WIRE_TOPIC, WIRE_ENCODING): WIRE,
    (WIRE_TOPIC, BARE_ENCODING): BARE,
    (EVENT_TOPIC, EVENT_ENCODING): EVENT,
}
_PASSED_OVER = (SCHEMA_OP, MESSAGE_INDEX_OP, ATTACHMENT_OP, CHECK_OP)
LONGEST_MESSAGE = 16 << 20
LONGEST_RARE = 1 << 20
LONGEST_CHUNK = 256 << 20
"""A record that claims to be longer is damage, not a record."""
_BATCH_READS = 1 << 13
"""Most reads that are handed on at once."""
_BEHIND = 1 << 31
"""A number so far ahead, modulo 2^32, is behind."""
_HINT = "a newer imumon wrote it, or only wire files that imumon recorded can be replayed"
BAD_RECORD = (McapError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)
"""What the library raises for a record that is not what its first byte says."""


class Stop(NamedTuple):
    """Where records end."""

    at: int
    in_doubt: bool
    """What begins there is no record, or damaged; otherwise more bytes are needed, or the data ends."""


def message_at(data: bytes, at: int) -> tuple[int, int]:
    """Return number and time of the message that begins here."""
    _, _, _, sequence, time_ns, _ = MESSAGE.unpack_from(data, at)
    return sequence, time_ns


class Records:
    """Takes records apart, and keeps what those behind need: channels, and the number of the next message.

    Parameters
    ----------
    path : Path
        What errors name.
    found : WireSummary
        Where everything is counted.
    """

    def __init__(self, path: Path, found: WireSummary) -> None:
        self.found = found
        self.next_sequence: int | None = None
        """Of the next message, modulo 2^32; None before the first in a file without check records."""
        self._path = path
        self._pieces: list[bytes] = []
        self._arrivals_ns: list[int] = []
        self._contents = {WIRE_CHANNEL: WIRE, BARE_CHANNEL: BARE, EVENT_CHANNEL: EVENT}

    def ahead(self, sequence: int) -> int:
        """Return how many messages are missing before one of this number; below 0 if it was there before."""
        if self.next_sequence is None:
            return 0
        ahead = (sequence - self.next_sequence) & SEQUENCE_MASK
        return ahead if ahead < _BEHIND else ahead - SEQUENCE_MASK - 1

    def reads(self) -> Generator[Reads]:
        """Yield the reads that were found since the last event, as one."""
        if self._pieces:
            ends = np.cumsum(np.fromiter(map(len, self._pieces), np.int64, len(self._pieces)))
            data = np.frombuffer(b"".join(self._pieces), np.uint8)
            batch = Reads(data, ends, np.array(self._arrivals_ns, np.int64))
            self._pieces, self._arrivals_ns = [], []
            self.found.reads += len(ends)
            self.found.bytes += len(data)
            yield batch

    def first_message(self, data: bytes, begin: int, end: int) -> int:
        """Return where the first message of a block is that is as it was written; its end without one."""
        at = begin + self._head(data, begin)
        while at < end and data[at] != MESSAGE_OP:
            at += RECORD.size + RECORD.unpack_from(data, at)[1]
        return at

    def sealed(self, data: bytes, begin: int, end: int) -> Generator[Reads | Event]:
        """Yield the items of bytes that are as they were written.

        Raises BAD_DATA for what a newer version wrote.
        """
        stop = yield from self._items(data, begin + self._head(data, begin), end, sealed=True)
        if stop.at < end:
            raise self.error(f"a record of type {data[stop.at]} is not understood")

    def unsealed(
        self, data: bytes, begin: int, end: int, *, last: bool
    ) -> Generator[Reads | Event, None, Stop]:
        """Yield the items of bytes that nothing vouches for, and return where that ends.

        A message counts when its two times are the same, its number follows, and another record begins where
        it ends; `last` says that the end of these bytes is that of the file.
        """
        return (yield from self._items(data, begin, end, sealed=False, last=last))

    def next_message(self, data: bytes, begin: int, end: int) -> int:
        """Return where a message begins that was not there before; the end where there is none."""
        at = data.find(MESSAGE_OP, begin, end)
        while 0 <= at <= end - MESSAGE.size:
            if self._begins(data, at, end) and self.ahead(message_at(data, at)[0]) >= 0:
                return at
            at = data.find(MESSAGE_OP, at + 1, end)
        return end

    def error(self, what: str) -> ImumonError:
        """Return the error of a file that cannot be read."""
        return ImumonError(Reason.BAD_DATA, f"{self._path}: {what}", _HINT)

    def lose(self, offset: int, size: int, before_ns: int, sequence: int) -> Generator[Reads]:
        """Count a damaged place, behind which the message with this number is the next.

        Yields the reads before it.
        """
        if not size and not self.ahead(sequence):
            return
        yield from self.reads()
        missing = max(0, self.ahead(sequence))
        self.found.damage.add(Place(offset, size, self.found.last_ns, before_ns, missing))
        if self.next_sequence is not None:
            self.next_sequence = (self.next_sequence + missing) & SEQUENCE_MASK

    # One record after the other

    @staticmethod
    def _head(data: bytes, begin: int) -> int:
        """Return how many bytes stand before the first record."""
        return len(MAGIC) if data.startswith(MAGIC, begin) else 0

    def _items(
        self, data: bytes, at: int, end: int, *, sealed: bool, last: bool = True
    ) -> Generator[Reads | Event, None, Stop]:
        stop = Stop(end, in_doubt=False)
        while at < end:
            if not sealed and not (believed := self._is_believed(data, at, end, last)):
                stop = Stop(at, in_doubt=believed is False)
                break
            opcode = data[at]
            if opcode == DATA_END_OP:
                stop = Stop(at, in_doubt=False)
                break
            if opcode != MESSAGE_OP:
                after = at + RECORD.size + RECORD.unpack_from(data, at)[1]
                try:
                    yield from self._rare(opcode, data[at + RECORD.size : after])
                except BAD_RECORD:
                    stop = Stop(at, in_doubt=True)
                    break
                at = after
                continue
            _, length, channel, sequence, time_ns, _ = MESSAGE.unpack_from(data, at)
            after = at + RECORD.size + length
            content = self._contents.get(channel, FOREIGN)
            self.next_sequence = (sequence + 1) & SEQUENCE_MASK
            self.found.last_ns = time_ns
            if content is WIRE or content is BARE:
                self._pieces.append(data[at + MESSAGE.size + (CDR.size if content is WIRE else 0) : after])
                self._arrivals_ns.append(time_ns)
            elif content is EVENT:
                yield from self._event(data[at + MESSAGE.size : after], time_ns, sealed=sealed)
            at = after
        if len(self._pieces) >= _BATCH_READS:
            yield from self.reads()
        return stop

    def _is_believed(self, data: bytes, at: int, end: int, last: bool) -> bool | None:
        """Return whether a record that nothing vouches for is one; None where more bytes must tell."""
        if end - at < MESSAGE.size and not last:
            return None
        if end - at < RECORD.size or not self._begins(data, at, end):
            return False
        after = at + RECORD.size + RECORD.unpack_from(data, at)[1]
        if not last and after + MESSAGE.size > end:
            return None
        if after > end or (after < end and not self._begins(data, after, end)):
            return False
        if data[at] != MESSAGE_OP:
            return True
        sequence, _ = message_at(data, at)
        if after + MESSAGE.size <= end and data[after] == MESSAGE_OP:
            follows = message_at(data, after)[0] == (sequence + 1) & SEQUENCE_MASK
        else:
            follows = True
        return follows and not self.ahead(sequence)

    def _begins(self, data: bytes, at: int, end: int) -> bool:
        """Return whether a record begins here, by the fields that are there: a message has its time twice."""
        opcode = data[at]
        if end - at < RECORD.size or (opcode == MESSAGE_OP and end - at < MESSAGE.size):
            return 0 < opcode <= DATA_END_OP or opcode == CHECK_OP
        if opcode != MESSAGE_OP:
            longest = LONGEST_CHUNK if opcode == CHUNK_OP else LONGEST_RARE
            known = 0 < opcode <= DATA_END_OP or opcode == CHECK_OP
            return known and RECORD.unpack_from(data, at)[1] <= longest
        _, length, channel, _, time_ns, published_ns = MESSAGE.unpack_from(data, at)
        content = self._contents.get(channel)
        if content is None or time_ns != published_ns or time_ns >= 1 << 63 or length > LONGEST_MESSAGE:
            return False
        if content is not WIRE or end - at < MESSAGE.size + CDR.size:
            return True
        size = length + RECORD.size - MESSAGE.size - CDR.size
        return bool(CDR.unpack_from(data, at + MESSAGE.size)[1] == size)

    def _event(self, body: bytes, time_ns: int, *, sealed: bool) -> Generator[Reads | Event]:
        yield from self.reads()
        try:
            fields = json.loads(body)
            if fields["kind"] == UNRECORDED:
                self._unrecorded(fields, time_ns)
                return
            event = Event(EventKind(fields["kind"]), time_ns, str(fields["detail"]))
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            if sealed:
                text = f"event at {time_ns} ns is not understood: {body[:200]!r}"
                raise self.error(text) from error
            self.found.damage.events += 1
        else:
            self.found.events += 1
            yield event

    def _unrecorded(self, fields: dict[str, int], time_ns: int) -> None:
        """Count what the file says is missing here."""
        self.found.bytes_unrecorded += int(fields["bytes"])
        if "after_ns" in fields:
            place = Place(0, 0, int(fields["after_ns"]), time_ns, int(fields["reads"]))
            self.found.damage.add(place)
            self.found.recovered.add(place)

    def _rare(self, opcode: int, body: bytes) -> Generator[Reads | Event]:
        """Take in a rare record: header, channel, or a chunk if another tool rewrote the file.

        Raises ValueError when it is not what its first byte says; the library has others.
        """
        stream = ReadDataStream(BytesIO(body))
        if opcode == HEADER_OP:
            profile = Header.read(stream).profile
            if profile not in FORMATS:
                raise self.error(f"is an MCAP file of profile {profile!r}, not {FORMAT!r}")
        elif opcode == CHANNEL_OP:
            self._channel(Channel.read(stream))
        elif opcode == METADATA_OP:
            metadata = Metadata.read(stream)
            self.found.metadata |= metadata.metadata if metadata.name == "imumon" else {}
        elif opcode == CHUNK_OP:
            yield from self._chunk(Chunk.read(stream))
        elif opcode not in _PASSED_OVER:
            raise ValueError("such a record does not stand here")

    def _channel(self, channel: Channel) -> None:
        """Note what a channel has; ours have it even where the record that says so is damaged."""
        content = _CONTENTS.get((channel.topic, channel.message_encoding))
        if content is not None or channel.id not in self._contents:
            self._contents[channel.id] = content or FOREIGN

    def _chunk(self, chunk: Chunk) -> Generator[Reads | Event]:
        """Yield the items of a chunk, which has a checksum of its own; its messages need no numbers."""
        if chunk.uncompressed_size > LONGEST_CHUNK:
            raise ValueError("the chunk is too long")
        for inside in breakup_chunk(chunk, validate_crc=True):
            if isinstance(inside, Channel):
                self._channel(inside)
            elif isinstance(inside, Message):
                if inside.log_time >= 1 << 63:
                    raise ValueError("the time is out of range")
                self.found.last_ns = inside.log_time
                content = self._contents.get(inside.channel_id)
                if content is EVENT:
                    yield from self._event(inside.data, inside.log_time, sealed=True)
                elif content in (WIRE, BARE):
                    self._pieces.append(inside.data[CDR.size if content is WIRE else 0 :])
                    self._arrivals_ns.append(inside.log_time)
