"""The data identifiers of MTData2: what each carries, as a table.

Facts from the MT Low Level Communication Protocol Documentation (MT0101P) and the public data types of the
vendor.  The last four bits of an identifier are its format: bits 0-1 the precision of real numbers, bits 2-3
the reference frame.  Values are in the device's units times a factor.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from math import pi

from imumon.columns import KNOWN, Column
from imumon.protocols.base import MAIN, NO_GROUP
from imumon.protocols.messages import Message, Part, counted, field, floats, gap, gnss, real
from imumon.protocols.numbers import FROM_MATRIX, MATRIX, Number, count, date, known, number, utc_time, vector

DEGREE = pi / 180

PRECISIONS = {
    "float32": ("f32", 1.0),
    "fp12.20": ("i32", 2.0**-20),
    "fp16.32": ("fp1632", 1.0),
    "float64": ("f64", 1.0),
}
"""Number type and factor of the precisions, in the order of their codes."""

FRAMES = {"ENU": 0x0, "NED": 0x4, "NWU": 0x8}
"""Reference frames of orientation, velocity and free acceleration, by their bits in the identifier."""


MAG = vector("mag", "a.u.", "magnetic field, 1 at the place of calibration (the device has no unit)")
VELOCITY = vector("velocity", "m/s", "velocity in the reference frame")
UTC_VALID = count("utc_valid", "validity bits of the UTC time")
RAW = (
    *vector("raw_accel", "1", "accelerometer, raw counts"),
    *vector("raw_gyro", "1", "gyroscope, raw counts"),
    *vector("raw_mag", "1", "magnetometer, raw counts"),
)
RAW_TEMPERATURE = number("raw_temperature", "1", "temperature, raw counts")

UTC_KINDS = ("u32", "u16", "u8", "u8", "u8", "u8", "u8", "u8")
UTC_VALUES = tuple(map(Number, (*date("utc_"), UTC_VALID), UTC_KINDS))


@dataclass(frozen=True, slots=True)
class Identifier:
    """A data identifier without its format bits.

    Numbers without a type have the precision that the identifier states; without numbers, the field is
    recognised whatever its size.  `raw`: the last bit states if counts are signed.  `least`: as `Message`.
    """

    code: int
    name: str
    numbers: tuple[Number, ...] = ()
    framed: bool = False
    raw: bool = False
    least: int = 0

    @property
    def is_real(self) -> bool:
        """Whether the format states a precision."""
        return bool(self.numbers) and not self.numbers[0].type and not self.raw

    def message(self, form: int = 0) -> Message | None:
        """Return the field in a format, the last four bits of the identifier; None when it has no such."""
        group = _HIGH_RATE.get(self.code) or _GROUPS.get(self.code >> 8, "status")
        kind, factor, good = "", 1.0, form == 0
        if self.is_real:
            kind, factor = [*PRECISIONS.values()][form & 0x3]
            good = form & 0xC in (FRAMES.values() if self.framed else (0,))
        elif self.raw or not self.numbers:
            kind, good = ("u16", "i16")[form & 1], form < 2
        typed = [n._replace(type=n.type or kind, factor=n.factor * factor) for n in self.numbers]
        return field(self.name, tuple(typed), group=group, least=self.least) if good else None


_GROUPS = {
    0x10: NO_GROUP,
    **dict.fromkeys((0x40, 0x80, 0xA0), MAIN),
    0xC0: "mag",
    0x08: "temperature",
    0x20: "attitude",
    0x30: "pressure",
    **dict.fromkeys((0x50, 0xD0), "navigation"),
    **dict.fromkeys((0x70, 0x88), "gnss"),
    0xB0: "analog",
    **dict.fromkeys((0xEE, 0x48), "trigger"),
}
_HIGH_RATE = {0x4040: "imu_hr", 0x8040: "imu_hr", 0x4030: "attitude", 0xA050: "mag"}
"""What the vendor's grouping does not state: the high-rate outputs have a rate of their own."""


def _real(
    code: int, name: str, columns: str | Iterable[Column], factor: float = 1.0, framed: bool = False
) -> Identifier:
    return Identifier(code, name, floats(columns, factor, kind=""), framed)


def _plain(code: int, name: str, *parts: Part, least: int = 0) -> Identifier:
    return Identifier(code, name, tuple(chain(*parts)), least=least)


def _raw(code: int, name: str, *columns: Column) -> Identifier:
    # A temperature is signed in either format.
    kinds = ["i16" if "temperature" in column.name else "" for column in columns]
    return Identifier(code, name, tuple(map(Number, columns, kinds)), raw=True)


