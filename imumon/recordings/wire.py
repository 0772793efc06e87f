"""The wire file: every byte with its time of arrival, as an MCAP file that is whole at any moment.

The layout is in docs/session-format.md.  The file is written without chunks, so that each record is of use as
soon as it is on disk, and no index grows with the length of the recording; what goes to the disk at once is
sealed with a check record.
"""

import fcntl
import json
import mmap
import os
import struct
import zlib
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from imumon.errors import ImumonError, Reason
from imumon.transport.reader import Bytes, Item
from imumon.version import __version__

FORMAT = "imumon-wire/2"
"""Written as the profile of the MCAP file."""
BARE_CHANNEL, EVENT_CHANNEL, WIRE_CHANNEL = 1, 2, 3
"""Always these, so that a file whose beginning is damaged can be read; the first has bare bytes."""
CDR = struct.Struct("<4sI")
"""What CDR has before the bytes of ``uint8[] data``: little-endian, and how many they are."""
CDR_LITTLE = b"\x00\x01\x00\x00"
UNRECORDED = "unrecorded"
"""Kind of the event that states how many bytes are missing before it."""

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""Opcode, and bytes that follow."""
FIELDS = struct.Struct("<HIQQ")
"""Of a message: channel, sequence, log time, publish time; then the payload."""
MESSAGE_OP, DATA_END_OP = int(Opcode.MESSAGE), int(Opcode.DATA_END)
SEQUENCE_MASK = (1 << 32) - 1

CHECK_OP = 0x91
"""A check record seals the bytes since the one before: who reads the file while it is written, or after a
crash, can check what is as it was written, and can find back into a file that is damaged in the middle.

MCAP leaves 0x80 and above to the application; other readers pass such a record over.
"""
MARKER = bytes.fromhex("a3d1f08b5ce749268e7f13b0c96d42f5")
"""What to search for: 16 bytes drawn once at random, so that no device sends them."""
_CHECK = struct.Struct("<QQIIq")
_BEFORE_CHECK = RECORD.pack(CHECK_OP, len(MARKER) + _CHECK.size + 4) + MARKER
CHECK_SIZE = len(_BEFORE_CHECK) + _CHECK.size + 4


class Check(NamedTuple):
    """A check record."""

    start: int  # where in the file the bytes begin that it seals
    size: int  # how many they are; the record itself is not among them
    sequence: int  # of the message that follows, modulo 2^32
    crc: int  # CRC-32 of the bytes
    time_ns: int  # Unix time of the latest message before, 0 when there is none

    def pack(self) -> bytes:
        """Return the record."""
        body = _BEFORE_CHECK + _CHECK.pack(*self)
        return body + zlib.crc32(body).to_bytes(4, "little")

    @classmethod
    def unpack(cls, buffer: mmap.mmap | bytes, offset: int) -> "Check | None":
        """Return the record that begins here, or None when it is not one, or damaged."""
        record = buffer[offset : offset + CHECK_SIZE]
        if len(record) < CHECK_SIZE or zlib.crc32(record[:-4]).to_bytes(4, "little") != record[-4:]:
            return None
        found = record.startswith(_BEFORE_CHECK)
        return cls(*_CHECK.unpack_from(record, len(_BEFORE_CHECK))) if found else None


PENDING_LIMIT = 8 << 20
"""Bytes that are kept for a disk that is full or stuck; what comes on top is counted, not kept."""
BLOCK_BYTES = 1 << 13
"""A block is sealed when it has so many bytes, or when it is flushed: so much is lost by one wrong bit."""


@dataclass
class WireCounters:
    """What a `WireWriter` got, and what of it is in the file."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_on_disk: int = 0  # of `bytes`, those that the system has; they survive the end of this process
    bytes_unrecorded: int = 0  # of `bytes`, those that were given up because the disk was full or failed


