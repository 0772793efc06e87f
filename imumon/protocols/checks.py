"""Checksums of serial protocols by name, of many packets at once; each is a `Check` of a frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, IntArray
from imumon.protocols.base import ByteArray
from imumon.protocols.framing import windows


class Crc(NamedTuple):
    """A cyclic redundancy check in the terms of Greg Cook's catalogue."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int


CRCS = {
    "crc16-arc": Crc(16, 0x8005, 0x0000, True, 0x0000),
    "crc16-modbus": Crc(16, 0x8005, 0xFFFF, True, 0x0000),
    "crc16-xmodem": Crc(16, 0x1021, 0x0000, False, 0x0000),
    "crc16-ccitt-false": Crc(16, 0x1021, 0xFFFF, False, 0x0000),
    "crc16-aug-ccitt": Crc(16, 0x1021, 0x1D0F, False, 0x0000),
    "crc16-genibus": Crc(16, 0x1021, 0xFFFF, False, 0xFFFF),
    "crc16-kermit": Crc(16, 0x1021, 0x0000, True, 0x0000),
    "crc16-mcrf4xx": Crc(16, 0x1021, 0xFFFF, True, 0x0000),
    "crc16-x25": Crc(16, 0x1021, 0xFFFF, True, 0xFFFF),
    "crc32": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "crc32-mpeg2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0x00000000),
    "crc32c": Crc(32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF),
}
"""CRCs by the names of the catalogue, with a hyphen behind the width."""


def _weighted(data: ByteArray, weights: npt.ArrayLike) -> IntArray:
    """Return the sum of the bytes of each row times weights: exact in float64, and five times as fast."""
    real = data.astype(np.float64)
    return np.asarray(real @ np.broadcast_to(weights, data.shape[1]).astype(np.float64)).astype(np.int64)


def _total(data: ByteArray, size: IntArray) -> IntArray:
    del size
    return _weighted(data, 1)


def _words(data: ByteArray, size: IntArray, big: bool) -> IntArray:
    even = (np.arange(data.shape[1]) - data.shape[1] + size[:, np.newaxis]) % 2 == 0
    return np.asarray(np.sum(data.astype(np.int64) << np.where(even == big, 8, 0), axis=1))


def _fletcher(data: ByteArray, size: IntArray, modulus: int) -> IntArray:
    high = _weighted(data, np.arange(data.shape[1], 0, -1))
    return high % modulus << 8 | _total(data, size) % modulus


Formula = Callable[[ByteArray, IntArray], IntArray]
"""Takes rows of bytes, which begin with zeros where they are shorter than the longest, and their sizes."""
SIMPLE: dict[str, tuple[int, Formula]] = {
    "sum8": (1, _total),
    "sum8-negated": (1, lambda data, size: -_total(data, size)),
    "xor8": (1, lambda data, _: np.bitwise_xor.reduce(data, axis=1).astype(np.int64)),
    "sum16": (2, _total),
    "sum16-words-le": (2, partial(_words, big=False)),
    "sum16-words-be": (2, partial(_words, big=True)),
    "fletcher16": (2, partial(_fletcher, modulus=255)),
    "fletcher16-256": (2, partial(_fletcher, modulus=256)),
}
"""Bytes and formula of the others.

sum8-negated makes the sum of all bytes and the checksum zero.  sum16-words-* adds numbers of 16 bits, low
(le) or high byte (be) first; a last byte alone has zero for the other.  fletcher16 is modulo 255 (RFC 1145,
second sum in the high byte); fletcher16-256 is the variant modulo 256 that MIP and UBX use.
"""

CHECKSUM_NAMES = ("none", *SIMPLE, *CRCS)


def aligned(held: ByteArray, first: IntArray, last: IntArray) -> Iterator[tuple[IntArray, ByteArray]]:
    """Yield numbers of spans, and their bytes with zeros before the shorter ones, (m, longest).

    Those of the most frequent length come at once; others with those that are at most twice as long.
    """
    sizes = last - first
    usual = int(np.argmax(np.bincount(sizes))) if len(sizes) else 0
    which = np.flatnonzero(sizes == usual)
    yield which, windows(held, first[which], usual)
    if len(which) == len(sizes):
        return
    most, octaves = int(sizes.max()), np.where(sizes == usual, 0, np.frexp(sizes)[1] + 1)
    padded = np.concatenate([np.zeros(most, np.uint8), held])
    for octave in np.flatnonzero(np.bincount(octaves)[1:]).tolist():
        which = np.flatnonzero(octaves == octave + 1)
        size = sizes[which, np.newaxis]
        longest = int(size.max())
        data = windows(padded, last[which] + most - longest, longest)
        yield which, np.where(np.arange(longest) < longest - size, np.uint8(0), data)


