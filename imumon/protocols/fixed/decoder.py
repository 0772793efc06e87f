"""Decoder of fixed-length packets: a compiled search finds whole packets, NumPy reads their columns.

The search sees every byte as it comes and is compiled, as reads may be short and many.  The columns are
made when they are taken, from many packets at once, with the structured types of NumPy.
Cost, measured by ``scripts/benchmark``: linear in bytes and in columns.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.compiled import njit
from imumon.protocols.base import (
    CAPACITY,
    CHECKSUM_ERRORS,
    HELD,
    IN_PACKETS,
    LENGTH_ERRORS,
    PACKETS,
    RECEIVED,
    ROWS,
    SKIPPED,
    ByteArray,
    Counters,
    Decoder,
)
from imumon.protocols.checksums import CrcTable, checksum, make_checksum
from imumon.protocols.fixed.description import ByteOrder, Packet, PlacedColumn
from imumon.protocols.kernel import NUMBER_TYPES, arrival_of, keep_rest

# Places in the vector that describes the frame to the kernel.
LENGTH, SYNC_SIZE, CK_CODE, CK_FIRST, CK_STOP, CK_AT, CK_BIG, CK_SIZE, CK_INITIAL, CK_FINAL, CK_SHIFT = range(
    11
)


class FixedDecoder(Decoder):
    """Decoder of a packet that a device file describes."""

    def __init__(self, name: str, packet: Packet, rate_hz: float | None) -> None:
        super().__init__()
        self._placed = packet.placed()
        self.timing = packet.timing(rate_hz)
        self._name = name
        self._columns = (KNOWN["arrival_time_ns"], *(item.column for item in self._placed))
        self._header = _header(packet)
        self._frame, self._crc_table = _frame(packet)
        self._layout = _layout(self._placed, packet.length)
        self._packets: ByteArray = np.zeros((CAPACITY, packet.length), np.uint8)
        self._arrivals: IntArray = np.zeros(CAPACITY, np.int64)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the blocks: the arrival time and what the packet has."""
        return self._columns

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        state = [int(value) for value in self._state]
        return Counters(
            bytes_received=state[RECEIVED],
            bytes_in_packets=state[IN_PACKETS],
            bytes_skipped=state[SKIPPED],
            packets=state[PACKETS],
            checksum_errors=state[CHECKSUM_ERRORS],
            length_errors=state[LENGTH_ERRORS],
            packets_by_type={self._name: state[PACKETS]} if state[PACKETS] else {},
        )

    def _scan(self, chunk: ByteArray, arrival_ns: int, final: bool) -> None:
        held = int(self._state[HELD])
        self._held[held : held + len(chunk)] = chunk
        self._state[RECEIVED] += len(chunk)
        self._state[HELD] += len(chunk)
        _scan_fixed(
            arrival_ns, final, self._held, self._held_arrival, self._state, self._frame, self._header,
            self._crc_table, self._packets, self._arrivals,
        )  # fmt: skip

    def _rows(self) -> SampleBlock:
        n = int(self._state[ROWS])
        records = self._packets[:n].view(self._layout)[:, 0]
        columns = {item.column.name: _values(records[item.column.name], item) for item in self._placed}
        return SampleBlock({"arrival_time_ns": self._arrivals[:n].copy(), **columns})


def _layout(placed: list[PlacedColumn], length: int) -> np.dtype[np.void]:
    """Return the packet as a structured type; a number of three bytes, which NumPy lacks, as its bytes."""
    formats: list[tuple[str, int] | str] = []
    for item in placed:
        number = NUMBER_TYPES[item.type]
        kind = "f" if not number.integer else "i" if number.signed or number.size == 8 else "u"
        formats.append(("u1", 3) if number.size == 3 else f"{'>' if item.big else '<'}{kind}{number.size}")
    return np.dtype(
        {
            "names": [item.column.name for item in placed],
            "formats": formats,
            "offsets": [item.at for item in placed],
            "itemsize": length,
        }
    )


def _values(raw: ColumnArray, item: PlacedColumn) -> ColumnArray:
    """Return the column of one field: raw * scale + offset, or the integer."""
    number = NUMBER_TYPES[item.type]
    if number.size == 3:
        raw = _whole(raw, item.big, number.signed)
    if item.mask:
        low_bit = (item.mask & -item.mask).bit_length() - 1
        raw = ((raw.astype(np.uint64) & np.uint64(item.mask)) >> np.uint64(low_bit)).astype(np.int64)
    if item.column.dtype == "float64":
        values = raw.astype(np.float64)
        values *= item.scale
        values += item.offset
        return values
    if not number.integer:
        with np.errstate(invalid="ignore"):  # a clock that is not a number becomes the least integer
            return np.rint(raw.astype(np.float64) * item.scale).astype(np.int64)
    return raw.astype(np.int64)


