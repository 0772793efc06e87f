"""The wire file: every byte with its time of arrival, as an MCAP file that is whole at any moment.

The layout is in docs/session-format.md.  The file is written without chunks, so that each record is of use as
soon as it is on disk, and no index grows with the length of the recording.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, DataEnd, Header
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import CompressionType, IndexType, Writer
from zstandard import ZstdError

from imumon import __version__
from imumon.blocks import IntArray
from imumon.compiled import inner, njit
from imumon.errors import ImumonError, Reason
from imumon.transport.reader import ByteArray, Bytes, Event, EventKind, Item, Reads

FORMAT = "imumon-wire/1"
"""Written as the profile of the MCAP file."""
WIRE_TOPIC = "/wire"
EVENT_TOPIC = "/event"
UNRECORDED = "unrecorded"
"""Kind of the message in `EVENT_TOPIC` that tells how many bytes could not be written before it."""

PENDING_LIMIT = 8 << 20
"""Bytes that are kept for a disk that is full or stuck; what comes on top is counted, not kept."""
READ_SIZE = 1 << 20
LONGEST_RECORD = 256 << 20
"""A record that claims to be longer is damage, not a record."""

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = _MESSAGE.size
_MESSAGE_FIELDS = _MESSAGE.size - _RECORD.size
LATEST_NS = (1 << 63) - 1
"""A time beyond this is damage."""
_DAMAGE = (McapError, ZstdError, struct.error, ValueError, RuntimeError)
"""What the library raises for a record that is not what its first byte says."""
_HEADER, _CHANNEL, _MESSAGE_OP, _CHUNK, _DATA_END = 0x01, 0x04, 0x05, 0x06, 0x0F
_OTHER, _WIRE, _EVENT = range(3)
"""What a channel has."""
_BATCH_BYTES, _BATCH_READS = 1 << 16, 1 << 13
"""Most that is handed on at once."""


@dataclass(frozen=True, slots=True)
class WireCounters:
    """What a `WireWriter` got, and what of it is in the file."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_on_disk: int = 0
    """Of `bytes`, those handed to the operating system; they survive the end of this process."""
    bytes_unrecorded: int = 0
    """Of `bytes`, those that were given up because the disk was full or failed."""


class WireWriter:
    """Writes a wire file.  Writing never fails; `flush` does, and may be tried again without harm.

    Not for use from several threads at once.

    Parameters
    ----------
    path : Path
        New file.
    metadata : mapping of str to str
        Written into the file as the metadata record "imumon".

    Raises
    ------
    ImumonError
        EXISTS when there is such a file.
    OSError
        When it cannot be created.
    """

    def __init__(self, path: Path, metadata: Mapping[str, str]) -> None:
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as error:
            raise ImumonError(Reason.EXISTS, f"{path} exists already", "nothing was overwritten") from error
        self._spool = _Spool(descriptor)
        self._mcap = Writer(
            self._spool,  # type: ignore[arg-type]  # it needs no more than write, flush and tell
            use_chunking=False,
            compression=CompressionType.NONE,
            index_types=IndexType.METADATA,
            enable_data_crcs=True,
        )
        self._mcap.start(profile=FORMAT, library=f"imumon {__version__}")
        self._mcap.add_metadata("imumon", dict(metadata))
        self._wire = self._mcap.register_channel(WIRE_TOPIC, "x-bytes", schema_id=0)
        self._event = self._mcap.register_channel(EVENT_TOPIC, "json", schema_id=0)
        try:
            self._mcap.flush()  # type: ignore[no-untyped-call]  # the library does not say
        except OSError:
            self._spool.close()
            raise
        self._unflushed: deque[tuple[int, int]] = deque()
        self._sequence = self._reads = self._bytes = self._events = 0
        self._on_disk = self._unrecorded = 0
        self._gap_reads = self._gap_bytes = self._gap_events = 0

    @property
    def counters(self) -> WireCounters:
        """What was written so far."""
        return WireCounters(self._reads, self._bytes, self._events, self._on_disk, self._unrecorded)

    def write(self, item: Item) -> None:
        """Take an item in; it is on disk after the next `flush` that succeeds."""
        if isinstance(item, Bytes):
            self._reads += 1
            self._bytes += len(item.data)
        else:
            self._events += 1
        if self._spool.pending > PENDING_LIMIT:
            self._give_up(item)
            return
        self._say_gap(item.arrival_ns if isinstance(item, Bytes) else item.time_ns)
        if isinstance(item, Bytes):
            self._add(self._wire, item.arrival_ns, item.data)
            self._unflushed.append((self._spool.tell(), len(item.data)))
        else:
            self._add_event(item.kind.value, item.time_ns, {"detail": item.detail})

    def flush(self) -> None:
        """Hand everything to the operating system.

        Raises
        ------
        OSError
            When the disk is full or fails; nothing is lost yet, and the next `flush` goes on from there.
        """
        try:
            self._spool.flush()
        finally:
            while self._unflushed and self._unflushed[0][0] <= self._spool.written:
                self._on_disk += self._unflushed.popleft()[1]

    def close(self) -> None:
        """Finish and close the file; what cannot be written now is counted as unrecorded.

        Raises
        ------
        OSError
            When the last bytes cannot be written; the file is closed, and what it holds is readable.
        """
        if self._spool.closed:
            return
        self._say_gap(0)
        self._mcap.finish()  # type: ignore[no-untyped-call]  # the library does not say
        try:
            self.flush()
        finally:
            self._unrecorded += sum(size for _, size in self._unflushed)
            self._unflushed.clear()
            self._spool.close()

    def _add(self, channel: int, time_ns: int, data: bytes) -> None:
        self._mcap.add_message(channel, time_ns, data, time_ns, self._sequence & 0xFFFFFFFF)
        self._sequence += 1

    def _add_event(self, kind: str, time_ns: int, rest: Mapping[str, str | int]) -> None:
        self._add(self._event, time_ns, json.dumps({"kind": kind, **rest}, ensure_ascii=False).encode())

    def _give_up(self, item: Item) -> None:
        if isinstance(item, Bytes):
            self._gap_reads += 1
            self._gap_bytes += len(item.data)
            self._unrecorded += len(item.data)
        else:
            self._gap_events += 1

    def _say_gap(self, time_ns: int) -> None:
        if self._gap_reads or self._gap_events:
            counts = {"reads": self._gap_reads, "bytes": self._gap_bytes, "events": self._gap_events}
            self._add_event(UNRECORDED, time_ns, counts)
            self._gap_reads = self._gap_bytes = self._gap_events = 0


