"""Checksums of many packets at once, for frames (`imumon.protocols.framing`): each is a `Check`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from imumon.blocks import IntArray
from imumon.protocols.checksums import CRCS, Crc
from imumon.protocols.framing import BoolArray, Check
from imumon.protocols.stream import ByteArray


def gathered(held: ByteArray, first: IntArray, last: IntArray) -> tuple[ByteArray, IntArray]:
    """Return the bytes from each first to before each last place, in one row, and where each begins.

    None of the spans may be empty.
    """
    sizes = last - first
    begins = np.cumsum(sizes) - sizes
    return held[np.repeat(first - begins, sizes) + np.arange(int(sizes.sum()))], begins


def sent(held: ByteArray, end: IntArray, size: int, big: bool) -> IntArray:
    """Return the integers of `size` bytes that end before these places."""
    places = range(size)[:: -1 if big else 1]
    value = np.zeros(len(end), np.int64)
    for n, k in enumerate(places):
        value |= held[end - size + k].astype(np.int64) << 8 * n
    return value


def unchecked(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Believe every packet."""
    del held, length
    return np.ones(len(at), np.bool_)


@dataclass(frozen=True, slots=True)
class Sum:
    """A checksum that adds up numbers of the bytes `first` .. length - `size`, and stands in the last ones.

    Parameters
    ----------
    first : int
        Place in the packet of the first byte that counts.
    size : int
        Bytes of the checksum.
    negated : bool
        The sum and the checksum add up to zero.
    big : bool
        Whether the most significant byte comes first.
    words : str
        "little" or "big": not bytes are added but numbers of 16 bits in this order; a last one that lacks its
        second byte has zero there.
    """

    first: int = 0
    size: int = 1
    negated: bool = False
    big: bool = False
    words: Literal["", "little", "big"] = ""

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        if not len(at):
            return np.zeros(0, np.bool_)
        data, begins = gathered(held, at + self.first, at + length - self.size)
        numbers = data.astype(np.int64)
        if self.words:
            place = np.arange(len(data)) - np.repeat(begins, np.diff(begins, append=len(data)))
            numbers <<= np.where((place % 2 == 0) == (self.words == "big"), 8, 0)
        sums = np.add.reduceat(numbers, begins)
        difference = (-sums if self.negated else sums) - sent(held, at + length, self.size, self.big)
        return np.asarray(difference & (1 << 8 * self.size) - 1 == 0)


@dataclass(frozen=True, slots=True)
class Xor:
    """The exclusive or of the bytes from `first` on, in the last byte."""

    first: int = 0

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        if not len(at):
            return np.zeros(0, np.bool_)
        data, begins = gathered(held, at + self.first, at + length - 1)
        return np.asarray(np.bitwise_xor.reduceat(data, begins) == held[at + length - 1])


@dataclass(frozen=True, slots=True)
class Fletcher:
    """Fletcher's two sums of eight bits, of the bytes from `first` on, in the last two: see `checksums`."""

    first: int = 0
    modulus: int = 256
    big: bool = False

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        if not len(at):
            return np.zeros(0, np.bool_)
        data, begins = gathered(held, at + self.first, at + length - 2)
        covered = length - 2 - self.first
        distance = np.repeat(begins + covered, covered) - np.arange(len(data))
        low = np.add.reduceat(data.astype(np.int64), begins) % self.modulus
        high = np.add.reduceat(data * distance, begins) % self.modulus
        return np.asarray((high << 8 | low) == sent(held, at + length, 2, self.big))


@dataclass(frozen=True, slots=True)
class CyclicCheck:
    """A CRC in the terms of the catalogue, in the last bytes of a packet, over all from `first` on.

    It is linear: each byte adds what depends on its value and on its distance to the end, so all bytes of all
    packets are looked up at once.  `zeros` more bytes, which are not sent, count as if they came before it.
    """

    crc: Crc
    first: int = 0
    big: bool = False
    zeros: int = 0

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        if not len(at):
            return np.zeros(0, np.bool_)
        size = self.crc.width // 8
        data, begins = gathered(held, at + self.first, at + length - size)
        covered = length - size - self.first
        table, empty = _by_distance(self.crc, 1 << int(covered.max() + self.zeros).bit_length())
        distance = np.repeat(begins + covered - 1 + self.zeros, covered) - np.arange(len(data))
        value = np.bitwise_xor.reduceat(table[distance, data], begins) ^ empty[covered + self.zeros]
        return np.asarray(value == sent(held, at + length, size, self.big))


def check_of(name: str, first: int = 0, big: bool = False, zeros: int = 0) -> Check:
    """Return the check of this name (`imumon.protocols.checksums`), over all bytes from `first` on."""
    if name in CRCS:
        return CyclicCheck(CRCS[name], first, big, zeros)
    if name.startswith("fletcher16"):
        return Fletcher(first, 256 if name == "fletcher16-256" else 255, big)
    simple: dict[str, Check] = {
        "none": unchecked,
        "xor8": Xor(first),
        "sum8": Sum(first),
        "sum8-negated": Sum(first, negated=True),
        "sum16": Sum(first, 2, big=big),
        "sum16-words-le": Sum(first, 2, big=big, words="little"),
        "sum16-words-be": Sum(first, 2, big=big, words="big"),
    }
    return simple[name]


@lru_cache
def _by_distance(crc: Crc, longest: int) -> tuple[IntArray, IntArray]:
    """Return what a byte adds to the CRC by its distance to the end and its value, and the CRC of zeros.

    Shapes: (longest, 256) and (longest + 1,).
    """
    mask = (1 << crc.width) - 1
    step = np.array([_shifted(crc, byte) for byte in range(256)], np.int64)

    def with_zero(register: IntArray) -> IntArray:
        """Return the register after one more byte, which is zero."""
        if crc.reflected:
            return np.asarray((register >> 8) ^ step[register & 0xFF])
        return np.asarray(((register << 8) & mask) ^ step[register >> crc.width - 8])

    table = np.empty((longest, 256), np.int64)
    empty = np.empty(longest + 1, np.int64)
    table[0], empty[0] = step, _turned(crc.initial, crc.width) if crc.reflected else crc.initial
    for k in range(1, longest + 1):
        if k < longest:
            table[k] = with_zero(table[k - 1])
        empty[k] = with_zero(empty[k - 1 : k])[0]
    return table, empty ^ crc.final_xor


def _shifted(crc: Crc, byte: int) -> int:
    """Return the register after a byte, begun at zero."""
    if crc.reflected:
        polynomial, register = _turned(crc.polynomial, crc.width), byte
        for _ in range(8):
            register = (register >> 1) ^ (polynomial if register & 1 else 0)
        return register
    top, register = 1 << crc.width - 1, byte << crc.width - 8
    for _ in range(8):
        register = (register << 1 ^ (crc.polynomial if register & top else 0)) & (1 << crc.width) - 1
    return register


def _turned(value: int, width: int) -> int:
    """Return the bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)
