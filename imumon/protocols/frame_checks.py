"""Checksums of many packets at once, for frames (`imumon.protocols.framing`): each is a `Check`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.protocols.checksums import CRCS, Crc
from imumon.protocols.framing import Check, windows
from imumon.protocols.stream import ByteArray


def aligned(held: ByteArray, first: IntArray, last: IntArray) -> Iterator[tuple[IntArray, ByteArray]]:
    """Yield numbers of spans, and their bytes with zeros before the shorter ones, (m, longest).

    Those of the most frequent length come at once; others with those that are at most twice as long.
    """
    sizes = last - first
    usual = int(np.argmax(np.bincount(sizes))) if len(sizes) else 0
    which = np.flatnonzero(sizes == usual)
    yield which, windows(held, first[which], usual)
    octaves = np.where(sizes == usual, 0, np.frexp(sizes)[1] + 1)
    for octave in np.flatnonzero(np.bincount(octaves, minlength=1)[1:]).tolist():
        which = np.flatnonzero(octaves == octave + 1)
        place = last[which, np.newaxis] + np.arange(-int(sizes[which].max()), 0)
        there = place >= first[which, np.newaxis]
        yield which, np.where(there, held[np.where(there, place, 0)], np.uint8(0))


def sent(held: ByteArray, end: IntArray, size: int, big: bool) -> IntArray:
    """Return the integers of `size` bytes that end before these places."""
    places = range(size)[:: -1 if big else 1]
    value = np.zeros(len(end), np.int64)
    for n, k in enumerate(places):
        value |= held[end - size + k].astype(np.int64) << 8 * n
    return value


class Trailing(ABC):
    """A checksum of all bytes from `first` on, in the last `size` bytes of a packet."""

    first: int
    size: int
    big: bool

    def values(self, held: ByteArray, first: IntArray, last: IntArray) -> IntArray:
        """Return the checksums of the bytes from each first to before each last place."""
        found = np.zeros(len(first), np.int64)
        for which, data in aligned(held, first, last):
            found[which] = self._of(data, (last - first)[which])
        return found

    @abstractmethod
    def _of(self, data: ByteArray, size: IntArray) -> IntArray:
        """Return the checksums of rows of which these are the sizes; what is before is zero."""

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
class Sum(Trailing):
    """A checksum that adds up numbers."""

    first: int = 0
    """Place in the packet of the first byte that counts."""
    size: int = 1
    """Bytes of the checksum."""
    negated: bool = False
    """The sum and the checksum add up to zero."""
    big: bool = False
    """Whether the most significant byte comes first."""
    words: Literal["", "little", "big"] = ""
    """"little" or "big": not bytes are added but numbers of 16 bits in this order; a last one that lacks
    its second byte has zero there."""

    def _of(self, data: ByteArray, size: IntArray) -> IntArray:
        if self.words:
            even = (np.arange(data.shape[1]) - data.shape[1] + size[:, np.newaxis]) % 2 == 0
            sums = np.sum(data.astype(np.int64) << np.where(even == (self.words == "big"), 8, 0), axis=1)
        else:
            sums = np.sum(data, axis=1, dtype=np.int64)
        return np.asarray((-sums if self.negated else sums) & (1 << 8 * self.size) - 1)


@dataclass(frozen=True)
class Xor(Trailing):
    """The exclusive or of the bytes, in the last byte."""

    first: int = 0
    size: int = 1
    big: bool = False

    def _of(self, data: ByteArray, size: IntArray) -> IntArray:
        del size
        return np.asarray(np.bitwise_xor.reduce(data, axis=1), np.int64)


@dataclass(frozen=True)
class Fletcher(Trailing):
    """Fletcher's two sums of eight bits: see `checksums`."""

    first: int = 0
    modulus: int = 256
    big: bool = False
    size: int = 2

    def _of(self, data: ByteArray, size: IntArray) -> IntArray:
        del size
        distance = np.arange(data.shape[1], 0, -1)
        low, high = np.sum(data, axis=1, dtype=np.int64), data @ distance
        return np.asarray(high % self.modulus << 8 | low % self.modulus)


@dataclass(frozen=True)
class CyclicCheck(Trailing):
    """A CRC in the terms of the catalogue.

    It is linear: each byte adds what depends on its value and on its distance to the end, so all bytes of all
    packets are looked up at once.  `zeros` more bytes, which are not sent, count as if they came before it.
    """

    crc: Crc
    first: int = 0
    big: bool = False
    zeros: int = 0

    @property
    def size(self) -> int:  # type: ignore[override]
        """Bytes of the CRC."""
        return self.crc.width // 8

    @property
    def of_last_byte(self) -> IntArray:
        """What the last byte adds, by its value."""
        return by_distance(self.crc, 1)[0]

    def _of(self, data: ByteArray, size: IntArray) -> IntArray:
        longest = data.shape[1] + self.zeros
        table, empty = by_distance(self.crc, 1 << longest.bit_length())
        distance = np.arange(longest - 1, self.zeros - 1, -1)
        value = np.bitwise_xor.reduce(table.take(data + 256 * distance), axis=1)
        return np.asarray(value ^ empty[size + self.zeros])


def rearranged(check: Check, order: Callable[[int], Sequence[int]]) -> Check:
    """Return the check of packets that have their bytes in another order.

    `order` takes the length of a packet, and returns the places of what counts, those of the checksum last.
    """
    return partial(_right_rearranged, check, order)


def _right_rearranged(
    check: Check,
    order: Callable[[int], Sequence[int]],
    held: ByteArray,
    at: IntArray,
    length: IntArray,
) -> BoolArray:
    verdict = np.zeros(len(at), np.bool_)
    for size in np.flatnonzero(np.bincount(length)).tolist():
        which, places = np.flatnonzero(length == size), order(size)
        moved = windows(held, at[which], size).take(places, axis=1)
        begins = np.arange(len(which)) * len(places)
        verdict[which] = check(moved.reshape(-1), begins, np.full(len(which), len(places)))
    return verdict


def trailing(name: str, first: int = 0, big: bool = False, zeros: int = 0) -> Trailing:
    """Return the checksum of this name (`imumon.protocols.checksums`), which is not "none"."""
    if name in CRCS:
        return CyclicCheck(CRCS[name], first, big, zeros)
    simple = {
        "xor8": Xor(first),
        "sum8": Sum(first),
        "sum8-negated": Sum(first, negated=True),
        "sum16": Sum(first, 2, big=big),
        "sum16-words-le": Sum(first, 2, big=big, words="little"),
        "sum16-words-be": Sum(first, 2, big=big, words="big"),
        "fletcher16": Fletcher(first, 255, big),
        "fletcher16-256": Fletcher(first, 256, big),
    }
    return simple[name]


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