class _Spool:
    """The stream below the MCAP writer: keeps bytes until the operating system has taken them.

    A write that fails half-way leaves the rest here, so that the file is never torn in the middle.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._pending = bytearray()
        self.written = 0
        self.closed = False

    @property
    def pending(self) -> int:
        return len(self._pending)

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self.written + len(self._pending)

    def flush(self) -> None:
        while self._pending:
            count = os.write(self._descriptor, self._pending)
            del self._pending[:count]
            self.written += count

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            os.close(self._descriptor)


@dataclass(frozen=True, slots=True)
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


class WireReader:
    """Reads a wire file in order of arrival, in constant memory; one that was cut short is read to its cut.

    Each iteration reads the file anew; `summary` is that of the last iteration that came to the end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary = WireSummary()

    def __iter__(self) -> Iterator[Item]:
        """Yield the items in the order in which they were written, each read by itself.

        Raises
        ------
        ImumonError
            As `batches`.
        """
        for item in self.batches():
            if isinstance(item, Event):
                yield item
            else:
                yield from item

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises
        ------
        ImumonError
            BAD_DATA, when the file cannot be read or is not a wire file.
        """
        scan = _Scan(self.path)
        try:
            with self.path.open("rb") as file:
                scan.check_magic(file.read(len(MAGIC)))
                while not scan.done and (data := file.read(READ_SIZE)):
                    yield from scan.feed(data)
                self.summary = scan.summary(file)
        except OSError as error:
            raise ImumonError(Reason.BAD_DATA, f"{self.path}: cannot be read: {error.strerror}") from error


class _Scan:
    """Takes a wire file apart piece by piece.

    Reads are taken out by compiled code, as there may be hundreds a second for days; rare records are left
    to the library.
    """

    def __init__(self, path: Path) -> None:
        self.done = False
        self._path = path
        self._rest = b""
        self._used = 0
        self._position = len(MAGIC)
        self._crc = zlib.crc32(MAGIC)
        self._topics: ByteArray = np.zeros(1 << 16, np.uint8)  # by channel
        self._data_ended = False
        self._checksum_ok: bool | None = None
        self._reads = self._bytes = self._events = self._unrecorded = 0

    def check_magic(self, magic: bytes) -> None:
        """Raise when this is not the beginning of an MCAP file; it may have been cut within."""
        if not MAGIC.startswith(magic):
            raise ImumonError(Reason.BAD_DATA, f"{self._path}: is not a wire file: it begins with {magic!r}")
        self._position = len(magic)

    def feed(self, data: bytes) -> Iterator[Reads | Event]:
        """Yield the items of the records that are whole by now; `done` when nothing of use can follow."""
        buffer = self._rest + data
        yield from self._parse(buffer)
        self._crc = zlib.crc32(memoryview(buffer)[: self._used], self._crc)
        self._position += self._used
        self._rest = buffer[self._used :]

    def summary(self, file: BinaryIO) -> WireSummary:
        """Return what was found."""
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return WireSummary(
            self._reads,
            self._bytes,
            self._events,
            self._unrecorded,
            tail_bytes=0 if self._data_ended else size - self._position,
            complete=self._data_ended and file.read() == MAGIC,
            checksum_ok=self._checksum_ok,
        )

    def _parse(self, buffer: bytes) -> Iterator[Reads | Event]:
        """Yield the items in a buffer that begins with a record, and note how much of it was used."""
        offset, end = 0, len(buffer)
        while offset + _RECORD.size <= end and not self.done:
            reads, offset = _read_many(buffer, offset, self._topics)
            if len(reads.ends):
                yield self._counted(reads)
                continue
            opcode, length = _RECORD.unpack_from(buffer, offset)
            after = offset + _RECORD.size + length
            if opcode == 0 or length > LONGEST_RECORD or (opcode == _MESSAGE_OP and length < _MESSAGE_FIELDS):
                self.done = True
                break
            if after > end:
                break
            if opcode == _MESSAGE_OP:
                _, _, channel, _, time_ns, _ = _MESSAGE.unpack_from(buffer, offset)
                if time_ns > LATEST_NS:
                    self.done = True
                    break
                body = buffer[offset + _MESSAGE.size : after]
                if self._topics[channel] == _WIRE:  # longer than a batch
                    one = np.frombuffer(body, np.uint8), np.array([len(body)]), np.array([time_ns])
                    yield self._counted(Reads(*one))
                elif self._topics[channel] == _EVENT:
                    yield from self._event(body, time_ns)
            else:
                try:
                    yield from self._rare(opcode, buffer[:offset], buffer[offset + _RECORD.size : after])
                except _DAMAGE:
                    self.done = True
                    break
            offset = after
        self._used = offset

    def _counted(self, reads: Reads) -> Reads:
        self._reads += len(reads.ends)
        self._bytes += len(reads.data)
        return reads

    def _event(self, body: bytes, time_ns: int) -> Iterator[Event]:
        try:
            fields = json.loads(body)
            kind = fields["kind"]
            if kind == UNRECORDED:
                self._unrecorded += int(fields["bytes"])
            else:
                self._events += 1
                yield Event(EventKind(kind), time_ns, str(fields["detail"]))
        except (ValueError, KeyError, TypeError) as error:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{self._path}: event at {time_ns} ns is not understood: {body[:200]!r}",
                "the file is damaged, or a newer imumon wrote it",
            ) from error

    def _end_data(self, before: bytes, body: bytes) -> None:
        expected = DataEnd.read(_stream(body)).data_section_crc
        self._checksum_ok = zlib.crc32(before, self._crc) == expected if expected else None
        self._data_ended = self.done = True

    def _rare(self, opcode: int, before: bytes, body: bytes) -> Iterator[Reads | Event]:
        """Take in a rare record: header, channel, end, or a chunk if another tool rewrote the file."""
        if opcode == _DATA_END:
            self._end_data(before, body)
        elif opcode == _HEADER:
            profile = Header.read(_stream(body)).profile
            if profile != FORMAT:
                raise ImumonError(
                    Reason.BAD_DATA,
                    f"{self._path}: is an MCAP file of profile {profile!r}, not {FORMAT!r}",
                    "only wire files that imumon recorded can be replayed",
                )
        elif opcode == _CHANNEL:
            channel = Channel.read(_stream(body))
            if channel.topic == WIRE_TOPIC:
                self._topics[channel.id] = _WIRE
            elif channel.topic == EVENT_TOPIC:
                self._topics[channel.id] = _EVENT
        elif opcode == _CHUNK:
            inside, size = get_chunk_data_stream(Chunk.read(_stream(body)))
            yield from self._parse(inside.read(size))


def _read_many(buffer: bytes, offset: int, topics: ByteArray) -> tuple[Reads, int]:
    """Return the reads whose messages follow each other from here on, and where the next record begins."""
    data = np.empty(_BATCH_BYTES, np.uint8)
    ends, arrivals_ns = np.empty(_BATCH_READS, np.int64), np.empty(_BATCH_READS, np.int64)
    n, offset = _gather(np.frombuffer(buffer, np.uint8), offset, topics, data, ends, arrivals_ns)
    data.setflags(write=False)  # as what comes from a port: the decoders need one kernel for both
    used = int(ends[n - 1]) if n else 0
    return Reads(data[:used], ends[:n], arrivals_ns[:n]), offset


@njit
def _gather(
    buffer: ByteArray, offset: int, topics: ByteArray, data: ByteArray, ends: IntArray, arrivals: IntArray
) -> tuple[int, int]:
    """Copy reads to `data` until there is no room, or something that is not a whole message with a read."""
    n = used = 0
    while n < len(ends) and offset + _MESSAGE_HEAD <= len(buffer) and buffer[offset] == _MESSAGE_OP:
        length = _little(buffer, offset + 1, 8)
        channel, time_ns = _little(buffer, offset + 9, 2), _little(buffer, offset + 15, 8)
        body, size = offset + _MESSAGE_HEAD, length - _MESSAGE_FIELDS
        if (
            topics[channel] != _WIRE
            or not 0 <= size <= min(len(buffer) - body, len(data) - used)
            or time_ns < 0
        ):
            break
        start, to = np.uint64(body), np.uint64(used)
        for i in range(np.uint64(size)):
            data[to + i] = buffer[start + i]
        used += size
        ends[n], arrivals[n] = used, time_ns
        n += 1
        offset = body + size
    return n, offset


@inner
def _little(buffer: ByteArray, at: int, size: int) -> int:
    """Return a number whose least byte comes first; one beyond int64 is negative."""
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(buffer[at + i]) << (8 * i)
    return int(number)


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
