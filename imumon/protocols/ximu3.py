"""x-io x-IMU3: binary and text data messages, as they come by USB, serial, network, or in ``.ximu3`` files.

Facts from the vendor's software.  A message ends with a line feed; its first byte, an upper-case letter (plus
0x80 when binary), names its kind.  There is no checksum: a message counts when it has exactly its length (or
its numbers) and a time that a device can have run.  Temperature comes in messages of its own, five a second.
"""

from fractions import Fraction
from functools import partial
from math import pi

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import MAIN, ByteArray, Timing
from imumon.protocols.framing import Found, Frame
from imumon.protocols.messages import FamilyDecoder, Message, Part, axes, field, floats, real
from imumon.protocols.numbers import number
from imumon.protocols.text import NUMBER, line_frame, line_lengths, texts

BINARY = 0x80
END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0x0A, 0xDB, 0xDC, 0xDD
"""In a message, the first two are an escape and one of the others."""
TIME_SIZE = 8
YEARS_US = 1 << 58
"""Microseconds of 9000 years: a message that claims more began in the middle of another."""
DEGREE = pi / 180

MATRIX = [number(f"matrix_{i}{j}", "1", "rotation matrix") for i in "xyz" for j in "xyz"]


def _message(name: str, group: str, *parts: Part) -> Message:
    return field(name, floats("device_ticks", kind="u64"), *parts, group=group)


MESSAGES = {
    ord("I"): _message("inertial", MAIN, floats("gyro", DEGREE), floats("accel", STANDARD_GRAVITY)),
    ord("M"): _message("magnetometer", "mag",
                       axes("mag", "a.u.", "magnetic field, 1 when calibrated")),
    ord("T"): _message("temperature", "temperature", floats("temperature")),
    ord("Q"): _message("quaternion", "attitude", floats("q")),
    ord("A"): _message("euler", "attitude", floats("angles", DEGREE)),
    ord("R"): _message("matrix", "attitude", floats(MATRIX)),
    ord("L"): _message("linear", "attitude",
                       axes("free_accel", "m/s^2", "without gravity", STANDARD_GRAVITY)),
    ord("E"): _message("earth", "attitude",
                       axes("earth_accel", "m/s^2", "without gravity, in the reference frame",
                        STANDARD_GRAVITY)),
    ord("H"): _message("high_g", "high_g",
                       axes("accel_high_g", "m/s^2", "for high accelerations", STANDARD_GRAVITY)),
    ord("B"): _message("battery", "status", real("battery", "1", "charge, percent"),
                       real("battery_voltage", "V", "of the battery"),
                       real("charging", "1", "status of charging")),
    ord("W"): _message("rssi", "status", real("rssi_percent", "1", "strength of the radio signal"),
                       real("rssi_power", "1", "the same, dBm")),
    ord("Y"): _message("sync", "sync", real("sync_edge", "1", "edge at the input")),
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


def _as_binary(line: str) -> bytes:
    numbers = _numbers(line)
    assert numbers is not None
    return (
        line[:1].encode()
        + int(numbers[0]).to_bytes(TIME_SIZE, "little")
        + np.array(numbers[1:], "<f4").tobytes()
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
        lines = np.flatnonzero(found.kind >= len(MESSAGES))
        of_text = texts(found.held, found.at[lines], found.length[lines])
        binary = dict(zip(lines.tolist(), map(_as_binary, of_text), strict=True))
        return Found(plain, at, length, found.kind).replaced(binary)

    def _key(self, packet: bytes) -> int:
        return packet[0] & ~BINARY
