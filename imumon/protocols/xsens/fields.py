"""The data identifiers of MTData2: what each carries, as a table.

Facts from the MT Low Level Communication Protocol Documentation (MT0101P) and the public data types of the
vendor.  The last four bits of an identifier are its format: bits 0-1 the precision of real numbers, bits 2-3
the reference frame.  Values are in the device's units times a factor.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

from imumon.columns import KNOWN, Column

from ..messages import Message, rows
from ..numbers import FROM_MATRIX, utc_time

PRECISIONS = {
    "float32": ("f32", 1.0),
    "fp12.20": ("i32", 2.0**-20),
    "fp16.32": ("fp1632", 1.0),
    "float64": ("f64", 1.0),
}
"""Number type and factor of the precisions, in the order of their codes."""

FRAMES = {"ENU": 0x0, "NED": 0x4, "NWU": 0x8}
"""Reference frames of orientation, velocity and free acceleration, by their bits in the identifier."""

_DATE = """_{0}year u16 1 year | _{0}month u8 1 month | _{0}day u8 1 day | _{0}hour u8 1 hour
  | _{0}minute u8 1 minute | _{0}second u8 1 second"""
UTC = f"_utc_of_second u32 1 ns | {_DATE.format('utc_')} | utc_valid u8 1 validity bits of the UTC time"


@dataclass(frozen=True, eq=False)
class Identifier(Message):
    """A data identifier without its format bits.

    Numbers of type "real" or "framed" have the precision that the format states, "count" its sign.
    """

    code: int = 0

    @property
    def framed(self) -> bool:
        """Whether the format states a reference frame."""
        return any(number.type == "framed" for number in self.numbers)

    @property
    def is_real(self) -> bool:
        """Whether the format states a precision."""
        return any(number.type in ("real", "framed") for number in self.numbers)

    @property
    def raw(self) -> bool:
        """Whether the numbers are raw counts, of which the last bit of the format states the sign."""
        return self.code >> 8 == 0xA0

    def message(self, form: int = 0) -> Message | None:
        """Return the field in a format, the last four bits of the identifier; None when it has no such."""
        factor, kinds, good = 1.0, {"count": ("u16", "i16")[form & 1]}, form == 0
        if self.is_real:
            kind, factor = [*PRECISIONS.values()][form & 0x3]
            kinds = {"real": kind, "framed": kind}
            good = form & 0xC in (FRAMES.values() if self.framed else (0,))
        elif self.raw:
            good = form < 2
        typed = (n._replace(type=kinds.get(n.type, n.type), factor=n.factor * factor) for n in self.numbers)
        return replace(self, numbers=(*typed,)) if good else None


_GNSS_DATE, _NANO = _DATE.format("gnss_utc_"), "_gnss_utc_of_second i32 1 ns"
_WEEK = "gnss:time_of_week u32*1e-3 s"
_DOPS = "gnss:gdop,pdop,tdop,vdop,hdop,ndop,edop u16*0.01 1"
MOST_SATELLITES = 60
"""In a GnssSatInfo."""
_SATELLITES = " | ".join(
    f"gnss:sat{k}_id u16 1 | gnss:sat{k}_cno,sat{k}_flags u8 1" for k in range(1, 1 + MOST_SATELLITES)
)
"""System times 256 and number; carrier to noise in dBHz; quality (bits 0-2), used (3), health (4-5)."""
_TRIGGERS = "".join(
    f"{code + 0x10 * k:04X} TriggerIn{k} [trigger]: trigger{k}_line u8 1 trigger {k}: line"
    f" | trigger{k}_polarity u8 1 trigger {k}: polarity"
    f" | trigger{k}_ticks u32 1 trigger {k}: time in device ticks"
    f" | trigger{k}_frame u16 1 trigger {k}: frame number\n"
    for code in (0xEE00, 0x4800)
    for k in (1, 2, 3)
)
_TABLE = f"""
1020 PacketCounter []: packet_counter u16
1060 SampleTimeFine []: device_ticks u32
1070 SampleTimeCoarse []: sample_time_coarse u32 s device clock, s
10A0 SampleTime64 []: sample_time_64 u64 ns device clock
1090 PacketCounter8 []: packet_counter_8 u8 1 packet counter of 8 bits
1010 UtcTime []: {UTC}
1030 Itow []: time_of_week u32*1e-3 s GPS time of week
1040 GnssAge []: gnss_age u8 1 age of the GNSS data, in packets
1050 PressureAge []: pressure_age u8 1 age of the pressure, in packets
1080 FrameRange []: frame_first u16 1 first frame of the packet | frame_last u16 1 last frame of the packet
8020 RateOfTurn: gyro real
4020 Acceleration: accel real
C020 MagneticField [mag]:
  mag_xyz real a.u. magnetic field, 1 at the place of calibration (the device has no unit)
