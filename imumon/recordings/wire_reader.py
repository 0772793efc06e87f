"""Reads a wire file in order of arrival, whatever happened to it.

A block, the bytes that a check record seals, is as it was written or it is not: one whose CRC differs is
left out as a whole, as its times and bytes may be wrong.  Only what no check record follows is read without:
the end of a file that was cut short, and files of versions that wrote none.
"""

from __future__ import annotations

import json
import mmap
import struct
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from imumon.errors import ImumonError, Reason
from imumon.files import readable
from imumon.recordings import wire_format as wf
from imumon.recordings.wire_format import (
    CDR,
    CHECK_SIZE,
    MAGIC,
    MESSAGE,
    PROFILE,
    RECORD,
    SEQUENCE_MASK,
    Check,
)
from imumon.recordings.wire_summary import Damage, Place, WireSummary
from imumon.transport.reader import Event, EventKind, Item, Reads

READ_SIZE = 1 << 20
"""Bytes of reads that are handed on at once, and of which a checksum is taken."""
RELEASE_SIZE = 16 << 20
"""Bytes of the file that are taken out of the memory of the process at a time."""
_BEFORE_DATA = {wf.WIRE_CHANNEL: CDR.size, wf.BARE_CHANNEL: 0}
"""Bytes before the data of a read, by its channel."""
_PASSED_OVER = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, wf.CHECK_OP)
"""The channels of a wire file have the same numbers in all."""
LONGEST_MESSAGE = 16 << 20
LONGEST_RARE = 1 << 20
"""A record that claims to be longer is damage, not a record."""
BAD_RECORD = (McapError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)
"""What the library raises for a record that is not what its first byte says."""


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap | bytes]:
    """Give the bytes of a file, of which the system keeps in memory what is looked at."""
    with readable(path), path.open("rb") as file:
        if not path.stat().st_size:
            yield b""
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


class WireReader:
    """Reads a wire file in order of arrival, in constant memory.

    Each iteration reads the file anew; `summary` is that of the last iteration that came to the end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary = WireSummary()
        self.damage = Damage()
        """What was found so far by the iteration that goes on."""

    def __iter__(self) -> Iterator[Item]:
        """Yield the items in the order in which they were written, each read by itself.

        Raises ImumonError as `batches`.
        """
        for item in self.batches():
            if isinstance(item, Event):
                yield item
            else:
                yield from item

    def metadata(self) -> dict[str, str]:
        """Return what the recording program wanted to say, at the begin of the file; empty if damaged.

        Raises BAD_DATA when the file cannot be read, or is of another program.
        """
        with _mapped(self.path) as data:
            contents = _Contents(self.path, data)
            next(contents.batches(), None)  # it stands before the first message
        return contents.found.metadata

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises BAD_DATA, when the file cannot be read or is not a wire file.
        """
        with _mapped(self.path) as data:
            contents = _Contents(self.path, data)
            self.damage = contents.found.damage
            yield from contents.batches()
        self.summary = contents.found


