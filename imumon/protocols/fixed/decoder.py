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
    DATED,
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
(LENGTH, SYNC_SIZE, KNOWN_BITS, PATTERN,
 CK_CODE, CK_FIRST, CK_STOP, CK_AT, CK_BIG, CK_SIZE, CK_INITIAL, CK_FINAL, CK_SHIFT) = range(13)  # fmt: skip

BATCH_BYTES = 16_384
"""Packets are worked on in batches of about half an L1 data cache."""


class FixedDecoder(Decoder):
    """Decoder of a packet that a device file describes."""

    def __init__(self, device: FixedDevice) -> None:
        super().__init__()
        placed = device.placed()
        self.timing = device.timing()
        self._name = device.name
        self._columns = (KNOWN["arrival_time_ns"], *(item.column for item in placed))
        self._header = _header(device)
        self._frame, self._crc_table = _frame(device, self._header)
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
        # Where each column of a block is among the rows of integers and then of floats.
        self._order = [0, *(int(f[OUT] if f[IS_INT] else count[1] + f[OUT]) for f in self._fields)]
        self._names = [column.name for column in self._columns]
        self._floats: FloatArray = np.zeros((count[0], CAPACITY))
        self._ints: IntArray = np.zeros((count[1], CAPACITY), np.int64)
        batch = max(BATCH_BYTES // device.packet.length, 64)
        self._starts: UIntArray = np.zeros(batch, np.uint64)
        self._bits: IntArray = np.zeros(batch, np.int64)

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
            chunk, arrival_ns, final, self._held, self._held_arrival, self._state, self._frame, self._header,
            self._crc_table, self._fields, self._scales, self._floats, self._ints, self._starts, self._bits,
        )  # fmt: skip

    def _rows(self) -> SampleBlock:
        n = int(self._state[ROWS])
        # Two copies and a view for each column take a third of the time of a copy for each column.
        rows: list[ColumnArray] = [*self._ints[:, :n].copy(), *self._floats[:, :n].copy()]
        return SampleBlock({name: rows[row] for name, row in zip(self._names, self._order, strict=True)})


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


def _frame(device: FixedDevice, header: IntArray) -> tuple[IntArray, CrcTable]:
    packet = device.packet
    check = make_checksum(packet.checksum.type)
    big = (packet.checksum.byte_order or packet.byte_order) == "big"
    frame = np.array([
        packet.length, len(packet.sync), *_first_word(header),
        check.code, packet.checksum.first, packet.checksum.last + 1, packet.checksum.at, big,
        check.size, check.initial, check.final_xor, check.shift,
    ], np.int64)  # fmt: skip
    return frame, check.table


def _first_word(header: IntArray) -> tuple[int, int]:
    """Return which bits of a packet's first 8 bytes are the same in every packet, and what they are.

    Where the length stands further back no word has the pattern, so that each header is judged byte by byte.
    """
    known, pattern = np.zeros(8, np.uint8), np.zeros(8, np.uint8)
    if header[:, 0].max() >= 8:
        return 0, 1
    known[header[:, 0]] = 0xFF
    pattern[header[:, 0]] = header[:, 1]
    return int(known.view("<i8")[0]), int(pattern.view("<i8")[0])


@njit(cache=True, nogil=True)
def _scan_fixed(
    chunk: ByteArray, arrival_ns: int, final: bool, held: ByteArray, held_arrival: IntArray, state: IntArray,
    frame: IntArray, header: IntArray, crc_table: CrcTable, fields: IntArray, scales: FloatArray,
    floats: FloatArray, ints: IntArray, starts: UIntArray, bits: IntArray,
) -> None:  # fmt: skip
    """Decode a chunk: the arrays are those of `FixedDecoder`.

    Goes in batches of as many packets as `starts` holds, so that a column finds their bytes in the L1 cache.
    """
    stop = append_chunk(chunk, held, state)
    rest, row, capacity = 0, state[ROWS], ints.shape[1]
    batch_full = True
    while batch_full and row < capacity:
        room = min(len(starts), capacity - row)
        rest, found = _find_packets(held, rest, stop, final, header, frame, crc_table, starts, room, state)
        _fill_arrivals(starts, found, frame[LENGTH], arrival_ns, held_arrival, state, ints[0, row:])
        for f in range(len(fields)):
            field = fields[f]
            if field[IS_INT]:
                _fill_ints(held, starts, found, field, scales[f, 0], ints[field[OUT], row:])
            else:
                _fill_floats(held, starts, found, field, scales[f, 0], scales[f, 1], bits,
                             floats[field[OUT], row:])  # fmt: skip
        row += found
        batch_full = found == room
    state[ROWS] = row
    keep_rest(rest, arrival_ns, held, held_arrival, state, row == capacity)


