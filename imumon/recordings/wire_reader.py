"""Reads a wire file in order of arrival, whatever happened to it.

A block, the bytes that a check record seals, is as it was written or it is not: one whose CRC differs is
left out as a whole, as its times and bytes may be wrong.  Only what no check record follows is read without:
the end of a file that was cut short, and files of versions that wrote none.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from pathlib import Path

from imumon.errors import ImumonError, Reason
from imumon.files import readable
from imumon.recordings.wire_format import (
    CHECK_SIZE,
    DATA_END_OP,
    FORMAT,
    MAGIC,
    MARKER,
    MESSAGE,
    RECORD,
    SEQUENCE_MASK,
    STATISTICS_COUNTS,
    STATISTICS_OP,
    Check,
)
from imumon.recordings.wire_records import LONGEST_MESSAGE, Records, message_at
from imumon.recordings.wire_summary import Damage, Place, WireSummary
from imumon.transport.reader import Event, Item, Reads

READ_SIZE = 1 << 20
UNSEALED_AFTER = 4 << 20
"""A file in which so many bytes have no check record was written without: a block has some 64 KiB."""
LONGEST_BLOCK = 2 * LONGEST_MESSAGE
"""What is kept while the next check record is searched for."""
PROFILE = FORMAT.rpartition("/")[0].encode()
_HEAD = 64
_HINT = "only wire files that imumon recorded can be replayed"


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
        return file.read(_HEAD)


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
        found = WireSummary()
        with readable(self.path), self.path.open("rb") as file:
            blocks = _Blocks(self.path, found)
            first = [*blocks.feed(file.read(READ_SIZE))]
            if not first and not found.metadata:
                next(blocks.finish(), None)  # it stands before the first message
        return found.metadata

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises BAD_DATA, when the file cannot be read or is not a wire file.
        """
        found = WireSummary()
        self.damage = found.damage
        blocks = _Blocks(self.path, found)
        with readable(self.path), self.path.open("rb") as file:
            while data := file.read(READ_SIZE):
                yield from blocks.feed(data)
            yield from blocks.finish()
            file.seek(max(0, file.seek(0, os.SEEK_END) - len(MAGIC)))
            found.complete = blocks.data_ended and file.read() == MAGIC
        self.summary = found


