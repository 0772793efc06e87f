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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.compiled import inner, njit
from imumon.protocols.base import CAPACITY
from imumon.protocols.numbers import F32, F64, FP1632
from imumon.protocols.stream import ByteArray, Stream, arrival_of, keep_rest

XBUS, MIP, WHOLE = range(3)
"""Framings; and the layout of a payload that is one field without header."""

MESSAGE, LIST, FIXED, COUNTED = range(4)
"""What a packet type is: said to the user, a list of fields, one field without header, or only counted."""

ANY_SIZE = -1
"""Size of a field that is recognised, counted and skipped whatever its length."""

BYTES_DONE, ROWS_FULL, LOG_FULL = range(3)
"""Why a scan ended."""

LONGEST_XBUS_PAYLOAD = 2048
MOST_UNKNOWN = 64
LOG_SIZE = 1 << 14

ShortArray = npt.NDArray[np.int16]


class State:
    """What a scan keeps besides the stream."""

    overlap: int  # bytes at the front that belong to the packet accepted last
    wrong_length: int  # of a payload that did not fit the profile
    types: IntArray  # packets by type
    roles: IntArray  # what each type is
    unknown_kinds: int
    unknown_key: IntArray  # fields that the table lacks
    unknown_size: IntArray
    unknown_count: IntArray
    logged: int
    log: ByteArray  # messages for the user, one behind the other


SHAPES = {"types": 256, "roles": 256, "log": LOG_SIZE} | dict.fromkeys(
    ("unknown_key", "unknown_size", "unknown_count"), MOST_UNKNOWN
)
"""Of the arrays in a `State`."""


class CompiledField(NamedTuple):
    """A field: bytes of data, its values from `first` to `stop`, and another field of the same key, or -1."""

    width: int
    first: int
    stop: int
    other: int
    group: int  # its bit


class CompiledValue(NamedTuple):
    """A number in a field; the column is that of the floats, or the complement of that of the integers."""

    kind: int
    width: int
    offset: int
    column: int
    factor: float


class Table(NamedTuple):
    """What packets are made of."""

    framing: int
    field_of: ShortArray
    fields: Sequence[CompiledField]
    values: Sequence[CompiledValue]


class Rows(NamedTuple):
    """Columns of what is decoded, the first integers arrivals and groups; how often each field came.

    Of the hundreds of columns of a protocol a device sends a few: memory that is zero takes no pages, and a
    column is made missing, to the last cell behind all rows, when a field of it comes for the first time.
    """

    floats: FloatArray
    ints: IntArray
    seen: IntArray


_INCOMPLETE, _NO_PACKET, _IMPOSSIBLE, _BAD_SUM, _NO_ROOM = -1, -2, -3, -4, -5

# An index that may be negative costs a test each time; so places in inner loops are unsigned.
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@inner
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


@inner
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


@inner
def _list_whole(buf: ByteArray, at: int, end: int, framing: int) -> bool:
    """Tell whether the fields fill the payload exactly."""
    if framing == XBUS:
        while at + 3 <= end:
            at += 3 + buf[at + 2]
    else:
        while at + 2 <= end and buf[at] >= 2:
            at += buf[at]
    return at == end


@inner
def _note_unknown(key: int, size: int, state: State) -> None:
    """Count a field that the table lacks, or has with another size."""
    kinds = state.unknown_kinds
    for k in range(kinds):
        if state.unknown_key[k] == key and state.unknown_size[k] == size:
            state.unknown_count[k] += 1
            return
    if kinds == MOST_UNKNOWN:
        # The last place stands for all further kinds.
        state.unknown_count[kinds - 1] += 1
        return
    state.unknown_key[kinds], state.unknown_size[kinds], state.unknown_count[kinds] = key, size, 1
    state.unknown_kinds += 1


@inner(inline="always")
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


@inner(inline="always")
def _integer(bits: np.uint64, number: int, size: int) -> np.int64:
    """Interpret the bytes of an integer; odd kinds are signed."""
    shift = np.uint64(64 - 8 * size)
    return np.int64(bits << shift) >> np.int64(shift) if number & 1 else np.int64(bits)


@inner(inline="always")
def _four(a: np.uint8, b: np.uint8, c: np.uint8, d: np.uint8) -> np.uint64:
    """Assemble four bytes, most significant first; without a loop it is a single load."""
    return np.uint64(
        (np.uint32(a) << np.uint32(24))
        | (np.uint32(b) << np.uint32(16))
        | (np.uint32(c) << np.uint32(8))
        | np.uint32(d)
    )


@inner
def _begin_columns(
    field: CompiledField, values: Sequence[CompiledValue], floats: FloatArray, ints: IntArray
) -> None:
    """Make missing the columns of a field that no other field has begun."""
    for v in range(field.first, field.stop):
        column = values[v].column
        if column >= 0 and floats[column, CAPACITY] == 0.0:
            for row in range(CAPACITY + 1):
                floats[column, row] = np.nan
        elif column < 0 and ints[~column, CAPACITY] == 0:
            for row in range(CAPACITY + 1):
                ints[~column, row] = NO_INT