@njit(cache=True, nogil=True)
def _find_packets(
    held: ByteArray, start: int, stop: int, final: bool, header: IntArray, frame: IntArray,
    crc_table: CrcTable, starts: UIntArray, room: int, state: IntArray,
) -> tuple[int, int]:  # fmt: skip
    """Find up to `room` packets in held[start:stop]; return (first byte to keep, packets found).

    Every byte passed over is counted.  A candidate that is not complete ends the scan, or, at the end of the
    data, is passed over provisionally: it stays pending unless a whole packet follows.
    """
    at, done, found, unfinished = start, start, 0, -1
    length, known, pattern = frame[LENGTH], np.uint64(frame[KNOWN_BITS]), np.uint64(frame[PATTERN])
    last_word, first_byte = stop - max(length, 8), header[0, 1]
    while at < stop and found < room:
        if held[np.uint64(at)] != first_byte:
            at += 1
            continue
        verdict = GOOD
        if at > last_word or bytes_little(held, at, 8) & known != pattern:
            verdict = _judge_header(held, at, stop, header, frame)
        if verdict == GOOD and frame[CK_SIZE] and not _checksum_fits(held, at, frame, crc_table):
            verdict = BAD_CHECKSUM
        if verdict == GOOD:
            starts[np.uint64(found)] = at
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


@njit(cache=True, nogil=True)
def _judge_header(held: ByteArray, at: int, stop: int, header: IntArray, frame: IntArray) -> int:
    """Tell whether a packet may begin at a place: sync bytes, length, and whether all of it is there."""
    available = stop - at
    for i in range(len(header)):
        if header[i, 0] >= available:
            break
        if held[at + header[i, 0]] != header[i, 1]:
            return NO_SYNC if i < frame[SYNC_SIZE] else BAD_LENGTH
    return GOOD if available >= frame[LENGTH] else INCOMPLETE


@njit(cache=True, nogil=True, inline="always")
def _checksum_fits(held: ByteArray, at: int, frame: IntArray, crc_table: CrcTable) -> bool:
    """Compare the checksum of the packet with the one that it carries."""
    computed = checksum(frame[CK_CODE], held, at + frame[CK_FIRST], at + frame[CK_STOP], crc_table,
                        frame[CK_INITIAL], frame[CK_FINAL], frame[CK_SHIFT])  # fmt: skip
    place, size, big = at + frame[CK_AT], frame[CK_SIZE], frame[CK_BIG]
    if size == 2:
        sent = bytes_big(held, place, 2) if big else bytes_little(held, place, 2)
    elif size == 4:
        sent = bytes_big(held, place, 4) if big else bytes_little(held, place, 4)
    else:
        sent = bytes_little(held, place, 1)
    return bool(np.uint64(computed) == sent)


@njit(cache=True, nogil=True)
def _fill_arrivals(
    starts: UIntArray, n: int, length: int, arrival_ns: int, held_arrival: IntArray, state: IntArray,
    out: IntArray,
) -> None:  # fmt: skip
    """Write when the last byte of each packet arrived; only the first few can be from earlier chunks."""
    for k in range(n):
        out[k] = arrival_ns
    for k in range(n):
        last = np.int64(starts[k]) + length - 1
        if last >= state[DATED]:
            break
        out[k] = held_arrival[last]


@njit(cache=True, nogil=True, inline="always")
def _fill_ints(
    held: ByteArray, starts: UIntArray, n: int, field: IntArray, factor: float, out: IntArray
) -> None:
    """Write one field of n packets as integers."""
    _fill_raw(held, starts, n, field, out)
    code = field[KIND] & (BIG - 1)
    mask, shift = np.uint64(field[MASK]), np.uint64(field[SHIFT])
    if code == F64:
        for k in range(n):
            out[k] = np.int64(np.rint(np.int64(out[k]).view(np.float64) * factor))
    elif code == F32:
        for k in range(n):
            out[k] = np.int64(np.rint(np.float64(np.uint32(out[k]).view(np.float32)) * factor))
    elif mask:
        for k in range(n):
            out[k] = np.int64((np.uint64(out[k]) & mask) >> shift)


