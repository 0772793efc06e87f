"""Checksums of serial protocols, compiled, chosen by name.

A CRC is described as in Greg Cook's catalogue (width, polynomial, initial value, reflection, final XOR) and
computed eight bytes at a time ("slicing by 8": Kounavis and Berry, Intel, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imumon.compiled import njit, record
from imumon.protocols.stream import ByteArray

WordArray = npt.NDArray[np.uint32]

NONE, SUM8, SUM8_NEGATED, XOR8, SUM16, FLETCHER16, FLETCHER16_256, CRC_FORWARD, CRC_REFLECTED = range(9)
WORDS_LITTLE, WORDS_BIG = 9, 10


@dataclass(frozen=True, slots=True)
class Crc:
    """A cyclic redundancy check in the terms of the CRC catalogues."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int


SIMPLE = {
    "none": (NONE, 0),
    "sum8": (SUM8, 1),
    "sum8-negated": (SUM8_NEGATED, 1),
    "xor8": (XOR8, 1),
    "sum16": (SUM16, 2),
    "sum16-words-le": (WORDS_LITTLE, 2),
    "sum16-words-be": (WORDS_BIG, 2),
    "fletcher16": (FLETCHER16, 2),
    "fletcher16-256": (FLETCHER16_256, 2),
}
"""Kernel code and bytes by name.

sum8-negated makes the sum of all bytes and the checksum zero.  sum16-words-* adds numbers of 16 bits, low
(le) or high byte (be) first; a last byte alone has zero for the other.  fletcher16 is modulo 255 (RFC 1145,
second sum in the high byte); fletcher16-256 is the variant modulo 256 that MIP and UBX use.
"""

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

CHECKSUM_NAMES = (*SIMPLE, *CRCS)


class Checksum:
    """A checksum ready for the kernels: code, width in bytes, and what a CRC needs.

    A CRC runs in a 32-bit register, left-aligned when it is not reflected, so that one pair of loops does for
    every width; `shift` brings the result down.
    """

    code: int
    width: int
    initial: int
    final_xor: int
    shift: int
    table: WordArray


def make_checksum(name: str) -> Checksum:
    """Return the checksum of this name (one of `CHECKSUM_NAMES`)."""
    check = record(Checksum, table=(8, 256))
    if name in SIMPLE:
        check.code, check.width = SIMPLE[name]
        return check
    crc = CRCS[name]
    check.shift = 0 if crc.reflected else 32 - crc.width
    check.initial = reversed_bits(crc.initial, crc.width) if crc.reflected else crc.initial << check.shift
    check.code = CRC_REFLECTED if crc.reflected else CRC_FORWARD
    check.width, check.final_xor = crc.width // 8, crc.final_xor
    check.table[:] = crc_table(crc)
    return check


