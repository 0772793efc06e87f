"""Checksums of serial protocols by name, of many packets at once; each is a `Check` of a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, IntArray
from imumon.protocols.base import ByteArray
from imumon.protocols.framing import integers, windows


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


def _total(data: ByteArray, weights: npt.ArrayLike = 1) -> IntArray:
    """Return the sum of the bytes of each row times weights: exact in float64, and five times as fast."""
    real = data.astype(np.float64)
    return np.asarray(real @ np.broadcast_to(weights, data.shape[1]).astype(np.float64)).astype(np.int64)


def _words(data: ByteArray, order: str) -> IntArray:
    even = np.pad(data, ((0, 0), (0, data.shape[1] % 2)))
    return np.asarray(np.sum(even.view(f"{order}u2"), axis=1, dtype=np.int64))


def _fletcher(data: ByteArray, modulus: int) -> IntArray:
    second = _total(data, np.arange(data.shape[1], 0, -1))
    return second % modulus << 8 | _total(data) % modulus


SIMPLE: dict[str, tuple[int, Callable[[ByteArray], IntArray]]] = {
    "sum8": (1, _total),
    "sum8-negated": (1, lambda data: -_total(data)),
    "xor8": (1, lambda data: np.bitwise_xor.reduce(data, axis=1).astype(np.int64)),
    "sum16": (2, _total),
    "sum16-words-le": (2, partial(_words, order="<")),
    "sum16-words-be": (2, partial(_words, order=">")),
    "fletcher16": (2, partial(_fletcher, modulus=255)),
    "fletcher16-256": (2, partial(_fletcher, modulus=256)),
}
"""Bytes of the others, and what takes rows of bytes, (n, size), to their checksums, (n,).

sum8-negated makes the sum of all bytes and the checksum zero.  sum16-words-* adds numbers of 16 bits, low
(le) or high byte (be) first; a last byte alone has zero for the other.  fletcher16 is modulo 255 (RFC 1145,
second sum in the high byte); fletcher16-256 is the variant modulo 256 that MIP and UBX use.
"""

CHECKSUM_NAMES = ("none", *SIMPLE, *CRCS)


@dataclass(frozen=True)
class Checksum:
    """A checksum of all bytes from `first` to before `end`, which stands at `at`.

    Without these two it covers all, and stands in the last bytes of a packet.  `zeros` more bytes, which are
    not sent, count as if they followed the others (CRCs only).
    """

    name: str
    first: int = 0
    big: bool = False
    """Whether the most significant byte comes first."""
    zeros: int = 0
    end: int | None = None
    at: int | None = None

    @property
    def size(self) -> int:
        """Bytes of the checksum."""
        return CRCS[self.name].width // 8 if self.name in CRCS else SIMPLE[self.name][0]

    def values(self, held: ByteArray, first: IntArray, last: IntArray) -> IntArray:
        """Return the checksums of the bytes from each first to before each last place."""
        found, sizes = np.zeros(len(first), np.int64), last - first
        for size in np.flatnonzero(np.bincount(sizes)).tolist():
            which = np.flatnonzero(sizes == size)
            data = windows(held, first[which], size)
            found[which] = self._cyclic(data) if self.name in CRCS else SIMPLE[self.name][1](data)
        return found & (1 << 8 * self.size) - 1

    def _cyclic(self, data: ByteArray) -> IntArray:
        """Return CRCs: they are linear, so each byte adds what its value and distance to the end give."""
        longest = data.shape[1] + self.zeros
        table, empty = by_distance(CRCS[self.name], 1 << longest.bit_length())
        distance = np.arange(longest - 1, self.zeros - 1, -1)
        value = np.bitwise_xor.reduce(table.take(data + 256 * distance), axis=1)
        return np.asarray(value ^ empty[longest])

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        place = length - self.size if self.at is None else self.at
        computed = self.values(held, at + self.first, at + (place if self.end is None else self.end))
        return np.asarray(computed == integers(held, at + place, self.size, self.big))

    def sealed(self, body: bytes) -> bytes:
        """Return the packet: the body and its checksum."""
        return self.sealed_rows(np.frombuffer(body, np.uint8)[np.newaxis]).tobytes()

    def sealed_rows(self, bodies: ByteArray) -> ByteArray:
        """Return packets of bodies of one size, (n, size), with their checksums behind them or in place."""
        n, size = bodies.shape
        begin = np.arange(n) * size
        sums = self.values(bodies.reshape(-1), begin + self.first, begin + (self.end or size))
        most_first = sums.astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - self.size :]
        stored = most_first if self.big else most_first[:, ::-1]
        if self.at is None:
            return np.concatenate([bodies, stored], axis=1)
        return np.concatenate([bodies[:, : self.at], stored, bodies[:, self.at + self.size :]], axis=1)


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
