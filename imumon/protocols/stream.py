"""The bytes held from chunk to chunk, with the reads that brought them, and what became of all others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imumon.blocks import IntArray
from imumon.compiled import inner, njit, record

ByteArray = npt.NDArray[np.uint8]

CHUNK = 1 << 16
"""Bytes that are appended at once at the most."""
LONGEST_PACKET = 4096
"""Bytes that a packet may have, so also the most that can be pending."""
MOST_HELD = CHUNK + LONGEST_PACKET


class Stream:
    """What a scan keeps from call to call.

    Of each byte it is known with which read it came: the reads end at these places of the held bytes.
    """

    received: int
    in_packets: int
    skipped: int
    packets: int
    checksum_errors: int
    length_errors: int
    rows: int  # not yet taken
    held: int
    reads: int
    read: int  # of the byte that `arrival_of` was asked for last
    bytes: ByteArray
    ends: IntArray
    arrivals: IntArray


def new_stream() -> Stream:
    """Return a stream of which nothing has come."""
    return record(Stream, bytes=MOST_HELD, ends=MOST_HELD, arrivals=MOST_HELD)


@njit
def append(chunk: ByteArray, ends: IntArray, arrivals: IntArray, streams: Sequence[Stream]) -> None:
    """Put a chunk behind the held bytes, with the reads of which it has a byte; others are passed over."""
    stream = streams[0]
    held, start, size = stream.bytes, stream.held, len(chunk)
    begin = np.uint64(start)
    # A loop becomes a memory copy; an assignment to a slice is done byte by byte, ten times slower.
    for i in range(np.uint64(size)):
        held[begin + i] = chunk[i]
    at = 0
    for i in range(len(ends)):
        end = min(ends[i], size)
        if end > at:
            stream.ends[stream.reads] = start + end
            stream.arrivals[stream.reads] = arrivals[i]
            stream.reads += 1
            at = end
    stream.received += size
    stream.held += size


@inner(inline="always")
def arrival_of(at: int, stream: Stream) -> int:
    """Return when the held byte at this place arrived; places are asked for from left to right."""
    while stream.ends[stream.read] <= at:
        stream.read += 1
    return int(stream.arrivals[stream.read])


@inner
def keep_rest(start: int, stream: Stream) -> None:
    """Move the bytes from `start` on to the front, with their reads."""
    held, ends, arrivals = stream.bytes, stream.ends, stream.arrivals
    rest = stream.held - start
    for i in range(rest):
        held[i] = held[start + i]
    kept = 0
    for i in range(stream.reads):
        if ends[i] > start:
            ends[kept], arrivals[kept] = ends[i] - start, arrivals[i]
            kept += 1
    stream.held, stream.reads, stream.read = rest, kept, 0
