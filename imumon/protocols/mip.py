"""MicroStrain MIP (3DM-GX3 to GX5, CV5, CV7, GQ7, GV7): packets of one descriptor set, each a list of fields.

Facts from the data communications protocols of the devices and the public definitions of the vendor's SDK.
The fields of one moment may come in several packets, of which often only the first carries the time.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, Columns

from .base import NO_GROUP, Encoder, Timing, chosen
from .messages import Message, TableDevice, table
from .numbers import FROM_MATRIX, Derived, known
from .tagged import MIP, TaggedDecoder

SENSOR, FILTER = 0x80, 0x82
GNSS = {0x81: "gnss", 0x91: "gnss1", 0x92: "gnss2", 0x93: "gnss3", 0x94: "gnss4", 0x95: "gnss5"}
"""Descriptor sets of receivers, and how their columns begin."""

Attitude = Literal["filter", "imu"]
Clock = Literal["reference", "gps"]

_GPS_TIME = """gps_time_of_week f64 s GPS time of week | gps_week u16 1 GPS week
  | gps_time_valid u16 1 validity of gps time"""
_VALID = "attitude_valid u16 1 validity of attitude"
_ESTIMATED = """
06 0B GyroBias filter_gyro_bias.xyz f32 rad/s estimated gyroscope bias
07 0C AccelBias accel_bias.xyz f32 m/s^2 estimated accelerometer bias
00 08 Position position.xyz f32 m position north, east, down
00 09 Velocity velocity.xyz f32 m/s velocity north, east, down
00 0A Euler euler.xyz f32 rad roll, pitch, yaw
0D 00 LinearAcceleration free_accel.xyz f32 m/s^2 acceleration without gravity
0E 00 CompensatedRate gyro_compensated.xyz f32 rad/s angular rate less the estimated bias
13 00 GravityVector gravity.xyz f32 m/s^2 gravity in the body
16 18 GyroScale gyro_scale_error.xyz f32 1 estimated scale error of the gyroscope
17 19 AccelScale accel_scale_error.xyz f32 1 estimated scale error of the accelerometer
1A 1B MagBias mag_bias.xyz f32*gauss uT estimated magnetometer bias
1C 00 CompensatedAcceleration accel_compensated.xyz f32 m/s^2 specific force less the bias
25 28 HardIron mag_hard_iron.xyz f32*gauss uT estimated hard iron
2C 00 MagResidual mag_residual.xyz f32*gauss uT residual of the magnetometer
30 31 AntennaOffset antenna_offset.xyz f32 m estimated offset of the antenna
00 36 PositionEcef ecef.xyz f32 m earth-fixed position
41 37 VelocityEcef ecef_velocity.xyz f32 m/s velocity, earth-centred earth-fixed
26 29 SoftIron mag_soft_iron.3x3 f32 1 estimated soft iron
2A 00 MagCovariance mag_covariance.3x3 f32 1 covariance of the magnetometer, as it is sent
0F 00 GravityMagnitude gravity_magnitude f32 m/s^2 gravity of WGS-84
21 00 PressureAltitude pressure_altitude f32 m altitude of the pressure
22 00 DensityAltitude density_altitude f32 m altitude of the density
47 48 OdometerScale odometer_scale_error f32 1 estimated scale error of the odometer
"""
"""Code, code of the uncertainty (00: none), name, column with its axes, type, unit and meaning."""


def _estimated() -> Iterator[str]:
    """Yield the rows of numbers of one unit, their uncertainties, and the validity of each."""
    for row in _ESTIMATED.strip().splitlines():
        code, sigma, name, column, kind, unit, what = row.split(maxsplit=6)
        stem, _, axes = column.partition(".")
        uncertainty = (sigma, f"{name}Sigma", f"{stem}_sigma", f"uncertainty of: {what}")
        for field, title, own, meaning in ((code, name, stem, what), uncertainty):
            if field != "00":
                values = f"{own}_{axes}".rstrip("_")
                valid = f"{own}_valid u16 1 validity of {own.replace('_', ' ')}"
                yield f"0x{field} {title}: {values} {kind} {unit} {meaning} | {valid}\n"


_FILTER = """
0x03 Quaternion: {q} | {valid}
0x05 Euler: {angles} | {valid}
0x04 Matrix: {matrix}
0x01 Position: place f64 | position_valid u16 1 validity of position
0x02 Velocity: velocity_xyz f32 m/s velocity north, east, down | velocity_valid u16 1 validity of velocity
0x11 FilterGpsTime []: {gps_time}
0x10 FilterStatus: filter_state u16 1 state of the filter
  | filter_dynamics u16 1 dynamics mode of the filter | status u16
{estimated}0x12 QuaternionSigma: q_sigma_wxyz f32 1 uncertainty of the quaternion
  | q_sigma_valid u16 1 validity of q sigma
