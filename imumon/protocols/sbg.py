"""SBG Systems Ellipse, Ekinox, Quanta, Pulse: the logs of sbgECom.

Facts from the vendor's documentation and code.  Every log begins with the time since power-up.  The inertial
sensors come as IMU_SHORT (integers) or, from older firmware, as IMU_DATA; the rate and acceleration of logs
52 and 53 have bias, gravity and earth rate taken off, and are columns of their own.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, IntArray
from imumon.protocols.base import LONGEST_PACKET, ByteArray, Timing
from imumon.protocols.checks import Checksum
from imumon.protocols.framing import Frame, counted_length
from imumon.protocols.messages import FamilyDecoder, Message, part, whole
from imumon.protocols.numbers import Columns, Derived, count, known, number, vector

SYNC, END = b"\xff\x5a", 0x33
HEADER, AROUND = 6, 9
LARGE = 0x80
"""Bit of the class of a page of a large log, whose payload begins with the number of the page."""
HIGH_RATE = 1 << 10
"""Bit of the status of IMU_SHORT: the rates have the scale of fast sensors."""
FAST, FINE = 12_304_174.0, 67_108_864.0

TIME = part(0, "u32", "device_ticks")
STATUS = part(4, "u16", "status")
RAW_RATE = tuple(count(f"_rate_{axis}", "rate as it is sent") for axis in "xyz")
FILTER = count("filter_status", "mode of the filter and what it uses, bits")


def _to_rates(columns: Columns) -> list[ColumnArray]:
    scale = np.where(columns["status"] & HIGH_RATE, FAST, FINE)
    return [columns[column.name] / scale for column in RAW_RATE]


def _of_rates(columns: Columns) -> list[ColumnArray]:
    status = columns.get("status", np.zeros(len(columns["gyro_x"]), np.int64))
    scale = np.where(status & HIGH_RATE, FAST, FINE)
    return [np.rint(np.nan_to_num(columns[f"gyro_{axis}"]) * scale).astype(np.int64) for axis in "xyz"]


RATES = Derived(tuple(column.name for column in RAW_RATE), known("gyro"), _to_rates, _of_rates)

ANGLE_SIGMA = tuple(
    number(f"{name}_sigma", "rad", f"uncertainty of {name}") for name in ("roll", "pitch", "yaw")
)
DECLINATION = (number("declination", "rad", "of the magnetic field"),
               number("inclination", "rad", "of the magnetic field"))  # fmt: skip
VELOCITY = vector("velocity", "m/s", "velocity north, east, down")
VELOCITY_SIGMA = vector("velocity_sigma", "m/s", "uncertainty of the velocity north, east, down")
POSITION_SIGMA = tuple(number(f"{name}_sigma", "m", f"uncertainty of the {name}")
                       for name in ("latitude", "longitude", "altitude"))  # fmt: skip
FREE = (vector("gyro_compensated", "rad/s", "angular rate, bias and earth rate taken off"),
        vector("free_accel", "m/s^2", "acceleration without gravity and bias"))  # fmt: skip
NED = (vector("rate_ned", "rad/s", "angular rate, bias and earth rate taken off, north, east, down"),
       vector("free_accel_ned", "m/s^2", "acceleration without gravity, north, east, down"))  # fmt: skip

LOGS = {
    44: Message("imu_short", 32, (TIME, STATUS, part(6, "i32", "accel", 2.0**-20), part(18, "i32", RAW_RATE),
                                  part(30, "i16", "temperature", 1 / 256))),
    3: Message("imu_data", 58, (TIME, STATUS, part(6, "f32", "accel"), part(18, "f32", "gyro"),
                                part(30, "f32", "temperature")), least=34),
    4: Message("mag", 30, (TIME, whole(4, "u16", "mag_status", "status of the magnetometer"),
                           part(6, "f32", vector("mag", "a.u.", "field, 1 when calibrated"))), "mag"),
    6: Message("ekf_euler", 40, (TIME, part(4, "f32", "angles"), part(16, "f32", ANGLE_SIGMA),
                                 part(28, "u32", [FILTER]), part(32, "f32", DECLINATION)),
                "filter", least=32),
    7: Message("ekf_quat", 44, (TIME, part(4, "f32", "q"),
                                part(20, "f32", ANGLE_SIGMA), part(32, "u32", [FILTER]),
                                part(36, "f32", DECLINATION)), "filter", least=36),
    8: Message("ekf_nav", 72, (TIME, part(4, "f32", VELOCITY), part(16, "f32", VELOCITY_SIGMA),
                               part(28, "f64", "place"),
                               part(52, "f32", [number("undulation", "m", "of the geoid")]),
                               part(56, "f32", POSITION_SIGMA), part(68, "u32", [FILTER])), "filter"),
    1: Message("status", 27, (TIME, whole(4, "u16", "general_status", "power, temperature, processor, bits"),
                              whole(8, "u32", "com_status", "ports, bits"),
                              whole(12, "u32", "aiding_status", "what aids the filter, bits"),
                              whole(22, "u32", "up_time", "since power-up", "s"),
                              whole(26, "u8", "processor_load", "in use, percent")), "status", least=22),
    2: Message("utc_time", 33, (TIME, whole(4, "u16", "clock_status", "clock and UTC, bits"),
                                whole(17, "u32", "gps_time_of_week", "GPS time of week", "ms")), "clock",
               least=21),
    52: Message("rate_body", 32, (TIME, part(8, "f32", FREE[0]), part(20, "f32", FREE[1])), "filter"),
    53: Message("rate_ned", 32, (TIME, part(8, "f32", NED[0]), part(20, "f32", NED[1])), "filter"),
    54: Message("velocity_body", 32, (TIME, part(8, "f32", vector("velocity_body", "m/s", "in the body"))),
                "filter", least=20),
}  # fmt: skip
"""Logs of class 0 by their identifier, those with the inertial sensors first."""

_CRC = Checksum("crc16-kermit", first=2)


def _right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    return np.asarray((held[at + length - 1] == END) & _CRC(held, at, length - 1))


class SbgDecoder(FamilyDecoder):
    """Decodes the logs of class 0; all other frames are counted."""

    messages = LOGS
    frames = (Frame({SYNC: "sbgECom"}, counted_length(4, 2, AROUND, LONGEST_PACKET), _right),)
    timing = Timing(tick_ns=Fraction(1000), tick_bits=32)
    start, more, head = HEADER, AROUND, (2, 3)
    derived = (RATES,)

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a frame of a log of class 0."""
        size = len(payload).to_bytes(2, "little")
        return _CRC.sealed(SYNC + bytes([key, 0]) + size + payload) + bytes([END])

    def _key(self, packet: bytes) -> int:
        if packet[3] & LARGE:
            self._report("logs in several pages are counted and not read")
        return packet[2] if packet[3] == 0 else -1
