"""Decoder of fixed-length packets: a compiled search finds whole packets, NumPy reads their columns.

The search sees every byte as it comes and is compiled, as reads may be short and many.  The columns are
made when they are taken, from many packets at once, with the structured types of NumPy.
Cost, measured by ``scripts/benchmark``: linear in bytes and in columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.compiled import alone, inner, njit, record
from imumon.protocols.base import CAPACITY, CompiledDecoder
from imumon.protocols.checksums import Checksum, checksum, make_checksum
from imumon.protocols.fixed.description import Packet
from imumon.protocols.payload import Record
from imumon.protocols.stream import ByteArray, Stream, arrival_of, keep_rest

LONGEST_HEADER = 12
"""Bytes that are the same in every packet: of the sync and of a length."""


class _Frame:
    """What the search asks of a packet: the bytes of its header, sync first, and its checksum's places."""

    length: int
    sync_size: int
    header_size: int
    header_at: IntArray
    header_byte: IntArray
    sum_first: int
    sum_stop: int
    sum_at: int
    sum_big: int


class FixedDecoder(CompiledDecoder):
    """Decoder of a packet that a device file describes."""

    def __init__(self, name: str, packet: Packet, rate_hz: float | None) -> None:
        super().__init__()
        self._record = Record(packet.placed(), size=packet.length)
        self.timing = packet.timing(rate_hz)
        self._name = name
        self._columns = (KNOWN["arrival_time_ns"], *self._record.columns)
        self._frames, self._checksums = alone(_frame(packet)), alone(make_checksum(packet.checksum.type))
        self._packets: ByteArray = np.zeros((CAPACITY, packet.length), np.uint8)
        self._arrivals: IntArray = np.zeros(CAPACITY, np.int64)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the blocks: the arrival time and what the packet has."""
        return self._columns

    def warnings(self) -> list[str]:
        """Return, once each, which columns do not hold all that was sent; see `Decoder.warnings`."""
        for text in self._record.complaints():
            self._warn(text)
        return super().warnings()

    def _packets_by_type(self) -> dict[str, int]:
        count = int(self._stream.packets)
        return {self._name: count} if count else {}

    def _scan(self, final: bool) -> bool:
        return _scan_fixed(final, self._streams, self._frames, self._checksums, self._packets, self._arrivals)

    def _rows(self, n: int) -> SampleBlock:
        columns = self._record.columns_of(self._packets[:n])
        return SampleBlock({"arrival_time_ns": self._arrivals[:n].copy(), **columns})


def _frame(packet: Packet) -> _Frame:
    header = list(enumerate(packet.sync))
    check = packet.checksum
    header += packet.length_bytes()
    frame = record(_Frame, header_at=LONGEST_HEADER, header_byte=LONGEST_HEADER)
    frame.length, frame.sync_size, frame.header_size = packet.length, len(packet.sync), len(header)
    frame.header_at[: len(header)], frame.header_byte[: len(header)] = np.transpose(header)
    frame.sum_first, frame.sum_stop, frame.sum_at = check.first, check.last + 1, check.at
    frame.sum_big = (check.byte_order or packet.byte_order) == "big"
    return frame


GOOD, NO_SYNC, INCOMPLETE, BAD_LENGTH, BAD_CHECKSUM = range(5)


@njit
def _scan_fixed(
    final: bool,
    streams: Sequence[Stream],
    frames: Sequence[_Frame],
    checks: Sequence[Checksum],
    packets: ByteArray,
    arrivals: IntArray,
) -> bool:
    """Copy the packets among the held bytes into the rows of `packets`; tell whether the rows ran out first.

    Every byte passed over is counted.  A candidate that is not complete ends the scan, or, at the end of the
    data, is passed over provisionally: it stays pending unless a whole packet follows.
    """
    stream, frame, check = streams[0], frames[0], checks[0]
    at, done, unfinished, row = 0, 0, -1, stream.rows
    held, stop, length, first_byte = stream.bytes, stream.held, frame.length, frame.header_byte[0]
    while at < stop and row < len(packets):
        if held[np.uint64(at)] != first_byte:
            at += 1
            continue
        verdict = _judge(held, at, stop, frame, check)
        if verdict == GOOD:
            start, out = np.uint64(at), packets[row]
            for i in range(np.uint64(length)):
                out[i] = held[start + i]
            arrivals[row] = arrival_of(at + length - 1, stream)
            row += 1
            stream.skipped += at - done
            at += length
            done, unfinished = at, -1
            continue
        if verdict == INCOMPLETE:
            if not final:
                break
            if unfinished < 0:
                unfinished = at
        elif verdict == BAD_CHECKSUM:
            stream.checksum_errors += 1
        elif verdict == BAD_LENGTH:
            stream.length_errors += 1
        at += 1
    rest = unfinished if unfinished >= 0 else at
    found = row - stream.rows
    stream.skipped += rest - done
    stream.packets += found
    stream.in_packets += found * length
    stream.rows = row
    keep_rest(rest, stream)
    return bool(row == len(packets))


@inner
def _judge(held: ByteArray, at: int, stop: int, frame: _Frame, check: Checksum) -> int:
    """Tell whether a packet begins at a place: sync bytes, length, whether all of it is there, checksum."""
    available = stop - at
    for i in range(frame.header_size):
        if frame.header_at[i] >= available:
            break
        if held[at + frame.header_at[i]] != frame.header_byte[i]:
            return NO_SYNC if i < frame.sync_size else BAD_LENGTH
    if available < frame.length:
        return INCOMPLETE
    if check.width == 0:
        return GOOD
    sent = np.int64(0)
    for i in range(check.width):
        place = i if frame.sum_big else check.width - 1 - i
        sent = sent << 8 | held[at + frame.sum_at + place]
    computed = checksum(check, held, at + frame.sum_first, at + frame.sum_stop)
    return GOOD if computed == sent else BAD_CHECKSUM
