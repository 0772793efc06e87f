"""The fields of VectorNav's binary groups and the numbers of its sentences, as tables.

Facts from the vendor's SDK and the VN-100 manual.
"""

from imumon.columns import KNOWN
from imumon.protocols.messages import part, table

COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2, GNSS3 = 1, 2, 3, 4, 5, 6, 7, 12
RECEIVERS = {GNSS1: "gnss1", GNSS2: "gnss2", GNSS3: "gnss3"}
SIDE_GROUPS = ("mag", "temperature", "pressure", "attitude", "filter", *RECEIVERS.values())
FILTERED = ("gyro", "accel", "mag")
"""What the device sends both as it was calibrated in the factory and as its filter has left it."""


def _filtered(base: str, factor: str = "") -> str:
    """Return what the filter has left; where nothing else comes it has the columns without a suffix."""
    unit = KNOWN[f"{base}_x"].unit
    return f"{base}_compensated_xyz f32{factor} {unit} {base}, corrected by the device's own filter"


YPR, QUATERNION = "yaw f32*deg | pitch f32*deg | roll f32*deg", "q_x f32 | q_y f32 | q_z f32 | q_w f32"
RATE, FORCE, FIELD = _filtered("gyro"), _filtered("accel"), _filtered("mag", "*gauss")
DELTA_THETA = """delta_time f32 s time over which the increments were summed
  | delta_theta_xyz f32*deg rad rotation over the sample"""
DELTA_VELOCITY = "delta_velocity_xyz f32 m/s velocity increment"
FREE = "free_accel_xyz f32 m/s^2 acceleration without gravity"
VELOCITY_NED = "velocity_xyz f32 m/s velocity north, east, down"
GPS_TIME = "gps_time u64 ns time since 1980-01-06 on the GPS clock"
SYNC_TIME = "time_since_sync_in u64 ns time since the last pulse at the input"
PPS = "time_since_pps u64 ns time since the receiver's last pulse"

_RECEIVER = """
0 TimeUtc: 8
1 Tow [GNSS]: GNSS:time_of_week u64 ns
2 Week [GNSS]: GNSS:week u16 1
3 NumSats [GNSS]: GNSS:satellites u8 1
4 Fix [GNSS]: GNSS:fix u8 1
5 Position [GNSS]: GNSS:latitude,longitude f64 deg | GNSS:altitude f64 m
6 PositionEcef: 24
7 Velocity [GNSS]: GNSS:velocity_north,velocity_east,velocity_down f32 m/s
8 VelocityEcef: 12
9 PositionU [GNSS]: GNSS:position_sigma_north,position_sigma_east,position_sigma_down f32 m
10 VelocityU [GNSS]: GNSS:velocity_sigma f32 m/s
11 TimeU [GNSS]: GNSS:time_sigma f32 s
12 TimeInfo: 2
13 Dop [GNSS]: GNSS:gdop,pdop,tdop,vdop,hdop,ndop,edop f32 1
14 SatInfo: 2
16 RawMeas: 12
17 Status [GNSS]: GNSS:status u16 1
18 AltMsl [GNSS]: GNSS:altitude_msl f64 m
"""
REPEATS = {"SatInfo": (8, 0), "RawMeas": (28, 10)}
"""Fields that have more bytes for each count of a byte in them: how many, and the place of that byte."""
GROUP_NAMES = {COMMON: "Common", TIME: "Time", IMU: "Imu", GNSS1: "Gnss1", ATTITUDE: "Attitude", INS: "Ins",
               GNSS2: "Gnss2", GNSS3: "Gnss3"}  # fmt: skip
