"""The catalogue of checksums of serial protocols, by name; `imumon.protocols.frame_checks` computes them.

A CRC is described as in Greg Cook's catalogue: width, polynomial, initial value, reflection, final XOR.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Crc:
    """A cyclic redundancy check in the terms of the CRC catalogues."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int


SIMPLE = ("none", "sum8", "sum8-negated", "xor8", "sum16", "sum16-words-le", "sum16-words-be", "fletcher16",
          "fletcher16-256")  # fmt: skip
"""Names of the others.

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