@inner
def _decode(begin: int, end: int, layout: int, stream: Stream, state: State, table: Table, rows: Rows) -> int:
    """Decode a payload into the next row; return how many of its fields had values.

    `layout` is the framing, or `WHOLE` when the payload is the first field of the table without a header.
    """
    # Names, as taking an array out of a tuple anew for each number costs more than the number.
    buf, fields, values, field_of = stream.bytes, table.fields, table.values, table.field_of
    floats, ints, seen = rows.floats, rows.ints, rows.seen
    row = np.uint64(stream.rows)
    known = 0
    groups = np.int64(0)
    at = np.int64(begin)
    while at < end:
        number = 0
        size = np.int64(end - at)
        if layout != WHOLE:
            if layout == XBUS:
                key = (np.int64(buf[at]) << 8) | np.int64(buf[at + 1])
                size = np.int64(buf[at + 2])
                at += 3
            else:
                key = (np.int64(buf[begin - 2]) << 8) | np.int64(buf[at + 1])
                size = np.int64(buf[at]) - 2
                at += 2
            number = int(field_of[key])
            while number >= 0 and fields[number].width != size and fields[number].width != ANY_SIZE:
                number = fields[number].other
            if number < 0:
                _note_unknown(int(key), int(size), state)
                at += size
                continue
        field = fields[number]
        if seen[number] == 0:
            _begin_columns(field, values, floats, ints)
        seen[number] += 1
        first, stop = np.uint64(field.first), np.uint64(field.stop)
        known += int(stop > first)
        groups |= field.group
        for v in range(first, stop):
            value = values[v]
            width = value.width
            place = np.uint64(at + value.offset)
            if width == 4:
                bits = _four(buf[place], buf[place + _1], buf[place + _2], buf[place + _3])
            else:
                bits = np.uint64(0)
                for i in range(place, place + np.uint64(width)):
                    bits = (bits << np.uint64(8)) | np.uint64(buf[i])
            if value.column >= 0:
                floats[np.uint64(value.column), row] = _number(bits, value.kind, width) * value.factor
            else:
                ints[np.uint64(~value.column), row] = _integer(bits, value.kind, width)
        at += size
    ints[1, row] = groups
    return known


@inner
def _log_message(buf: ByteArray, at: int, end: int, kind: int, state: State) -> None:
    """Keep a message for the user: type, length in two bytes, payload."""
    to, log = state.logged, state.log
    size = end - at
    log[to] = kind
    log[to + 1] = size >> 8
    log[to + 2] = size & 0xFF
    for i in range(size):
        log[to + 3 + i] = buf[at + i]
    state.logged = to + 3 + size


@inner
def _judge(at: int, done: int, framing: int, stream: Stream, state: State, whole_size: int) -> int:
    """Return the length of the valid packet at a preamble, or what is wrong with it."""
    buf, n = stream.bytes, stream.held
    length = _packet_length(buf, at, n, framing)
    if length < 0:
        return length
    if at + length <= done:
        return _NO_PACKET
    if at + length > n:
        return _INCOMPLETE
    if not _sums_right(buf, at, length, framing):
        return _BAD_SUM
    role = state.roles[buf[at + 2]]
    begin = _payload_begin(buf, at, framing)
    end = at + length - (1 if framing == XBUS else 2)
    if role == LIST and not _list_whole(buf, begin, end, framing):
        return _IMPOSSIBLE
    if role == FIXED and end - begin != whole_size:
        state.wrong_length = end - begin
        return _IMPOSSIBLE
    if role == MESSAGE and state.logged + 3 + end - begin > LOG_SIZE:
        return _NO_ROOM
    return length


@inner
def _payload_begin(buf: ByteArray, at: int, framing: int) -> int:
    """Return where the payload of a packet begins."""
    return at + 6 if framing == XBUS and buf[at + 3] == 0xFF else at + 4


@njit
def scan_packets(
    final: bool, streams: Sequence[Stream], states: Sequence[State], table: Table, rows: Rows
) -> int:
    """Decode until bytes, rows or room in the log run out; return which did.

    `done` is where the packet accepted last ends; `at` may be before it (see the text of the module).
    """
    stream, state, ints = streams[0], states[0], rows.ints
    held, n, framing = stream.bytes, stream.held, table.framing
    whole_size = table.fields[0].width
    why = BYTES_DONE
    sync = 0xFA if framing == XBUS else 0x75
    at = 0
    done = state.overlap
    pending = -1  # at the end of the data: the first packet cut short
    bad_sums = 0  # not yet counted: when nothing good follows, they are part of what is pending
    bad_lengths = 0
    while True:
        if at < done < n and held[done] == sync:
            at = done
        while at < n and held[at] != sync:
            at += 1
        if at >= n:
            break
        if stream.rows == CAPACITY:
            why = ROWS_FULL
            break
        verdict = _judge(at, done, framing, stream, state, whole_size)
        if verdict == _NO_ROOM:
            why = LOG_FULL
            break
        if verdict == _INCOMPLETE and not final:
            break
        if verdict == _INCOMPLETE and pending < 0:
            pending = at
        if verdict >= 0 or pending == at:
            stream.checksum_errors += bad_sums
            stream.length_errors += bad_lengths
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
        stream.skipped += max(at - done, 0)
        stream.in_packets += at + verdict - max(at, done)
        stream.packets += 1
        state.types[kind] += 1
        done = at + verdict
        end = done - (1 if framing == XBUS else 2)
        at += 1
        role = state.roles[kind]
        if role == MESSAGE:
            _log_message(held, begin, end, kind, state)
        elif role != COUNTED:
            layout = WHOLE if role == FIXED else framing
            if _decode(begin, end, layout, stream, state, table, rows):
                ints[0, stream.rows] = arrival_of(done - 1, stream)
                stream.rows += 1
    if pending >= 0:
        at = pending
    else:
        stream.checksum_errors += bad_sums
        stream.length_errors += bad_lengths
    stream.skipped += max(at - done, 0)
    state.overlap = max(done - at, 0)
    keep_rest(at, stream)
    return why