0x14 HeadingUpdate: filter_heading f32 rad heading that aided the filter
  | filter_heading_sigma f32 rad uncertainty of that | heading_source u16 1 what gave the heading, bits
  | filter_heading_valid u16 1 validity of filter heading
0x15 MagneticModel: mag_model_xyz f32*gauss uT field of the world magnetic model north, east, down
  | inclination f32 rad of the magnetic model | declination f32 rad of the magnetic model
  | mag_model_valid u16 1 validity of mag model
0x20 StandardAtmosphere: geometric_altitude f32 m standard atmosphere
  | geopotential_altitude f32 m standard atmosphere | standard_temperature f32 degC standard atmosphere
  | standard_pressure f32*hPa Pa standard atmosphere | standard_density f32 kg/m^3 standard atmosphere
  | standard_atmosphere_valid u16 1 validity of standard atmosphere
0x40 PositionEcef: ecef_xyz f64 m position, earth-centred earth-fixed | ecef_valid u16 1 validity of ecef
0x42 RelativePosition: relative_position_xyz f64 m from the reference place, north, east, down
  | relative_position_valid u16 1 validity of relative position
0x32 ClockCorrection: clock_receiver u8 1 number of the receiver | clock_bias f32 m of the receiver
  | clock_drift f32 m/s of the receiver | clock_valid u16 1 validity of clock
0x33 ClockCorrectionSigma: clock_sigma_receiver u8 1 number of the receiver
  | clock_bias_sigma f32 m uncertainty | clock_drift_sigma f32 m/s uncertainty
  | clock_sigma_valid u16 1 validity of clock sigma
0x34 ReceiverAntennaOffset: antenna_receiver u8 1 number of the receiver
  | receiver_antenna_offset_xyz f32 m estimated offset of the antenna of a receiver
  | antenna_valid u16 1 validity of antenna
0x35 ReceiverAntennaOffsetSigma: antenna_sigma_receiver u8 1 number of the receiver
  | receiver_antenna_offset_sigma_xyz f32 m uncertainty of that
  | antenna_sigma_valid u16 1 validity of antenna sigma
0x43 PositionAiding: position_aiding_receiver u8 1 number of the receiver
  | position_aiding_time_of_week f32 s GPS time of week
  | position_aiding_status u16 1 status of the aiding, bits | 8
0x44 AttitudeAiding: attitude_aiding_time_of_week f32 s GPS time of week
  | attitude_aiding_status u16 1 status of the aiding, bits | 8
0x45 HeadingAiding: heading_aiding_time_of_week f32 s GPS time of week
  | heading_aiding_type u8 1 what aids | 8
0x46 AidingSummary: aiding_time_of_week f32 s GPS time of week | aiding_source u8 1 number of the source
  | aiding_type u8 1 kind of measurement | aiding_indicator u8 1 what became of it, bits
0x49 DualAntenna: antennas_time_of_week f32 s GPS time of week
  | antennas_heading f32 rad heading of two antennas | antennas_heading_sigma f32 rad uncertainty of that
  | antennas_fix u8 1 kind of fix | antennas_status u16 1 data of both receivers, bits
  | antennas_valid u16 1 validity of antennas