class _Blocks:
    """Finds the blocks of a wire file as it comes, and hands on the records of those that are whole."""

    def __init__(self, path: Path, found: WireSummary) -> None:
        self.data_ended = False
        """Whether the record was reached that ends the data."""
        self._path = path
        self._found = found
        self._records = Records(path, found)
        self._buffer = b""
        self._base = 0
        """Where in the file the buffer begins."""
        self._done = 0
        """Up to where in the file everything is read or given up."""
        self._search = 0
        """From where in the file on the next check record, or message, is searched for."""
        self._crc = 0
        """Of the bytes of the file before the buffer."""
        self._is_mcap = True
        self._sealed: bool | None = None
        """Whether the file has check records; None until that is known."""

    def feed(self, data: bytes) -> Iterator[Reads | Event]:
        """Yield what is whole by now."""
        if not self._base and not self._buffer:
            data = self._begun(data)
        self._buffer += data
        if self._sealed is not False:
            yield from self._blocks()
        if self._sealed is None and len(self._buffer) > UNSEALED_AFTER:
            self._sealed, self._search = False, 0
        if self._sealed is False:
            yield from self._unsealed(last=False)
        yield from self._records.reads()
        self._forget(max(self._done, self._base + len(self._buffer) - LONGEST_BLOCK))

    def finish(self) -> Iterator[Reads | Event]:
        """Yield what is behind the last check record.

        Raises BAD_DATA when this is no wire file.
        """
        if not self._sealed:
            self._search = 0
        yield from self._unsealed(last=True)
        yield from self._records.reads()
        if self.data_ended:
            yield from self._compare_count()
        if not self.data_ended:
            self._found.tail_bytes = self._base + len(self._buffer) - self._done
        if not self._is_mcap and not self._done:
            raise ImumonError(Reason.BAD_DATA, f"{self._path}: is not a wire file", _HINT)

    def _begun(self, data: bytes) -> bytes:
        """Return the beginning of the file with the eight bytes that are the same in all."""
        self._is_mcap = MAGIC.startswith(data[: len(MAGIC)])
        if self._is_mcap or PROFILE not in data[:_HEAD]:
            return data
        self._found.damage.add(Place(0, len(MAGIC), 0, 0, 0))
        return MAGIC + data[len(MAGIC) :]

    def _forget(self, offset: int) -> None:
        """Drop the bytes before this place of the file."""
        count = offset - self._base
        if count > 0:
            self._crc = zlib.crc32(memoryview(self._buffer)[:count], self._crc)
            self._buffer, self._base = self._buffer[count:], offset

    # With check records

    def _blocks(self) -> Iterator[Reads | Event]:
        while (marker := self._buffer.find(MARKER, self._search - self._base)) >= 0:
            at = marker - RECORD.size
            if at + CHECK_SIZE > len(self._buffer):
                return
            self._search = self._base + marker + len(MARKER)
            check = Check.unpack(self._buffer, at) if at >= 0 else None
            if check is not None:
                yield from self._block(check, at)
        self._search = max(self._search, self._base + len(self._buffer) - len(MARKER) + 1)

    def _block(self, check: Check, end: int) -> Iterator[Reads | Event]:
        """Hand on the block that a check record at this place of the buffer seals, or count what is lost.

        A block whose messages were there before is in the file twice: it is passed over.
        """
        if not self._sealed:
            self._sealed, self._records.next_sequence = True, 0
        begin = end - check.size
        is_whole = begin >= 0 and zlib.crc32(memoryview(self._buffer)[begin:end]) == check.crc
        at = self._records.first_message(self._buffer, begin, end) if is_whole else end
        sequence, time_ns = (check.sequence, check.time_ns) if at == end else message_at(self._buffer, at)
        if self._records.ahead(sequence) < 0:
            return
        behind = self._base + end + CHECK_SIZE
        lost_to = self._base + begin if is_whole else behind
        yield from self._records.lose(self._done, lost_to - self._done, time_ns, sequence)
        self._done = self._search = behind
        if is_whole:
            yield from self._records.sealed(self._buffer, begin, end)

    # Without

    def _unsealed(self, *, last: bool) -> Iterator[Reads | Event]:
        """Hand on what is believed by itself; in a file without check records, also behind a doubt."""
        end = len(self._buffer)
        at = max(self._done - self._base, 0)
        while not self.data_ended:
            if self._base + at == 0 and self._buffer.startswith(MAGIC):
                at = len(MAGIC)
            stop = yield from self._records.unsealed(self._buffer, at, end, last=last)
            if stop.at > at:
                self._done = self._base + stop.at
            if not stop.in_doubt:
                self._end_data(stop.at)
                return
            begin = max(stop.at + 1, self._search - self._base)
            at = end if self._sealed else self._records.next_message(self._buffer, begin, end)
            if at == end:
                self._search = self._base + max(begin, end - MESSAGE.size)
                return
            sequence, time_ns = message_at(self._buffer, at)
            yield from self._records.lose(self._done, self._base + at - self._done, time_ns, sequence)
            self._done = self._base + at

    def _compare_count(self) -> Iterator[Reads]:
        """Count what is missing before the end, by the number of messages that the statistics say."""
        at = self._done - self._base
        while at + RECORD.size + STATISTICS_COUNTS.size <= len(self._buffer):
            opcode, length = RECORD.unpack_from(self._buffer, at)
            if opcode == STATISTICS_OP:
                (messages,) = STATISTICS_COUNTS.unpack_from(self._buffer, at + RECORD.size)
                yield from self._records.lose(self._done, 0, self._found.last_ns, messages & SEQUENCE_MASK)
                return
            at += RECORD.size + length

    def _end_data(self, at: int) -> None:
        """Take the record in that ends the data, if it stands here, with the checksum of all before it."""
        record = self._buffer[at : at + RECORD.size + 4]
        if len(record) == RECORD.size + 4 and RECORD.unpack_from(record) == (DATA_END_OP, 4):
            self.data_ended = True
            expected = int.from_bytes(record[-4:], "little")
            found = zlib.crc32(memoryview(self._buffer)[:at], self._crc)
            self._found.checksum_ok = found == expected if expected else None
