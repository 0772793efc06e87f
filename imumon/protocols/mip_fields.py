"""The data sets of MIP: every field, as the vendor's public definitions have it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import pi
from typing import Literal

from imumon.columns import KNOWN, Column
from imumon.geodesy import STANDARD_GRAVITY as G
from imumon.protocols.base import MAIN
from imumon.protocols.messages import Message, field
from imumon.protocols.numbers import NO_GROUP, Number
from imumon.protocols.quantities import MATRIX, count, known, number, vector

GAUSS = 100.0
"""Gauss in µT."""
MILLIBAR = 100.0
"""Millibar in Pa."""

SENSOR, FILTER, SYSTEM = 0x80, 0x82, 0xA0
GNSS = {0x81: "gnss", 0x91: "gnss1", 0x92: "gnss2", 0x93: "gnss3", 0x94: "gnss4", 0x95: "gnss5"}
"""Descriptor sets of receivers, and how their columns begin."""

Attitude = Literal["filter", "imu"]
Clock = Literal["reference", "gps"]
Row = tuple[int, str, tuple[Number, ...]]


def floats(columns: str | Iterable[Column], factor: float = 1.0) -> tuple[Number, ...]:
    """Return numbers of four bytes; a canonical quantity goes by its name."""
    there = known(columns) if isinstance(columns, str) else columns
    return tuple(Number(column, "f32", factor) for column in there)


def doubles(columns: Iterable[Column]) -> tuple[Number, ...]:
    """Return numbers of eight bytes."""
    return tuple(Number(column, "f64") for column in columns)


def counted(name: str, description: str, kind: str, unit: str = "1") -> Number:
    """Return an integer."""
    return Number(count(name, description, unit), kind)


def valid(name: str) -> Number:
    """Return the flags that say whether a field is valid."""
    return counted(f"{name}_valid", f"validity of {name.replace('_', ' ')}", "u16")


GPS_TIME = (
    Number(number("gps_time_of_week", "s", "GPS time of week"), "f64"),
    counted("gps_week", "GPS week", "u16"),
    valid("gps_time"),
)


def angles(prefix: str) -> tuple[Column, ...]:
    """Return roll, pitch and yaw, the canonical ones without a prefix."""
    names = known("angles")
    described = [number(prefix + angle.name, "rad", f"{angle.name} of another filter") for angle in names]
    return tuple(described) if prefix else names


_VECTORS = (
    (0x06, 0x0B, "GyroBias", "gyro_bias", "rad/s", "estimated gyroscope bias"),
    (0x07, 0x0C, "AccelBias", "accel_bias", "m/s^2", "estimated accelerometer bias"),
    (0, 0x08, "Position", "position", "m", "position north, east, down"),
    (0, 0x09, "Velocity", "velocity", "m/s", "velocity north, east, down"),
    (0, 0x0A, "Euler", "euler", "rad", "roll, pitch, yaw"),
    (0x0D, 0, "LinearAcceleration", "free_accel", "m/s^2", "acceleration without gravity"),
    (0x0E, 0, "CompensatedRate", "gyro_compensated", "rad/s", "angular rate less the estimated bias"),
    (0x13, 0, "GravityVector", "gravity", "m/s^2", "gravity in the body"),
    (0x16, 0x18, "GyroScale", "gyro_scale_error", "1", "estimated scale error of the gyroscope"),
    (0x17, 0x19, "AccelScale", "accel_scale_error", "1", "estimated scale error of the accelerometer"),
    (0x1A, 0x1B, "MagBias", "mag_bias", "uT", "estimated magnetometer bias"),
    (0x1C, 0, "CompensatedAcceleration", "accel_compensated", "m/s^2", "specific force less the bias"),
    (0x25, 0x28, "HardIron", "mag_hard_iron", "uT", "estimated hard iron"),
    (0x2C, 0, "MagResidual", "mag_residual", "uT", "residual of the magnetometer"),
    (0x30, 0x31, "AntennaOffset", "antenna_offset", "m", "estimated offset of the antenna"),
    (0, 0x36, "PositionEcef", "ecef", "m", "earth-fixed position"),
    (0x41, 0x37, "VelocityEcef", "ecef_velocity", "m/s", "velocity, earth-centred earth-fixed"),
)
"""Code, code of the uncertainty (0: none), name, column, unit and meaning of three numbers."""

_MATRICES = (
    (0x26, 0x29, "SoftIron", "mag_soft_iron", "1", "estimated soft iron"),
    (0x2A, 0, "MagCovariance", "mag_covariance", "1", "covariance of the magnetometer, as it is sent"),
)
_SINGLE = (
    (0x0F, 0, "GravityMagnitude", "gravity_magnitude", "m/s^2", "gravity of WGS-84"),
    (0x21, 0, "PressureAltitude", "pressure_altitude", "m", "altitude of the pressure"),
    (0x22, 0, "DensityAltitude", "density_altitude", "m", "altitude of the density"),
    (0x47, 0x48, "OdometerScale", "odometer_scale_error", "1", "estimated scale error of the odometer"),
)
_SUFFIXES = (
    (_VECTORS, ("_x", "_y", "_z")),
    (_MATRICES, tuple(f"_{i}{j}" for i in "123" for j in "123")),
    (_SINGLE, ("",)),
)
"""How the columns of these end."""
_NOT_READ = (
    (0x23, "MagScale"), (0x24, "MagScaleSigma"), (0x27, "CompensatedMag"), (0x2B, "GravityCovariance"),
    (0x2D, "MagFilteredResidual"),
)  # fmt: skip
"""Named by the vendor without saying what is in them."""


def _estimated() -> list[Row]:
    """Return fields of numbers of one unit, their uncertainties, and the validity of each."""
    found = []
    for table, suffixes in _SUFFIXES:
        for code, sigma, name, column, unit, what in table:
            for at, more, of in ((code, "", ""), (sigma, "Sigma", "uncertainty of: ")):
                own = column + more.replace("Sigma", "_sigma")
                columns = [
                    number(own + suffix, unit, f"{of}{what}{suffix.replace('_', ', ')}")
                    for suffix in suffixes
                ]
                values = (*floats(columns, GAUSS if unit == "uT" else 1.0), valid(own))
                found += [(at, name + more, values)] if at else []
    return found


def _aiding() -> list[Row]:
    """Return fields about what aids the filter."""

    def receiver(prefix: str) -> Number:
        return counted(f"{prefix}_receiver", "number of the receiver", "u8")

    def tow(prefix: str) -> Number:
        return Number(number(f"{prefix}_time_of_week", "s", "GPS time of week"), "f32")

    def passed(kind: str, n: int) -> tuple[Number, ...]:
        return (Number(None, kind),) * n

    offset = vector("receiver_antenna_offset", "m", "estimated offset of the antenna of a receiver")
    offset_sigma = vector("receiver_antenna_offset_sigma", "m", "uncertainty of that")
    clock = (number("clock_bias", "m", "of the receiver"), number("clock_drift", "m/s", "of the receiver"))
    clock_sigma = (
        number("clock_bias_sigma", "m", "uncertainty"),
        number("clock_drift_sigma", "m/s", "uncertainty"),
    )
    antennas = (number("antennas_heading", "rad", "heading of two antennas"),
                number("antennas_heading_sigma", "rad", "uncertainty of that"))  # fmt: skip
    status = "status of the aiding, bits"
    return [
        (0x32, "ClockCorrection", (receiver("clock"), *floats(clock), valid("clock"))),
        (0x33, "ClockCorrectionSigma", (receiver("clock_sigma"), *floats(clock_sigma), valid("clock_sigma"))),
        (0x34, "ReceiverAntennaOffset", (receiver("antenna"), *floats(offset), valid("antenna"))),
        (0x35, "ReceiverAntennaOffsetSigma",
         (receiver("antenna_sigma"), *floats(offset_sigma), valid("antenna_sigma"))),
        (0x43, "PositionAiding", (receiver("position_aiding"), tow("position_aiding"),
                                  counted("position_aiding_status", status, "u16"), *passed("u64", 1))),
        (0x44, "AttitudeAiding", (tow("attitude_aiding"), counted("attitude_aiding_status", status, "u16"),
                                  *passed("u64", 1))),
        (0x45, "HeadingAiding", (tow("heading_aiding"), counted("heading_aiding_type", "what aids", "u8"),
                                 *passed("f32", 2))),
        (0x46, "AidingSummary", (tow("aiding"), counted("aiding_source", "number of the source", "u8"),
                                 counted("aiding_type", "kind of measurement", "u8"),
                                 counted("aiding_indicator", "what became of it, bits", "u8"))),
        (0x49, "DualAntenna", (tow("antennas"), *floats(antennas),
                               counted("antennas_fix", "kind of fix", "u8"),
                               counted("antennas_status", "data of both receivers, bits", "u16"),
                               valid("antennas"))),
    ]  # fmt: skip


def _models() -> list[Row]:
    """Return fields of the filter's models and of heading and place in other forms."""
    heading = (number("filter_heading", "rad", "heading that aided the filter"),
               number("filter_heading_sigma", "rad", "uncertainty of that"))  # fmt: skip
    earth = vector("mag_model", "uT", "field of the world magnetic model north, east, down")
    dip = (number("inclination", "rad", "of the magnetic model"),
           number("declination", "rad", "of the magnetic model"))  # fmt: skip
    air = (number("geometric_altitude", "m", "standard atmosphere"),
           number("geopotential_altitude", "m", "standard atmosphere"),
           number("standard_temperature", "degC", "standard atmosphere"))  # fmt: skip
    pressure = (number("standard_pressure", "Pa", "standard atmosphere"),)
    density = (number("standard_density", "kg/m^3", "standard atmosphere"),)
    sigma = vector("q_sigma", "1", "uncertainty of the quaternion", "wxyz")
    place = vector("ecef", "m", "position, earth-centred earth-fixed")
    relative = vector("relative_position", "m", "from the reference place, north, east, down")
    return [
        (0x12, "QuaternionSigma", (*floats(sigma), valid("q_sigma"))),
        (0x14, "HeadingUpdate", (*floats(heading),
                                 counted("heading_source", "what gave the heading, bits", "u16"),
                                 valid("filter_heading"))),
        (0x15, "MagneticModel", (*floats(earth, GAUSS), *floats(dip), valid("mag_model"))),
        (0x20, "StandardAtmosphere", (*floats(air), *floats(pressure, MILLIBAR), *floats(density),
                                      valid("standard_atmosphere"))),
        (0x40, "PositionEcef", (*doubles(place), valid("ecef"))),
        (0x42, "RelativePosition", (*doubles(relative), valid("relative_position"))),
    ]  # fmt: skip