def sent(held: ByteArray, end: IntArray, size: int, big: bool) -> IntArray:
    """Return the integers of `size` bytes that end before these places."""
    value = np.zeros(len(end), np.int64)
    for n, k in enumerate(range(size)[:: -1 if big else 1]):
        value |= held[end - size + k].astype(np.int64) << 8 * n
    return value


@dataclass(frozen=True)
class Checksum:
    """A checksum of all bytes from `first` on, in the last bytes of a packet.

    `zeros` more bytes, which are not sent, count as if they followed the others (CRCs only).
    """

    name: str
    first: int = 0
    big: bool = False
    """Whether the most significant byte comes first."""
    zeros: int = 0

    @property
    def size(self) -> int:
        """Bytes of the checksum."""
        return CRCS[self.name].width // 8 if self.name in CRCS else SIMPLE[self.name][0]

    def values(self, held: ByteArray, first: IntArray, last: IntArray) -> IntArray:
        """Return the checksums of the bytes from each first to before each last place."""
        found = np.zeros(len(first), np.int64)
        for which, data in aligned(held, first, last):
            size = (last - first)[which]
            found[which] = self._cyclic(data, size) if self.name in CRCS else SIMPLE[self.name][1](data, size)
        return found & (1 << 8 * self.size) - 1

    def _cyclic(self, data: ByteArray, size: IntArray) -> IntArray:
        """Return CRCs: they are linear, so each byte adds what its value and distance to the end give."""
        longest = data.shape[1] + self.zeros
        table, empty = by_distance(CRCS[self.name], 1 << longest.bit_length())
        distance = np.arange(longest - 1, self.zeros - 1, -1)
        value = np.bitwise_xor.reduce(table.take(data + 256 * distance), axis=1)
        return np.asarray(value ^ empty[size + self.zeros])

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        computed = self.values(held, at + self.first, at + length - self.size)
        return np.asarray(computed == sent(held, at + length, self.size, self.big))

    def sealed(self, body: bytes) -> bytes:
        """Return the packet: the body and its checksum."""
        return self.sealed_rows(np.frombuffer(body, np.uint8)[np.newaxis]).tobytes()

    def sealed_rows(self, bodies: ByteArray) -> ByteArray:
        """Return the packets of bodies of one size, (n, size), with their checksums."""
        n, size = bodies.shape
        begin = np.arange(n) * size
        sums = self.values(bodies.reshape(-1), begin + self.first, begin + size)
        return np.concatenate([bodies, self.stored(sums)], axis=1)

    def stored(self, values: IntArray) -> ByteArray:
        """Return checksums as they stand in packets, (n, size)."""
        most_first = values.astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - self.size :]
        return most_first if self.big else most_first[:, ::-1]


@dataclass(frozen=True)
class Rearranged:
    """The check of packets that have their bytes in another order.

    `places`: those of what counts, those of the checksum last; of packets of any length a function of that.
    """

    check: Checksum
    places: Sequence[int] | Callable[[int], Sequence[int]]

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        right = np.zeros(len(at), np.bool_)
        for size in np.flatnonzero(np.bincount(length)).tolist():
            which, places = np.flatnonzero(length == size), self.places
            places = places(size) if callable(places) else places
            moved = windows(held, at[which], size).take(places, axis=1)
            begins = np.arange(len(which)) * len(places)
            right[which] = self.check(moved.reshape(-1), begins, np.full(len(which), len(places)))
        return right


@lru_cache
def by_distance(crc: Crc, longest: int) -> tuple[IntArray, IntArray]:
    """Return what a byte adds to the CRC by its distance to the end and its value, and the CRC of zeros.

    Shapes: (longest * 256,), distance first, and (longest + 1,).
    """
    top, mask = crc.width - 1, (1 << crc.width) - 1
    polynomial, initial = crc.polynomial, crc.initial
    if crc.reflected:
        polynomial, initial = (int(f"{n:0{crc.width}b}"[::-1], 2) for n in (polynomial, initial))
    step = np.arange(256) << (0 if crc.reflected else crc.width - 8)
    for _ in range(8):
        if crc.reflected:
            step = (step >> 1) ^ np.where(step & 1, polynomial, 0)
        else:
            step = ((step << 1) & mask) ^ np.where(step >> top & 1, polynomial, 0)

    def with_zero(register: IntArray) -> IntArray:
        """Return the register after one more byte, which is zero."""
        if crc.reflected:
            return np.asarray((register >> 8) ^ step[register & 0xFF])
        return np.asarray(((register << 8) & mask) ^ step[register >> crc.width - 8])

    table = np.empty((longest, 256), np.uint16 if crc.width == 16 else np.uint32)
    empty = np.empty(longest + 1, np.int64)
    empty[0], added = initial, step
    for k in range(longest):
        table[k] = added
        added = with_zero(added)
        empty[k + 1] = with_zero(empty[k : k + 1])[0]
    return table.reshape(-1), empty ^ crc.final_xor