"""
_SENSORS = """
0x05 ScaledGyro: gyro f32
0x04 ScaledAccel: accel f32*g
0x06 ScaledMag [mag]: mag f32*gauss
0x14 Temperature [temperature]: temperature_min f32 degC lowest sensor temperature
  | temperature_max f32 degC highest sensor temperature | temperature f32 degC mean sensor temperature
0x17 ScaledPressure [pressure]: pressure f32*hPa
0x0A ImuQuaternion [attitude]: {q}
0x0C ImuEuler [attitude]: {angles}
0x09 ImuMatrix [attitude]: {matrix}
0x07 DeltaTheta: delta_theta_xyz f32 rad rotation over the sample
0x08 DeltaVelocity: delta_velocity_xyz f32*g m/s velocity increment
0x10 NorthVector [mag]: north_xyz f32*gauss uT magnetic north in the body
0x11 UpVector [attitude]: up_xyz f32*g m/s^2 vertical in the body
0x12 SensorGpsTime []: {gps_time}
0x18 Overrange [status]: overrange u16 1 sensors out of range, bits
0x40 Odometer [odometer]: odometer_speed f32 m/s speed of the odometer
  | odometer_accuracy f32 m/s accuracy of that speed | odometer_valid u16 1 validity of odometer
0x01 RawAccel: raw_accel_xyz f32 1 accelerometer, raw counts
0x02 RawGyro: raw_gyro_xyz f32 1 gyroscope, raw counts
0x03 RawMag [mag]: raw_mag_xyz f32 1 magnetometer, raw counts
0x16 RawPressure [pressure]: raw_pressure f32 1 pressure, raw counts
0x0E InternalTimestamp []: internal_timestamp u32 1 internal clock of old devices
0x0F PpsTimestamp []: pps_seconds u32 s time since the last pulse, s | pps_microseconds u32 us and us
"""
_RECEIVER = """
0x03 Position: GNSS:latitude,longitude f64 deg | GNSS:altitude,altitude_msl f64 m
  | GNSS:horizontal_accuracy,vertical_accuracy f32 m | GNSS_position_valid u16 1 validity of GNSS position
0x05 Velocity: GNSS:velocity_north,velocity_east,velocity_down,speed,ground_speed f32 m/s
  | GNSS:course f32*deg rad | GNSS:speed_accuracy f32 m/s | GNSS:course_accuracy f32*deg rad
  | GNSS_velocity_valid u16 1 validity of GNSS velocity
0x07 Dop: GNSS:gdop,pdop,hdop,vdop,tdop,ndop,edop f32 1 | GNSS_dop_valid u16 1 validity of GNSS dop
"""
_SHARED = """
0xD5 ReferenceTime: {time}
0xD3 GpsTime: {gps_time}
0xD7 ExternalTime: external_time u64 ns external clock | external_time_valid u16 1 validity of external time
0xD0 EventSource: event_source u8 1 trigger of the packet; 0: none
0xD1 Ticks: base_ticks u32 1 base periods since power-up
0xD2 DeltaTicks: delta_base_ticks u32 1 base periods since the last packet
0xD4 DeltaTime: delta_time f64 s external time since the last packet
0xD6 ReferenceTimeDelta: delta_reference_time u64 ns since the last packet
0xD8 ExternalTimeDelta: delta_external_time u64 ns since the last packet
  | delta_external_time_valid u16 1 validity of delta external time
