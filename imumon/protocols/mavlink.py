"""MAVLink 1 and 2 over a serial line: the inertial messages of ArduPilot and PX4.

Facts from the protocol's documentation and the common dialect; the checksum has a byte for each message, so a
message that is not in the table cannot be checked and is not read.  Version 2 leaves out zeros at the end.
Only the first vehicle that is received is read: a stream may hold many.

SCALED_IMU and RAW_IMU have rates in steps of 1 mrad/s, 206 deg/h.
"""

from fractions import Fraction
from functools import partial

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, IntArray
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import ByteArray, Timing
from imumon.protocols.framing import (
    CRCS,
    IMPOSSIBLE,
    INCOMPLETE,
    Checksum,
    Found,
    Frame,
    by_distance,
    integers,
    windows,
)
from imumon.protocols.messages import FamilyDecoder, Message, Part, counted, field, floats, gap, real
from imumon.protocols.numbers import Columns, Derived, count, known, vector

FIRST, SECOND = b"\xfe", b"\xfd"
HEADERS = {FIRST: 6, SECOND: 10}
SIGNATURE = 13
SIGNED = 1
GAUSS, HECTOPASCAL = 100.0, 100.0
LONGEST = 64
"""Bytes of the longest payload in the table, with its extensions."""

HUNDREDTHS = count("_hundredths", "temperature, 0 when there is none")
FILTER_RATE = vector("gyro_compensated", "rad/s", "angular rate less the filter's bias")


def _to_celsius(columns: Columns) -> list[ColumnArray]:
    raw = columns[HUNDREDTHS.name]
    return [np.where(raw == 0, np.nan, raw / 100)]


def _of_celsius(columns: Columns) -> list[ColumnArray]:
    raw = np.rint(np.nan_to_num(columns["temperature"]) * 100)
    return [np.where(np.isnan(columns["temperature"]), 0, np.where(raw == 0, 1, raw)).astype(np.int64)]


CELSIUS = Derived((HUNDREDTHS.name,), known("temperature"), _to_celsius, _of_celsius)


def _imu(name: str, ticks: Part, unread: Part) -> Message:
    vectors = floats("accel", STANDARD_GRAVITY / 1000, "i16") + floats("gyro", 1e-3, "i16")
    field_of_earth, celsius = floats("mag", GAUSS / 1000, "i16"), floats([HUNDREDTHS], kind="i16")
    return field(name, ticks, vectors, field_of_earth, unread, celsius, least=1)


MILLISECONDS, MICROSECONDS = floats("device_ticks", 1000.0, "u32"), floats("device_ticks", kind="u64")
MESSAGES = {
    105: field("highres_imu", MICROSECONDS, floats("accel"), floats("gyro"), floats("mag", GAUSS),
               floats("pressure", HECTOPASCAL), gap(4), real("pressure_altitude", "m", "from the pressure"),
               floats("temperature"), counted("updated", "which values are new, bits", "u16"), gap(1),
               least=1),
    26: _imu("scaled_imu", MILLISECONDS, gap(0)),
    27: _imu("raw_imu", MICROSECONDS, gap(1)),
    29: field("scaled_pressure", MILLISECONDS, floats("pressure", HECTOPASCAL), gap(8), group="pressure",
              least=1),
    30: field("attitude", MILLISECONDS, floats("angles"), floats(FILTER_RATE), group="attitude", least=1),
    31: field("attitude_quaternion", MILLISECONDS, floats("q"), floats(FILTER_RATE), group="attitude",
              least=1),
    0: field("heartbeat", counted("vehicle_mode", "mode of the vehicle", "u32"), gap(5), group="vehicle",
             least=1),
}  # fmt: skip
"""Messages by their number; the second and third sensors (116, 129) are only counted."""
EXTRA = {0: 50, 2: 137, 26: 170, 27: 144, 29: 115, 30: 39, 31: 246, 105: 93, 107: 108, 111: 34, 116: 76,
         129: 46}  # fmt: skip
