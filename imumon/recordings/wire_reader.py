"""Reads a wire file in order of arrival, whatever happened to it.

A block, the bytes that a check record seals, is as it was written or it is not: one whose CRC differs is
left out as a whole, as its times and bytes may be wrong, and so is what no check record follows at the end of
a file that was cut short.  Files of versions that wrote no check records are read up to the first record that
cannot be one.
"""

import json
import mmap
import struct
import zlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from imumon.errors import ImumonError, bad_data
from imumon.files import readable
from imumon.transport.reader import Event, EventKind, Item, Reads

from . import wire
from .folder import iso_utc
from .wire import CHECK_SIZE, FIELDS, MAGIC, RECORD, SEQUENCE_MASK, Check

FORMATS = ("imumon-wire/1", wire.FORMAT)
"""Those that are read; in the first, reads are bare bytes."""
PROFILE = wire.FORMAT.rpartition("/")[0].encode()
HEAD_SIZE = 64
"""Bytes at the begin of a file among which the profile stands."""
READ_SIZE = 1 << 20
"""Bytes of reads that are handed on at once, and of which a checksum is taken."""
RELEASE_SIZE = 16 << 20
"""Bytes of the file that are taken out of the memory of the process at a time."""
_BEFORE_DATA = {wire.WIRE_CHANNEL: wire.CDR.size, wire.BARE_CHANNEL: 0}
"""Bytes before the data of a read, by its channel."""
_PASSED_OVER = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, wire.CHECK_OP)
"""The channels of a wire file have the same numbers in all."""
BAD_RECORD = (
    McapError, struct.error, MemoryError, ValueError, ArithmeticError, LookupError, TypeError, RuntimeError,
)  # fmt: skip
"""What is raised for an event or another record that is not what it states."""
SHOWN_BYTES = 200
"""Of a record that is not understood."""
KEPT_PLACES = 100
"""Damaged places of which the details are kept; all are counted."""


@dataclass(frozen=True)
class Place:
    """A place of a wire file at which something is missing."""

    offset: int  # where in the file
    bytes: int  # how many bytes of the file are of no use there; 0 when bytes were cut out
    after_ns: int | None  # Unix time of the last message before; None when there is none
    before_ns: int | None  # that of the last one lost, or of the first one behind
    messages: int  # reads and events missing, by the numbers of those before and behind; 0 where not known

    @property
    def seconds(self) -> float:
        """Time that it spans."""
        return max(0, self.before_ns - self.after_ns) * 1e-9 if self.after_ns and self.before_ns else 0.0

    def __str__(self) -> str:
        when = f", {self.seconds:.3f} s from {iso_utc(self.after_ns)}" if self.after_ns else ""
        return (
            f"{self.bytes:,} bytes at byte {self.offset:,}{when}, {self.messages or 'some'} messages missing"
        )


@dataclass
class Damage:
    """What a wire file lacks."""

    places: int = 0
    bytes: int = 0  # bytes of the file that are of no use
    messages: int = 0  # reads and events that are missing
    seconds: float = 0.0  # time that the places span
    where: list[Place] = field(default_factory=list)  # the first places, with their details

    def add(self, place: Place) -> None:
        """Count a place."""
        self.places += 1
        self.bytes += place.bytes
        self.messages += place.messages
        self.seconds += place.seconds
        if len(self.where) < KEPT_PLACES:
            self.where.append(place)


