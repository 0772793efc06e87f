"""Inertial Sense IMX-5, uINS, uIMU: data sets of the ISB protocol.

Facts from the vendor's SDK and manual.  Temperature comes in other data sets than the inertial sensors, at
rates of its own.  PIMU carries increments, with the time over which they were summed.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Final

import numpy as np

from imumon.blocks import ColumnArray
from imumon.protocols.base import LONGEST_PACKET, Timing
from imumon.protocols.checks import Checksum
from imumon.protocols.framing import Frame, counted_length
from imumon.protocols.messages import FamilyDecoder, Message, part, whole
from imumon.protocols.numbers import Columns, Derived, known, number, vector

SYNC = b"\xef\x49"
HEADER, AROUND = 6, 8
FLETCHER = Checksum("fletcher16-256")
DATA, SET_DATA, WITH_OFFSET = 4, 5, 0x20
KILOPASCAL: Final = 1000.0
USUAL_S: Final = 0.004
"""Time over which a virtual device sums increments where it is not stated, s."""

TIME = part(0, "f64", "device_ticks", 1e9)
DELTA_TIME = [number("delta_time", "s", "time over which the increments were summed")]
THETA = vector("delta_theta", "rad", "rotation over the sample")
DELTA_VELOCITY = vector("delta_velocity", "m/s", "velocity increment")
BODY_VELOCITY = vector("velocity_body", "m/s", "velocity in the body frame")
OF_WEEK = (whole(0, "u32", "gps_week", "GPS week"), part(4, "f64", [number("gps_time_of_week", "s", "GPS")]))
FILTER = (whole(12, "u32", "ins_status", "status of the filter, bits"),
          whole(16, "u32", "hardware_status", "status of the hardware, bits"))  # fmt: skip


def _mean_rates(columns: Columns) -> list[ColumnArray]:
    with np.errstate(all="ignore"):  # an interval of zero gives no rate
        means = [columns[c.name] / columns["delta_time"] for c in (*THETA, *DELTA_VELOCITY)]
    return [np.where(np.isfinite(mean), mean, np.nan) for mean in means]


def _with_increments(columns: Columns) -> list[ColumnArray]:
    interval = columns.get("delta_time", np.full(len(columns["gyro_x"]), USUAL_S))
    return [interval, *(columns[column.name] * interval for column in known("gyro", "accel"))]


MEANS = Derived(tuple(c.name for c in (*DELTA_TIME, *THETA, *DELTA_VELOCITY)), known("gyro", "accel"),
                _mean_rates, _with_increments)  # fmt: skip

SAMPLE = (TIME, part(8, "u32", "status"), part(12, "f32", "gyro"), part(24, "f32", "accel"))
DATA_SETS = {
    58: Message("imu", 36, SAMPLE),
    97: Message("imu_raw", 36, SAMPLE),
    3: Message("pimu", 40, (TIME, part(8, "f32", DELTA_TIME), part(12, "u32", "status"),
                            part(16, "f32", THETA), part(28, "f32", DELTA_VELOCITY))),
    11: Message("sys_sensors", 80, (TIME, part(8, "f32", "temperature"), part(12, "f32", "gyro"),
                                    part(24, "f32", "accel"), part(36, "f32", "mag"),
                                    part(48, "f32", "pressure", KILOPASCAL)), "sensors"),
    10: Message("sys_params", 64, (whole(0, "u32", "time_of_week_ms", "GPS time of week", "ms"),
                                   part(12, "f32", "temperature")), "temperature"),
    52: Message("mag", 20, (TIME, part(8, "f32", "mag")), "mag"),
    53: Message("baro", 24, (TIME, part(8, "f32", "pressure", KILOPASCAL),
                             part(12, "f32", [number("altitude_msl", "m", "from the pressure")]),
                             part(16, "f32", [number("baro_temperature", "degC", "of the barometer")])),
                "pressure"),
    4: Message("ins_1", 80, (*OF_WEEK, *FILTER, part(20, "f32", "angles"), part(32, "f32", BODY_VELOCITY),
                             part(44, "f64", "place")), "filter"),
    5: Message("ins_2", 72, (*OF_WEEK, *FILTER, part(20, "f32", "q"),
                             part(36, "f32", BODY_VELOCITY), part(48, "f64", "place")), "filter"),
}  # fmt: skip
"""Data sets by their identifier."""


class InertialSenseDecoder(FamilyDecoder):
    """Decodes data sets that come whole; other packets are counted."""

    messages = DATA_SETS
    frames = (Frame({SYNC: "ISB"}, counted_length(4, 2, AROUND, LONGEST_PACKET), FLETCHER),)
    timing = Timing(tick_ns=Fraction(1))
    start, more, head = HEADER, AROUND, (2, 3)
    derived = (MEANS,)

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a packet of a data set."""
        return FLETCHER.sealed(SYNC + bytes([DATA, key]) + len(payload).to_bytes(2, "little") + payload)

    def _key(self, packet: bytes) -> int:
        flags = packet[2]
        if flags & WITH_OFFSET:
            self._report("data sets that come in part are counted and not read")
        return packet[3] if flags & (WITH_OFFSET | 0x0F) in (DATA, SET_DATA) else -1
