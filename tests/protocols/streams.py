"""Damage to byte streams and ways to cut them up, for the tests of decoders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from imumon.blocks import SampleBlock
from imumon.protocols.decoder import Decoder
from imumon.transport.statistics import Counters

chunkings = st.lists(st.integers(1, 400), min_size=1, max_size=20)
"""Lengths of chunks, repeated as long as there are bytes."""


def feed_in_chunks(
    decoder: Decoder, data: bytes, lengths: Sequence[int], arrival: Sequence[int] | None = None
) -> SampleBlock:
    """Feed in chunks that respect the times of arrival, finish, and take everything."""
    at = turn = 0
    # Asking a decoder for its books makes it search: after many chunks the books are checked more rarely.
    while at < len(data):
        end = min(at + lengths[turn % len(lengths)], len(data))
        time = 0
        if arrival is not None:
            time = arrival[at]
            end = next((i for i in range(at, end) if arrival[i] != time), end)
        decoder.feed(data[at:end], time)
        if turn < 30 or turn % 37 == 0:
            check_books(decoder.counters())
        at, turn = end, turn + 1
    decoder.finish()
    check_books(decoder.counters())
    return decoder.take()


def check_books(counters: Counters) -> None:
    """Bytes in packets + skipped + pending = received, none of them negative."""
    assert (
        counters.bytes_in_packets + counters.bytes_skipped + counters.bytes_pending == counters.bytes_received
    )
    assert min(counters.bytes_in_packets, counters.bytes_skipped, counters.bytes_pending) >= 0
    assert sum(counters.packets_by_type.values()) == counters.packets


def damage(
    packets: Sequence[bytes], rng: np.random.Generator, flips: float, cuts: float, junk: float
) -> tuple[bytes, list[int]]:
    """Flip a bit of, cut bytes out of, or put junk before a share of the packets.

    Returns the stream and the numbers of the packets that are still whole.
    """
    stream, whole = bytearray(), []
    for number, packet in enumerate(packets):
        draw = rng.random()
        changed = bytearray(packet)
        if draw < flips:
            place = int(rng.integers(len(changed)))
            changed[place] ^= 1 << int(rng.integers(8))
        elif draw < flips + cuts:
            start = int(rng.integers(len(changed)))
            del changed[start : start + int(rng.integers(1, 12))]
        else:
            whole.append(number)
            if draw < flips + cuts + junk:
                stream += rng.integers(0, 256, int(rng.integers(1, 40)), np.uint8).tobytes()
        stream += changed
    return bytes(stream), whole


def xbus_message(kind: int, payload: bytes = b"", address: int = 0xFF) -> bytes:
    """Return an Xbus message."""
    size = len(payload)
    length = bytes([size]) if size < 255 else bytes([255, size >> 8, size & 0xFF])
    body = bytes([address, kind]) + length + payload
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])