def _trigger(code: int, line: int) -> Identifier:
    what, names = f"trigger {line}", f"trigger{line}"
    return _plain(
        code + 0x10 * line,
        f"TriggerIn{line}",
        counted(f"{names}_line", f"{what}: line", "u8"),
        counted(f"{names}_polarity", f"{what}: polarity", "u8"),
        counted(f"{names}_ticks", f"{what}: time in device ticks", "u32"),
        counted(f"{names}_frame", f"{what}: frame number", "u16"),
    )


_gnss = partial(gnss, "gnss")
_TIME_OF_WEEK = _gnss("s", "time_of_week", kind="u32", factor=1e-3)
_DATE = tuple(map(Number, date("gnss_utc_")[1:], UTC_KINDS[1:]))
_NANO = floats(date("gnss_utc_")[:1], kind="i32")
_TIME_VALID = _gnss("1", "time_valid", kind="u8")
_TIME_ACCURACY = _gnss("s", "time_accuracy", kind="u32", factor=1e-9)
_DILUTIONS = _gnss("1", *(f"{name}dop" for name in "gptvhne"), kind="u16", factor=0.01)
_PVT = (
    *(_TIME_OF_WEEK, _DATE, _TIME_VALID, _TIME_ACCURACY, _NANO),
    _gnss("1", "fix_type", "flags", "satellites", kind="u8"),
    gap(1),
    _gnss("deg", "longitude", "latitude", kind="i32", factor=1e-7),
    _gnss("m", "altitude", "altitude_msl", kind="i32", factor=1e-3),
    _gnss("m", "horizontal_accuracy", "vertical_accuracy", kind="u32", factor=1e-3),
    _gnss("m/s", "velocity_north", "velocity_east", "velocity_down", "ground_speed", kind="i32", factor=1e-3),
    _gnss("rad", "course", kind="i32", factor=1e-5 * DEGREE),
    _gnss("m/s", "speed_accuracy", kind="u32", factor=1e-3),
    _gnss("rad", "course_accuracy", kind="u32", factor=1e-5 * DEGREE),
    _gnss("rad", "vehicle_heading", kind="i32", factor=1e-5 * DEGREE),
    _DILUTIONS,
)
_SOLUTION = (
    _TIME_OF_WEEK,
    gap(4),
    _gnss("1", "week", kind="i16"),
    _gnss("1", "fix_type", "flags", kind="u8"),
    _gnss("m", *(f"ecef_{axis}" for axis in "xyz"), kind="i32", factor=0.01),
    _gnss("m", "position_accuracy", kind="u32", factor=0.01),
    _gnss("m/s", *(f"ecef_velocity_{axis}" for axis in "xyz"), kind="i32", factor=0.01),
    _gnss("m/s", "speed_accuracy", kind="u32", factor=0.01),
    _gnss("1", "pdop", kind="u16", factor=0.01),
    gap(1),
    _gnss("1", "satellites", kind="u8"),
    gap(1),
)

MOST_SATELLITES = 60
"""In a GnssSatInfo."""


def _satellite(k: int) -> Part:
    """System times 256 and number; carrier to noise in dBHz; quality (bits 0-2), used (3), health (4-5)."""
    return _gnss("1", f"sat{k}_id", kind="u16") + _gnss("1", f"sat{k}_cno", f"sat{k}_flags", kind="u8")


_SATELLITES = (_TIME_OF_WEEK, _gnss("1", "satellites_seen", kind="u8"), gap(3))