def filter_fields(attitude: Attitude) -> dict[int, Message]:
    """Return the fields of the filter set by their codes.

    `attitude`: whether that of this set ("filter") or of the sensor set ("imu") has the canonical names.
    """
    own = attitude == "filter"
    quaternion = known("q") if own else vector("filter_q", "1", "attitude of the filter", "wxyz")
    status = (
        counted("filter_state", "state of the filter", "u16"),
        counted("filter_dynamics", "dynamics mode of the filter", "u16"),
        Number(KNOWN["status"], "u16"),
    )
    velocity = vector("velocity", "m/s", "velocity north, east, down")
    table: list[Row] = [
        (0x03, "Quaternion", (*floats(quaternion), valid("attitude"))),
        (0x05, "Euler", (*floats(angles("" if own else "filter_")), valid("attitude"))),
        (0x04, "Matrix", (*floats(MATRIX), valid("attitude")) if own else ()),
        (0x01, "Position", (*doubles(known("place")), valid("position"))),
        (0x02, "Velocity", (*floats(velocity), valid("velocity"))),
        (0x11, "FilterGpsTime", GPS_TIME),
        (0x10, "FilterStatus", status),
        *_estimated(),
        *_models(),
        *_aiding(),
        *((code, name, ()) for code, name in _NOT_READ),
    ]  # fmt: skip
    return {
        code: field(name, numbers, NO_GROUP if code == 0x11 else "filter") for code, name, numbers in table
    }


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
    degree = pi / 180
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
