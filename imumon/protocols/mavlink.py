"""MAVLink 1 and 2 over a serial line: the inertial messages of ArduPilot and PX4.

Facts from the protocol's documentation and the common dialect; the checksum has a byte for each message, so a
message that is not in the table cannot be checked and is not read.  Version 2 leaves out zeros at the end.
Only the first vehicle of which more than a heartbeat comes is read: a stream may hold many, and a gimbal.

SCALED_IMU and RAW_IMU have rates in steps of 1 mrad/s, 206 deg/h.
"""

from fractions import Fraction
from functools import partial

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, Columns, IntArray

from .base import ByteArray, Timing
from .decoder import Layouts
from .framing import CRCS, IMPOSSIBLE, INCOMPLETE, Checksum, Found, Frame, by_distance, integers, windows
from .messages import FamilyDecoder, table
from .numbers import Derived, known

SECOND = b"\xfd"  # first byte of a message of version 2
FIRST_HEADER, SECOND_HEADER = 6, 10
HEADERS = {b"\xfe": FIRST_HEADER, SECOND: SECOND_HEADER}
NUMBER_SIZES = {FIRST_HEADER: 1, SECOND_HEADER: 3}  # bytes of the message's number, which ends the header
VEHICLE_AT, NUMBER_AT = 5, 7  # in version 2: number and component of the sender, number of the message
SIGNATURE = 13
SIGNED = 1
COARSE = "rates of SCALED_IMU and RAW_IMU have steps of 206 deg/h; finer: HIGHRES_IMU, but PX4 corrects it"
LONGEST = 64  # bytes of the longest payload in the table, with its extensions


def _to_celsius(columns: Columns) -> list[ColumnArray]:
    raw = columns["_hundredths"]
    return [np.where(raw == 0, np.nan, raw / 100)]


def _of_celsius(columns: Columns) -> list[ColumnArray]:
    raw = np.rint(np.nan_to_num(columns["temperature"]) * 100)
    return [np.where(np.isnan(columns["temperature"]), 0, np.where(raw == 0, 1, raw)).astype(np.int64)]


_VECTORS = "accel i16*g/1000 | gyro i16*0.001 | mag i16*gauss/1000"
_CELSIUS = "_hundredths i16 1 temperature, 0 when there is none"
_FILTER = "gyro_compensated_xyz f32 rad/s angular rate less the filter's bias"
MESSAGES = table(f"""
105 highres_imu: device_ticks u64 | accel f32 | gyro f32 | mag f32*gauss | pressure f32*hPa | 4
  | pressure_altitude f32 m from the pressure | temperature f32 | updated u16 1 which values are new, bits | 1
26 scaled_imu: device_ticks u32*1000 | {_VECTORS} | {_CELSIUS}
27 raw_imu: device_ticks u64 | {_VECTORS} | 1 | {_CELSIUS}
29 scaled_pressure [pressure]: device_ticks u32*1000 | pressure f32*hPa | 8
30 attitude [attitude]: device_ticks u32*1000 | angles f32 | {_FILTER}
31 attitude_quaternion [attitude]: device_ticks u32*1000 | q f32 | {_FILTER}
0 heartbeat [vehicle]: vehicle_mode u32 1 mode of the vehicle | 5
""")
"""Messages by their number; the second and third sensors (116, 129) are only counted."""
OF_VEHICLE = (*(MESSAGES.keys() - {0}),)
"""Messages of which the first decides the vehicle; a heartbeat may be that of a gimbal or a radio."""
EXTRA = {0: 50, 2: 137, 26: 170, 27: 144, 29: 115, 30: 39, 31: 246, 105: 93, 107: 108, 111: 34, 116: 76,
         129: 46}  # fmt: skip
"""Byte of each message that the checksum counts behind the last."""
EXTRAS = np.zeros(256, np.int64)
EXTRAS[[*EXTRA]] = [*EXTRA.values()]
_CRC = Checksum("crc16-mcrf4xx")
_OF_LAST_BYTE = by_distance(CRCS["crc16-mcrf4xx"], 1)[0]  # distance 0 first: what the last byte adds
_BEFORE_EXTRA = Checksum("crc16-mcrf4xx", zeros=1)


