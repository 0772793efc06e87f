"""The records of a wire file: what MCAP defines, and the check record that imumon adds.

The layout is in docs/session-format.md.  A check record seals the bytes since the one before: who reads the
file while it is written, or after a crash, can check what is as it was written, and can find back into a file
that is damaged in the middle.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode

from imumon.files import readable

FORMAT = "imumon-wire/2"
"""Written as the profile of the MCAP file."""
FORMATS = ("imumon-wire/1", FORMAT)
"""Those that are read; in the first, reads are bare bytes."""
BARE_CHANNEL, EVENT_CHANNEL, WIRE_CHANNEL = 1, 2, 3
"""Always these, so that a file whose beginning is damaged can be read; the first has bare bytes."""
CDR = struct.Struct("<4sI")
"""What CDR has before the bytes of ``uint8[] data``: little-endian, and how many they are."""
CDR_LITTLE = b"\x00\x01\x00\x00"
UNRECORDED = "unrecorded"
"""Kind of the event that states how many bytes are missing before it."""

PROFILE = FORMAT.rpartition("/")[0].encode()
HEAD_SIZE = 64
"""Bytes at the begin of a file among which the profile stands."""
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""Opcode, and bytes that follow."""
MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, bytes that follow, channel, sequence, log time, publish time; then the payload."""
MESSAGE_FIELDS = MESSAGE.size - RECORD.size
MESSAGE_OP, DATA_END_OP = int(Opcode.MESSAGE), int(Opcode.DATA_END)
SEQUENCE_MASK = (1 << 32) - 1

CHECK_OP = 0x91
"""MCAP leaves 0x80 and above to the application; other readers pass such a record over."""
MARKER = bytes.fromhex("a3d1f08b5ce749268e7f13b0c96d42f5")
"""What to search for: 16 bytes drawn once at random, so that no device sends them."""
_CHECK = struct.Struct("<BQ16sQQIIq")
CHECK_SIZE = _CHECK.size + 4
CHECK_LENGTH = CHECK_SIZE - RECORD.size


@dataclass(frozen=True, slots=True)
class Check:
    """A check record."""

    start: int
    size: int
    """Where in the file the bytes begin that it seals, and how many they are; the record itself is not
    among them."""
    sequence: int
    """Of the message that follows, modulo 2^32."""
    crc: int
    """CRC-32 of the bytes."""
    time_ns: int
    """Unix time of the latest message before, 0 when there is none."""

    def pack(self) -> bytes:
        """Return the record."""
        fields = self.start, self.size, self.sequence, self.crc, self.time_ns
        body = _CHECK.pack(CHECK_OP, CHECK_LENGTH, MARKER, *fields)
        return body + zlib.crc32(body).to_bytes(4, "little")

    @classmethod
    def unpack(cls, buffer: mmap.mmap | bytes, offset: int) -> Check | None:
        """Return the record that begins here, or None when it is not one, or damaged."""
        record = buffer[offset : offset + CHECK_SIZE]
        if len(record) < CHECK_SIZE or zlib.crc32(record[:-4]).to_bytes(4, "little") != record[-4:]:
            return None
        opcode, length, marker, *fields = _CHECK.unpack_from(record)
        return cls(*fields) if (opcode, length, marker) == (CHECK_OP, CHECK_LENGTH, MARKER) else None


def is_wire(path: Path) -> bool:
    """Test whether a file is MCAP by its first bytes, or by the profile behind them where these are damaged.

    Raises BAD_DATA when it cannot be read.
    """
    return _head(path).startswith(MAGIC) or is_own(path)


def is_own(path: Path) -> bool:
    """Return whether imumon recorded a file, by the profile at its begin.  Raises BAD_DATA as `is_wire`."""
    return PROFILE in _head(path)


def _head(path: Path) -> bytes:
    with readable(path), path.open("rb") as file:
        return file.read(HEAD_SIZE)