_TABLES = {
    COMMON: f"""
0 TimeStartup []: device_ticks u64
1 TimeGps []: {GPS_TIME}
2 TimeSyncIn []: {SYNC_TIME}
3 Ypr [attitude]: {YPR}
4 Quaternion [attitude]: {QUATERNION}
5 AngRate: {RATE}
6 Position [filter]: place f64
7 Velocity [filter]: {VELOCITY_NED}
8 Accel: {FORCE}
9 Imu: accel f32 | gyro f32
10 MagPres [mag]: {FIELD} | temperature f32 | pressure f32*kPa
11 Deltas: {DELTA_THETA} | {DELTA_VELOCITY}
12 Status: status u16
13 SyncInCnt: sync_in_count u32 1 pulses at the input
14 TimeGpsPps []: {PPS}
""",
    TIME: f"""
0 TimeStartup []: device_ticks u64
1 TimeGps []: {GPS_TIME}
2 TimeGpsTow []: gps_time_of_week u64 ns GPS time of week
3 TimeGpsWeek []: gps_week u16 1 GPS week
4 TimeSyncIn []: {SYNC_TIME}
5 TimeGpsPps []: {PPS}
6 TimeUtc: 8
7 SyncInCnt: sync_in_count u32 1 pulses at the input
8 SyncOutCnt: sync_out_count u32 1 pulses at the output
9 TimeStatus: time_status u8 1 which clocks are valid, bits
""",
    IMU: f"""
0 ImuStatus: imu_status u16 1 status of the sensors
1 UncompMag [mag]: mag f32*gauss
2 UncompAccel: accel f32
3 UncompGyro: gyro f32
4 Temperature [temperature]: temperature f32
5 Pressure [pressure]: pressure f32*kPa
6 DeltaTheta: {DELTA_THETA}
7 DeltaVelocity: {DELTA_VELOCITY}
8 Mag [mag]: {FIELD}
9 Accel: {FORCE}
10 AngRate: {RATE}
11 SensSat: saturation u16 1 saturated: mag, accel, gyro x y z, pressure, bits
12 reserved: 40
""",
    ATTITUDE: f"""
0 VpeStatus: status u16
1 Ypr [attitude]: {YPR}
2 Quaternion [attitude]: {QUATERNION}
3 Dcm: 36
4 MagNed [mag]: mag_ned_xyz f32*gauss uT magnetic field, north, east, down
5 AccelNed: accel_ned_xyz f32 m/s^2 acceleration with gravity, north, east, down
6 LinearAccelBody: {FREE}
7 LinearAccelNed: 12
8 YprU [attitude]: ypr_sigma_xyz f32*deg rad uncertainty of yaw, pitch, roll
9 reserved: 12
10 reserved: 28
11 reserved: 24
12 Heave: heave_xyz f32 m heave, its rate, and delayed
13 AttU [attitude]: attitude_sigma f32*deg rad uncertainty of the attitude
""",
    INS: f"""
0 InsStatus [filter]: ins_status u16 1 status of the navigation filter
1 Position [filter]: place f64
2 PositionEcef: 24
3 VelocityBody [filter]: velocity_body_xyz f32 m/s velocity in the body frame
4 Velocity [filter]: {VELOCITY_NED}
5 VelocityEcef: 12
6 MagEcef: 12
7 AccelEcef: 12
8 LinearAccelEcef: 12
9 PositionU [filter]: position_sigma f32 m uncertainty of the position
10 VelocityU [filter]: velocity_sigma f32 m/s uncertainty of the velocity
11 reserved: 68
12 reserved: 64
""",
    **{group: _RECEIVER.replace("GNSS", prefix) for group, prefix in RECEIVERS.items()},
}
BY_PLACE = {(group, bit): item for group, text in _TABLES.items() for bit, item in table(text).items()}
"""Fields by group and bit."""

SENTENCES = {
    "YPR": part(YPR),
    "QTN": part(QUATERNION),
    "QMR": part(f"{QUATERNION} | {FIELD} | {FORCE} | {RATE}"),
    "MAG": part(FIELD),
    "ACC": part(FORCE),
    "GYR": part(RATE),
    "MAR": part(f"{FIELD} | {FORCE} | {RATE}"),
    "YMR": part(f"{YPR} | {FIELD} | {FORCE} | {RATE}"),
    "YBA": part(f"{YPR} | {FREE} | {RATE}"),
    "YIA": part(f"{YPR} | accel_ned_xyz f32 m/s^2 acceleration without gravity, north, east, down | {RATE}"),
    "IMU": part("mag f32*gauss | accel f32 | gyro f32 | temperature f32 | pressure f32*kPa"),
    "DTV": part(f"{DELTA_THETA} | {DELTA_VELOCITY}"),
}
"""Numbers of each ASCII sentence."""
