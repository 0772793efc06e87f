"""Inertial Sense IMX-5, uINS, uIMU: data sets of the ISB protocol.

Facts from the vendor's SDK and manual.  Temperature comes in other data sets than the inertial sensors, at
rates of its own.  PIMU carries increments, with the time over which they were summed.
"""

from fractions import Fraction

import numpy as np

from imumon.blocks import ColumnArray
from imumon.protocols.base import LONGEST_PACKET, Timing
from imumon.protocols.framing import Checksum, Frame, counted_length
from imumon.protocols.messages import FamilyDecoder, axes, counted, field, floats, gap, real
from imumon.protocols.numbers import Columns, Derived, known, number, vector

SYNC = b"\xef\x49"
HEADER, AROUND = 6, 8
FLETCHER = Checksum("fletcher16-256")
DATA, SET_DATA, WITH_OFFSET = 4, 5, 0x20
KILOPASCAL = 1000.0
USUAL_S = 0.004
"""Time over which a virtual device sums increments where it is not stated, s."""

TIME, STATUS = floats("device_ticks", 1e9, "f64"), floats("status", kind="u32")
DELTA_TIME = [number("delta_time", "s", "time over which the increments were summed")]
THETA = vector("delta_theta", "rad", "rotation over the sample")
DELTA_VELOCITY = vector("delta_velocity", "m/s", "velocity increment")
BODY_VELOCITY = axes("velocity_body", "m/s", "velocity in the body frame")
OF_FILTER = (
    *counted("gps_week", "GPS week", "u32"),
    *real("gps_time_of_week", "s", "GPS", "f64"),
    *counted("ins_status", "status of the filter, bits", "u32"),
    *counted("hardware_status", "status of the hardware, bits", "u32"),
)


def _mean_rates(columns: Columns) -> list[ColumnArray]:
    with np.errstate(all="ignore"):  # an interval of zero gives no rate
        means = [columns[c.name] / columns["delta_time"] for c in (*THETA, *DELTA_VELOCITY)]
    return [np.where(np.isfinite(mean), mean, np.nan) for mean in means]


def _with_increments(columns: Columns) -> list[ColumnArray]:
    interval = columns.get("delta_time", np.full(len(columns["gyro_x"]), USUAL_S))
    return [interval, *(columns[column.name] * interval for column in known("gyro", "accel"))]


MEANS = Derived(tuple(c.name for c in (*DELTA_TIME, *THETA, *DELTA_VELOCITY)), known("gyro", "accel"),
                _mean_rates, _with_increments)  # fmt: skip

SAMPLE = (TIME, STATUS, floats("gyro"), floats("accel"))
PRESSURE = floats("pressure", KILOPASCAL)
DATA_SETS = {
    58: field("imu", *SAMPLE),
    97: field("imu_raw", *SAMPLE),
    3: field("pimu", TIME, floats(DELTA_TIME), STATUS, floats(THETA), floats(DELTA_VELOCITY)),
    11: field("sys_sensors", TIME, floats("temperature"), floats("gyro"), floats("accel"), floats("mag"),
              PRESSURE, gap(28), group="sensors"),
    10: field("sys_params", counted("time_of_week_ms", "GPS time of week", "u32", "ms"), gap(8),
              floats("temperature"), gap(48), group="temperature"),
    52: field("mag", TIME, floats("mag"), group="mag"),
    53: field("baro", TIME, PRESSURE, real("altitude_msl", "m", "from the pressure"),
              real("baro_temperature", "degC", "of the barometer"), gap(4), group="pressure"),
    4: field("ins_1", OF_FILTER, floats("angles"), BODY_VELOCITY, floats("place", kind="f64"), gap(12),
             group="filter"),
    5: field("ins_2", OF_FILTER, floats("q"), BODY_VELOCITY, floats("place", kind="f64"), group="filter"),
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
