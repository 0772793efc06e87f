"""x-io x-IMU3: binary and text data messages, as they come by USB, serial, network, or in ``.ximu3`` files.

Facts from the vendor's software.  A message ends with a line feed; its first byte, an upper-case letter (plus
0x80 when binary), says what it is.  There is no checksum: a message counts when it has exactly its length (or
its numbers) and a time that a device can have run.  Temperature comes in messages of its own, five a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from math import pi
from typing import Final

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.columns import Column
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import MAIN, ByteArray, Timing
from imumon.protocols.framing import Found, Frame, windows
from imumon.protocols.messages import FamilyDecoder, Message, TableDevice, TableFamily, part
from imumon.protocols.quantities import number, vector
from imumon.protocols.text import NUMBER, line_frame, line_lengths

BINARY: Final = 0x80
END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0x0A, 0xDB, 0xDC, 0xDD
"""In a message, the first two are an escape and one of the others."""
TIME_SIZE: Final = 8
YEARS_US: Final = 1 << 58
"""Microseconds of 9000 years: a message that claims more began in the middle of another."""
DEGREE: Final = pi / 180
LINE: Final = partial(line_lengths, False)

MATRIX = [number(f"matrix_{i}{j}", "1", "rotation matrix") for i in "xyz" for j in "xyz"]

Kind = tuple[str, str, list[tuple[str | Sequence[Column], float]]]
KINDS: dict[str, Kind] = {
    "I": ("inertial", MAIN, [("gyro", DEGREE),
                             ("accel", STANDARD_GRAVITY)]),
    "M": ("magnetometer", "mag", [(vector("mag", "a.u.", "magnetic field, 1 when calibrated"), 1.0)]),
    "T": ("temperature", "temperature", [("temperature", 1.0)]),
    "Q": ("quaternion", "attitude", [("q", 1.0)]),
    "A": ("euler", "attitude", [("angles", DEGREE)]),
    "R": ("matrix", "attitude", [(MATRIX, 1.0)]),
    "L": ("linear", "attitude", [(vector("free_accel", "m/s^2", "without gravity"), STANDARD_GRAVITY)]),
    "E": ("earth", "attitude", [(vector("earth_accel", "m/s^2", "without gravity, in the reference frame"),
                                 STANDARD_GRAVITY)]),
    "H": ("high_g", "high_g", [(vector("accel_high_g", "m/s^2", "for high accelerations"),
                                STANDARD_GRAVITY)]),
    "B": ("battery", "status", [([number("battery", "1", "charge, percent"),
                                  number("battery_voltage", "V", "of the battery"),
                                  number("charging", "1", "status of charging")], 1.0)]),
    "W": ("rssi", "status", [([number("rssi_percent", "1", "strength of the radio signal"),
                               number("rssi_power", "1", "the same, dBm")], 1.0)]),
    "Y": ("sync", "sync", [([number("sync_edge", "1", "edge at the input")], 1.0)]),
}  # fmt: skip
"""Messages with numbers: name, group, and columns with their factors; all are f32."""


def _message(letter: str) -> Message:
    name, group, vectors = KINDS[letter]
    at, parts = TIME_SIZE, [part(0, "u64", "device_ticks")]
    for columns, factor in vectors:
        parts.append(part(at, "f32", columns, factor))
        at = parts[-1][-1].end
    return Message(name, at, tuple(parts), group)


MESSAGES = {ord(letter): _message(letter) for letter in KINDS}


def _right(size: int, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Check binary messages: their bytes without escapes, and their time."""
    right: BoolArray = length == size + 2
    rows = windows(held, at[right], size + 2)
    right[right] = ~np.any(rows == ESCAPE, axis=1) & (rows[:, TIME_SIZE] < YEARS_US >> 56)
    longer = np.flatnonzero((length > size + 2) & (length <= 2 * size + 3))
    width = 2 * size + 3
    rows = windows(np.pad(held, (0, width)), at[longer], width)
    inside = np.arange(width) < length[longer, np.newaxis] - 1
    escapes = inside & (rows == ESCAPE)
    ends_well = ~escapes[:, :-1] | (rows[:, 1:] == ESCAPED_END) | (rows[:, 1:] == ESCAPED_ESCAPE)
    place = np.cumsum(inside & ~escapes, axis=1)
    end_of_time = rows[np.arange(len(rows)), np.argmax(place == TIME_SIZE + 1, axis=1)]
    good = ends_well.all(axis=1) & (place[:, -1] == size + 1) & (end_of_time < YEARS_US >> 56)
    right[longer] = good
    return right


def _numbers(text: str) -> list[float] | None:
    """Return time and numbers of a text message, else None."""
    letter, *words = text.rstrip("\r\n").split(",")
    size = len(MESSAGES[ord(letter)].columns) - 1
    good = len(words) == size + 1 and words[0].isdigit() and all(NUMBER.fullmatch(word) for word in words)
    return [float(word) for word in words] if good and float(words[0]) < YEARS_US else None


class XimuDecoder(FamilyDecoder):
    """Decodes data messages with numbers; answers to commands and notes are skipped."""

    def _plain(self, found: Found) -> Found:
        """Return all messages as binary ones without escapes and end, those of text behind the others."""
        held, escapes = found.held.copy(), found.held == ESCAPE
        follows = np.append(False, escapes[:-1])
        follows[found.at] = False
        held[follows] = np.where(held[follows] == ESCAPED_END, END, ESCAPE)
        place = np.cumsum(~escapes)
        at = place[found.at] - 1
        length = place[found.at + found.length - 1] - 1 - at
        parts, size = [held[~escapes].tobytes()], int(place[-1])
        for row in np.flatnonzero(found.frame >= len(MESSAGES)).tolist():
            message = found.held[found.at[row] : found.at[row] + found.length[row]].tobytes()
            parts.append(_as_binary(message))
            at[row], length[row] = size, len(parts[-1])
            size += len(parts[-1])
        return Found(np.frombuffer(b"".join(parts), np.uint8), at, length, found.frame)

    def _key(self, packet: bytes) -> int:
        return packet[0] & ~BINARY


def _as_binary(message: bytes) -> bytes:
    numbers = _numbers(message.decode("ascii"))
    assert numbers is not None
    return (
        message[:1] + int(numbers[0]).to_bytes(TIME_SIZE, "little") + np.array(numbers[1:], "<f4").tobytes()
    )


def _wrapped(key: int, payload: bytes) -> bytes:
    stuffed = payload.replace(b"\xdb", b"\xdb\xdd").replace(b"\n", b"\xdb\xdc")
    return bytes([key | BINARY]) + stuffed + b"\n"


FRAMES = [
    *(Frame(m.name, bytes([key | BINARY]), LINE, partial(_right, m.size)) for key, m in MESSAGES.items()),
    *(line_frame(f"{m.name} text", b"%c," % key, _numbers) for key, m in MESSAGES.items()),
]


class XimuDevice(TableDevice):
    """Device file of an x-IMU3."""

    family = TableFamily(MESSAGES, FRAMES, XimuDecoder, _wrapped, Timing(tick_ns=Fraction(1000)), 1, 1, (0,))
