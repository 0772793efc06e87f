"""Checksums of serial protocols, compiled, chosen by name.

A CRC is described as in Greg Cook's catalogue (width, polynomial, initial value, reflection, final XOR) and
computed eight bytes at a time ("slicing by 8": Kounavis and Berry, Intel, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imumon.compiled import inner, njit, record
from imumon.protocols.stream import ByteArray

WordArray = npt.NDArray[np.uint32]

NONE, SUM, XOR, FLETCHER, CRC = range(5)
"""How the bytes are put together."""


@dataclass(frozen=True, slots=True)
class Crc:
    """A cyclic redundancy check in the terms of the CRC catalogues."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int


SIMPLE = {
    "none": (NONE, 0, 0, 0),
    "sum8": (SUM, 1, 1, 0),
    "sum8-negated": (SUM, 1, -1, 0),
    "xor8": (XOR, 1, 0, 0),
    "sum16": (SUM, 2, 1, 0),
    "sum16-words-le": (SUM, 2, 1, 255),
    "sum16-words-be": (SUM, 2, 256, -255),
    "fletcher16": (FLETCHER, 2, 255, 0),
    "fletcher16-256": (FLETCHER, 2, 256, 0),
}
"""By name: how, bytes of the result, weight of every byte or modulus, and weight of each second byte on top.

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
    """A checksum ready for the kernels: how, width in bytes, weights or modulus, and what a CRC needs.

    A CRC runs in a register of 32 bits of which the lowest byte meets the next byte of the data.  One that is
    not reflected is kept with its bytes in reverse, so that one loop does for all; `turned` says so.
    """

    how: int
    width: int
    factor: int
    second: int
    initial: int
    final_xor: int
    turned: int
    table: WordArray


def make_checksum(name: str) -> Checksum:
    """Return the checksum of this name (one of `CHECKSUM_NAMES`)."""
    check = record(Checksum, table=(8, 256))
    if name in SIMPLE:
        check.how, check.width, check.factor, check.second = SIMPLE[name]
        return check
    crc = CRCS[name]
    check.how, check.width, check.final_xor, check.turned = (
        CRC,
        crc.width // 8,
        crc.final_xor,
        not crc.reflected,
    )
    check.initial = _in_register(crc, crc.initial)
    check.table[:] = _crc_table(crc)
    return check


def _in_register(crc: Crc, value: int) -> int:
    """Return a value of the catalogue as it is in the register."""
    if crc.reflected:
        return reversed_bits(value, crc.width)
    return int.from_bytes(value.to_bytes(crc.width // 8, "big"), "little")


def reversed_bits(value: int, width: int) -> int:
    """Return the bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)


def crc_of_bytes(crc: Crc) -> list[int]:
    """Return the register after each byte, started from zero, its bits in the order of the catalogue."""
    found = []
    for byte in range(256):
        register = reversed_bits(byte, 8) if crc.reflected else byte
        register <<= crc.width - 8
        for _ in range(8):
            register = register << 1 ^ (crc.polynomial if register >> (crc.width - 1) & 1 else 0)
            register &= (1 << crc.width) - 1
        found.append(register)
    return found


def _crc_table(crc: Crc) -> WordArray:
    """Tables T[k][b]: the register after byte b and 7 - k zero bytes, started from zero."""
    table = np.zeros((8, 256), np.uint32)
    table[7] = [_in_register(crc, register) for register in crc_of_bytes(crc)]
    for k in range(6, -1, -1):
        table[k] = table[k + 1] >> 8 ^ table[7, table[k + 1] & 0xFF]
    return table


# Places are unsigned: with a signed one numba tests each index for being negative, and nothing is vectorised
# (34 ns instead of 6 for the sum of 58 bytes).


@njit
def checksum(check: Checksum, buf: ByteArray, start: int, stop: int) -> np.int64:
    """Compute a checksum over buf[start:stop]."""
    if check.how == CRC:
        return _crc(check, buf, start, stop)
    if check.how == FLETCHER:
        return _fletcher(buf, start, stop, check.factor)
    first, total, second, all_bits = np.uint64(start), np.uint32(0), np.uint32(0), np.uint8(0)
    for i in range(np.uint64(stop - start)):
        byte = buf[first + i]
        total += np.uint32(byte)
        second += np.uint32(byte) * np.uint32(i & np.uint64(1))
        all_bits ^= byte
    if check.how == XOR:
        return np.int64(all_bits)
    return (check.factor * np.int64(total) + check.second * np.int64(second)) & ((1 << 8 * check.width) - 1)


@inner
def _fletcher(buf: ByteArray, start: int, stop: int, modulus: int) -> np.int64:
    """Both sums at once: the second is the sum of the bytes weighted by their distance to the end."""
    last, low, high = np.uint64(stop), np.uint32(0), np.uint32(0)
    for i in range(np.uint64(start), last):
        byte = np.uint32(buf[i])
        low += byte
        high += byte * np.uint32(last - i)
    return np.int64(high) % modulus << 8 | np.int64(low) % modulus


@inner
def _crc(check: Checksum, buf: ByteArray, start: int, stop: int) -> np.int64:
    """Eight bytes at a time; the register reaches the first four of them."""
    crc, table, at = np.uint32(check.initial), check.table, np.uint64(start)
    for _ in range((stop - start) // 8):
        register, crc = crc, np.uint32(0)
        for k in range(np.uint64(8)):
            crc ^= table[k, np.uint32(buf[at + k]) ^ register & np.uint32(0xFF)]
            register >>= np.uint32(8)
        at += np.uint64(8)
    for _ in range((stop - start) % 8):
        crc = crc >> np.uint32(8) ^ table[7, crc & np.uint32(0xFF) ^ np.uint32(buf[at])]
        at += np.uint64(1)
    value = np.int64(crc)
    if check.turned:
        turned = np.int64(0)
        for _ in range(check.width):
            turned = turned << 8 | value & 0xFF
            value >>= 8
        value = turned
    return value ^ check.final_xor
