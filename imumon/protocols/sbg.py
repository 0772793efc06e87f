"""SBG Systems Ellipse, Ekinox, Quanta, Pulse: the logs of sbgECom.

Facts from the vendor's documentation and code.  Every log begins with the time since power-up.  The inertial
sensors come as IMU_SHORT (integers) or, from older firmware, as IMU_DATA; the rate and acceleration of logs
52 and 53 have bias, gravity and earth rate taken off, and are columns of their own.
"""

from fractions import Fraction
from functools import partial

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, Columns, IntArray

from .base import LONGEST_PACKET, ByteArray, Timing
from .framing import Checksum, Frame, counted_lengths
from .messages import FamilyDecoder, table
from .numbers import Derived, known

SYNC, END = b"\xff\x5a", 0x33
HEADER, AROUND = 6, 9  # bytes before the payload, and of the frame besides the payload
LARGE = 0x80  # bit of the class of a page of a large log, whose payload begins with the number of the page
HIGH_RATE = 1 << 10  # bit of the status of IMU_SHORT: the rates have the scale of fast sensors
FAST, FINE = 12_304_174.0, 2.0**26  # counts per rad/s; fast: 2**31 are 10 000 deg/s

RAW_RATE = tuple(f"_rate_{axis}" for axis in "xyz")


def _to_rates(columns: Columns) -> list[ColumnArray]:
    scale = np.where(columns["status"] & HIGH_RATE, FAST, FINE)
    return [columns[name] / scale for name in RAW_RATE]


def _of_rates(columns: Columns) -> list[ColumnArray]:
    status = columns.get("status", np.zeros(len(columns["gyro_x"]), np.int64))
    scale = np.where(status & HIGH_RATE, FAST, FINE)
    raw = [np.rint(np.nan_to_num(columns[f"gyro_{axis}"]) * scale).astype(np.int64) for axis in "xyz"]
    return [*raw, status]


_FILTER = "filter_status u32 1 mode of the filter and what it uses, bits"
_ACCURACY = f"""roll_sigma f32 rad uncertainty of roll | pitch_sigma f32 rad uncertainty of pitch
  | yaw_sigma f32 rad uncertainty of yaw | {_FILTER}
  | declination f32 rad of the magnetic field | inclination f32 rad of the magnetic field"""
LOGS = table(f"""
44 imu_short: device_ticks u32 | status u16 | accel i32/1048576 | _rate_xyz i32 1 rate as it is sent
  | temperature i16/256
3 imu_data >=34: device_ticks u32 | status u16 | accel f32 | gyro f32 | temperature f32 | 24
4 mag [mag]: device_ticks u32 | mag_status u16 1 status of the magnetometer
  | mag_xyz f32 a.u. field, 1 when calibrated | 12
6 ekf_euler [filter] >=32: device_ticks u32 | angles f32 | {_ACCURACY}
7 ekf_quat [filter] >=36: device_ticks u32 | q f32 | {_ACCURACY}
8 ekf_nav [filter]: device_ticks u32 | velocity_xyz f32 m/s velocity north, east, down
  | velocity_sigma_xyz f32 m/s uncertainty of the velocity north, east, down | place f64
  | undulation f32 m of the geoid | latitude_sigma f32 m uncertainty of the latitude
  | longitude_sigma f32 m uncertainty of the longitude | altitude_sigma f32 m uncertainty of the altitude
  | {_FILTER}
1 status [status] >=22: device_ticks u32 | general_status u16 1 power, temperature, processor, bits | 2
  | com_status u32 1 ports, bits | aiding_status u32 1 what aids the filter, bits | 6
  | up_time u32 s since power-up | processor_load u8 1 in use, percent
2 utc_time [clock] >=21: device_ticks u32 | clock_status u16 1 clock and UTC, bits | 11
  | gps_time_of_week u32 ms GPS time of week | 12
52 rate_body [filter]: device_ticks u32 | 4
  | gyro_compensated_xyz f32 rad/s angular rate, bias and earth rate taken off
  | free_accel_xyz f32 m/s^2 acceleration without gravity and bias
53 rate_ned [filter]: device_ticks u32 | 4
  | rate_ned_xyz f32 rad/s angular rate, bias and earth rate taken off, north, east, down
  | free_accel_ned_xyz f32 m/s^2 acceleration without gravity, north, east, down
54 velocity_body [filter] >=20: device_ticks u32 | 4 | velocity_body_xyz f32 m/s in the body | 12
""")
"""Logs of class 0 by their identifier, those with the inertial sensors first."""

_CRC = Checksum("crc16-kermit", first=2)


def _right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    return np.asarray((held[at + length - 1] == END) & _CRC(held, at, length - 1))


class SbgDecoder(FamilyDecoder):
    """Decodes the logs of class 0; all other frames are counted."""

    messages = LOGS
    frames = (Frame({SYNC: "sbgECom"}, partial(counted_lengths, 4, 2, AROUND, LONGEST_PACKET), _right),)
    timing = Timing(tick_ns=Fraction(1000), tick_bits=32)
    start, overhead, head = HEADER, AROUND, (2, 3)
    derived = (Derived((*RAW_RATE, "status"), known("gyro"), _to_rates, _of_rates),)

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a frame of a log of class 0."""
        size = len(payload).to_bytes(2, "little")
        return _CRC.sealed(SYNC + bytes([key, 0]) + size + payload) + bytes([END])

    def _key(self, packet: bytes) -> int:
        if packet[3] & LARGE:
            self._report("logs in several pages are counted and not read")
        return packet[2] if packet[3] == 0 else -1
