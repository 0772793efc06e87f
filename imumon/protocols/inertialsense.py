"""Inertial Sense IMX-5, uINS, uIMU: data sets of the ISB protocol.

Facts from the vendor's SDK and manual.  Temperature comes in other data sets than the inertial sensors, at
rates of its own.  PIMU carries increments, with the time over which they were summed.
"""

from fractions import Fraction
from functools import partial

import numpy as np

from imumon.blocks import ColumnArray, Columns

from .base import LONGEST_PACKET, Timing
from .framing import Checksum, Frame, counted_lengths
from .messages import FamilyDecoder, table
from .numbers import Derived, known

SYNC = b"\xef\x49"
HEADER, AROUND = 6, 8  # bytes before the payload, and of the packet besides the payload
FLETCHER = Checksum("fletcher16-256")
DATA, SET_DATA = 4, 5  # types of packets
WITH_OFFSET = 0x20  # bit of one that has a part of a data set
USUAL_S = 0.004
"""Time over which a virtual device sums increments where it is not stated, s.  Assumed."""

INCREMENTS = (
    "delta_time", "delta_theta_x", "delta_theta_y", "delta_theta_z",
    "delta_velocity_x", "delta_velocity_y", "delta_velocity_z",
)  # fmt: skip
RATES = known("gyro", "accel")  # in the order of the increments


def _mean_rates(columns: Columns) -> list[ColumnArray]:
    with np.errstate(all="ignore"):  # an interval of zero gives no rate
        means = [columns[name] / columns["delta_time"] for name in INCREMENTS[1:]]
    return [np.where(np.isfinite(mean), mean, np.nan) for mean in means]


def _with_increments(columns: Columns) -> list[ColumnArray]:
    interval = columns.get("delta_time", np.full(len(columns["gyro_x"]), USUAL_S))
    return [interval, *(columns[column.name] * interval for column in RATES)]


_TIME = "device_ticks f64*1e9"
_FILTER = """gps_week u32 1 GPS week | gps_time_of_week f64 s GPS
  | ins_status u32 1 status of the filter, bits | hardware_status u32 1 status of the hardware, bits"""
_MOVES = "velocity_body_xyz f32 m/s velocity in the body frame | place f64"
DATA_SETS = table(f"""
58 imu: {_TIME} | status u32 | gyro f32 | accel f32
97 imu_raw: {_TIME} | status u32 | gyro f32 | accel f32
3 pimu: {_TIME} | delta_time f32 s time over which the increments were summed | status u32
  | delta_theta_xyz f32 rad rotation over the sample | delta_velocity_xyz f32 m/s velocity increment
11 sys_sensors [sensors]: {_TIME} | temperature f32 | gyro f32 | accel f32 | mag f32 | pressure f32*kPa | 28
10 sys_params [temperature]: time_of_week_ms u32 ms GPS time of week | 8 | temperature f32 | 48
52 mag [mag]: {_TIME} | mag f32
53 baro [pressure]: {_TIME} | pressure f32*kPa | altitude_msl f32 m from the pressure
  | baro_temperature f32 degC of the barometer | 4
4 ins_1 [filter]: {_FILTER} | angles f32 | {_MOVES} | 12
5 ins_2 [filter]: {_FILTER} | q f32 | {_MOVES}
""")


class InertialSenseDecoder(FamilyDecoder):
    """Decodes data sets that come whole; other packets are counted."""

    messages = DATA_SETS
    frames = (Frame({SYNC: "ISB"}, partial(counted_lengths, 4, 2, AROUND, LONGEST_PACKET), FLETCHER),)
    timing = Timing(tick_ns=Fraction(1))
    start, overhead, head = HEADER, AROUND, (2, 3)
    derived = (Derived(INCREMENTS, RATES, _mean_rates, _with_increments),)

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a packet of a data set."""
        return FLETCHER.sealed(SYNC + bytes([DATA, key]) + len(payload).to_bytes(2, "little") + payload)

    def _key(self, packet: bytes) -> int:
        flags = packet[2]
        if flags & WITH_OFFSET:
            self._report("data sets that come in part are counted and not read")
        return packet[3] if flags & (WITH_OFFSET | 0x0F) in (DATA, SET_DATA) else -1
