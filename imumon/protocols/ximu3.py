"""x-io x-IMU3: binary and text data messages, as they come by USB, serial, network, or in ``.ximu3`` files.

Facts from the vendor's software.  A message ends with a line feed; its first byte, an upper-case letter (plus
0x80 when binary), names its kind.  There is no checksum: a message counts when it has exactly its length (or
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
from imumon.protocols.framing import Found, Frame
from imumon.protocols.messages import FamilyDecoder, Message, part
from imumon.protocols.numbers import number, vector
from imumon.protocols.text import NUMBER, line_frame, line_lengths

BINARY: Final = 0x80
END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0x0A, 0xDB, 0xDC, 0xDD
"""In a message, the first two are an escape and one of the others."""
TIME_SIZE: Final = 8
YEARS_US: Final = 1 << 58
"""Microseconds of 9000 years: a message that claims more began in the middle of another."""
DEGREE: Final = pi / 180

MATRIX = [number(f"matrix_{i}{j}", "1", "rotation matrix") for i in "xyz" for j in "xyz"]


def _message(name: str, group: str, *vectors: tuple[str | Sequence[Column], float]) -> Message:
    """Return a message of the time and of floats: columns with their factors."""
    at, parts = TIME_SIZE, [part(0, "u64", "device_ticks")]
    for columns, factor in vectors:
        parts.append(part(at, "f32", columns, factor))
        at = parts[-1][-1].end
    return Message(name, at, tuple(parts), group)


MESSAGES = {
    ord("I"): _message("inertial", MAIN, ("gyro", DEGREE), ("accel", STANDARD_GRAVITY)),
    ord("M"): _message("magnetometer", "mag",
                       (vector("mag", "a.u.", "magnetic field, 1 when calibrated"), 1.0)),
    ord("T"): _message("temperature", "temperature", ("temperature", 1.0)),
    ord("Q"): _message("quaternion", "attitude", ("q", 1.0)),
    ord("A"): _message("euler", "attitude", ("angles", DEGREE)),
    ord("R"): _message("matrix", "attitude", (MATRIX, 1.0)),
    ord("L"): _message("linear", "attitude",
                       (vector("free_accel", "m/s^2", "without gravity"), STANDARD_GRAVITY)),
    ord("E"): _message("earth", "attitude",
                       (vector("earth_accel", "m/s^2", "without gravity, in the reference frame"),
                        STANDARD_GRAVITY)),
    ord("H"): _message("high_g", "high_g",
                       (vector("accel_high_g", "m/s^2", "for high accelerations"), STANDARD_GRAVITY)),
    ord("B"): _message("battery", "status", ([number("battery", "1", "charge, percent"),
                                              number("battery_voltage", "V", "of the battery"),
                                              number("charging", "1", "status of charging")], 1.0)),
    ord("W"): _message("rssi", "status", ([number("rssi_percent", "1", "strength of the radio signal"),
                                           number("rssi_power", "1", "the same, dBm")], 1.0)),
    ord("Y"): _message("sync", "sync", ([number("sync_edge", "1", "edge at the input")], 1.0)),
}  # fmt: skip
"""Messages with numbers by their letter."""
SIZES = np.zeros(256, np.int64)
SIZES[[key | BINARY for key in MESSAGES]] = [message.size for message in MESSAGES.values()]
"""Bytes of time and numbers of binary messages, by their first byte."""


def _plain_bytes(held: ByteArray) -> tuple[ByteArray, IntArray]:
    """Return bytes without their escapes, and the place of each byte in these, (n,)."""
    plain, stays = held.copy(), held != ESCAPE
    after = np.flatnonzero(~stays[:-1]) + 1
    plain[after] = np.where(held[after] == ESCAPED_END, END, ESCAPE)
    return plain[stays], np.cumsum(stays) - 1


def _right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Check binary messages: their bytes without escapes, and their time."""
    plain, place = _plain_bytes(held)
    begin, end = place[at], at + length - 1
    escapes = np.flatnonzero(held[:-1] == ESCAPE)
    bad = escapes[~np.isin(held[escapes + 1], (ESCAPED_END, ESCAPED_ESCAPE))]
    unspoilt = np.searchsorted(bad, at) == np.searchsorted(bad, end)
    in_time = plain[np.minimum(begin + TIME_SIZE, len(plain) - 1)] < YEARS_US >> 56
    return np.asarray(unspoilt & in_time & (place[end] - begin == SIZES[held[at]] + 1))


def _numbers(text: str) -> list[float] | None:
    """Return time and numbers of a text message, else None."""
    letter, *words = text.rstrip("\r\n").split(",")
    size = len(MESSAGES[ord(letter)].columns) - 1
    good = len(words) == size + 1 and words[0].isdigit() and all(NUMBER.fullmatch(word) for word in words)
    return [float(word) for word in words] if good and float(words[0]) < YEARS_US else None


def _as_binary(message: bytes) -> bytes:
    numbers = _numbers(message.decode("ascii"))
    assert numbers is not None
    return (
        message[:1] + int(numbers[0]).to_bytes(TIME_SIZE, "little") + np.array(numbers[1:], "<f4").tobytes()
    )


class XimuDecoder(FamilyDecoder):
    """Decodes data messages with numbers; answers to commands and notes are skipped."""

    messages = MESSAGES
    frames = (
        Frame(
            {bytes([key | BINARY]): message.name for key, message in MESSAGES.items()},
            partial(line_lengths, False),
            _right,
        ),
        line_frame({b"%c," % key: f"{message.name} text" for key, message in MESSAGES.items()}, _numbers),
    )
    timing = Timing(tick_ns=Fraction(1000))
    start, more, head = 1, 1, (0,)

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a binary message."""
        stuffed = payload.replace(b"\xdb", b"\xdb\xdd").replace(b"\n", b"\xdb\xdc")
        return bytes([key | BINARY]) + stuffed + b"\n"

    def _plain(self, found: Found) -> Found:
        """Return all messages as binary ones without escapes and end, those of text behind the others."""
        plain, place = _plain_bytes(found.held)
        at = place[found.at]
        plain[at] = found.held[found.at]  # a damaged byte before a message may be an escape
        length = place[found.at + found.length - 1] - at
        parts, size = [plain.tobytes()], len(plain)
        for row in np.flatnonzero(found.kind >= len(MESSAGES)).tolist():
            message = found.held[found.at[row] : found.at[row] + found.length[row]].tobytes()
            parts.append(_as_binary(message))
            at[row], length[row] = size, len(parts[-1])
            size += len(parts[-1])
        return Found(np.frombuffer(b"".join(parts), np.uint8), at, length, found.kind)

    def _key(self, packet: bytes) -> int:
        return packet[0] & ~BINARY
