"""MicroStrain MIP (3DM-GX3 to GX5, CV5, CV7, GQ7, GV7): packets of one descriptor set, each a list of fields.

Facts from the data communications protocols of the devices and the public definitions of the vendor's SDK.
The fields of one moment may come in several packets, of which often only the first carries the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cache
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, ColumnArray
from imumon.columns import KNOWN, Column
from imumon.geodesy import STANDARD_GRAVITY as G
from imumon.protocols.base import MAIN, Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.messages import ANY_SIZE, Message, field
from imumon.protocols.mip_filter import (
    GAUSS,
    GPS_TIME,
    MILLIBAR,
    Attitude,
    Row,
    angles,
    counted,
    doubles,
    filter_fields,
    floats,
    valid,
)
from imumon.protocols.numbers import NO_GROUP, Columns, Derived, Number
from imumon.protocols.quantities import MATRIX, QUATERNION_OF_MATRIX, count, known, number, vector
from imumon.protocols.tagged import MIP, TaggedDecoder, TaggedEncoder

WEEK_NS = 7 * 86_400 * 10**9

SENSOR, FILTER, SYSTEM = 0x80, 0x82, 0xA0
GNSS = {0x81: "gnss", 0x91: "gnss1", 0x92: "gnss2", 0x93: "gnss3", 0x94: "gnss4", 0x95: "gnss5"}
"""Descriptor sets of receivers, and how their columns begin."""

SET_NAMES = {
    0x01: "base commands",
    0x0C: "3DM commands",
    0x0D: "filter commands",
    0x0E: "GNSS commands",
    0x0F: "RTK commands",
    0x13: "aiding commands",
    0x7F: "system commands",
    SENSOR: "sensor data",
    FILTER: "filter data",
    SYSTEM: "system data",
    **{code: f"{prefix.upper()} data" for code, prefix in GNSS.items()},
}
"""Names of the descriptor sets."""

DATA_SETS = range(0x80, 0x100)
"""Those without fields for a row are counted; commands and replies are messages."""

ERRORS = {1: "unknown command", 2: "invalid checksum", 3: "invalid parameter", 4: "failed", 5: "timed out"}
"""Codes of an acknowledgement that is none."""

Clock = Literal["reference", "gps"]


def _shared(clock: Clock) -> dict[int, Message]:
    """Return the fields that every data set may carry."""
    reference = (
        KNOWN["device_ticks"] if clock == "reference" else count("reference_time", "device clock", "ns")
    )
    since = "since the last packet"
    table: list[Row] = [
        (0xD5, "ReferenceTime", (Number(reference, "u64"),)),
        (0xD3, "GpsTime", GPS_TIME),
        (0xD7, "ExternalTime", (counted("external_time", "external clock", "u64", "ns"),
                                valid("external_time"))),
        (0xD0, "EventSource", (counted("event_source", "trigger of the packet; 0: none", "u8"),)),
        (0xD1, "Ticks", (counted("base_ticks", "base periods since power-up", "u32"),)),
        (0xD2, "DeltaTicks", (counted("delta_base_ticks", f"base periods {since}", "u32"),)),
        (0xD4, "DeltaTime", doubles((number("delta_time", "s", f"external time {since}"),))),
        (0xD6, "ReferenceTimeDelta", (counted("delta_reference_time", since, "u64", "ns"),)),
        (0xD8, "ExternalTimeDelta", (counted("delta_external_time", since, "u64", "ns"),
                                     valid("delta_external_time"))),
    ]  # fmt: skip
    return {code: field(name, numbers, NO_GROUP) for code, name, numbers in table}


def _sensor_fields(attitude: Attitude) -> dict[int, Message]:
    own = attitude == "imu"
    quaternion = known("q") if own else vector("imu_q", "1", "attitude of the complementary filter", "wxyz")
    temperatures = (
        number("temperature_min", "degC", "lowest sensor temperature"),
        number("temperature_max", "degC", "highest sensor temperature"),
        number("temperature", "degC", "mean sensor temperature"),
    )
    odometer = (
        number("odometer_speed", "m/s", "speed of the odometer"),
        number("odometer_accuracy", "m/s", "accuracy of that speed"),
    )
    table: list[Row] = [
        (0x05, "ScaledGyro", floats("gyro")),
        (0x04, "ScaledAccel", floats("accel", G)),
        (0x06, "ScaledMag", floats("mag", GAUSS)),
        (0x14, "Temperature", floats(temperatures)),
        (0x17, "ScaledPressure", floats("pressure", MILLIBAR)),
        (0x0A, "ImuQuaternion", floats(quaternion)),
        (0x0C, "ImuEuler", floats(angles("" if own else "imu_"))),
        (0x09, "ImuMatrix", floats(MATRIX) if own else ()),
        (0x07, "DeltaTheta", floats(vector("delta_theta", "rad", "rotation over the sample"))),
        (0x08, "DeltaVelocity", floats(vector("delta_velocity", "m/s", "velocity increment"), G)),
        (0x10, "NorthVector", floats(vector("north", "uT", "magnetic north in the body"), GAUSS)),
        (0x11, "UpVector", floats(vector("up", "m/s^2", "vertical in the body"), G)),
        (0x12, "SensorGpsTime", GPS_TIME),
        (0x18, "Overrange", (counted("overrange", "sensors out of range, bits", "u16"),)),
        (0x40, "Odometer", (*floats(odometer), valid("odometer"))),
        (0x01, "RawAccel", floats(vector("raw_accel", "1", "accelerometer, raw counts"))),
        (0x02, "RawGyro", floats(vector("raw_gyro", "1", "gyroscope, raw counts"))),
        (0x03, "RawMag", floats(vector("raw_mag", "1", "magnetometer, raw counts"))),
        (0x16, "RawPressure", floats((number("raw_pressure", "1", "pressure, raw counts"),))),
        (0x0B, "ImuUpdateMatrix", ()),
        (0x0D, "RawTemperature", ()),
        (0x0E, "InternalTimestamp", (counted("internal_timestamp", "internal clock of old devices", "u32"),)),
        (0x0F, "PpsTimestamp", (counted("pps_seconds", "time since the last pulse, s", "u32", "s"),
                                counted("pps_microseconds", "and us", "u32", "us"))),
    ]  # fmt: skip
    return {code: field(name, numbers, _SENSOR_GROUPS.get(code, MAIN)) for code, name, numbers in table}


_SENSOR_GROUPS = {
    **dict.fromkeys((0x03, 0x06, 0x10), "mag"),
    **dict.fromkeys((0x0D, 0x14), "temperature"),
    **dict.fromkeys((0x16, 0x17), "pressure"),
    **dict.fromkeys((0x09, 0x0A, 0x0B, 0x0C, 0x11), "attitude"),
    **dict.fromkeys((0x0E, 0x0F, 0x12), NO_GROUP),
    0x18: "status",
    0x40: "odometer",
}
"""What of the sensor set is not inertial."""


def _gnss_fields(prefix: str) -> dict[int, Message]:
    def of(*names_and_units: tuple[str, str]) -> tuple[Column, ...]:
        return tuple(
            number(f"{prefix}_{name}", unit, f"receiver {prefix}: {name}") for name, unit in names_and_units
        )

    place = of(("latitude", "deg"), ("longitude", "deg"), ("altitude", "m"), ("altitude_msl", "m"))
    accuracy = of(("horizontal_accuracy", "m"), ("vertical_accuracy", "m"))
    motion = of(("velocity_north", "m/s"), ("velocity_east", "m/s"), ("velocity_down", "m/s"),
                ("speed", "m/s"), ("ground_speed", "m/s"))  # fmt: skip
    degree = np.pi / 180
    velocity = (*floats(motion), *floats(of(("course", "rad")), degree),
                *floats(of(("speed_accuracy", "m/s"))), *floats(of(("course_accuracy", "rad")), degree),
                valid(f"{prefix}_velocity"))  # fmt: skip
    dilutions = floats(of(*((f"{x}dop", "1") for x in "gphvtne")))
    table: list[Row] = [
        (0x03, "Position", (*doubles(place), *floats(accuracy), valid(f"{prefix}_position"))),
        (0x05, "Velocity", velocity),
        (0x07, "Dop", (*dilutions, valid(f"{prefix}_dop"))),
    ]
    return {code: field(name, numbers, prefix) for code, name, numbers in table}


@cache
def mip_fields(attitude: Attitude = "filter", clock: Clock = "reference") -> dict[int, Message]:
    """Return every field that is understood, by descriptor set and code: set << 8 | code."""
    sets = {SENSOR: _sensor_fields(attitude), FILTER: filter_fields(attitude)}
    sets |= {code: _gnss_fields(prefix) for code, prefix in GNSS.items()}
    shared = _shared(clock)
    return {of << 8 | code: item for of, own in sets.items() for code, item in (shared | own).items()}


def _gps_to_ticks(columns: Columns) -> list[ColumnArray]:
    """GPS time in ns since the GPS epoch."""
    week, second = columns["gps_week"], columns["gps_time_of_week"]
    there = (week != NO_INT) & np.isfinite(second) & (np.abs(second) < 1e6)
    of_week = np.rint(np.where(there, second, 0) * 1e9).astype(np.int64)
    return [np.where(there, np.where(there, week, 0) * WEEK_NS + of_week, NO_INT)]


def _ticks_to_gps(columns: Columns) -> list[ColumnArray]:
    ticks = columns["device_ticks"]
    there = ticks != NO_INT
    week, of_week = np.divmod(np.where(there, ticks, 0), WEEK_NS)
    return [np.where(there, week, NO_INT), np.where(there, of_week / 1e9, np.nan)]


_GPS_CLOCK = Derived(("gps_week", "gps_time_of_week"), known("device_ticks"), _gps_to_ticks, _ticks_to_gps)


def _derived(clock: Clock) -> tuple[Derived, ...]:
    return (QUATERNION_OF_MATRIX, _GPS_CLOCK) if clock == "gps" else (QUATERNION_OF_MATRIX,)


class MipDecoder(TaggedDecoder):
    """Decodes MIP data packets; commands and replies are counted by descriptor set.

    `attitude`: whether ``roll``, ``pitch``, ``yaw`` and ``q_*`` are those of the "filter" set or of the "imu"
        set (devices without a navigation filter); the others get columns of their own.
    `clock`: whether ``device_ticks`` is the "reference" time of newer devices, or "gps" time.
    """

    def __init__(
        self, attitude: Attitude = "filter", clock: Clock = "reference", rate_hz: float | None = None
    ) -> None:
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        self._fields = mip_fields(attitude, clock)
        sets = (SENSOR, FILTER, *GNSS)
        super().__init__(MIP, timing, self._fields.values(), sets, _derived(clock), [*GNSS.values()])

    def _field(self, key: int, size: int) -> Message | None:
        found = self._fields.get(key)
        return found if found is not None and found.size in (size, ANY_SIZE) else None

    def _type_name(self, kind: int) -> str:
        return SET_NAMES.get(kind, f"set 0x{kind:02X}")

    def _field_name(self, key: int) -> str:
        name = self._fields[key].name if key in self._fields else f"0x{key & 0xFF:02X}"
        return f"{name} of {self._type_name(key >> 8)}"

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        while kind not in DATA_SETS and len(payload) >= 2 and 2 <= payload[0] <= len(payload):
            if payload[1] == 0xF1 and payload[0] >= 4 and payload[3]:
                why = ERRORS.get(payload[3], f"code {payload[3]}")
                yield f"the device refused command 0x{payload[2]:02X} of the {self._type_name(kind)}: {why}"
            payload = payload[payload[0] :]


class MipEncoder(TaggedEncoder):
    """Makes MIP data packets of one descriptor set.

    Raises BAD_CONFIG when there is no such field in the set.

    `names` are sent in their order.
    """

    def __init__(
        self,
        names: Sequence[str],
        descriptor_set: int = SENSOR,
        attitude: Attitude = "filter",
        clock: Clock = "reference",
    ) -> None:
        there = {
            item.name: (key, item)
            for key, item in mip_fields(attitude, clock).items()
            if key >> 8 == descriptor_set and item.columns
        }
        fields = chosen(names, there, f"field of descriptor set 0x{descriptor_set:02X}")
        super().__init__(MIP, descriptor_set, fields, _derived(clock))


class MipDevice(DeviceFile):
    """Device file of a MicroStrain device; `sends` is for its virtual twin alone."""

    protocol: Literal["mip"]
    attitude: Attitude = "filter"
    clock: Clock = "reference"
    sends: list[str]

    def decoder(self) -> MipDecoder:
        """Make a decoder for this device."""
        return MipDecoder(self.attitude, self.clock, self.rate_hz)

    def encoder(self) -> MipEncoder:
        """Make an encoder that sends what the device would send."""
        return MipEncoder(self.sends, SENSOR, self.attitude, self.clock)
