"""MicroStrain MIP (3DM-GX3 to GX5, CV5, CV7, GQ7, GV7): packets of one descriptor set, each a list of fields.

Facts from the data communications protocols of the devices and the public definitions of the vendor's SDK.
The fields of one moment may come in several packets, of which often only the first carries the time.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache, partial
from math import pi
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, ColumnArray
from imumon.columns import Column
from imumon.geodesy import STANDARD_GRAVITY as G
from imumon.protocols.base import MAIN, NO_GROUP, Encoder, Timing, chosen
from imumon.protocols.messages import (
    Message,
    Part,
    TableDevice,
    axes,
    counted,
    field,
    floats,
    gap,
    gnss,
    real,
)
from imumon.protocols.numbers import FROM_MATRIX, MATRIX, Columns, Derived, known, number, vector
from imumon.protocols.tagged import MIP, TaggedDecoder, tagged_encoder

GAUSS = 100.0
"""Gauss in µT."""
MILLIBAR = 100.0
"""Millibar in Pa."""
DEGREE = pi / 180

SENSOR, FILTER, SYSTEM = 0x80, 0x82, 0xA0
GNSS = {0x81: "gnss", 0x91: "gnss1", 0x92: "gnss2", 0x93: "gnss3", 0x94: "gnss4", 0x95: "gnss5"}
"""Descriptor sets of receivers, and how their columns begin."""

Attitude = Literal["filter", "imu"]
Clock = Literal["reference", "gps"]
Row = tuple[int, str, *tuple[Part, ...]]
"""Code, name, and the numbers one behind the other; without numbers a field is recognised and passed over."""


def valid(name: str) -> Part:
    """Return the flags that state whether a field is valid."""
    return counted(f"{name}_valid", f"validity of {name.replace('_', ' ')}", "u16")


def time_of_week(prefix: str) -> Part:
    """Return the GPS time of week in a field about the aiding."""
    return real(f"{prefix}_time_of_week", "s", "GPS time of week")


def receiver(prefix: str) -> Part:
    """Return the number of a receiver."""
    return counted(f"{prefix}_receiver", "number of the receiver", "u8")


def angles(prefix: str) -> tuple[Column, ...]:
    """Return roll, pitch and yaw, the canonical ones without a prefix."""
    names = known("angles")
    described = [number(prefix + angle.name, "rad", f"{angle.name} of another filter") for angle in names]
    return tuple(described) if prefix else names


GPS_TIME = (
    *real("gps_time_of_week", "s", "GPS time of week", "f64"),
    *counted("gps_week", "GPS week", "u16"),
    *valid("gps_time"),
)

_XYZ, _MATRIX, _SINGLE = ("_x", "_y", "_z"), tuple(f"_{i}{j}" for i in "123" for j in "123"), ("",)
_ESTIMATED = (
    (0x06, 0x0B, "GyroBias", "gyro_bias", _XYZ, "rad/s", "estimated gyroscope bias"),
    (0x07, 0x0C, "AccelBias", "accel_bias", _XYZ, "m/s^2", "estimated accelerometer bias"),
    (0, 0x08, "Position", "position", _XYZ, "m", "position north, east, down"),
    (0, 0x09, "Velocity", "velocity", _XYZ, "m/s", "velocity north, east, down"),
    (0, 0x0A, "Euler", "euler", _XYZ, "rad", "roll, pitch, yaw"),
    (0x0D, 0, "LinearAcceleration", "free_accel", _XYZ, "m/s^2", "acceleration without gravity"),
    (0x0E, 0, "CompensatedRate", "gyro_compensated", _XYZ, "rad/s", "angular rate less the estimated bias"),
    (0x13, 0, "GravityVector", "gravity", _XYZ, "m/s^2", "gravity in the body"),
    (0x16, 0x18, "GyroScale", "gyro_scale_error", _XYZ, "1", "estimated scale error of the gyroscope"),
    (0x17, 0x19, "AccelScale", "accel_scale_error", _XYZ, "1", "estimated scale error of the accelerometer"),
    (0x1A, 0x1B, "MagBias", "mag_bias", _XYZ, "uT", "estimated magnetometer bias"),
    (0x1C, 0, "CompensatedAcceleration", "accel_compensated", _XYZ, "m/s^2", "specific force less the bias"),
    (0x25, 0x28, "HardIron", "mag_hard_iron", _XYZ, "uT", "estimated hard iron"),
    (0x2C, 0, "MagResidual", "mag_residual", _XYZ, "uT", "residual of the magnetometer"),
    (0x30, 0x31, "AntennaOffset", "antenna_offset", _XYZ, "m", "estimated offset of the antenna"),
    (0, 0x36, "PositionEcef", "ecef", _XYZ, "m", "earth-fixed position"),
    (0x41, 0x37, "VelocityEcef", "ecef_velocity", _XYZ, "m/s", "velocity, earth-centred earth-fixed"),
    (0x26, 0x29, "SoftIron", "mag_soft_iron", _MATRIX, "1", "estimated soft iron"),
    (0x2A, 0, "MagCovariance", "mag_covariance", _MATRIX, "1",
     "covariance of the magnetometer, as it is sent"),
    (0x0F, 0, "GravityMagnitude", "gravity_magnitude", _SINGLE, "m/s^2", "gravity of WGS-84"),
    (0x21, 0, "PressureAltitude", "pressure_altitude", _SINGLE, "m", "altitude of the pressure"),
    (0x22, 0, "DensityAltitude", "density_altitude", _SINGLE, "m", "altitude of the density"),
    (0x47, 0x48, "OdometerScale", "odometer_scale_error", _SINGLE, "1",
     "estimated scale error of the odometer"),
)  # fmt: skip
"""Code, code of the uncertainty (0: none), name, column with its suffixes, unit and meaning."""


def _estimated() -> list[Row]:
    """Return fields of numbers of one unit, their uncertainties, and the validity of each."""
    rows: list[Row] = []
    for code, sigma, name, column, suffixes, unit, what in _ESTIMATED:
        for at, more, end, of in ((code, "", "", ""), (sigma, "Sigma", "_sigma", "uncertainty of: ")):
            columns = [
                number(column + end + suffix, unit, f"{of}{what}{suffix.replace('_', ', ')}")
                for suffix in suffixes
            ]
            values = floats(columns, GAUSS if unit == "uT" else 1.0)
            rows += [(at, name + more, values, valid(column + end))] if at else []
    return rows


_NOT_READ = {
    0x23: "MagScale", 0x24: "MagScaleSigma", 0x27: "CompensatedMag", 0x2B: "GravityCovariance",
    0x2D: "MagFilteredResidual",
}  # fmt: skip
"""Named by the vendor, who does not document their content."""
_AIDING = "status of the aiding, bits"


def _filter_fields(attitude: Attitude) -> list[Row]:
    own = attitude == "filter"
    quaternion = known("q") if own else vector("filter_q", "1", "attitude of the filter", "wxyz")
    return [
        (0x03, "Quaternion", floats(quaternion), valid("attitude")),
        (0x05, "Euler", floats(angles("" if own else "filter_")), valid("attitude")),
        (0x04, "Matrix", *((floats(MATRIX), valid("attitude")) if own else ())),
        (0x01, "Position", floats("place", kind="f64"), valid("position")),
        (0x02, "Velocity", axes("velocity", "m/s", "velocity north, east, down"),
         valid("velocity")),
        (0x11, "FilterGpsTime", GPS_TIME),
        (0x10, "FilterStatus", counted("filter_state", "state of the filter", "u16"),
         counted("filter_dynamics", "dynamics mode of the filter", "u16"),
         floats("status", kind="u16")),
        *_estimated(),
        (0x12, "QuaternionSigma", axes("q_sigma", "1", "uncertainty of the quaternion", letters="wxyz"),
         valid("q_sigma")),
        (0x14, "HeadingUpdate", real("filter_heading", "rad", "heading that aided the filter"),
         real("filter_heading_sigma", "rad", "uncertainty of that"),
         counted("heading_source", "what gave the heading, bits", "u16"),
         valid("filter_heading")),
        (0x15, "MagneticModel",
         axes("mag_model", "uT", "field of the world magnetic model north, east, down", GAUSS),
          real("inclination", "rad", "of the magnetic model"),
          real("declination", "rad", "of the magnetic model"), valid("mag_model")),
        (0x20, "StandardAtmosphere", real("geometric_altitude", "m", "standard atmosphere"),
          real("geopotential_altitude", "m", "standard atmosphere"),
          real("standard_temperature", "degC", "standard atmosphere"),
          real("standard_pressure", "Pa", "standard atmosphere", factor=MILLIBAR),
          real("standard_density", "kg/m^3", "standard atmosphere"), valid("standard_atmosphere")),
        (0x40, "PositionEcef", axes("ecef", "m", "position, earth-centred earth-fixed",
                                        kind="f64"), valid("ecef")),
        (0x42, "RelativePosition",
         axes("relative_position", "m", "from the reference place, north, east, down",
                  kind="f64"), valid("relative_position")),
        (0x32, "ClockCorrection", receiver("clock"), real("clock_bias", "m", "of the receiver"),
         real("clock_drift", "m/s", "of the receiver"), valid("clock")),
        (0x33, "ClockCorrectionSigma", receiver("clock_sigma"), real("clock_bias_sigma", "m", "uncertainty"),
          real("clock_drift_sigma", "m/s", "uncertainty"), valid("clock_sigma")),
        (0x34, "ReceiverAntennaOffset", receiver("antenna"),
          axes("receiver_antenna_offset", "m", "estimated offset of the antenna of a receiver"),
          valid("antenna")),
        (0x35, "ReceiverAntennaOffsetSigma", receiver("antenna_sigma"),
          axes("receiver_antenna_offset_sigma", "m", "uncertainty of that"),
          valid("antenna_sigma")),
        (0x43, "PositionAiding", receiver("position_aiding"), time_of_week("position_aiding"),
         counted("position_aiding_status", _AIDING, "u16"), gap(8)),
        (0x44, "AttitudeAiding", time_of_week("attitude_aiding"),
         counted("attitude_aiding_status", _AIDING, "u16"), gap(8)),
        (0x45, "HeadingAiding", time_of_week("heading_aiding"),
         counted("heading_aiding_type", "what aids", "u8"),
         gap(8)),
        (0x46, "AidingSummary", time_of_week("aiding"),
         counted("aiding_source", "number of the source", "u8"),
         counted("aiding_type", "kind of measurement", "u8"),
         counted("aiding_indicator", "what became of it, bits", "u8")),
        (0x49, "DualAntenna", time_of_week("antennas"),
         real("antennas_heading", "rad", "heading of two antennas"),
         real("antennas_heading_sigma", "rad", "uncertainty of that"),
         counted("antennas_fix", "kind of fix", "u8"),
         counted("antennas_status", "data of both receivers, bits", "u16"),
         valid("antennas")),
        *_NOT_READ.items(),
    ]  # fmt: skip


def _shared(clock: Clock) -> list[Row]:
    """Return the fields that every data set may carry."""
    ticks, own = floats("device_ticks", kind="u64"), counted("reference_time", "device clock", "u64", "ns")
    since = "since the last packet"
    return [
        (0xD5, "ReferenceTime", ticks if clock == "reference" else own),
        (0xD3, "GpsTime", GPS_TIME),
        (0xD7, "ExternalTime", counted("external_time", "external clock", "u64", "ns"),
         valid("external_time")),
        (0xD0, "EventSource", counted("event_source", "trigger of the packet; 0: none", "u8")),
        (0xD1, "Ticks", counted("base_ticks", "base periods since power-up", "u32")),
        (0xD2, "DeltaTicks", counted("delta_base_ticks", f"base periods {since}", "u32")),
        (0xD4, "DeltaTime", real("delta_time", "s", f"external time {since}", "f64")),
        (0xD6, "ReferenceTimeDelta", counted("delta_reference_time", since, "u64", "ns")),
        (0xD8, "ExternalTimeDelta", counted("delta_external_time", since, "u64", "ns"),
         valid("delta_external_time")),
    ]  # fmt: skip


def _sensor_fields(attitude: Attitude) -> list[Row]:
    own = attitude == "imu"
    quaternion = known("q") if own else vector("imu_q", "1", "attitude of the complementary filter", "wxyz")
    return [
        (0x05, "ScaledGyro", floats("gyro")),
        (0x04, "ScaledAccel", floats("accel", G)),
        (0x06, "ScaledMag", floats("mag", GAUSS)),
        (0x14, "Temperature", real("temperature_min", "degC", "lowest sensor temperature"),
         real("temperature_max", "degC", "highest sensor temperature"),
         real("temperature", "degC", "mean sensor temperature")),
        (0x17, "ScaledPressure", floats("pressure", MILLIBAR)),
        (0x0A, "ImuQuaternion", floats(quaternion)),
        (0x0C, "ImuEuler", floats(angles("" if own else "imu_"))),
        (0x09, "ImuMatrix", floats(MATRIX) if own else ()),
        (0x07, "DeltaTheta", axes("delta_theta", "rad", "rotation over the sample")),
        (0x08, "DeltaVelocity", axes("delta_velocity", "m/s", "velocity increment", G)),
        (0x10, "NorthVector", axes("north", "uT", "magnetic north in the body", GAUSS)),
        (0x11, "UpVector", axes("up", "m/s^2", "vertical in the body", G)),
        (0x12, "SensorGpsTime", GPS_TIME),
        (0x18, "Overrange", counted("overrange", "sensors out of range, bits", "u16")),
        (0x40, "Odometer", real("odometer_speed", "m/s", "speed of the odometer"),
         real("odometer_accuracy", "m/s", "accuracy of that speed"), valid("odometer")),
        (0x01, "RawAccel", axes("raw_accel", "1", "accelerometer, raw counts")),
        (0x02, "RawGyro", axes("raw_gyro", "1", "gyroscope, raw counts")),
        (0x03, "RawMag", axes("raw_mag", "1", "magnetometer, raw counts")),
        (0x16, "RawPressure", real("raw_pressure", "1", "pressure, raw counts")),
        (0x0B, "ImuUpdateMatrix"),
        (0x0D, "RawTemperature"),
        (0x0E, "InternalTimestamp", counted("internal_timestamp", "internal clock of old devices", "u32")),
        (0x0F, "PpsTimestamp", counted("pps_seconds", "time since the last pulse, s", "u32", "s"),
         counted("pps_microseconds", "and us", "u32", "us")),
    ]  # fmt: skip


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


def _gnss_fields(prefix: str) -> list[Row]:
    of = partial(gnss, prefix)
    return [
        (0x03, "Position", of("deg", "latitude", "longitude", kind="f64"),
         of("m", "altitude", "altitude_msl", kind="f64"),
         of("m", "horizontal_accuracy", "vertical_accuracy"),
         valid(f"{prefix}_position")),
        (0x05, "Velocity", of("m/s", "velocity_north", "velocity_east", "velocity_down", "speed",
                                "ground_speed"), of("rad", "course", factor=DEGREE),
         of("m/s", "speed_accuracy"), of("rad", "course_accuracy", factor=DEGREE),
         valid(f"{prefix}_velocity")),
        (0x07, "Dop", of("1", *(f"{x}dop" for x in "gphvtne")), valid(f"{prefix}_dop")),
    ]  # fmt: skip


@cache
def mip_fields(attitude: Attitude = "filter", clock: Clock = "reference") -> dict[int, Message]:
    """Return every field that is understood, by descriptor set and code: set << 8 | code.

    `attitude`: which set, the filter's or the sensors', has the canonical names of the attitude.
    `clock`: whether ``device_ticks`` is the reference time.
    """
    sets: dict[int, tuple[list[Row], Mapping[int, str], str]] = {
        SENSOR: (_sensor_fields(attitude), _SENSOR_GROUPS, MAIN),
        FILTER: (_filter_fields(attitude), {0x11: NO_GROUP}, "filter"),
        **{code: (_gnss_fields(prefix), {}, prefix) for code, prefix in GNSS.items()},
    }
    found = dict[int, Message]()
    for of_set, (rows, groups, usual) in sets.items():
        shared = {code: field(name, *parts, group=NO_GROUP) for code, name, *parts in _shared(clock)}
        own = {code: field(name, *parts, group=groups.get(code, usual)) for code, name, *parts in rows}
        found |= {of_set << 8 | code: item for code, item in (shared | own).items()}
    return found


WEEK_NS = 7 * 86_400 * 10**9

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

ACK = 0xF1
"""Field of an acknowledgement: command and code."""
ERRORS = {1: "unknown command", 2: "invalid checksum", 3: "invalid parameter", 4: "failed", 5: "timed out"}
"""Codes of an acknowledgement that is none."""


def fields_of(payload: bytes) -> list[tuple[int, bytes]]:
    """Return descriptor and data of the fields of a payload, as far as they make sense."""
    found = []
    while len(payload) >= 2 and 2 <= payload[0] <= len(payload):
        found.append((payload[1], payload[2 : payload[0]]))
        payload = payload[payload[0] :]
    return found


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


class MipDecoder(TaggedDecoder):
    """Decodes MIP data packets; commands and replies are counted by descriptor set.

    `attitude`: whether ``roll``, ``pitch``, ``yaw`` and ``q_*`` are those of the "filter" set or of the "imu"
        set (devices without a navigation filter); the others get columns of their own.
    `clock`: whether ``device_ticks`` is the "reference" time of newer devices, or "gps" time.
    """

    form, data, apart = MIP, (SENSOR, FILTER, *GNSS), (*GNSS.values(),)
    timing = Timing(tick_ns=Fraction(1))

    def __init__(
        self, attitude: Attitude = "filter", clock: Clock = "reference", rate_hz: float | None = None
    ) -> None:
        self.messages = mip_fields(attitude, clock)
        self.derived = (FROM_MATRIX, _GPS_CLOCK) if clock == "gps" else (FROM_MATRIX,)
        super().__init__(rate_hz)

    def encoder(self, names: Sequence[str], descriptor_set: int = SENSOR) -> Encoder:
        """Return an encoder of fields of one descriptor set; see `TableDecoder.encoder`."""
        of_set = {
            item.name: (key, item)
            for key, item in self.messages.items()
            if key >> 8 == descriptor_set and item.columns
        }
        fields = chosen(names, of_set, f"field of descriptor set 0x{descriptor_set:02X}")
        return tagged_encoder(MIP, descriptor_set, fields, self.derived)

    def _field(self, key: int, size: int) -> Message | None:
        found = self.messages.get(key)
        return found if found is not None and (found.size == size or found.size < 0) else None

    def _type_name(self, kind: int) -> str:
        return SET_NAMES.get(kind, f"set 0x{kind:02X}")

    def _field_name(self, key: int) -> str:
        name = self.messages[key].name if key in self.messages else f"0x{key & 0xFF:02X}"
        return f"{name} of {self._type_name(key >> 8)}"

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        for code, data in fields_of(payload) if kind not in DATA_SETS else ():
            if code == ACK and len(data) >= 2 and data[1]:
                why = ERRORS.get(data[1], f"code {data[1]}")
                yield f"the device refused command 0x{data[0]:02X} of the {self._type_name(kind)}: {why}"


class MipDevice(TableDevice):
    """Device file of a MicroStrain device."""

    protocol: Literal["mip"]
    attitude: Attitude = "filter"
    clock: Clock = "reference"

    def decoder(self) -> MipDecoder:
        """Make a decoder for this device."""
        return MipDecoder(self.attitude, self.clock, self.rate_hz)
