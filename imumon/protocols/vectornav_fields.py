"""The fields of VectorNav's binary groups and the numbers of its sentences, as tables.

Facts from the vendor's SDK and the VN-100 manual.
"""

from functools import partial
from math import pi

from imumon.columns import KNOWN, Column
from imumon.protocols.base import NO_GROUP
from imumon.protocols.messages import Message, axes, counted, field, floats, gap, gnss, real
from imumon.protocols.numbers import Number, known, vector

DEGREE = pi / 180
GAUSS = 100.0
KILOPASCAL = 1000.0
COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2, GNSS3 = 1, 2, 3, 4, 5, 6, 7, 12
RECEIVERS = {GNSS1: "gnss1", GNSS2: "gnss2", GNSS3: "gnss3"}
SIDE_GROUPS = ("mag", "temperature", "pressure", "attitude", "filter", *RECEIVERS.values())
FILTERED = ("gyro", "accel", "mag")
"""What the device sends both as it was calibrated in the factory and as its filter has left it."""


def _filtered(base: str) -> tuple[Column, ...]:
    """Columns of what the filter has left; where nothing else comes they become those without a suffix."""
    unit = KNOWN[f"{base}_x"].unit
    return vector(f"{base}_compensated", unit, f"{base}, corrected by the device's own filter")


YPR = floats(known("yaw", "pitch", "roll"), DEGREE)
QUATERNION = floats(known("q_x", "q_y", "q_z", "q_w"))
TICKS = floats("device_ticks", kind="u64")
RATE, FORCE, FIELD = floats(_filtered("gyro")), floats(_filtered("accel")), floats(_filtered("mag"), GAUSS)
RAW_RATE, RAW_FORCE, RAW_FIELD = floats("gyro"), floats("accel"), floats("mag", GAUSS)
DELTA_TIME = real("delta_time", "s", "time over which the increments were summed")
DELTA_THETA = DELTA_TIME + axes("delta_theta", "rad", "rotation over the sample", DEGREE)
DELTA_VELOCITY = axes("delta_velocity", "m/s", "velocity increment")
TEMPERATURE, PRESSURE = floats("temperature"), floats("pressure", KILOPASCAL)
POSITION = floats("place", kind="f64")
VELOCITY_NED = axes("velocity", "m/s", "velocity north, east, down")
SYNC_IN = counted("sync_in_count", "pulses at the input", "u32")
PPS = counted("time_since_pps", "time since the receiver's last pulse", "u64", "ns")
GPS_TIME = counted("gps_time", "time since 1980-01-06 on the GPS clock", "u64", "ns")
SYNC_TIME = counted("time_since_sync_in", "time since the last pulse at the input", "u64", "ns")
STATUS = floats("status", kind="u16")


TIME_ITEMS = (
    field("TimeStartup", TICKS, group=NO_GROUP),
    field("TimeGps", GPS_TIME, group=NO_GROUP),
    field("TimeGpsTow", counted("gps_time_of_week", "GPS time of week", "u64", "ns"), group=NO_GROUP),
    field("TimeGpsWeek", counted("gps_week", "GPS week", "u16"), group=NO_GROUP),
    field("TimeSyncIn", SYNC_TIME, group=NO_GROUP),
    field("TimeGpsPps", PPS, group=NO_GROUP),
    field("TimeUtc", gap(8)),
    field("SyncInCnt", SYNC_IN),
    field("SyncOutCnt", counted("sync_out_count", "pulses at the output", "u32")),
    field("TimeStatus", counted("time_status", "which clocks are valid, bits", "u8")),
)
IMU_ITEMS = (
    field("ImuStatus", counted("imu_status", "status of the sensors", "u16")),
    field("UncompMag", RAW_FIELD, group="mag"),
    field("UncompAccel", RAW_FORCE),
    field("UncompGyro", RAW_RATE),
    field("Temperature", TEMPERATURE, group="temperature"),
    field("Pressure", PRESSURE, group="pressure"),
    field("DeltaTheta", DELTA_THETA),
    field("DeltaVelocity", DELTA_VELOCITY),
    field("Mag", FIELD, group="mag"),
    field("Accel", FORCE),
    field("AngRate", RATE),
    field("SensSat", counted("saturation", "saturated: mag, accel, gyro x y z, pressure, bits", "u16")),
    field("reserved", gap(40)),
)
ATTITUDE_ITEMS = (
    field("VpeStatus", STATUS),
    field("Ypr", YPR, group="attitude"),
    field("Quaternion", QUATERNION, group="attitude"),
    field("Dcm", gap(36)),
    field("MagNed", axes("mag_ned", "uT", "magnetic field, north, east, down", GAUSS), group="mag"),
    field("AccelNed", axes("accel_ned", "m/s^2", "acceleration with gravity, north, east, down")),
    field("LinearAccelBody", axes("free_accel", "m/s^2", "acceleration without gravity")),
    field("LinearAccelNed", gap(12)),
    field("YprU", axes("ypr_sigma", "rad", "uncertainty of yaw, pitch, roll",
                          DEGREE), group="attitude"),
    field("reserved", gap(12)), field("reserved", gap(28)), field("reserved", gap(24)),
    field("Heave", axes("heave", "m", "heave, its rate, and delayed")),
    field("AttU", real("attitude_sigma", "rad", "uncertainty of the attitude", factor=DEGREE),
          group="attitude"),
)  # fmt: skip
INS_ITEMS = (
    field("InsStatus", counted("ins_status", "status of the navigation filter", "u16"), group="filter"),
    field("Position", POSITION, group="filter"),
    field("PositionEcef", gap(24)),
    field("VelocityBody", axes("velocity_body", "m/s", "velocity in the body frame"), group="filter"),
    field("Velocity", VELOCITY_NED, group="filter"),
    *(field(name, gap(12)) for name in ("VelocityEcef", "MagEcef", "AccelEcef", "LinearAccelEcef")),
    field("PositionU", real("position_sigma", "m", "uncertainty of the position"), group="filter"),
    field("VelocityU", real("velocity_sigma", "m/s", "uncertainty of the velocity"), group="filter"),
    field("reserved", gap(68)),
    field("reserved", gap(64)),
)