IDENTIFIERS: tuple[Identifier, ...] = (
    _plain(0x1020, "PacketCounter", floats("packet_counter", kind="u16")),
    _plain(0x1060, "SampleTimeFine", floats("device_ticks", kind="u32")),
    _plain(0x1070, "SampleTimeCoarse", counted("sample_time_coarse", "device clock, s", "u32", "s")),
    _plain(0x10A0, "SampleTime64", counted("sample_time_64", "device clock", "u64", "ns")),
    _plain(0x1090, "PacketCounter8", counted("packet_counter_8", "packet counter of 8 bits", "u8")),
    _plain(0x1010, "UtcTime", UTC_VALUES),
    _plain(0x1030, "Itow", real("time_of_week", "s", "GPS time of week", "u32", 1e-3)),
    _plain(0x1040, "GnssAge", counted("gnss_age", "age of the GNSS data, in packets", "u8")),
    _plain(0x1050, "PressureAge", counted("pressure_age", "age of the pressure, in packets", "u8")),
    _plain(0x1080, "FrameRange", counted("frame_first", "first frame of the packet", "u16"),
           counted("frame_last", "last frame of the packet", "u16")),
    _real(0x8020, "RateOfTurn", "gyro"),
    _real(0x4020, "Acceleration", "accel"),
    _real(0xC020, "MagneticField", MAG),
    _real(0x0810, "Temperature", "temperature"),
    _real(0x2010, "Quaternion", "q", framed=True),
    _real(0x2020, "RotationMatrix", MATRIX, framed=True),
    _real(0x2030, "EulerAngles", "angles", DEGREE, framed=True),
    _plain(0x3010, "BaroPressure", floats("pressure", kind="u32")),
    _real(0x5040, "LatLon", known("latitude", "longitude")),
    _real(0x5020, "AltitudeEllipsoid", "altitude"),
    _real(0x5010, "AltitudeMsl", [number("altitude_msl", "m", "height above mean sea level")]),
    _real(0x5030, "PositionEcef", vector("ecef", "m", "position, earth-centred earth-fixed")),
    _real(0xD010, "VelocityXYZ", VELOCITY, framed=True),
    _real(0x4010, "DeltaV", vector("delta_velocity", "m/s", "velocity increment over the sample")),
    _real(0x8030, "DeltaQ", vector("delta_q", "1", "rotation over the sample, quaternion", "wxyz")),
    _real(0x4030, "FreeAcceleration", vector("free_accel", "m/s^2", "without gravity"), framed=True),
    _real(0x4040, "AccelerationHR", vector("accel_hr", "m/s^2", "specific force, high rate")),
    _real(0x8040, "RateOfTurnHR", vector("gyro_hr", "rad/s", "angular rate, high rate")),
    _real(0xC030, "MagneticFieldCorrected", vector("mag_corrected", "a.u.", "magnetic field, corrected")),
    _plain(0xE010, "StatusByte", floats("status", kind="u8")),
    _plain(0xE020, "StatusWord", floats("status", kind="u32")),
    _plain(0xE040, "Rssi", real("rssi", "1", "strength of the radio signal", "i8")),
    _plain(0xE080, "DeviceId", counted("device_id", "identity of the device", "u32")),
    _plain(0xE080, "DeviceId", counted("device_id", "identity of the device", "u64")),
    _plain(0xE090, "LocationId", counted("location_id", "number given by the user", "u16")),
    _plain(0x7010, "GnssPvtData", *_PVT),
    _plain(0x7020, "GnssSatInfo", *_SATELLITES, *map(_satellite, range(1, 1 + MOST_SATELLITES)), least=8),
    _plain(0x7030, "GnssPvtPulse"),
    _plain(0x8830, "GpsDop", _TIME_OF_WEEK, _DILUTIONS),
    _plain(0x8840, "GpsSol", *_SOLUTION),
    _plain(0x8880, "GpsTimeUtc", _TIME_OF_WEEK, _TIME_ACCURACY, _NANO, _DATE, _TIME_VALID),
    _plain(0x88A0, "GpsSvInfo"),
    _raw(0xA010, "RawAccGyrMagTemp", *RAW, RAW_TEMPERATURE),
    _raw(0xA020, "RawGyroTemp", *vector("raw_gyro_temperature", "1", "gyroscope temperature, raw counts")),
    _raw(0xA030, "RawAcc", *RAW[:3]),
    _raw(0xA040, "RawGyr", *RAW[3:6]),
    _raw(0xA050, "RawMag", *RAW[6:]),
    _plain(0xA060, "RawDeltaQ"),
    _plain(0xA070, "RawDeltaV"),
    _plain(0xA080, "RawBlob"),
    _plain(0xB010, "AnalogIn1", real("analog_1", "1", "analog input 1, raw counts", "u16")),
    _plain(0xB020, "AnalogIn2", real("analog_2", "1", "analog input 2, raw counts", "u16")),
    *(_trigger(code, line) for code in (0xEE00, 0x4800) for line in (1, 2, 3)),
)  # fmt: skip
"""Every data identifier, in the order of the columns."""


@lru_cache
def message_of(code: int, size: int | None = None) -> Message | None:
    """Return what an identifier with its format bits stands for, of so many bytes if given; None: nothing."""
    for item in (item for item in IDENTIFIERS if item.code == code & 0xFFF0):
        found = item.message(code & 0xF)
        if found is not None and (
            size in (None, found.size) or found.size < 0 or 0 < found.least <= (size or 0) <= found.size
        ):
            return found
    return None


DERIVED = (
    utc_time("utc_", count("utc_time_ns", "Unix time (UTC) as the device reports it", "ns")),
    utc_time("gnss_utc_", count("gnss_utc_time_ns", "Unix time (UTC) of the GNSS receiver's data", "ns")),
    FROM_MATRIX,
)
"""Columns of MTData2 and MTData that are computed from what is sent."""

DEVICE_TICKS_OF_UTC = utc_time("utc_", KNOWN["device_ticks"])
"""The clock of a legacy device that sends no other time."""
