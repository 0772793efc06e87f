"""Compiled scan of protocols whose packets carry a list of fields: framing, checks and decoding in one pass.

A packet begins with two bytes (preamble and bus address, or two sync bytes), its type and a length:

====  =======================================  ==============================  =========================
      packet                                   field                           checksum
====  =======================================  ==============================  =========================
Xbus  FA, FF or 01, type, length (FF: 16 more  identifier (16 bits), size of   one byte: all but FA sum
      bits follow), fields                     the data, data                  to zero
MIP   75, 65, type, length, fields             size of the field, identifier,  two bytes: both sums of
                                               data                            Fletcher, modulo 256
====  =======================================  ==============================  =========================

How damage is survived: after a bad checksum or an impossible length the scan steps one byte and looks again.
An eight-bit checksum lets one damaged packet in 256 pass, and one that has lost bytes then ends inside the
next, which is good.  So when an accepted packet is not followed by a preamble, the scan goes on inside it,
and a valid packet that begins there and ends behind it is accepted too; bytes count once.

Other bus addresses than FF (the device on its own) and 01 are those of trackers behind an Xbus Master, which
answer only to commands; taking them for packets would make noise of every FA in damaged data.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.protocols.base import (
    CAPACITY,
    CHECKSUM_ERRORS,
    IN_PACKETS,
    LENGTH_ERRORS,
    PACKETS,
    ROWS,
    SKIPPED,
    STATE_SIZE,
    ByteArray,
)
from imumon.protocols.kernel import (
    F32,
    F64,
    FP1632,
    append_chunk,
    arrival_of,
    keep_rest,
)

XBUS, MIP, WHOLE = range(3)
"""Framings; and the layout of a payload that is one field without header."""

MESSAGE, LIST, FIXED, COUNTED = range(4)
"""What a packet type is: said to the user, a list of fields, one field without header, or only counted."""

ANY_SIZE = -1
"""Size of a field that is recognised, counted and skipped whatever its length."""

LONGEST_XBUS_PAYLOAD = 2048

# The state continues that of `base`: bytes at the front that belong to the packet accepted last, used bytes
# of the log, whether it is full, a payload length that did not fit the profile, kinds of unknown fields.
OVERLAP, LOGGED, LOG_FULL, WRONG_LENGTH, UNKNOWN_KINDS = range(STATE_SIZE, STATE_SIZE + 5)
TYPES = 32  # packets by type
ROLES = TYPES + 256  # what each type is
UNKNOWN = ROLES + 256  # identifier, size and count of fields that the table lacks
MOST_UNKNOWN = 64
FIELDS = UNKNOWN + 3 * MOST_UNKNOWN  # how often each field of the table came

LOG_SIZE = 1 << 14

# Columns of the compiled tables.
FIELD_SIZE, FIRST, COUNT, NEXT, GROUP = range(5)
KIND, SIZE, OFFSET, COLUMN = range(4)

ShortArray = npt.NDArray[np.int16]

_INCOMPLETE, _NO_PACKET, _IMPOSSIBLE, _BAD_SUM, _NO_ROOM = -1, -2, -3, -4, -5

# An index that may be negative costs a test each time; so places in inner loops are unsigned.
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@njit
def _packet_length(buf: ByteArray, at: int, n: int, framing: int) -> int:
    """Return the length that the header at a preamble claims, or why there is none."""
    if at + 1 >= n:
        return _INCOMPLETE
    second = buf[at + 1]
    if framing == MIP:
        if second != 0x65:
            return _NO_PACKET
        return _INCOMPLETE if at + 3 >= n else int(buf[at + 3]) + 6
    if second != 0xFF and second != 0x01:
        return _NO_PACKET
    if at + 3 >= n:
        return _INCOMPLETE
    if buf[at + 3] != 0xFF:
        return int(buf[at + 3]) + 5
    if at + 5 >= n:
        return _INCOMPLETE
    length = (int(buf[at + 4]) << 8) | int(buf[at + 5])
    return _IMPOSSIBLE if length > LONGEST_XBUS_PAYLOAD else length + 7


@njit
def _sums_right(buf: ByteArray, at: int, length: int, framing: int) -> bool:
    """Check the checksum of a whole packet."""
    first = np.uint32(0)
    start = np.uint64(at)
    if framing == XBUS:
        for i in range(start + np.uint64(1), start + np.uint64(length)):
            first += np.uint32(buf[i])
        return bool(first & np.uint32(0xFF) == 0)
    second = np.uint32(0)
    end = start + np.uint64(length - 2)
    for i in range(start, end):
        byte = np.uint32(buf[i])
        first += byte
        second += byte * np.uint32(end - i)
    return bool(
        (first & np.uint32(0xFF)) == buf[end] and (second & np.uint32(0xFF)) == buf[end + np.uint64(1)]
    )


@njit
def _list_whole(buf: ByteArray, at: int, end: int, framing: int) -> bool:
    """Tell whether the fields fill the payload exactly."""
    if framing == XBUS:
        while at + 3 <= end:
            at += 3 + buf[at + 2]
    else:
        while at + 2 <= end and buf[at] >= 2:
            at += buf[at]
    return at == end


@njit
def _note_unknown(key: int, size: int, state: IntArray) -> None:
    """Count a field that the table lacks, or has with another size."""
    kinds = state[UNKNOWN_KINDS]
    for k in range(kinds):
        slot = UNKNOWN + 3 * k
        if state[slot] == key and state[slot + 1] == size:
            state[slot + 2] += 1
            return
    if kinds == MOST_UNKNOWN:
        # The last place stands for all further kinds.
        state[UNKNOWN + 3 * kinds - 1] += 1
        return
    slot = UNKNOWN + 3 * kinds
    state[slot] = key
    state[slot + 1] = size
    state[slot + 2] = 1
    state[UNKNOWN_KINDS] += 1


@njit(inline="always")
def _number(bits: np.uint64, number: int, size: int) -> float:
    """Interpret the bytes of a number, assembled with the most significant first, as float64."""
    if number == F32:
        return np.float64(np.uint32(bits).view(np.float32))
    if number == F64:
        return np.float64(np.uint64(bits).view(np.float64))
    if number == FP1632:
        # The fraction is sent first; with the integer part on top it is one number of 48 bits.
        swapped = (bits << np.uint64(48)) | (bits & np.uint64(0xFFFFFFFF0000))
        return np.float64(np.int64(swapped) >> np.int64(16)) / 4294967296.0
    return np.float64(_integer(bits, number, size))


@njit(inline="always")
def _integer(bits: np.uint64, number: int, size: int) -> np.int64:
    """Interpret the bytes of an integer; odd kinds are signed."""
    shift = np.uint64(64 - 8 * size)
    return np.int64(bits << shift) >> np.int64(shift) if number & 1 else np.int64(bits)


@njit(inline="always")
def _four(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8) -> np.uint64:
    """Assemble four bytes, most significant first; without a loop it is a single load."""
    return np.uint64(
        (np.uint32(a) << np.uint32(24))
        | (np.uint32(b) << np.uint32(16))
        | (np.uint32(c) << np.uint32(8))
        | np.uint32(d)
    )


@njit
def _decode(
    buf: ByteArray,
    begin: int,
    end: int,
    kind: int,
    layout: int,
    state: IntArray,
    field_of: ShortArray,
    fields: IntArray,
    values: IntArray,
    factors: FloatArray,
    floats: FloatArray,
    ints: IntArray,
) -> int:
    """Decode a payload into the next row; return how many of its fields had values.

    `layout` is the framing, or `WHOLE` when the payload is the first field of the table without a header.
    This is one function, because arrays are costly to pass.
    """
    row = np.uint64(state[ROWS])
    known = 0
    groups = np.int64(0)
    at = np.int64(begin)
    while at < end:
        field = np.int64(0)
        size = np.int64(end - at)
        if layout != WHOLE:
            if layout == XBUS:
                key = (np.int64(buf[at]) << 8) | np.int64(buf[at + 1])
                size = np.int64(buf[at + 2])
                at += 3
            else:
                key = (np.int64(kind) << 8) | np.int64(buf[at + 1])
                size = np.int64(buf[at]) - 2
                at += 2
            field = np.int64(field_of[key])
            while field >= 0 and fields[field, FIELD_SIZE] != size and fields[field, FIELD_SIZE] != ANY_SIZE:
                field = fields[field, NEXT]
            if field < 0:
                _note_unknown(int(key), int(size), state)
                at += size
                continue
        found = np.uint64(field)
        state[np.uint64(FIELDS) + found] += 1
        first = np.uint64(fields[found, FIRST])
        stop = first + np.uint64(fields[found, COUNT])
        known += int(stop > first)
        groups |= fields[found, GROUP]
        for v in range(first, stop):
            column, width = values[v, COLUMN], values[v, SIZE]
            place = np.uint64(at + values[v, OFFSET])
            if width == 4:
                bits = _four(buf[place], buf[place + _1], buf[place + _2], buf[place + _3])
            else:
                bits = np.uint64(0)
                for i in range(place, place + np.uint64(width)):
                    bits = (bits << np.uint64(8)) | np.uint64(buf[i])
            if column >= 0:
                floats[np.uint64(column), row] = _number(bits, values[v, KIND], width) * factors[v]
            else:
                ints[np.uint64(~column), row] = _integer(bits, values[v, KIND], width)
        at += size
    ints[1, row] = groups
    return known


@njit
def _log_message(buf: ByteArray, at: int, end: int, kind: int, state: IntArray, log: ByteArray) -> None:
    """Keep a message for the user: type, length in two bytes, payload."""
    to = state[LOGGED]
    size = end - at
    log[to] = kind
    log[to + 1] = size >> 8
    log[to + 2] = size & 0xFF
    for i in range(size):
        log[to + 3 + i] = buf[at + i]
    state[LOGGED] = to + 3 + size


@njit
def _judge(buf: ByteArray, at: int, n: int, done: int, framing: int, state: IntArray, whole_size: int) -> int:
    """Return the length of the valid packet at a preamble, or what is wrong with it."""
    length = _packet_length(buf, at, n, framing)
    if length < 0:
        return length
    if at + length <= done:
        return _NO_PACKET
    if at + length > n:
        return _INCOMPLETE
    if not _sums_right(buf, at, length, framing):
        return _BAD_SUM
    role = state[ROLES + buf[at + 2]]
    begin = _payload_begin(buf, at, framing)
    end = at + length - (1 if framing == XBUS else 2)
    if role == LIST and not _list_whole(buf, begin, end, framing):
        return _IMPOSSIBLE
    if role == FIXED and end - begin != whole_size:
        state[WRONG_LENGTH] = end - begin
        return _IMPOSSIBLE
    if role == MESSAGE and state[LOGGED] + 3 + end - begin > LOG_SIZE:
        return _NO_ROOM
    return length


@njit
def _payload_begin(buf: ByteArray, at: int, framing: int) -> int:
    """Return where the payload of a packet begins."""
    return at + 6 if framing == XBUS and buf[at + 3] == 0xFF else at + 4


@njit
def scan_packets(
    chunk: ByteArray,
    arrival_ns: int,
    final: bool,
    framing: int,
    held: ByteArray,
    held_arrival: IntArray,
    state: IntArray,
    log: ByteArray,
    field_of: ShortArray,
    fields: IntArray,
    values: IntArray,
    factors: FloatArray,
    floats: FloatArray,
    ints: IntArray,
) -> None:
    """Append the chunk and decode until rows, room in the log or bytes run out.

    `done` is where the packet accepted last ends; `at` may be before it (see the text of the module).
    """
    n = append_chunk(chunk, held, state)
    sync = 0xFA if framing == XBUS else 0x75
    at = 0
    done = state[OVERLAP]
    pending = -1  # at the end of the data: the first packet cut short
    bad_sums = 0  # not yet counted: when nothing good follows, they are part of what is pending
    bad_lengths = 0
    state[LOG_FULL] = 0
    while True:
        if at < done < n and held[done] == sync:
            at = done
        while at < n and held[at] != sync:
            at += 1
        if at >= n or state[ROWS] == CAPACITY:
            break
        verdict = _judge(held, at, n, done, framing, state, fields[0, FIELD_SIZE])
        if verdict == _NO_ROOM:
            state[LOG_FULL] = 1
            break
        if verdict == _INCOMPLETE and not final:
            break
        if verdict == _INCOMPLETE and pending < 0:
            pending = at
        if verdict >= 0 or pending == at:
            state[CHECKSUM_ERRORS] += bad_sums
            state[LENGTH_ERRORS] += bad_lengths
            bad_sums = bad_lengths = 0
        if verdict < 0:
            # Inside a good packet a preamble may well be data.
            bad_sums += verdict == _BAD_SUM and at >= done
            bad_lengths += verdict == _IMPOSSIBLE and at >= done
            at += 1
            continue
        kind = held[at + 2]
        begin = _payload_begin(held, at, framing)
        pending = -1
        state[SKIPPED] += max(at - done, 0)
        state[IN_PACKETS] += at + verdict - max(at, done)
        state[PACKETS] += 1
        state[TYPES + kind] += 1
        done = at + verdict
        end = done - (1 if framing == XBUS else 2)
        at += 1
        role = state[ROLES + kind]
        if role == MESSAGE:
            _log_message(held, begin, end, kind, state, log)
        elif role != COUNTED:
            layout = WHOLE if role == FIXED else framing
            if _decode(
                held, begin, end, kind, layout, state, field_of, fields, values, factors, floats, ints
            ):
                ints[0, state[ROWS]] = arrival_of(done - 1, arrival_ns, held_arrival, state)
                state[ROWS] += 1
    if pending >= 0:
        at = pending
    else:
        state[CHECKSUM_ERRORS] += bad_sums
        state[LENGTH_ERRORS] += bad_lengths
    state[SKIPPED] += max(at - done, 0)
    state[OVERLAP] = max(done - at, 0)
    keep_rest(at, arrival_ns, held, held_arrival, state, state[ROWS] == CAPACITY or state[LOG_FULL] == 1)
