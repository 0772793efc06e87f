"""The fields of VectorNav's binary groups and the numbers of its sentences, as tables.

Facts from the vendor's SDK and the VN-100 manual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

from imumon.columns import KNOWN, Column
from imumon.protocols.base import MAIN
from imumon.protocols.numbers import NO_GROUP, NUMBER_TYPES, Placed, Value
from imumon.protocols.tagged_columns import count, known, number, vector

DEGREE = pi / 180
GAUSS = 100.0
KILOPASCAL = 1000.0
COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2, GNSS3 = 1, 2, 3, 4, 5, 6, 7, 12
RECEIVERS = {GNSS1: "gnss1", GNSS2: "gnss2", GNSS3: "gnss3"}
SIDE_GROUPS = ("mag", "temperature", "pressure", "attitude", "filter", *RECEIVERS.values())
FILTERED = ("gyro", "accel", "mag")
"""What the device sends both as it was calibrated in the factory and as its filter has left it."""


@dataclass(frozen=True)
class Item:
    """A field of a binary group: its name, its numbers, and the group of columns that it belongs to.

    A field that is passed over has none but a number of bytes; one with `repeat` has so many more bytes for
    each count of the byte at `counter`.
    """

    name: str
    values: tuple[Value, ...] = ()
    group: str = MAIN
    skipped: int = 0
    repeat: int = 0
    counter: int = 0

    @cached_property
    def size(self) -> int:
        """Bytes of the field without its repetitions."""
        return sum(NUMBER_TYPES[value.type].size for value in self.values) or self.skipped

    def placed(self, at: int) -> list[Placed]:
        """Return the numbers of a field that begins here."""
        found = []
        for value in self.values:
            found.append(Placed(value, at, self.group))
            at += NUMBER_TYPES[value.type].size
        return found


def _numbers(columns: Sequence[Column | None], kind: str = "f32", factor: float = 1.0) -> tuple[Value, ...]:
    return tuple(Value(column, kind, factor) for column in columns)


def _whole(name: str, description: str, kind: str, unit: str = "1") -> tuple[Value, ...]:
    return (Value(count(name, description, unit), kind),)


def _filtered(base: str) -> tuple[Column, ...]:
    """Columns of what the filter has left; where nothing else comes they become those without a suffix."""
    unit = KNOWN[f"{base}_x"].unit
    return vector(f"{base}_compensated", unit, f"{base}, corrected by the device's own filter")


GYRO, ACCEL, MAG = (known(*(f"{base}_{axis}" for axis in "xyz")) for base in FILTERED)
YPR = _numbers(known("yaw", "pitch", "roll"), factor=DEGREE)
QUATERNION = _numbers(known("q_x", "q_y", "q_z", "q_w"))
TICKS = (Value(KNOWN["device_ticks"], "u64"),)
RATE = Item("AngRate", _numbers(_filtered("gyro")))
FORCE = Item("Accel", _numbers(_filtered("accel")))
FIELD = Item("Mag", _numbers(_filtered("mag"), factor=GAUSS), "mag")
DELTA_TIME = number("delta_time", "s", "time over which the increments were summed")
DELTA_THETA = _numbers((DELTA_TIME,)) + _numbers(
    vector("delta_theta", "rad", "rotation over the sample"), factor=DEGREE
)
DELTA_VELOCITY = _numbers(vector("delta_velocity", "m/s", "velocity increment"))
TEMPERATURE = _numbers(known("temperature"))
PRESSURE = _numbers(known("pressure"), factor=KILOPASCAL)
POSITION = _numbers(known("latitude", "longitude", "altitude"), "f64")
VELOCITY_NED = _numbers(vector("velocity", "m/s", "velocity north, east, down"))
SYNC_IN = _whole("sync_in_count", "pulses at the input", "u32")
PPS = _whole("time_since_pps", "time since the receiver's last pulse", "u64", "ns")
GPS_TIME = _whole("gps_time", "time since 1980-01-06 on the GPS clock", "u64", "ns")
SYNC_TIME = _whole("time_since_sync_in", "time since the last pulse at the input", "u64", "ns")
STATUS = (Value(KNOWN["status"], "u16"),)


def _skipped(name: str, size: int, group: str = MAIN) -> Item:
    return Item(name, (), group, size)


COMMON_ITEMS = (
    Item("TimeStartup", TICKS, NO_GROUP),
    Item("TimeGps", GPS_TIME, NO_GROUP),
    Item("TimeSyncIn", SYNC_TIME, NO_GROUP),
    Item("Ypr", YPR, "attitude"),
    Item("Quaternion", QUATERNION, "attitude"),
    RATE,
    Item("Position", POSITION, "filter"),
    Item("Velocity", VELOCITY_NED, "filter"),
    FORCE,
    Item("Imu", _numbers(ACCEL) + _numbers(GYRO)),
    Item("MagPres", _numbers(_filtered("mag"), factor=GAUSS) + TEMPERATURE + PRESSURE, "mag"),
    Item("Deltas", DELTA_THETA + DELTA_VELOCITY),
    Item("Status", STATUS),
    Item("SyncInCnt", SYNC_IN),
    Item("TimeGpsPps", PPS, NO_GROUP),
)
TIME_ITEMS = (
    Item("TimeStartup", TICKS, NO_GROUP),
    Item("TimeGps", GPS_TIME, NO_GROUP),
    Item("TimeGpsTow", _whole("gps_time_of_week", "GPS time of week", "u64", "ns"), NO_GROUP),
    Item("TimeGpsWeek", _whole("gps_week", "GPS week", "u16"), NO_GROUP),
    Item("TimeSyncIn", SYNC_TIME, NO_GROUP),
    Item("TimeGpsPps", PPS, NO_GROUP),
    _skipped("TimeUtc", 8),
    Item("SyncInCnt", SYNC_IN),
    Item("SyncOutCnt", _whole("sync_out_count", "pulses at the output", "u32")),
    Item("TimeStatus", _whole("time_status", "which clocks are valid, bits", "u8")),
)
IMU_ITEMS = (
    Item("ImuStatus", _whole("imu_status", "status of the sensors", "u16")),
    Item("UncompMag", _numbers(MAG, factor=GAUSS), "mag"),
    Item("UncompAccel", _numbers(ACCEL)),
    Item("UncompGyro", _numbers(GYRO)),
    Item("Temperature", TEMPERATURE, "temperature"),
    Item("Pressure", PRESSURE, "pressure"),
    Item("DeltaTheta", DELTA_THETA),
    Item("DeltaVelocity", DELTA_VELOCITY),
    FIELD,
    FORCE,
    RATE,
    Item("SensSat", _whole("saturation", "saturated: mag, accel, gyro x y z, pressure, bits", "u16")),
    _skipped("reserved", 40),
)
ATTITUDE_ITEMS = (
    Item("VpeStatus", STATUS),
    Item("Ypr", YPR, "attitude"),
    Item("Quaternion", QUATERNION, "attitude"),
    _skipped("Dcm", 36, "attitude"),
    Item("MagNed", _numbers(vector("mag_ned", "uT", "magnetic field, north, east, down"), factor=GAUSS),
         "mag"),
    Item("AccelNed", _numbers(vector("accel_ned", "m/s^2", "acceleration with gravity, north, east, down"))),
    Item("LinearAccelBody", _numbers(vector("free_accel", "m/s^2", "acceleration without gravity"))),
    _skipped("LinearAccelNed", 12),
    Item("YprU", _numbers(vector("ypr_sigma", "rad", "uncertainty of yaw, pitch, roll"),
                          factor=DEGREE), "attitude"),
    _skipped("reserved", 12), _skipped("reserved", 28), _skipped("reserved", 24),
    Item("Heave", _numbers(vector("heave", "m", "heave, its rate, and delayed"))),
    Item("AttU", _numbers((number("attitude_sigma", "rad", "uncertainty of the attitude"),), factor=DEGREE),
         "attitude"),
)  # fmt: skip
INS_ITEMS = (
    Item("InsStatus", _whole("ins_status", "status of the navigation filter", "u16"), "filter"),
    Item("Position", POSITION, "filter"),
    _skipped("PositionEcef", 24, "filter"),
    Item("VelocityBody", _numbers(vector("velocity_body", "m/s", "velocity in the body frame")), "filter"),
    Item("Velocity", VELOCITY_NED, "filter"),
    *(_skipped(name, 12, "filter") for name in ("VelocityEcef", "MagEcef", "AccelEcef", "LinearAccelEcef")),
    Item("PositionU", _numbers((number("position_sigma", "m", "uncertainty of the position"),)), "filter"),
    Item("VelocityU", _numbers((number("velocity_sigma", "m/s", "uncertainty of the velocity"),)), "filter"),
    _skipped("reserved", 68),
    _skipped("reserved", 64),
)


def _receiver_items(prefix: str) -> tuple[Item | None, ...]:
    """Return the fields of a receiver."""

    def real(name: str, unit: str, kind: str = "f32") -> Value:
        return Value(number(f"{prefix}_{name}", unit, f"receiver {prefix}: {name}"), kind)

    def whole(name: str, kind: str, unit: str = "1") -> tuple[Value, ...]:
        return _whole(f"{prefix}_{name}", f"receiver {prefix}: {name.replace('_', ' ')}", kind, unit)

    place = tuple(real(name, unit, "f64") for name, unit in
                  (("latitude", "deg"), ("longitude", "deg"), ("altitude", "m")))  # fmt: skip
    velocity = tuple(real(f"velocity_{name}", "m/s") for name in ("north", "east", "down"))
    sigma = tuple(real(f"position_sigma_{name}", "m") for name in ("north", "east", "down"))
    dilution = tuple(real(f"{name}dop", "1") for name in "gptvhne")
    fields: tuple[tuple[str, tuple[Value, ...], int], ...] = (
        ("TimeUtc", (), 8),
        ("Tow", whole("time_of_week", "u64", "ns"), 8),
        ("Week", whole("week", "u16"), 2),
        ("NumSats", whole("satellites", "u8"), 1),
        ("Fix", whole("fix", "u8"), 1),
        ("Position", place, 24),
        ("PositionEcef", (), 24),
        ("Velocity", velocity, 12),
        ("VelocityEcef", (), 12),
        ("PositionU", sigma, 12),
        ("VelocityU", (real("velocity_sigma", "m/s"),), 4),
        ("TimeU", (real("time_sigma", "s"),), 4),
        ("TimeInfo", (), 2),
        ("Dop", dilution, 28),
    )
    items = [Item(name, values, prefix, size) for name, values, size in fields]
    return (
        *items,
        Item("SatInfo", (), prefix, 2, repeat=8),
        None,
        Item("RawMeas", (), prefix, 12, repeat=28, counter=10),
        Item("Status", whole("status", "u16"), prefix),
        Item("AltMsl", (real("altitude_msl", "m", "f64"),), prefix),
    )


GROUP_NAMES = {COMMON: "Common", TIME: "Time", IMU: "Imu", ATTITUDE: "Attitude", INS: "Ins",
               GNSS1: "Gnss1", GNSS2: "Gnss2", GNSS3: "Gnss3"}  # fmt: skip
GROUPS: dict[int, tuple[Item | None, ...]] = {
    COMMON: COMMON_ITEMS,
    TIME: TIME_ITEMS,
    IMU: IMU_ITEMS,
    ATTITUDE: ATTITUDE_ITEMS,
    INS: INS_ITEMS,
    **{group: _receiver_items(prefix) for group, prefix in RECEIVERS.items()},
}
"""Fields of each group by bit; None is a bit that has none."""


_RATE, _FORCE, _FIELD = RATE.values, FORCE.values, FIELD.values
_RAW_RATE, _RAW_FORCE, _RAW_FIELD = _numbers(GYRO), _numbers(ACCEL), _numbers(MAG, factor=GAUSS)
_BODY, _INERTIAL = (
    _numbers(vector("free_accel", "m/s^2", "acceleration without gravity")),
    _numbers(vector("accel_ned", "m/s^2", "acceleration without gravity, north, east, down")),
)
SENTENCES: dict[str, tuple[Value, ...]] = {
    "YPR": YPR,
    "QTN": QUATERNION,
    "QMR": (*QUATERNION, *_FIELD, *_FORCE, *_RATE),
    "MAG": _FIELD,
    "ACC": _FORCE,
    "GYR": _RATE,
    "MAR": (*_FIELD, *_FORCE, *_RATE),
    "YMR": (*YPR, *_FIELD, *_FORCE, *_RATE),
    "YBA": (*YPR, *_BODY, *_RATE),
    "YIA": (*YPR, *_INERTIAL, *_RATE),
    "IMU": (*_RAW_FIELD, *_RAW_FORCE, *_RAW_RATE, *TEMPERATURE, *PRESSURE),
    "DTV": (*DELTA_THETA, *DELTA_VELOCITY),
}
"""Numbers of each ASCII sentence."""