"""Byte of each message that the checksum counts behind the last."""
EXTRAS = np.full(256, -1)
EXTRAS[list(EXTRA)] = [*EXTRA.values()]
_CRC = Checksum("crc16-mcrf4xx")
_OF_LAST_BYTE = by_distance(CRCS["crc16-mcrf4xx"], 1)[0]
"""What the last byte adds to the CRC, by its value."""
_BEFORE_EXTRA = Checksum("crc16-mcrf4xx", zeros=1)


def _number(held: ByteArray, at: IntArray, header: int) -> IntArray:
    size = 1 if header == HEADERS[FIRST] else 3
    return integers(held, at + header - size, size)


def _length(header: int, held: ByteArray, at: IntArray) -> IntArray:
    result = np.full(len(at), INCOMPLETE, np.int64)
    there = np.flatnonzero(at + header <= len(held))
    begin = at[there]
    number, size = _number(held, begin, header), header + 2 + held[begin + 1].astype(np.int64)
    good = (number < len(EXTRAS)) & (EXTRAS[number % len(EXTRAS)] >= 0)
    if header == HEADERS[SECOND]:
        flags = held[begin + 2]
        size += SIGNATURE * (flags & SIGNED)
        good &= flags <= SIGNED
    result[there] = np.where(good, size, IMPOSSIBLE)
    return result


def _right(header: int, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    signature = SIGNATURE * (held[at + 2] & SIGNED) if header == HEADERS[SECOND] else 0
    end, extra = at + length - signature, EXTRAS[_number(held, at, header)]
    # The CRC is linear: that of a zero in the place of the extra byte, and what this adds.
    crc = _BEFORE_EXTRA.values(held, at + 1, end - 2) ^ _OF_LAST_BYTE[extra]
    return np.asarray(crc == integers(held, end - 2, 2))


class MavlinkDecoder(FamilyDecoder):
    """Decodes the inertial messages of the first vehicle that is received."""

    messages = MESSAGES
    frames = tuple(
        Frame({sync: f"MAVLink {k + 1}"}, partial(_length, header), partial(_right, header))
        for k, (sync, header) in enumerate(HEADERS.items())
    )
    timing = Timing(tick_ns=Fraction(1000))
    start, more, head = HEADERS[SECOND], HEADERS[SECOND], (5, 6, 7, 8, 9)
    derived = (CELSIUS,)
    _vehicle = b""

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a message of version 2, which leaves out zeros at the end."""
        payload = payload.rstrip(b"\0") or b"\0"
        body = bytes([len(payload), 0, 0, 0, 1, 1]) + key.to_bytes(3, "little") + payload
        return SECOND + body + _CRC.sealed(body + bytes([EXTRA[key]]))[-2:]

    def _plain(self, found: Found) -> Found:
        """Return the messages as those of version 2 with all their zeros."""
        size = HEADERS[SECOND] + LONGEST
        held, padded = np.zeros((len(found), size), np.uint8), np.pad(found.held, (0, LONGEST))
        for kind, header in enumerate(HEADERS.values()):
            rows = np.flatnonzero(found.kind == kind)
            at = found.at[rows]
            numbers = 1 if header == HEADERS[FIRST] else 3
            held[rows, 5 : 7 + numbers] = windows(found.held, at + header - numbers - 2, 2 + numbers)
            there = np.arange(LONGEST) < found.held[at + 1][:, np.newaxis]
            held[rows, HEADERS[SECOND] :] = windows(padded, at + header, LONGEST) * there
        begins = np.arange(len(found)) * size
        return Found(held.reshape(-1), begins, np.full(len(found), size), found.kind)

    def _key(self, packet: bytes) -> int:
        vehicle, key = packet[5:7], int.from_bytes(packet[7:10], "little")
        self._vehicle = self._vehicle or vehicle
        if key in (26, 27):
            self._warn("rates of SCALED_IMU and RAW_IMU have steps of 206 deg/h: HIGHRES_IMU is finer")
        if vehicle != self._vehicle:
            number, component = self._vehicle
            self._report(f"only vehicle {number}, component {component} is read of several")
            return -1
        return key
