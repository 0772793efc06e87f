"""Compiled code of the wire file: reads taken out in bulk, and the next good record after a damaged place."""

from __future__ import annotations

import numpy as np

from imumon.blocks import IntArray
from imumon.compiled import njit
from imumon.recordings.wire_format import (
    CDR,
    CHECK_LENGTH,
    CHECK_OP,
    CHECK_SEQUENCE_AT,
    CHUNK_OP,
    DATA_END_OP,
    FOOTER_OP,
    MARKER,
    MESSAGE,
    MESSAGE_FIELDS,
    MESSAGE_OP,
    RECORD,
    SEQUENCE_AT,
)
from imumon.transport.reader import ByteArray

OTHER, WIRE, EVENT, FOREIGN, BARE = range(5)
"""What a channel has; BARE: reads without the head of CDR."""
LONGEST_MESSAGE = 16 << 20
LONGEST_RARE = 1 << 20
LONGEST_CHUNK = 256 << 20
"""A record that claims to be longer is damage, not a record."""
HEAD = 64
"""Bytes from which any beginning of a record can be judged."""

_RECORD, _HEAD, _FIELDS, _CDR = RECORD.size, MESSAGE.size, MESSAGE_FIELDS, CDR.size
_MARKER = np.frombuffer(MARKER, np.uint8)
_CHUNK_FIXED = 8 + 8 + 8 + 4 + 4 + 8
"""Bytes of a chunk's fields without the name of its compression."""
_LAST_RARE = 0x0F


@njit
def gather(
    buffer: ByteArray,
    offset: int,
    topics: ByteArray,
    sequence: int,
    data: ByteArray,
    ends: IntArray,
    arrivals: IntArray,
    checks: IntArray,
) -> tuple[int, int, int]:
    """Copy reads to `data` while they follow each other without fault, and pass check records over.

    A read is taken when what follows it begins as a record does: a damaged length leads elsewhere.

    Parameters
    ----------
    sequence : int
        That the first must have; -1 when they are not numbered.

    Returns
    -------
    reads, checks, offset : int
        How many were found, and where the next record begins; `checks` has where the check records begin.
    """
    n = used = passed = 0
    while n < len(ends) and passed < len(checks) and offset + HEAD <= len(buffer):
        if buffer[offset] == CHECK_OP and begins(buffer, offset, topics):
            if sequence >= 0 and little(buffer, offset + CHECK_SEQUENCE_AT, 4) != (sequence + n) & 0xFFFFFFFF:
                break
            checks[passed] = offset
            passed += 1
            offset += _RECORD + CHECK_LENGTH
            continue
        topic = topics[little(buffer, offset + 9, 2)]
        head = _HEAD + (_CDR if topic == WIRE else 0)
        size = little(buffer, offset + 1, 8) + _RECORD - head
        after = offset + head + size
        if (
            buffer[offset] != MESSAGE_OP
            or (topic != WIRE and topic != BARE)
            or not 0 <= size <= min(len(buffer) - offset - head - HEAD, len(data) - used)
            or (sequence >= 0 and little(buffer, offset + SEQUENCE_AT, 4) != (sequence + n) & 0xFFFFFFFF)
            or not begins(buffer, offset, topics)
            or not begins(buffer, after, topics)
        ):
            break
        start, to = np.uint64(offset + head), np.uint64(used)
        for i in range(np.uint64(size)):
            data[to + i] = buffer[start + i]
        used += size
        ends[n], arrivals[n] = used, little(buffer, offset + 15, 8)
        n += 1
        offset = after
    return n, passed, offset


@njit
def next_good(buffer: ByteArray, offset: int, stop: int, topics: ByteArray) -> int:
    """Return where the next record begins of which the beginning can be told from any bytes, or -1."""
    for at in range(offset, min(stop, len(buffer))):
        opcode = buffer[at]
        told = opcode in (MESSAGE_OP, CHECK_OP, DATA_END_OP, CHUNK_OP)
        if told and begins(buffer, at, topics):
            return at
    return -1


@njit
def begins(buffer: ByteArray, at: int, topics: ByteArray) -> bool:
    """Tell whether a record begins here, as far as its fixed fields tell.

    A message of ours has its time twice, 64 equal bits; a check record its marker; a chunk its length twice.
    """
    left = len(buffer) - at
    if left < _RECORD:
        return False
    opcode, length = buffer[at], little(buffer, at + 1, 8)
    if length < 0:
        return False
    if opcode == MESSAGE_OP:
        if left < _HEAD or not _FIELDS <= length <= LONGEST_MESSAGE:
            return False
        time_ns, topic = little(buffer, at + 15, 8), topics[little(buffer, at + 9, 2)]
        if topic == OTHER or time_ns < 0:
            return False
        return bool(topic == FOREIGN or time_ns == little(buffer, at + 23, 8))
    if opcode == CHECK_OP:
        if left < HEAD - 3 or length != CHECK_LENGTH:
            return False
        return bool(np.all(buffer[at + _RECORD : at + _RECORD + len(_MARKER)] == _MARKER))
    if opcode == DATA_END_OP:
        if length != 4 or left < _RECORD + 4 + _RECORD:
            return False
        following, size = buffer[at + _RECORD + 4], little(buffer, at + _RECORD + 5, 8)
        return FOOTER_OP <= following <= _LAST_RARE and 0 < size <= LONGEST_RARE
    if opcode == CHUNK_OP:
        return _chunk_begins(buffer, at, length)
    return 0 < opcode < _LAST_RARE and opcode != FOOTER_OP and length <= LONGEST_RARE


@njit
def _chunk_begins(buffer: ByteArray, at: int, length: int) -> bool:
    body = at + _RECORD
    if len(buffer) < body + _CHUNK_FIXED + 4 or not _CHUNK_FIXED <= length <= LONGEST_CHUNK:
        return False
    name = little(buffer, body + 28, 4)  # "", "lz4" or "zstd"
    if name != 0 and name != 3 and name != 4:
        return False
    return little(buffer, body + 32 + name, 8) == length - _CHUNK_FIXED - name


@njit
def little(buffer: ByteArray, at: int, size: int) -> int:
    """Return a number whose least byte comes first; one beyond int64 is negative."""
    number = np.int64(0)
    for i in range(size):
        number |= np.int64(buffer[at + i]) << (8 * i)
    return int(number)