@njit(cache=True, nogil=True, inline="always")
def _fill_floats(
    held: ByteArray, starts: UIntArray, n: int, field: IntArray, factor: float, offset: float, bits: IntArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Write one field of n packets as raw * factor + offset; plain integers, the usual case, in one pass."""
    code, mask, shift = field[KIND] & (BIG - 1), np.uint64(field[MASK]), np.uint64(field[SHIFT])
    if code < F32 and not mask and field[SIZE] in (1, 2, 4):
        _fill_scaled(held, starts, n, field, factor, offset, out)
        return
    _fill_raw(held, starts, n, field, bits)
    if code == F32:
        for k in range(n):
            out[k] = np.float64(np.uint32(bits[k]).view(np.float32)) * factor + offset
    elif code == F64:
        for k in range(n):
            out[k] = np.int64(bits[k]).view(np.float64) * factor + offset
    elif mask:
        for k in range(n):
            out[k] = np.float64((np.uint64(bits[k]) & mask) >> shift) * factor + offset
    else:
        for k in range(n):
            out[k] = np.float64(bits[k]) * factor + offset


# The two functions below have a loop for each size and byte order, made by inlining with constants: so the
# bytes of a number become one load and a byte swap.


@njit(cache=True, nogil=True, inline="always")
def _number(held: ByteArray, place: int, size: int, big: bool, to_sign: np.int64) -> np.int64:
    """Read an integer; `to_sign` is 64 less its bits if it is signed, else 0."""
    bits = bytes_big(held, place, size) if big else bytes_little(held, place, size)
    return np.int64(bits << np.uint64(to_sign)) >> to_sign


@njit(cache=True, nogil=True, inline="always")
def _sign_shift(kind: int, size: int) -> np.int64:
    code = kind & (BIG - 1)
    return np.int64(64 - 8 * size) if code < F32 and code & 1 else np.int64(0)


@njit(cache=True, nogil=True, inline="always")
def _raw_loop(
    held: ByteArray,
    starts: UIntArray,
    n: int,
    at: int,
    to_sign: np.int64,
    size: int,
    big: bool,
    out: IntArray,
) -> None:
    for k in range(n):
        out[k] = _number(held, starts[k] + np.uint64(at), size, big, to_sign)


@njit(cache=True, nogil=True, inline="always")
def _scaled_loop(
    held: ByteArray, starts: UIntArray, n: int, at: int, to_sign: np.int64, size: int, big: bool,
    factor: float, offset: float, out: FloatArray,
) -> None:  # fmt: skip
    for k in range(n):
        out[k] = np.float64(_number(held, starts[k] + np.uint64(at), size, big, to_sign)) * factor + offset


@njit(cache=True, nogil=True, inline="always")
def _fill_raw(held: ByteArray, starts: UIntArray, n: int, field: IntArray, out: IntArray) -> None:
    """Write the raw integers of a field, or the bits of a floating-point number."""
    at, size, big = field[AT], field[SIZE], field[KIND] >= BIG
    to_sign = _sign_shift(field[KIND], size)
    if size == 1:
        _raw_loop(held, starts, n, at, to_sign, 1, False, out)
    elif size == 2 and big:
        _raw_loop(held, starts, n, at, to_sign, 2, True, out)
    elif size == 2:
        _raw_loop(held, starts, n, at, to_sign, 2, False, out)
    elif size == 4 and big:
        _raw_loop(held, starts, n, at, to_sign, 4, True, out)
    elif size == 4:
        _raw_loop(held, starts, n, at, to_sign, 4, False, out)
    else:
        _raw_loop(held, starts, n, at, to_sign, size, big, out)


@njit(cache=True, nogil=True, inline="always")
def _fill_scaled(
    held: ByteArray, starts: UIntArray, n: int, field: IntArray, factor: float, offset: float, out: FloatArray
) -> None:
    """Write the integers of a field of 1, 2 or 4 bytes as raw * factor + offset."""
    at, size, big = field[AT], field[SIZE], field[KIND] >= BIG
    to_sign = _sign_shift(field[KIND], size)
    if size == 1:
        _scaled_loop(held, starts, n, at, to_sign, 1, False, factor, offset, out)
    elif size == 2 and big:
        _scaled_loop(held, starts, n, at, to_sign, 2, True, factor, offset, out)
    elif size == 2:
        _scaled_loop(held, starts, n, at, to_sign, 2, False, factor, offset, out)
    elif size == 4 and big:
        _scaled_loop(held, starts, n, at, to_sign, 4, True, factor, offset, out)
    else:
        _scaled_loop(held, starts, n, at, to_sign, 4, False, factor, offset, out)