OF_OTHERS = {item.name: item for item in (*TIME_ITEMS, *IMU_ITEMS, *ATTITUDE_ITEMS, *INS_ITEMS)}
COMMON_ITEMS = (
    *(OF_OTHERS[name] for name in ("TimeStartup", "TimeGps", "TimeSyncIn", "Ypr", "Quaternion", "AngRate",
                                   "Position", "Velocity", "Accel")),
    field("Imu", RAW_FORCE + RAW_RATE),
    field("MagPres", FIELD + TEMPERATURE + PRESSURE, group="mag"),
    field("Deltas", DELTA_THETA + DELTA_VELOCITY),
    field("Status", STATUS),
    *(OF_OTHERS[name] for name in ("SyncInCnt", "TimeGpsPps")),
)  # fmt: skip


def _receiver_items(prefix: str) -> tuple[Message | None, ...]:
    of, item = partial(gnss, prefix), partial(field, group=prefix)
    return (
        field("TimeUtc", gap(8)),
        item("Tow", of("ns", "time_of_week", kind="u64")),
        item("Week", of("1", "week", kind="u16")),
        item("NumSats", of("1", "satellites", kind="u8")),
        item("Fix", of("1", "fix", kind="u8")),
        item("Position", of("deg", "latitude", "longitude", kind="f64"), of("m", "altitude", kind="f64")),
        field("PositionEcef", gap(24)),
        item("Velocity", of("m/s", "velocity_north", "velocity_east", "velocity_down")),
        field("VelocityEcef", gap(12)),
        item("PositionU", of("m", "position_sigma_north", "position_sigma_east", "position_sigma_down")),
        item("VelocityU", of("m/s", "velocity_sigma")),
        item("TimeU", of("s", "time_sigma")),
        field("TimeInfo", gap(2)),
        item("Dop", of("1", *(f"{name}dop" for name in "gptvhne"))),
        field("SatInfo", gap(2)),
        None,
        field("RawMeas", gap(12)),
        item("Status", of("1", "status", kind="u16")),
        item("AltMsl", of("m", "altitude_msl", kind="f64")),
    )


REPEATS = {"SatInfo": (8, 0), "RawMeas": (28, 10)}
"""Fields that have more bytes for each count of a byte in them: how many, and the place of that byte."""
GROUP_NAMES = {COMMON: "Common", TIME: "Time", IMU: "Imu", GNSS1: "Gnss1", ATTITUDE: "Attitude", INS: "Ins",
               GNSS2: "Gnss2", GNSS3: "Gnss3"}  # fmt: skip
GROUPS: dict[int, tuple[Message | None, ...]] = {
    COMMON: COMMON_ITEMS,
    TIME: TIME_ITEMS,
    IMU: IMU_ITEMS,
    ATTITUDE: ATTITUDE_ITEMS,
    INS: INS_ITEMS,
    **{group: _receiver_items(prefix) for group, prefix in RECEIVERS.items()},
}
"""Fields of each group by bit; None is a bit that has none."""
BY_PLACE = {
    (group, bit): item
    for group, items in GROUPS.items()
    for bit, item in enumerate(items)
    if item is not None
}
"""The same by group and bit."""

SENTENCES: dict[str, tuple[Number, ...]] = {
    "YPR": YPR,
    "QTN": QUATERNION,
    "QMR": (*QUATERNION, *FIELD, *FORCE, *RATE),
    "MAG": FIELD,
    "ACC": FORCE,
    "GYR": RATE,
    "MAR": (*FIELD, *FORCE, *RATE),
    "YMR": (*YPR, *FIELD, *FORCE, *RATE),
    "YBA": (*YPR, *axes("free_accel", "m/s^2", "acceleration without gravity"), *RATE),
    "YIA": (*YPR, *axes("accel_ned", "m/s^2", "acceleration without gravity, north, east, down"),
            *RATE),
    "IMU": (*RAW_FIELD, *RAW_FORCE, *RAW_RATE, *TEMPERATURE, *PRESSURE),
    "DTV": (*DELTA_THETA, *DELTA_VELOCITY),
}  # fmt: skip
"""Numbers of each ASCII sentence."""
