"""SBG Systems Ellipse, Ekinox, Quanta, Pulse: the logs of sbgECom.

Facts from the vendor's documentation and code.  Every log begins with the time since power-up.  The inertial
sensors come as IMU_SHORT (integers) or, from older firmware, as IMU_DATA; the rate and acceleration of logs
52 and 53 have bias, gravity and earth rate taken off, and are columns of their own.
"""

from fractions import Fraction

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, IntArray
from imumon.protocols.base import LONGEST_PACKET, ByteArray, Timing
from imumon.protocols.framing import Checksum, Frame, counted_length
from imumon.protocols.messages import FamilyDecoder, axes, counted, field, floats, gap, real
from imumon.protocols.numbers import Columns, Derived, count, known, number

SYNC, END = b"\xff\x5a", 0x33
HEADER, AROUND = 6, 9
LARGE = 0x80
"""Bit of the class of a page of a large log, whose payload begins with the number of the page."""
HIGH_RATE = 1 << 10
"""Bit of the status of IMU_SHORT: the rates have the scale of fast sensors."""
FAST, FINE = 12_304_174.0, 67_108_864.0

TIME = floats("device_ticks", kind="u32")
STATUS = floats("status", kind="u16")
RAW_RATE = tuple(count(f"_rate_{axis}", "rate as it is sent") for axis in "xyz")
FILTER = counted("filter_status", "mode of the filter and what it uses, bits", "u32")


def _to_rates(columns: Columns) -> list[ColumnArray]:
    scale = np.where(columns["status"] & HIGH_RATE, FAST, FINE)
    return [columns[column.name] / scale for column in RAW_RATE]


def _of_rates(columns: Columns) -> list[ColumnArray]:
    status = columns.get("status", np.zeros(len(columns["gyro_x"]), np.int64))
    scale = np.where(status & HIGH_RATE, FAST, FINE)
    return [np.rint(np.nan_to_num(columns[f"gyro_{axis}"]) * scale).astype(np.int64) for axis in "xyz"]


RATES = Derived(tuple(column.name for column in RAW_RATE), known("gyro"), _to_rates, _of_rates)

ANGLE_SIGMA = floats(
    [number(f"{name}_sigma", "rad", f"uncertainty of {name}") for name in ("roll", "pitch", "yaw")]
)
DECLINATION = (real("declination", "rad", "of the magnetic field")
               + real("inclination", "rad", "of the magnetic field"))  # fmt: skip
POSITION_SIGMA = [number(f"{name}_sigma", "m", f"uncertainty of the {name}")
                  for name in ("latitude", "longitude", "altitude")]  # fmt: skip

LOGS = {
    44: field("imu_short", TIME, STATUS, floats("accel", 2.0**-20, "i32"), floats(RAW_RATE, kind="i32"),
              floats("temperature", 1 / 256, "i16")),
    3: field("imu_data", TIME, STATUS, floats("accel"), floats("gyro"), floats("temperature"), gap(24),
             least=34),
    4: field("mag", TIME, counted("mag_status", "status of the magnetometer", "u16"),
             axes("mag", "a.u.", "field, 1 when calibrated"), gap(12), group="mag"),
    6: field("ekf_euler", TIME, floats("angles"), ANGLE_SIGMA, FILTER, DECLINATION, group="filter", least=32),
    7: field("ekf_quat", TIME, floats("q"), ANGLE_SIGMA, FILTER, DECLINATION, group="filter", least=36),
    8: field("ekf_nav", TIME, axes("velocity", "m/s", "velocity north, east, down"),
             axes("velocity_sigma", "m/s", "uncertainty of the velocity north, east, down"),
             floats("place", kind="f64"), real("undulation", "m", "of the geoid"), floats(POSITION_SIGMA),
             FILTER, group="filter"),
    1: field("status", TIME, counted("general_status", "power, temperature, processor, bits", "u16"), gap(2),
             counted("com_status", "ports, bits", "u32"),
             counted("aiding_status", "what aids the filter, bits", "u32"), gap(6),
             counted("up_time", "since power-up", "u32", "s"),
             counted("processor_load", "in use, percent", "u8"), group="status", least=22),
    2: field("utc_time", TIME, counted("clock_status", "clock and UTC, bits", "u16"), gap(11),
             counted("gps_time_of_week", "GPS time of week", "u32", "ms"), gap(12), group="clock", least=21),
    52: field("rate_body", TIME, gap(4),
              axes("gyro_compensated", "rad/s", "angular rate, bias and earth rate taken off"),
              axes("free_accel", "m/s^2", "acceleration without gravity and bias"),
              group="filter"),
    53: field("rate_ned", TIME, gap(4), axes("rate_ned", "rad/s",
                            "angular rate, bias and earth rate taken off, north, east, down"),
              axes("free_accel_ned", "m/s^2", "acceleration without gravity, north, east, down"),
              group="filter"),
    54: field("velocity_body", TIME, gap(4), axes("velocity_body", "m/s", "in the body"), gap(12),
              group="filter", least=20),
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