class _Contents:
    """One iteration over the bytes of a wire file."""

    def __init__(self, path: Path, data: mmap.mmap | bytes) -> None:
        self.found = WireSummary()
        self._path, self._data = path, data
        self._done = 0
        """Up to where everything is read or given up."""
        self._released = 0
        self._next_sequence: int | None = None
        """Of the next message, modulo 2^32; None before the first in a file without check records."""
        self._pieces: list[bytes] = []
        self._arrivals_ns: list[int] = []
        self._kept = 0
        """Reads that were found since the last batch, and their bytes."""

    def batches(self) -> Generator[Reads | Event]:
        """Yield everything; `found` is complete afterwards.

        Raises BAD_DATA when this is no wire file, or what a newer version wrote is in it.
        """
        data, head = self._data, self._data[: wf.HEAD_SIZE]
        is_mcap = MAGIC.startswith(head[: len(MAGIC)])
        if not is_mcap and PROFILE in head:
            self.found.damage.add(Place(0, len(MAGIC), 0, 0, 0))
        marker = -1
        while (marker := data.find(wf.MARKER, marker + 1)) >= 0:
            at = marker - RECORD.size
            check = Check.unpack(data, at) if at >= 0 else None
            if check is not None:
                yield from self._block(check, at)
                self._release(at)
        ended = yield from self._unsealed(len(MAGIC) if is_mcap or PROFILE in head else 0)
        yield from self._reads()
        if ended:
            yield from self._compare_count()
        else:
            self.found.tail_bytes = len(data) - self._done
        self.found.complete = ended and data[-len(MAGIC) :] == MAGIC
        if not is_mcap and not self._done:
            hint = "only wire files that imumon recorded can be replayed"
            raise ImumonError(Reason.BAD_DATA, f"{self._path}: is not a wire file", hint)
        if not self.found.reads and data[self._done : self._done + 1] == bytes([Opcode.CHUNK]):
            raise self._error("another program has put it into chunks")

    def _block(self, check: Check, end: int) -> Generator[Reads | Event]:
        """Yield the block that a check record at this place seals, or count what is lost.

        A block whose messages were there before is in the file twice: it is passed over.
        """
        if self._next_sequence is None:
            self._next_sequence = 0
        begin = end - check.size
        block = self._data[max(begin, 0) : end]
        if begin == 0:
            block = MAGIC + block[len(MAGIC) :]  # the same in all files, should it be damaged
        is_whole = begin >= 0 and zlib.crc32(block) == check.crc
        at = first = len(MAGIC) if block.startswith(MAGIC) else 0
        while is_whole and at < len(block) and block[at] != wf.MESSAGE_OP:
            at += RECORD.size + RECORD.unpack_from(block, at)[1]
        if is_whole and at < len(block):
            sequence, time_ns = _message_at(block, at)
        else:
            sequence, time_ns = check.sequence, check.time_ns
        if self._ahead(sequence) < 0:
            return
        behind = end + CHECK_SIZE
        yield from self._lose((begin if is_whole else behind) - self._done, time_ns, sequence)
        self._done = behind
        if is_whole:
            stop = yield from self._records(block, first, len(block), sealed=True)
            if stop < len(block):
                raise self._error(f"a record of type {block[stop]} is not understood")

    def _unsealed(self, first: int) -> Generator[Reads | Event, None, bool]:
        """Yield what no check record follows; in a file without any also behind damage.

        Returns whether the record was reached that ends the data.
        """
        data, end = self._data, len(self._data)
        is_sealed, at = self._done > 0, self._done or first
        while True:
            stop = yield from self._records(data, at, end, sealed=False)
            if stop > at:
                self._done = stop
            if stop >= end or (data[stop] == wf.DATA_END_OP and self._is_believed(stop)):
                return self._ends_data(stop)
            at = end if is_sealed else self._next_message(stop + 1)
            if at == end:
                return False
            sequence, time_ns = _message_at(data, at)
            yield from self._lose(at - self._done, time_ns, sequence)
            self._done = at

    def _ends_data(self, at: int) -> bool:
        """Return whether the record that ends the data is whole; compare its checksum of all before it."""
        record = self._data[at : at + RECORD.size + 4]
        if len(record) < RECORD.size + 4 or RECORD.unpack_from(record) != (wf.DATA_END_OP, 4):
            return False
        if expected := int.from_bytes(record[-4:], "little"):
            crc, self._released = zlib.crc32(MAGIC), 0
            for begin in range(len(MAGIC), at, READ_SIZE):
                crc = zlib.crc32(self._data[begin : min(begin + READ_SIZE, at)], crc)
                self._release(begin)
            self.found.checksum_ok = crc == expected
        return True

    def _compare_count(self) -> Generator[Reads]:
        """Count what is missing before the end, by the number of messages that the statistics say."""
        at = self._done
        while at + RECORD.size + wf.STATISTICS_COUNTS.size <= len(self._data):
            opcode, length = RECORD.unpack_from(self._data, at)
            if opcode == Opcode.STATISTICS:
                (messages,) = wf.STATISTICS_COUNTS.unpack_from(self._data, at + RECORD.size)
                yield from self._lose(0, self.found.last_ns, messages & SEQUENCE_MASK)
                return
            at += RECORD.size + length

    def _release(self, before: int) -> None:
        """Keep what was read out of the memory that is counted as that of this process."""
        while before - self._released > RELEASE_SIZE and isinstance(self._data, mmap.mmap):
            self._data.madvise(mmap.MADV_DONTNEED, self._released, RELEASE_SIZE)
            self._released += RELEASE_SIZE

    # Losses

    def _ahead(self, sequence: int) -> int:
        """Return how many messages are missing before one of this number; below 0 if it was there before."""
        if self._next_sequence is None:
            return 0
        half = (SEQUENCE_MASK + 1) // 2
        return (sequence - self._next_sequence + half & SEQUENCE_MASK) - half

    def _lose(self, size: int, before_ns: int, sequence: int) -> Generator[Reads]:
        """Count a damaged place of so many bytes, behind which the message with this number is the next.

        Yields the reads before it.
        """
        missing = max(0, self._ahead(sequence))
        if size or missing:
            yield from self._reads()
            self.found.damage.add(Place(self._done, size, self.found.last_ns, before_ns, missing))
        if self._next_sequence is not None:
            self._next_sequence = self._next_sequence + missing & SEQUENCE_MASK

    def _error(self, what: str) -> ImumonError:
        hint = "a newer imumon wrote it, or only wire files that imumon recorded can be replayed"
        return ImumonError(Reason.BAD_DATA, f"{self._path}: {what}", hint)

    # Records

    def _records(
        self, data: mmap.mmap | bytes, at: int, end: int, *, sealed: bool
    ) -> Generator[Reads | Event, None, int]:
        """Yield the items of one record after the other; return where that ends.

        What is sealed is as it was written; any other record must be believed.
        """
        while at < end and (sealed or self._is_believed(at)):
            opcode = data[at]
            if opcode == wf.DATA_END_OP:
                break
            if opcode != wf.MESSAGE_OP:
                after = at + RECORD.size + RECORD.unpack_from(data, at)[1]
                try:
                    self._rare(opcode, data[at + RECORD.size : after])
                except BAD_RECORD:
                    break
            else:
                _, length, channel, sequence, time_ns, _ = MESSAGE.unpack_from(data, at)
                after = at + RECORD.size + length
                self._next_sequence = (sequence + 1) & SEQUENCE_MASK
                self.found.last_ns = time_ns
                if channel == wf.EVENT_CHANNEL:
                    yield from self._event(data[at + MESSAGE.size : after], time_ns, sealed=sealed)
                elif channel in _BEFORE_DATA:
                    self._pieces.append(data[at + MESSAGE.size + _BEFORE_DATA[channel] : after])
                    self._arrivals_ns.append(time_ns)
                    self._kept += length
                    if self._kept >= READ_SIZE:
                        yield from self._reads()
            at = after
        return at

    def _is_believed(self, at: int) -> bool:
        """Return whether a record that nothing vouches for is one: another begins where it ends.

        Of a message the number must follow, too.
        """
        data, end = self._data, len(self._data)
        if end - at < RECORD.size or not self._begins(at):
            return False
        after = at + RECORD.size + RECORD.unpack_from(data, at)[1]
        if after > end or (after < end and not self._begins(after)):
            return False
        if data[at] != wf.MESSAGE_OP:
            return True
        sequence, _ = _message_at(data, at)
        if after + MESSAGE.size <= end and data[after] == wf.MESSAGE_OP:
            following, _ = _message_at(data, after)
            if following != (sequence + 1) & SEQUENCE_MASK:
                return False
        return not self._ahead(sequence)

    def _begins(self, at: int) -> bool:
        """Return whether a record begins here, by the fields that are there: a message has its time twice."""
        opcode, left = self._data[at], len(self._data) - at
        if opcode != wf.MESSAGE_OP or left < MESSAGE.size:
            is_known = 0 < opcode <= wf.DATA_END_OP or opcode == wf.CHECK_OP
            is_cut = left < RECORD.size or opcode == wf.MESSAGE_OP
            return is_known and (is_cut or RECORD.unpack_from(self._data, at)[1] <= LONGEST_RARE)
        _, length, channel, _, time_ns, published_ns = MESSAGE.unpack_from(self._data, at)
        is_known = channel in _BEFORE_DATA or channel == wf.EVENT_CHANNEL
        if not is_known or time_ns != published_ns or time_ns >= 1 << 63 or length > LONGEST_MESSAGE:
            return False
        if channel != wf.WIRE_CHANNEL or left < MESSAGE.size + CDR.size:
            return True
        _, size = CDR.unpack_from(self._data, at + MESSAGE.size)
        return bool(size == length + RECORD.size - MESSAGE.size - CDR.size)

    def _next_message(self, at: int) -> int:
        """Return where a message begins that was not there before; the end where there is none."""
        end = len(self._data)
        while 0 <= (at := self._data.find(bytes([wf.MESSAGE_OP]), at)) <= end - MESSAGE.size:
            if self._begins(at) and self._ahead(_message_at(self._data, at)[0]) >= 0:
                return at
            at += 1
        return end

    # What they hold

    def _reads(self) -> Generator[Reads]:
        """Yield the reads that were found since the last event, as one."""
        if self._pieces:
            ends = np.cumsum(np.fromiter(map(len, self._pieces), np.int64, len(self._pieces)))
            data = np.frombuffer(b"".join(self._pieces), np.uint8)
            batch = Reads(data, ends, np.array(self._arrivals_ns, np.int64))
            self._pieces, self._arrivals_ns, self._kept = [], [], 0
            self.found.reads += len(ends)
            self.found.bytes += len(data)
            yield batch

    def _event(self, body: bytes, time_ns: int, *, sealed: bool) -> Generator[Reads | Event]:
        yield from self._reads()
        try:
            fields = json.loads(body)
            if fields["kind"] == wf.UNRECORDED:
                self._unrecorded(fields, time_ns)
                return
            event = Event(EventKind(fields["kind"]), time_ns, str(fields["detail"]))
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            if sealed:
                text = f"event at {time_ns} ns is not understood: {body[:200]!r}"
                raise self._error(text) from error
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

    def _rare(self, opcode: int, body: bytes) -> None:
        """Take in a rare record: header or metadata.

        Raises ValueError when it is not what its first byte says; the library has others.
        """
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.HEADER:
            profile = Header.read(stream).profile
            if profile not in wf.FORMATS:
                raise self._error(f"is an MCAP file of profile {profile!r}, not {wf.FORMAT!r}")
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self.found.metadata |= metadata.metadata if metadata.name == "imumon" else {}
        elif opcode not in _PASSED_OVER:
            raise ValueError("such a record does not stand here")


def _message_at(data: mmap.mmap | bytes, at: int) -> tuple[int, int]:
    """Return number and time of the message that begins here."""
    _, _, _, sequence, time_ns, _ = MESSAGE.unpack_from(data, at)
    return sequence, time_ns