def reversed_bits(value: int, width: int) -> int:
    """Return the bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)


def crc_table(crc: Crc) -> WordArray:
    """Tables T[k][b]: the register after byte b and k zero bytes, started from zero."""
    table = np.zeros((8, 256), np.uint32)
    for byte in range(256):
        if crc.reflected:
            polynomial, register = reversed_bits(crc.polynomial, crc.width), byte
            for _ in range(8):
                register = (register >> 1) ^ (polynomial if register & 1 else 0)
        else:
            polynomial, register = crc.polynomial << (32 - crc.width), byte << 24
            for _ in range(8):
                register = ((register << 1) & 0xFFFFFFFF) ^ (polynomial if register & 0x80000000 else 0)
        table[0, byte] = register
    for k in range(1, 8):
        last = table[k - 1]
        if crc.reflected:
            table[k] = (last >> 8) ^ table[0, last & 0xFF]
        else:
            table[k] = (last << 8) ^ table[0, last >> 24]
    return table


# Places are unsigned: with a signed one numba tests each index for being negative, and nothing is vectorised
# (34 ns instead of 6 for the sum of 58 bytes).


@njit
def checksum(check: Checksum, buf: ByteArray, start: int, stop: int) -> np.int64:
    """Compute a checksum over buf[start:stop]."""
    code, table, initial = check.code, check.table, check.initial
    first, last = np.uint64(start), np.uint64(stop)
    if code in (FLETCHER16, FLETCHER16_256):
        return np.int64(_fletcher(buf, first, last, 255 if code == FLETCHER16 else 256))
    if code == CRC_FORWARD:
        crc = _crc_forward(buf, first, last, table, initial) >> np.uint32(check.shift)
        return np.int64(crc ^ np.uint32(check.final_xor))
    if code == CRC_REFLECTED:
        return np.int64(_crc_reflected(buf, first, last, table, initial) ^ np.uint32(check.final_xor))
    if code == XOR8:
        value = np.uint8(0)
        for i in range(first, last):
            value ^= buf[i]
        return np.int64(value)
    total = np.uint32(0)
    if code in (WORDS_LITTLE, WORDS_BIG):
        for i in range(first, last):
            high = ((i - first) % np.uint64(2) == np.uint64(0)) == (code == WORDS_BIG)
            total += np.uint32(buf[i]) << np.uint32(8 if high else 0)
        return np.int64(total & np.uint32(0xFFFF))
    for i in range(first, last):
        total += np.uint32(buf[i])
    if code == SUM16:
        return np.int64(total & np.uint32(0xFFFF))
    if code == SUM8_NEGATED:
        return np.int64((np.uint32(0) - total) & np.uint32(0xFF))
    return np.int64(total & np.uint32(0xFF))


@njit
def _fletcher(buf: ByteArray, first: np.uint64, last: np.uint64, modulus: int) -> np.int64:
    """Both sums at once: the second is the sum of the bytes weighted by their distance to the end."""
    low = np.uint32(0)
    high = np.uint32(0)
    for i in range(first, last):
        byte = np.uint32(buf[i])
        low += byte
        high += byte * np.uint32(last - i)
    if modulus == 256:
        return (np.int64(high & np.uint32(255)) << 8) | np.int64(low & np.uint32(255))
    return (np.int64(high % np.uint32(255)) << 8) | np.int64(low % np.uint32(255))


@njit
def _crc_forward(
    buf: ByteArray, first: np.uint64, last: np.uint64, table: WordArray, initial: int
) -> np.uint32:
    crc = np.uint32(initial)
    whole = first + (last - first) // np.uint64(8) * np.uint64(8)
    for i in range(first, whole, np.uint64(8)):
        a = np.uint32(buf[i]) ^ (crc >> np.uint32(24))
        b = np.uint32(buf[i + np.uint64(1)]) ^ ((crc >> np.uint32(16)) & np.uint32(0xFF))
        c = np.uint32(buf[i + np.uint64(2)]) ^ ((crc >> np.uint32(8)) & np.uint32(0xFF))
        d = np.uint32(buf[i + np.uint64(3)]) ^ (crc & np.uint32(0xFF))
        crc = table[7, a] ^ table[6, b] ^ table[5, c] ^ table[4, d] ^ _last_four(buf, np.uint64(i), table)
    for i in range(whole, last):
        crc = np.uint32(crc << np.uint32(8)) ^ table[0, np.uint32(crc >> np.uint32(24)) ^ np.uint32(buf[i])]
    return crc


@njit
def _crc_reflected(
    buf: ByteArray, first: np.uint64, last: np.uint64, table: WordArray, initial: int
) -> np.uint32:
    crc = np.uint32(initial)
    whole = first + (last - first) // np.uint64(8) * np.uint64(8)
    for i in range(first, whole, np.uint64(8)):
        a = np.uint32(buf[i]) ^ (crc & np.uint32(0xFF))
        b = np.uint32(buf[i + np.uint64(1)]) ^ ((crc >> np.uint32(8)) & np.uint32(0xFF))
        c = np.uint32(buf[i + np.uint64(2)]) ^ ((crc >> np.uint32(16)) & np.uint32(0xFF))
        d = np.uint32(buf[i + np.uint64(3)]) ^ (crc >> np.uint32(24))
        crc = table[7, a] ^ table[6, b] ^ table[5, c] ^ table[4, d] ^ _last_four(buf, np.uint64(i), table)
    for i in range(whole, last):
        crc = np.uint32(crc >> np.uint32(8)) ^ table[0, (crc ^ np.uint32(buf[i])) & np.uint32(0xFF)]
    return crc


@njit
def _last_four(buf: ByteArray, i: np.uint64, table: WordArray) -> np.uint32:
    """Contribution of bytes 4 to 7 of eight, which the register does not reach."""
    return np.uint32(
        table[3, buf[i + np.uint64(4)]]
        ^ table[2, buf[i + np.uint64(5)]]
        ^ table[1, buf[i + np.uint64(6)]]
        ^ table[0, buf[i + np.uint64(7)]]
    )