def _number(held: ByteArray, at: IntArray, header: int) -> IntArray:
    size = NUMBER_SIZES[header]
    return integers(held, at + header - size, size)


def _length(header: int, held: ByteArray, at: IntArray) -> IntArray:
    result = np.full_like(at, INCOMPLETE)
    there = np.flatnonzero(at + header <= len(held))
    begin = at[there]
    number, size = _number(held, begin, header), header + 2 + held[begin + 1].astype(np.int64)
    good = np.isin(number, [*EXTRA])
    if header == SECOND_HEADER:
        flags = held[begin + 2]
        size += SIGNATURE * (flags & SIGNED)
        good &= flags <= SIGNED
    result[there] = np.where(good, size, IMPOSSIBLE)
    return result


def _right(header: int, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    signature = SIGNATURE * (held[at + 2] & SIGNED) if header == SECOND_HEADER else 0
    end = at + length - signature
    extra = EXTRAS[_number(held, at, header)]
    # The CRC is linear: that of a zero in the place of the extra byte, and what this adds.
    crc = _BEFORE_EXTRA.values(held, at + 1, end - 2) ^ _OF_LAST_BYTE[extra]
    return np.asarray(crc == integers(held, end - 2, 2))


class MavlinkDecoder(FamilyDecoder):
    """Decodes the messages of the first vehicle that sends more than a heartbeat, from there on."""

    messages = MESSAGES
    frames = tuple(
        Frame({sync: f"MAVLink {k + 1}"}, partial(_length, header), partial(_right, header))
        for k, (sync, header) in enumerate(HEADERS.items())
    )
    timing = Timing(tick_ns=Fraction(1000))
    start, overhead, head = SECOND_HEADER, SECOND_HEADER, range(NUMBER_AT, SECOND_HEADER)
    derived = (Derived(("_hundredths",), known("temperature"), _to_celsius, _of_celsius),)
    _vehicle = -1  # component << 8 | number of the vehicle that is read

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a message of version 2, which leaves out zeros at the end."""
        payload = payload.rstrip(b"\0") or b"\0"
        body = bytes([len(payload), 0, 0, 0, 1, 1]) + key.to_bytes(3, "little") + payload
        return SECOND + body + _CRC.sealed(body + bytes([EXTRA[key]]))[-2:]

    def _plain(self, found: Found) -> Found:
        """Return the messages as those of version 2 with all their zeros."""
        size = SECOND_HEADER + LONGEST
        held = np.zeros((len(found), size), np.uint8)
        padded = np.pad(found.held, (0, LONGEST))
        for kind, header in enumerate(HEADERS.values()):
            rows = np.flatnonzero(found.kind == kind)
            at = found.at[rows]
            size_of_both = 2 + NUMBER_SIZES[header]  # vehicle and number
            both = windows(found.held, at + header - size_of_both, size_of_both)
            held[rows, VEHICLE_AT : VEHICLE_AT + size_of_both] = both
            there = np.arange(LONGEST) < found.held[at + 1][:, None]
            held[rows, SECOND_HEADER:] = windows(padded, at + header, LONGEST) * there
        begins = np.arange(len(found)) * size
        return Found(held.reshape(-1), begins, np.full(len(found), size), found.kind)

    def _key(self, packet: bytes) -> int:
        key = int.from_bytes(packet[NUMBER_AT:SECOND_HEADER], "little")
        if key in (26, 27):
            self._report(COARSE, is_warning=True)
        return key

    def _by_layout(self, found: Found) -> Layouts:
        vehicle = integers(found.held, found.at + VEHICLE_AT, 2)
        first = 0
        if self._vehicle < 0:
            number = _number(found.held, found.at, SECOND_HEADER)
            of_vehicle = np.flatnonzero(np.isin(number, OF_VEHICLE))
            if not len(of_vehicle):
                return ()
            first = int(of_vehicle[0])
            self._vehicle = int(vehicle[first])
        mine = first + np.flatnonzero(vehicle[first:] == self._vehicle)
        if len(mine) < len(found) - first:
            component, system = divmod(self._vehicle, 256)
            self._report(f"only vehicle {system}, component {component} is read of several")
        return ((layout, mine[rows]) for layout, rows in super()._by_layout(found.only(mine)))