0810 Temperature [temperature]: temperature real
2010 Quaternion [attitude]: q framed
2020 RotationMatrix [attitude]: _matrix_3x3 framed 1 rotation matrix, reference to body
2030 EulerAngles [attitude]: angles framed*deg
3010 BaroPressure [pressure]: pressure u32
5040 LatLon [navigation]: latitude real | longitude real
5020 AltitudeEllipsoid [navigation]: altitude real
5010 AltitudeMsl [navigation]: altitude_msl real m height above mean sea level
5030 PositionEcef [navigation]: ecef_xyz real m position, earth-centred earth-fixed
D010 VelocityXYZ [navigation]: velocity_xyz framed m/s velocity in the reference frame
4010 DeltaV: delta_velocity_xyz real m/s velocity increment over the sample
8030 DeltaQ: delta_q_wxyz real 1 rotation over the sample, quaternion
4030 FreeAcceleration [attitude]: free_accel_xyz framed m/s^2 without gravity
4040 AccelerationHR [imu_hr]: accel_hr_xyz real m/s^2 specific force, high rate
8040 RateOfTurnHR [imu_hr]: gyro_hr_xyz real rad/s angular rate, high rate
C030 MagneticFieldCorrected [mag]: mag_corrected_xyz real a.u. magnetic field, corrected
E010 StatusByte [status]: status u8
E020 StatusWord [status]: status u32
E040 Rssi [status]: rssi i8*1.0 1 strength of the radio signal
E080 DeviceId [status]: device_id u32 1 identity of the device
E080 DeviceId [status]: device_id u64 1 identity of the device
E090 LocationId [status]: location_id u16 1 number given by the user
7010 GnssPvtData [gnss]: {_WEEK} | {_GNSS_DATE} | gnss:time_valid u8 1
  | gnss:time_accuracy u32*1e-9 s | {_NANO} | gnss:fix_type,flags,satellites u8 1 | 1
  | gnss:longitude,latitude i32*1e-7 deg | gnss:altitude,altitude_msl i32*1e-3 m
  | gnss:horizontal_accuracy,vertical_accuracy u32*1e-3 m
  | gnss:velocity_north,velocity_east,velocity_down,ground_speed i32*1e-3 m/s
  | gnss:course i32*1e-5*deg rad | gnss:speed_accuracy u32*1e-3 m/s | gnss:course_accuracy u32*1e-5*deg rad
  | gnss:vehicle_heading i32*1e-5*deg rad | {_DOPS}
7020 GnssSatInfo [gnss] >=8: {_WEEK} | gnss:satellites_seen u8 1 | 3 | {_SATELLITES}
8830 GpsDop [gnss]: {_WEEK} | {_DOPS}
8840 GpsSol [gnss]: {_WEEK} | 4 | gnss:week i16 1 | gnss:fix_type,flags u8 1
  | gnss:ecef_x,ecef_y,ecef_z i32*0.01 m | gnss:position_accuracy u32*0.01 m
  | gnss:ecef_velocity_x,ecef_velocity_y,ecef_velocity_z i32*0.01 m/s | gnss:speed_accuracy u32*0.01 m/s
  | gnss:pdop u16*0.01 1 | 1 | gnss:satellites u8 1 | 1
8880 GpsTimeUtc [gnss]: {_WEEK} | gnss:time_accuracy u32*1e-9 s | {_NANO} | {_GNSS_DATE}
  | gnss:time_valid u8 1
A010 RawAccGyrMagTemp: raw_accel_xyz count 1 accelerometer, raw counts
  | raw_gyro_xyz count 1 gyroscope, raw counts | raw_mag_xyz count 1 magnetometer, raw counts
  | raw_temperature i16*1.0 1 temperature, raw counts
A020 RawGyroTemp: raw_gyro_temperature_xyz i16*1.0 1 gyroscope temperature, raw counts
A030 RawAcc: raw_accel_xyz count 1 accelerometer, raw counts
A040 RawGyr: raw_gyro_xyz count 1 gyroscope, raw counts
A050 RawMag [mag]: raw_mag_xyz count 1 magnetometer, raw counts
B010 AnalogIn1 [analog]: analog_1 u16*1.0 1 analog input 1, raw counts
B020 AnalogIn2 [analog]: analog_2 u16*1.0 1 analog input 2, raw counts
{_TRIGGERS}"""
"""A temperature among raw counts is signed in either format."""
IDENTIFIERS = tuple(
    Identifier(name, numbers, group, least, int(key, 16)) for key, name, numbers, group, least in rows(_TABLE)
)
"""Every data identifier, in the order of the columns."""


@lru_cache
def message_of(code: int, size: int | None = None) -> Message | None:
    """Return what an identifier with its format bits stands for, of so many bytes if given; None: nothing."""
    for item in (item for item in IDENTIFIERS if item.code == code & 0xFFF0):
        found = item.message(code & 0xF)
        if found is not None and (size in (None, found.size) or 0 < found.least <= (size or 0) <= found.size):
            return found
    return None


DERIVED = (
    utc_time("utc_", Column("utc_time_ns", "ns", "int64", "Unix time (UTC) as the device reports it")),
    utc_time(
        "gnss_utc_", Column("gnss_utc_time_ns", "ns", "int64", "Unix time (UTC) of the GNSS receiver's data")
    ),
    FROM_MATRIX,
)
"""Columns of MTData2 and MTData that are computed from what is sent."""

DEVICE_TICKS_OF_UTC = utc_time("utc_", KNOWN["device_ticks"])
"""The clock of a legacy device that sends no other time."""