def _whole(three: ColumnArray, big: bool, signed: bool) -> IntArray:
    """Return integers of three bytes, (n, 3)."""
    high, middle, low = three.astype(np.int64).T[:: 1 if big else -1]
    whole: IntArray = high << 16 | middle << 8 | low
    return whole - ((whole >> 23) << 24) if signed else whole


def _header(packet: Packet) -> IntArray:
    """Return the bytes that are the same in every packet, (n, 2): place, value; sync first, then length."""
    header = list(enumerate(packet.sync))
    field = packet.length_field
    if field is not None:
        order: ByteOrder = field.byte_order or packet.byte_order
        value = field.value.to_bytes(NUMBER_TYPES[field.type].size, order)
        header += [(field.at + i, byte) for i, byte in enumerate(value)]
    return np.array(header, np.int64)


def _frame(packet: Packet) -> tuple[IntArray, CrcTable]:
    check = make_checksum(packet.checksum.type)
    big = (packet.checksum.byte_order or packet.byte_order) == "big"
    frame = np.array([
        packet.length, len(packet.sync),
        check.code, packet.checksum.first, packet.checksum.last + 1, packet.checksum.at, big,
        check.size, check.initial, check.final_xor, check.shift,
    ], np.int64)  # fmt: skip
    return frame, check.table


GOOD, NO_SYNC, INCOMPLETE, BAD_LENGTH, BAD_CHECKSUM = range(5)


@njit
def _scan_fixed(
    arrival_ns: int, final: bool, held: ByteArray, held_arrival: IntArray, state: IntArray, frame: IntArray,
    header: IntArray, crc_table: CrcTable, packets: ByteArray, arrivals: IntArray,
) -> None:  # fmt: skip
    """Copy the packets among the held bytes into the rows of `packets`, until bytes or rows run out.

    Every byte passed over is counted.  A candidate that is not complete ends the scan, or, at the end of the
    data, is passed over provisionally: it stays pending unless a whole packet follows.
    """
    at, done, unfinished, row = 0, 0, -1, state[ROWS]
    stop, length, first_byte = state[HELD], frame[LENGTH], header[0, 1]
    while at < stop and row < len(packets):
        if held[np.uint64(at)] != first_byte:
            at += 1
            continue
        verdict = _judge(held, at, stop, header, frame, crc_table)
        if verdict == GOOD:
            start, out = np.uint64(at), packets[row]
            for i in range(np.uint64(length)):
                out[i] = held[start + i]
            arrivals[row] = arrival_of(at + length - 1, arrival_ns, held_arrival, state)
            row += 1
            state[SKIPPED] += at - done
            at += length
            done, unfinished = at, -1
            continue
        if verdict == INCOMPLETE:
            if not final:
                break
            if unfinished < 0:
                unfinished = at
        elif verdict == BAD_CHECKSUM:
            state[CHECKSUM_ERRORS] += 1
        elif verdict == BAD_LENGTH:
            state[LENGTH_ERRORS] += 1
        at += 1
    rest = unfinished if unfinished >= 0 else at
    found = row - state[ROWS]
    state[SKIPPED] += rest - done
    state[PACKETS] += found
    state[IN_PACKETS] += found * length
    state[ROWS] = row
    keep_rest(rest, arrival_ns, held, held_arrival, state, row == len(packets))


@njit
def _judge(
    held: ByteArray, at: int, stop: int, header: IntArray, frame: IntArray, crc_table: CrcTable
) -> int:
    """Tell whether a packet begins at a place: sync bytes, length, whether all of it is there, checksum."""
    available = stop - at
    for i in range(len(header)):
        if header[i, 0] >= available:
            break
        if held[at + header[i, 0]] != header[i, 1]:
            return NO_SYNC if i < frame[SYNC_SIZE] else BAD_LENGTH
    if available < frame[LENGTH]:
        return INCOMPLETE
    if frame[CK_SIZE] == 0:
        return GOOD
    computed = checksum(
        frame[CK_CODE], held, at + frame[CK_FIRST], at + frame[CK_STOP], crc_table,
        frame[CK_INITIAL], frame[CK_FINAL], frame[CK_SHIFT],
    )  # fmt: skip
    sent = np.int64(0)
    for i in range(frame[CK_SIZE]):
        place = i if frame[CK_BIG] else frame[CK_SIZE] - 1 - i
        sent = sent << 8 | held[at + frame[CK_AT] + place]
    return GOOD if computed == sent else BAD_CHECKSUM
