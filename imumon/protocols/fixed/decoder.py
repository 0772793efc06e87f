"""Decoder of fixed-length packets: find the packets of a chunk, then fill one column after the other.

Cost, measured by ``scripts/benchmark``: linear in bytes and in columns; the checksum is the largest part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.protocols.base import (
    CAPACITY,
    CHECKSUM_ERRORS,
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
from imumon.protocols.kernel import (
    BIG,
    F32,
    F64,
    NUMBER_TYPES,
    append_chunk,
    arrival_of,
    bytes_big,
    bytes_little,
    keep_rest,
)

if TYPE_CHECKING:
    from imumon.protocols.fixed.description import ByteOrder, FixedDevice

UIntArray = npt.NDArray[np.uint64]

# Columns of the integer table that describes the packet columns to the kernel.
AT, KIND, SIZE, IS_INT, OUT, MASK, SHIFT = range(7)
# Places in the vector that describes the frame to the kernel.
(LENGTH, SYNC_SIZE,
 CK_CODE, CK_FIRST, CK_STOP, CK_AT, CK_BIG, CK_SIZE, CK_INITIAL, CK_FINAL, CK_SHIFT) = range(11)  # fmt: skip


class FixedDecoder(Decoder):
    """Decoder of a packet that a device file describes."""

    def __init__(self, device: FixedDevice) -> None:
        super().__init__()
        placed = device.placed()
        self.timing = device.timing()
        self._name = device.name
        self._columns = (KNOWN["arrival_time_ns"], *(item.column for item in placed))
        self._header = _header(device)
        self._frame, self._crc_table = _frame(device)
        self._fields = np.zeros((len(placed), 7), np.int64)
        self._scales = np.array([[item.scale, item.offset] for item in placed])
        count = [0, 1]  # the first integer row is the arrival time
        for row, item in enumerate(placed):
            number = NUMBER_TYPES[item.type]
            is_int = item.column.dtype == "int64"
            low_bit = (item.mask & -item.mask).bit_length() - 1 if item.mask else 0
            kind = number.code + (BIG if item.big else 0)
            self._fields[row] = item.at, kind, number.size, is_int, count[is_int], item.mask, low_bit
            count[is_int] += 1
        self._floats: FloatArray = np.zeros((count[0], CAPACITY))
        self._ints: IntArray = np.zeros((count[1], CAPACITY), np.int64)
        self._starts: UIntArray = np.zeros(CAPACITY, np.uint64)
        self._bits: UIntArray = np.zeros(CAPACITY, np.uint64)

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
        _scan_fixed(
            chunk, arrival_ns, final, self._held, self._held_arrival, self._state, self._header, self._frame,
            self._crc_table, self._fields, self._scales, self._floats, self._ints, self._starts, self._bits,
        )  # fmt: skip

    def _rows(self) -> SampleBlock:
        n = int(self._state[ROWS])
        columns: dict[str, ColumnArray] = {"arrival_time_ns": self._ints[0, :n].copy()}
        for column, field in zip(self._columns[1:], self._fields, strict=True):
            source: ColumnArray = self._ints if field[IS_INT] else self._floats
            columns[column.name] = source[field[OUT], :n].copy()
        return SampleBlock(columns)


def _header(device: FixedDevice) -> IntArray:
    """Return the bytes that are the same in every packet, (n, 2): place, value; sync first, then length."""
    packet = device.packet
    header = list(enumerate(packet.sync))
    field = packet.length_field
    if field is not None:
        order: ByteOrder = field.byte_order or packet.byte_order
        value = field.value.to_bytes(NUMBER_TYPES[field.type].size, order)
        header += [(field.at + i, byte) for i, byte in enumerate(value)]
    return np.array(header, np.int64)


def _frame(device: FixedDevice) -> tuple[IntArray, CrcTable]:
    packet = device.packet
    check = make_checksum(packet.checksum.type)
    frame = np.zeros(11, np.int64)
    frame[:CK_CODE] = packet.length, len(packet.sync)
    big = (packet.checksum.byte_order or packet.byte_order) == "big"
    frame[CK_CODE:] = (
        check.code, packet.checksum.first, packet.checksum.last + 1, packet.checksum.at, big,
        check.size, check.initial, check.final_xor, check.shift,
    )  # fmt: skip
    return frame, check.table


@njit(cache=True, nogil=True)
def _scan_fixed(
    chunk: ByteArray, arrival_ns: int, final: bool, held: ByteArray, held_arrival: IntArray, state: IntArray,
    header: IntArray, frame: IntArray, crc_table: CrcTable, fields: IntArray, scales: FloatArray,
    floats: FloatArray, ints: IntArray, starts: UIntArray, bits: UIntArray,
) -> None:  # fmt: skip
    """Decode a chunk: the arrays are those of `FixedDecoder`."""
    stop = append_chunk(chunk, held, state)
    row = state[ROWS]
    rest, found = _find_packets(held, stop, final, header, frame, crc_table, starts, len(starts) - row, state)
    length = frame[LENGTH]
    for k in range(found):
        ints[0, row + k] = arrival_of(np.int64(starts[k]) + length - 1, arrival_ns, held_arrival, state)
    for f in range(len(fields)):
        _fill_column(held, starts, found, row, fields[f], scales[f], floats, ints, bits)
    state[ROWS] = row + found
    keep_rest(rest, arrival_ns, held, held_arrival, state, row + found == len(starts))


@njit(cache=True, nogil=True)
def _find_packets(
    held: ByteArray, stop: int, final: bool, header: IntArray, frame: IntArray, crc_table: CrcTable,
    starts: UIntArray, room: int, state: IntArray,
) -> tuple[int, int]:  # fmt: skip
    """Find up to `room` packets in held[:stop]; return (first byte to keep, packets found).

    Every byte passed over is counted.  A candidate that is not complete ends the scan, or, at the end of the
    data, is passed over provisionally: it stays pending unless a whole packet follows.
    """
    at, done, found, unfinished = 0, 0, 0, -1
    length = frame[LENGTH]
    ck_at, ck_big, ck_size = frame[CK_AT], frame[CK_BIG], frame[CK_SIZE]
    first, last, code = frame[CK_FIRST], frame[CK_STOP], frame[CK_CODE]
    initial, final_xor, shift = frame[CK_INITIAL], frame[CK_FINAL], frame[CK_SHIFT]
    while at < stop and found < room:
        verdict = _judge_header(held, at, stop, header, frame)
        if verdict == GOOD and ck_size > 0:
            computed = checksum(code, held, at + first, at + last, crc_table, initial, final_xor, shift)
            if computed != _sent(held, at + ck_at, ck_size, ck_big):
                verdict = BAD_CHECKSUM
        if verdict == GOOD:
            starts[found] = at
            found += 1
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
    rest = unfinished if unfinished >= 0 and found < room else at
    state[SKIPPED] += rest - done
    state[PACKETS] += found
    state[IN_PACKETS] += found * length
    return rest, found


GOOD, NO_SYNC, INCOMPLETE, BAD_LENGTH, BAD_CHECKSUM = range(5)


@njit(cache=True, nogil=True, inline="always")
def _judge_header(held: ByteArray, at: int, stop: int, header: IntArray, frame: IntArray) -> int:
    """Tell whether a packet may begin at a place: sync bytes, length, and whether all of it is there."""
    place, available = np.uint64(at), stop - at
    verdict = GOOD if available >= frame[LENGTH] else INCOMPLETE
    for i in range(len(header)):
        if header[i, 0] >= available:
            break
        if held[place + np.uint64(header[i, 0])] != header[i, 1]:
            verdict = NO_SYNC if i < frame[SYNC_SIZE] else BAD_LENGTH
            break
    return verdict


@njit(cache=True, nogil=True, inline="always")
def _sent(held: ByteArray, at: int, size: int, big: int) -> np.int64:
    """Read the checksum that stands in the packet."""
    place, value = np.uint64(at), np.int64(0)
    for i in range(size):
        byte = np.int64(held[place + np.uint64(i)])
        value = (value << 8) | byte if big else value | (byte << (8 * i))
    return value


@njit(cache=True, nogil=True)
def _fill_column(
    held: ByteArray, starts: UIntArray, n: int, row: int, field: IntArray, scale: FloatArray,
    floats: FloatArray, ints: IntArray, bits: UIntArray,
) -> None:  # fmt: skip
    """Write one field of n packets into its column, from `row` on."""
    kind, size = field[KIND], field[SIZE]
    _gather(held, starts, n, field[AT], size, kind >= BIG, bits)
    code = kind & (BIG - 1)
    to_sign = np.int64(64 - 8 * size) if code < F32 and code & 1 else np.int64(0)
    mask, shift = np.uint64(field[MASK]), np.uint64(field[SHIFT])
    factor, offset = scale[0], scale[1]
    if field[IS_INT]:
        whole = ints[field[OUT], row : row + n]
        if code == F64:
            for k in range(n):
                whole[k] = np.int64(np.rint(np.uint64(bits[k]).view(np.float64) * factor))
        elif code == F32:
            for k in range(n):
                whole[k] = np.int64(np.rint(np.float64(np.uint32(bits[k]).view(np.float32)) * factor))
        elif mask:
            for k in range(n):
                whole[k] = np.int64((bits[k] & mask) >> shift)
        else:
            for k in range(n):
                whole[k] = np.int64(bits[k] << np.uint64(to_sign)) >> to_sign
        return
    out = floats[field[OUT], row : row + n]
    if code == F32:
        for k in range(n):
            out[k] = np.float64(np.uint32(bits[k]).view(np.float32)) * factor + offset
    elif code == F64:
        for k in range(n):
            out[k] = np.uint64(bits[k]).view(np.float64) * factor + offset
    elif mask:
        for k in range(n):
            out[k] = np.float64((bits[k] & mask) >> shift) * factor + offset
    else:
        for k in range(n):
            out[k] = np.float64(np.int64(bits[k] << np.uint64(to_sign)) >> to_sign) * factor + offset


@njit(cache=True, nogil=True)
def _gather(
    held: ByteArray, starts: UIntArray, n: int, at: int, size: int, big: bool, bits: UIntArray
) -> None:
    """Collect the raw bits of a field; a loop for each size, so that each becomes a load and a byte swap."""
    place = np.uint64(at)
    if size == 1:
        for k in range(n):
            bits[k] = np.uint64(held[starts[k] + place])
    elif size == 2 and big:
        for k in range(n):
            bits[k] = bytes_big(held, starts[k] + place, 2)
    elif size == 2:
        for k in range(n):
            bits[k] = bytes_little(held, starts[k] + place, 2)
    elif size == 4 and big:
        for k in range(n):
            bits[k] = bytes_big(held, starts[k] + place, 4)
    elif size == 4:
        for k in range(n):
            bits[k] = bytes_little(held, starts[k] + place, 4)
    elif big:
        for k in range(n):
            bits[k] = bytes_big(held, starts[k] + place, size)
    else:
        for k in range(n):
            bits[k] = bytes_little(held, starts[k] + place, size)