class WireWriter:
    """Writes a wire file.  Writing never fails; `flush` does, and may be tried again without harm.

    Not for use from several threads at once, but for `sync`.  The file is locked while it is written
    (``flock``), so that a recording that goes on is not taken for one that was killed.

    Raises EXISTS when there is such a file; OSError when it cannot be created.

    `path`: new file.
    `metadata`: written into the file as the metadata record "imumon".
    """

    def __init__(self, path: Path, metadata: Mapping[str, str]) -> None:
        self._path = path
        self._metadata = mcap.Metadata(name="imumon", metadata=dict(metadata))
        # Of each block that is not on disk: where it ends in the file, and the device's bytes in it.
        self._unflushed: deque[tuple[int, int]] = deque()
        self._sequence = 0
        self.counters = WireCounters()
        self._gap = Counter[str]()  # of what is given up since the last message: reads, bytes and events
        self._first_ns = self._last_ns = self._highest_ns = 0
        self._messages: Counter[int] = Counter()
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError as error:
            raise ImumonError(Reason.EXISTS, f"{path} exists already", "nothing was overwritten") from error
        with suppress(OSError):  # a file system that knows no locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # What the operating system has not taken yet: a write that fails half-way leaves the rest here.
        self._pending = bytearray()
        self._crc = self._written = 0  # checksum of all that was put, and how much of it was written
        self._block_start = self._block_bytes = 0
        self._put(MAGIC)
        self._put(_packed(mcap.Header(profile=FORMAT, library=f"imumon {__version__}")))
        self._metadata_at = self._end
        self._put(_packed(self._metadata))
        self._put(_packed(*_TOPICS))
        try:
            self.flush()
        except OSError:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def _end(self) -> int:
        """Where in the file the next byte goes."""
        return self._written + len(self._pending)

    def _put(self, data: bytes) -> None:
        self._pending += data
        self._crc = zlib.crc32(data, self._crc)

    @property
    def has_vanished(self) -> bool:
        """Return whether the file is no longer under its name: what is written is lost, without an error."""
        try:
            return not os.path.samestat(self._path.stat(), os.fstat(self._file.fileno()))
        except OSError:
            return True

    def begun_again(self) -> "WireWriter":
        """Return the writer of a new file, with its folder, after this one has vanished.

        Its first event states what is missing.  Raises OSError when that cannot be done; what comes until it
        can is lost as well; EXISTS when there is another file by now.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new, counts = WireWriter(self._path, self._metadata.metadata), self.counters
        new.counters = replace(counts, bytes_on_disk=0, bytes_unrecorded=counts.bytes)
        new._gap = Counter(reads=counts.reads, bytes=counts.bytes, events=counts.events)
        new._note_gap(self._last_ns)
        self._file.close()
        return new

    def write(self, item: Item) -> None:
        """Take an item in; it is on disk after the next `flush` that succeeds."""
        counters, is_read = self.counters, int(isinstance(item, Bytes))
        size = len(item.data) if isinstance(item, Bytes) else 0
        counters.reads += is_read
        counters.bytes += size
        counters.events += 1 - is_read
        if len(self._pending) > PENDING_LIMIT:
            counters.bytes_unrecorded += size
            self._gap.update(reads=is_read, bytes=size, events=1 - is_read)
            return
        self._note_gap(item.time_ns)
        if isinstance(item, Bytes):
            self._add(WIRE_CHANNEL, item.time_ns, CDR.pack(CDR_LITTLE, size) + item.data)
            self._block_bytes += size
        else:
            self._add_event(item.kind.value, item.time_ns, {"detail": item.detail})
        if self._end - self._block_start > BLOCK_BYTES:
            self._seal()

    def missing(self, after_ns: int, before_ns: int, reads: int, size: int = 0) -> None:
        """Record that reads are missing here, between two times, for another reason than this disk.

        `size` is the number of their bytes, where that is known.
        """
        lost = {"reads": reads, "bytes": size, "events": 0, "after_ns": after_ns}
        self._add_event(UNRECORDED, before_ns, lost)

    def flush(self) -> None:
        """Hand everything to the operating system.

        Raises OSError when the disk is full or fails; nothing is lost yet, and the next `flush` goes on from
        there.
        """
        self._seal()
        try:
            while self._pending:
                count = os.write(self._file.fileno(), self._pending)
                del self._pending[:count]
                self._written += count
        finally:
            while self._unflushed and self._unflushed[0][0] <= self._written:
                self.counters.bytes_on_disk += self._unflushed.popleft()[1]

    def sync(self) -> None:
        """Wait until the medium has what was flushed; may be called from another thread.

        Raises OSError when the disk fails.
        """
        if not self._file.closed:
            os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Finish and close the file; what cannot be written now is counted as unrecorded.

        Raises OSError when the last bytes cannot be written; the file is closed, and what it holds is
        readable.
        """
        if self._file.closed:
            return
        self._note_gap(self._last_ns)
        self._seal()
        self._finish()
        try:
            self.flush()
            self.sync()
        finally:
            self.counters.bytes_unrecorded += sum(size for _, size in self._unflushed)
            self._unflushed.clear()
            self._file.close()

    def _add(self, channel: int, time_ns: int, data: bytes) -> None:
        fields = FIELDS.pack(channel, self._sequence & SEQUENCE_MASK, time_ns, time_ns)
        self._put(RECORD.pack(MESSAGE_OP, len(fields) + len(data)) + fields + data)
        self._first_ns = min(self._first_ns, time_ns) if self._sequence else time_ns
        self._highest_ns, self._last_ns = max(self._highest_ns, time_ns), time_ns
        self._messages[channel] += 1
        self._sequence += 1

    def _add_event(self, kind: str, time_ns: int, rest: Mapping[str, str | int]) -> None:
        text = json.dumps({"kind": kind, **rest}, ensure_ascii=False)
        self._add(EVENT_CHANNEL, time_ns, text.encode(errors="replace"))

    def _note_gap(self, time_ns: int) -> None:
        if self._gap.total():
            self._add_event(UNRECORDED, time_ns, {"reads": 0, "bytes": 0, "events": 0} | self._gap)
            self._gap.clear()

    def _seal(self) -> None:
        size = self._end - self._block_start
        if size:
            crc = zlib.crc32(self._pending[-size:])  # none of it is written yet
            check = Check(self._block_start, size, self._sequence & SEQUENCE_MASK, crc, self._last_ns)
            self._put(check.pack())
            self._block_start = self._end
            self._unflushed.append((self._block_start, self._block_bytes))
            self._block_bytes = 0

    def _finish(self) -> None:
        """Write the end of the data, the summary and the footer that MCAP requires."""
        self._put(_packed(mcap.DataEnd(self._crc)))
        statistics = mcap.Statistics(
            attachment_count=0,
            channel_count=len(_CHANNELS),
            channel_message_counts=dict(self._messages),
            chunk_count=0,
            message_count=self._sequence,
            message_end_time=self._highest_ns,
            message_start_time=self._first_ns,
            metadata_count=1,
            schema_count=len(_SCHEMAS),
        )
        length = len(_packed(self._metadata))
        index = mcap.MetadataIndex(offset=self._metadata_at, length=length, name=self._metadata.name)
        summary = _packed(*_TOPICS, statistics, index)
        start = self._end
        unchecked = _packed(mcap.Footer(summary_start=start, summary_offset_start=0, summary_crc=0))
        crc = zlib.crc32(unchecked[:-4], zlib.crc32(summary))
        footer = mcap.Footer(summary_start=start, summary_offset_start=0, summary_crc=crc)
        self._put(summary + _packed(footer) + MAGIC)
        self._block_start = self._end


_EVENT_SCHEMA = (
    b'{"title": "imumon.Event", "type": "object", "properties": {"kind": {"type": "string"}, '
    b'"detail": {"type": "string"}}, "required": ["kind"]}'
)
_SCHEMAS = (
    mcap.Schema(id=1, name="imumon/msg/Wire", encoding="ros2msg", data=b"uint8[] data"),
    mcap.Schema(id=2, name="imumon.Event", encoding="jsonschema", data=_EVENT_SCHEMA),
)
_CHANNELS = (
    mcap.Channel(id=WIRE_CHANNEL, topic="/wire", message_encoding="cdr", metadata={}, schema_id=1),
    mcap.Channel(id=EVENT_CHANNEL, topic="/event", message_encoding="json", metadata={}, schema_id=2),
)
_TOPICS: tuple[mcap.McapRecord, ...] = (*_SCHEMAS, *_CHANNELS)


def _packed(*records: mcap.McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # the library has no type for it


def is_recorded(path: Path) -> bool:
    """Return whether a program writes this wire file at the moment."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