"""
"""Fields that every data set may carry."""


def _attitude(is_canonical: bool, prefix: str, whose: str, more: str) -> dict[str, str]:
    """Return the numbers of an attitude: in the canonical columns, else in others, and no matrix."""
    if is_canonical:
        matrix = f"_matrix_3x3 f32 1 reference to body | {more}"
        return {"q": "q f32", "angles": "angles f32", "matrix": matrix}
    angles = (f"{prefix}_{name} f32 rad {name} of another filter" for name in ("roll", "pitch", "yaw"))
    q = f"{prefix}_q_wxyz f32 1 attitude of the {whose}"
    return {"q": q, "angles": " | ".join(angles), "matrix": "38" if more else "36"}  # bytes


@cache
def mip_fields(attitude: Attitude = "filter", clock: Clock = "reference") -> dict[int, Message]:
    """Return every field that is understood, by descriptor set and code: set << 8 | code.

    `attitude`: which set, the filter's or the sensors', has the canonical names of the attitude.
    `clock`: whether ``device_ticks`` is the reference time.
    """
    time = "device_ticks u64" if clock == "reference" else "reference_time u64 ns device clock"
    shared = table(_SHARED.format(time=time, gps_time=_GPS_TIME), NO_GROUP)
    of_imu = _attitude(attitude == "imu", "imu", "complementary filter", "")
    of_filter = _attitude(attitude == "filter", "filter", "filter", _VALID)
    given = {"valid": _VALID, "gps_time": _GPS_TIME, "estimated": "".join(_estimated())}
    sets = {
        SENSOR: table(_SENSORS.format(gps_time=_GPS_TIME, **of_imu)),
        FILTER: table(_FILTER.format(**given, **of_filter), "filter"),
        **{code: table(_RECEIVER.replace("GNSS", prefix), prefix) for code, prefix in GNSS.items()},
    }
    return {of << 8 | code: item for of, own in sets.items() for code, item in (shared | own).items()}


WEEK_NS = 7 * 86_400 * 10**9

SET_NAMES = {number: f"set 0x{number:02X}" for number in range(256)} | {
    SENSOR: "sensor data",
    FILTER: "filter data",
    0xA0: "system data",
    **{code: f"{prefix.upper()} data" for code, prefix in GNSS.items()},
}
"""Names of the descriptor sets; those without a name are of commands and their replies."""


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
    """Decodes MIP data packets; all others are counted by descriptor set.

    `attitude`: whether ``roll``, ``pitch``, ``yaw`` and ``q_*`` are those of the "filter" set or of the "imu"
        set (devices without a navigation filter); the others get columns of their own.
    `clock`: whether ``device_ticks`` is the "reference" time of newer devices, or "gps" time.
    """

    form, data, type_names = MIP, (SENSOR, FILTER, *GNSS), SET_NAMES
    apart = (*GNSS.values(),)
    timing = Timing(tick_ns=Fraction(1))

    def __init__(self, attitude: Attitude = "filter", clock: Clock = "reference") -> None:
        self.messages = mip_fields(attitude, clock)
        self.derived = (FROM_MATRIX, _GPS_CLOCK) if clock == "gps" else (FROM_MATRIX,)
        super().__init__()

    def encoder(self, names: Sequence[str], descriptor_set: int = SENSOR) -> Encoder:
        """Return an encoder of fields of one descriptor set; see `TableDecoder.encoder`."""
        of_set = {item.name: (key, item) for key, item in self.messages.items() if key >> 8 == descriptor_set}
        fields = chosen(names, of_set, f"field of descriptor set 0x{descriptor_set:02X}")
        return self.field_encoder(descriptor_set, fields)

    def _field(self, key: int, size: int) -> Message | None:
        found = self.messages.get(key)
        return found if found is not None and found.size == size else None

    def _field_name(self, key: int) -> str:
        name = self.messages[key].name if key in self.messages else f"0x{key & 0xFF:02X}"
        return f"{name} of {SET_NAMES[key >> 8]}"


class MipDevice(TableDevice):
    """Device file of a MicroStrain device."""

    protocol: Literal["mip"]
    attitude: Attitude = "filter"
    clock: Clock = "reference"

    def decoder(self) -> MipDecoder:
        """Make a decoder for this device."""
        return MipDecoder(self.attitude, self.clock)