@dataclass
class WireSummary:
    """What a wire file held."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_unrecorded: int = 0  # bytes that came from the device and are not in the file, as the file states
    tail_bytes: int = 0  # bytes at the end of the file that are no whole record, or damaged: of no use
    complete: bool = False  # whether it was finished; not after a power failure, a kill or a full disk
    checksum_ok: bool | None = None  # whether that over the file agrees; None when it was not finished
    last_ns: int = 0  # Unix time of the latest message
    damage: Damage = field(default_factory=Damage)  # what is missing, now or before the file was written anew
    recovered: Damage = field(default_factory=Damage)  # of that, what the file states was missing before
    metadata: dict[str, str] = field(default_factory=dict)  # the metadata that the recording program wrote

    @property
    def is_sound(self) -> bool:
        """Whether the file is whole and as it was written."""
        is_whole = self.damage.places == self.recovered.places
        return self.complete and self.checksum_ok is not False and is_whole


class WireReader:
    """Reads a wire file in order of arrival, in constant memory.

    Each iteration reads the file anew; `summary` is what the last one has found so far.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._begin(b"")

    def _begin(self, data: mmap.mmap | bytes) -> None:
        self.summary = WireSummary()
        self._data: mmap.mmap | bytes = data
        # Up to where everything is read or given up, and up to where it is no longer kept in memory.
        self._done = self._released = 0
        self._crc = 0  # CRC-32 of the file up to `_done`
        self._next_sequence = 0  # of the next message, modulo 2^32
        self._pieces: list[bytes] = []
        self._arrivals_ns: list[int] = []
        self._kept = 0  # reads that were found since the last batch, and their bytes

    def __iter__(self) -> Iterator[Item]:
        """Yield the items in the order in which they were written, each read by itself.

        Raises ImumonError as `batches`.
        """
        for item in self.batches():
            yield from (item,) if isinstance(item, Event) else item

    def metadata(self) -> dict[str, str]:
        """Return the metadata that the recording program wrote, at the begin of the file; empty if damaged.

        Raises BAD_DATA when the file cannot be read, or is of another program.
        """
        next(self.batches(), None)  # it stands before the first message
        return self.summary.metadata

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises BAD_DATA, when the file cannot be read, is no wire file, or has what a newer version wrote.
        """
        with readable(self.path), self.path.open("rb") as file:
            is_empty = not self.path.stat().st_size  # the system keeps in memory what is looked at
            self._begin(b"" if is_empty else mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        data, head = self._data, self._data[:HEAD_SIZE]
        is_mcap = MAGIC.startswith(head[: len(MAGIC)])
        if not is_mcap and PROFILE in head:
            self.summary.damage.add(Place(0, len(MAGIC), None, None, 0))
        marker = -1
        while (marker := data.find(wire.MARKER, marker + 1)) >= 0:
            at = marker - RECORD.size
            if at >= 0 and (check := Check.unpack(data, at)) is not None:
                yield from self._block(check, at)
        if not self._done:
            if not is_mcap and PROFILE not in head:
                raise self._error("is not a wire file")
            end = yield from self._records(data, min(len(MAGIC), len(data)), sealed=False)
            self._finish(end)
        yield from self._reads()
        yield from self._end()
        self._data = b""  # the file is closed

    def _block(self, check: Check, end: int) -> Generator[Reads | Event]:
        """Yield the block that a check record at this place seals, or count what is lost.

        A block whose messages were there before is in the file twice: it is passed over.
        """
        begin, behind = end - check.size, end + CHECK_SIZE
        block = self._data[max(begin, 0) : end]
        first = len(MAGIC) if begin == 0 else 0
        block = MAGIC[:first] + block[first:]  # the same in all files, should it be damaged
        is_whole = begin >= 0 and zlib.crc32(block) == check.crc
        sequence, time_ns = check.sequence, check.time_ns
        messages = (at for opcode, at, _ in _walk(block, first) if opcode == wire.MESSAGE_OP)
        if is_whole and (at := next(messages, 0)):
            _, sequence, time_ns, _ = FIELDS.unpack_from(block, at)
        if self._ahead(sequence) < 0:
            return
        yield from self._lose((begin if is_whole else behind) - self._done, time_ns, sequence)
        self._finish(behind)
        if is_whole:
            stop = yield from self._records(block, first, sealed=True)
            if stop < len(block):
                record = block[stop : stop + SHOWN_BYTES]
                raise self._error(f"the record at byte {begin + stop} is not understood: {record!r}")

    def _end(self) -> Generator[Reads]:
        """Compare checksum and number of messages with those that stand behind the data."""
        data, behind = self._data, _walk(self._data, self._done)
        opcode, begin, end = next(behind, (0, 0, 0))
        if opcode != wire.DATA_END_OP or end - begin != 4 or end > len(data):
            self.summary.tail_bytes = len(data) - self._done
            return
        if expected := int.from_bytes(data[begin:end], "little"):
            self.summary.checksum_ok = self._crc == expected
        for opcode, begin, _ in behind:
            if opcode == Opcode.STATISTICS:  # begins with the number of messages
                messages = int.from_bytes(data[begin : begin + 8], "little")
                yield from self._lose(0, self.summary.last_ns, messages & SEQUENCE_MASK)
        self.summary.complete = data[-len(MAGIC) :] == MAGIC

    def _finish(self, end: int) -> None:
        """Take what stands before this place as read: into the checksum, and out of the memory."""
        while self._done < end:
            stop = min(self._done + READ_SIZE, end)
            piece = MAGIC + self._data[len(MAGIC) : stop] if not self._done else self._data[self._done : stop]
            self._crc, self._done = zlib.crc32(piece, self._crc), stop
            if stop - self._released > RELEASE_SIZE and isinstance(self._data, mmap.mmap):
                self._data.madvise(mmap.MADV_DONTNEED, self._released, RELEASE_SIZE)
                self._released += RELEASE_SIZE

    def _ahead(self, sequence: int) -> int:
        """Return how many messages are missing before one of this number; below 0 if it was there before."""
        half = (SEQUENCE_MASK + 1) // 2
        return (sequence - self._next_sequence + half & SEQUENCE_MASK) - half

    def _lose(self, size: int, before_ns: int, sequence: int) -> Generator[Reads]:
        """Count a damaged place of so many bytes, behind which the message with this number is the next.

        Yields the reads before it.
        """
        missing = max(0, self._ahead(sequence))
        if size or missing:
            yield from self._reads()
            last_ns = self.summary.last_ns
            self.summary.damage.add(Place(self._done, size, last_ns or None, before_ns or None, missing))
        self._next_sequence = self._next_sequence + missing & SEQUENCE_MASK

    def _error(self, what: str) -> ImumonError:
        hint = "a newer imumon wrote it, or only wire files that imumon recorded can be replayed"
        return bad_data(f"{self.path}: {what}", hint)

    def _records(
        self, data: mmap.mmap | bytes, at: int, *, sealed: bool
    ) -> Generator[Reads | Event, None, int]:
        """Yield the items of one record after the other; return where that ends.

        What is sealed is as it was written; any other record is taken for one by its fields.
        """
        for opcode, begin, end in _walk(data, at):
            if opcode == wire.DATA_END_OP or not (sealed or self._is_record(opcode, begin, end)):
                break
            channel = time_ns = 0
            if opcode == wire.MESSAGE_OP:
                channel, sequence, time_ns, _ = FIELDS.unpack_from(data, begin)
                self._next_sequence = (sequence + 1) & SEQUENCE_MASK
                begin += FIELDS.size
            if channel in _BEFORE_DATA:
                self._pieces.append(data[begin + _BEFORE_DATA[channel] : end])
                self._arrivals_ns.append(time_ns)
                self._kept += end - begin
                if self._kept >= READ_SIZE:
                    yield from self._reads()
            else:
                yield from self._reads()
                self.summary.last_ns = max(self.summary.last_ns, time_ns)  # a mark may be older
                try:
                    event = self._other(opcode, channel, data[begin:end], time_ns)
                except BAD_RECORD:
                    break
                if event is not None:
                    yield event
            at = end
        return at

    def _is_record(self, opcode: int, begin: int, end: int) -> bool:
        """Return whether a whole record stands here: a message has its time twice, and its number follows."""
        if end > len(self._data) or not 0 < opcode <= wire.DATA_END_OP:
            return False
        if opcode != wire.MESSAGE_OP or end - begin < FIELDS.size:
            return opcode != wire.MESSAGE_OP
        _, sequence, time_ns, published_ns = FIELDS.unpack_from(self._data, begin)
        return bool(time_ns == published_ns < 1 << 63 and not self._ahead(sequence))

    def _reads(self) -> Generator[Reads]:
        """Yield the reads that were found since the last event, as one."""
        if self._pieces:
            ends = np.cumsum(np.fromiter(map(len, self._pieces), np.int64, len(self._pieces)))
            data = np.frombuffer(b"".join(self._pieces), np.uint8)
            times_ns = np.array(self._arrivals_ns, np.int64)
            batch = Reads(data, ends, times_ns)
            self.summary.last_ns = max(self.summary.last_ns, int(times_ns.max()))
            self._pieces, self._arrivals_ns, self._kept = [], [], 0
            self.summary.reads += len(ends)
            self.summary.bytes += len(data)
            yield batch

    def _other(self, opcode: int, channel: int, body: bytes, time_ns: int) -> Event | None:
        """Return an event, or take in what it states is missing, the header or the metadata.

        Raises one of `BAD_RECORD` for a record that is not what it states.
        """
        if opcode == wire.MESSAGE_OP:
            if channel != wire.EVENT_CHANNEL:
                return None
            fields = json.loads(body)
            if fields["kind"] != wire.UNRECORDED:
                event = Event(EventKind(fields["kind"]), time_ns, str(fields["detail"]))
                self.summary.events += 1
                return event
            self.summary.bytes_unrecorded += int(fields["bytes"])
            if "after_ns" in fields:
                place = Place(0, 0, int(fields["after_ns"]), time_ns, int(fields["reads"]))
                self.summary.damage.add(place)
                self.summary.recovered.add(place)
        elif opcode == Opcode.HEADER:
            profile = Header.read(ReadDataStream(BytesIO(body))).profile
            if profile not in FORMATS:
                raise self._error(f"is an MCAP file of profile {profile!r}, not {wire.FORMAT!r}")
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(BytesIO(body)))
            self.summary.metadata |= metadata.metadata if metadata.name == "imumon" else {}
        elif opcode == Opcode.CHUNK:
            raise self._error("another program has put it into chunks")
        elif opcode not in _PASSED_OVER:
            raise ValueError("such a record does not stand here")
        return None


def is_wire(path: Path) -> bool:
    """Test whether a file is MCAP by its first bytes, or by the profile behind them where these are damaged.

    Raises BAD_DATA when it cannot be read.
    """
    return _head(path).startswith(MAGIC) or is_own(path)


def is_own(path: Path) -> bool:
    """Return whether imumon recorded a file, by the profile at its begin.  Raises BAD_DATA as `is_wire`."""
    return PROFILE in _head(path)


def _head(path: Path) -> bytes:
    with readable(path), path.open("rb") as file:
        return file.read(HEAD_SIZE)


def _walk(data: mmap.mmap | bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield the type of each record from a place on, and where its content begins and ends."""
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        begin, at = at + RECORD.size, at + RECORD.size + length
        yield opcode, begin, at
