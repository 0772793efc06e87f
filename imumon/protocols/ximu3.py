"""x-io x-IMU3: binary and text data messages, as they come by USB, serial, network, or in ``.ximu3`` files.

Facts from the vendor's software.  A message ends with a line feed; its first byte, an upper-case letter (plus
0x80 when binary), names its kind.  There is no checksum: a message counts when it has exactly its length (or
its numbers) and a time that a device can have run.  Temperature comes in messages of its own, five a second.
"""

from fractions import Fraction
from functools import partial

import numpy as np

from imumon.blocks import BoolArray, IntArray

from .base import ByteArray, Timing
from .framing import Found, Frame
from .messages import FamilyDecoder, table
from .text import NUMBER, line_frame, line_lengths, texts

BINARY = 0x80
END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0x0A, 0xDB, 0xDC, 0xDD
"""In a message an end is sent as an escape and the third, an escape as two bytes: itself and the fourth."""
TIME_SIZE = 8
YEARS_US = 1 << 58  # microseconds of 9000 years: a message that claims more began in the middle of another

_MATRIX = " | ".join(f"matrix_{i}{j} f32 1 rotation matrix" for i in "xyz" for j in "xyz")
MESSAGES = table(f"""
I inertial: device_ticks u64 | gyro f32*deg | accel f32*g
M magnetometer [mag]: device_ticks u64 | mag_xyz f32 a.u. magnetic field, 1 when calibrated
T temperature [temperature]: device_ticks u64 | temperature f32
Q quaternion [attitude]: device_ticks u64 | q f32
A euler [attitude]: device_ticks u64 | angles f32*deg
R matrix [attitude]: device_ticks u64 | {_MATRIX}
L linear [attitude]: device_ticks u64 | free_accel_xyz f32*g m/s^2 without gravity
E earth [attitude]: device_ticks u64 | earth_accel_xyz f32*g m/s^2 without gravity, in the reference frame
H high_g [high_g]: device_ticks u64 | accel_high_g_xyz f32*g m/s^2 for high accelerations
B battery [status]: device_ticks u64 | battery f32 1 charge, percent | battery_voltage f32 V of the battery
  | charging f32 1 status of charging
W rssi [status]: device_ticks u64 | rssi_percent f32 1 strength of the radio signal
  | rssi_power f32 1 the same, dBm
Y sync [sync]: device_ticks u64 | sync_edge f32 1 edge at the input
""")
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
    in_time = plain[np.minimum(begin + TIME_SIZE, len(plain) - 1)] < YEARS_US >> 56  # highest byte
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
            partial(line_lengths, begins_with_end=False),
            _right,
        ),
        line_frame({b"%c," % key: f"{message.name} text" for key, message in MESSAGES.items()}, _numbers),
    )
    timing = Timing(tick_ns=Fraction(1000))
    start, overhead, head = 1, 1, (0,)

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
