"""VectorNav VN-100 to VN-310: binary output (FA) with any mask of groups, and ASCII sentences ($VN).

Facts from the vendor's SDK and the VN-100 manual.  A binary packet is FA, a byte that lists the groups
that follow (bit 7: a second byte, too), a word for each that lists its fields (bit 15: one more word, but
not of Common), the fields, and a CRC.  Its length is the sum of these: with an unknown field it is skipped.

`AngRate`, `Accel` and `Mag` are what the device's filter has left: its own estimate of the gyro bias is
already taken off.  `Uncomp...` and `Imu` are calibrated in the factory and no more; they make ``gyro``,
``accel`` and ``mag`` as soon as they come, and the others are then ``gyro_compensated`` and so on.
"""

from array import array
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import partial
from typing import NamedTuple

import numpy as np

from imumon.blocks import IntArray
from imumon.columns import KNOWN

from .base import LONGEST_PACKET, ByteArray, Encoder, Timing, chosen
from .decoder import Layouts
from .framing import IMPOSSIBLE, INCOMPLETE, Checksum, Found, Frame, counted_lengths, windows
from .messages import Message, Placed, TableDecoder, part, table
from .numbers import Number, Record
from .text import line_frame, sentence_body, texts

COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2, GNSS3 = *range(1, 8), 12  # bits from 1; second byte: from 8
RECEIVERS = {GNSS1: "gnss1", GNSS2: "gnss2", GNSS3: "gnss3"}
SIDE_GROUPS = ("mag", "temperature", "pressure", "attitude", "filter", *RECEIVERS.values())
FILTERED = ("gyro", "accel", "mag")  # sent both as calibrated in the factory and as the filter has left it

YPR, QUATERNION = "yaw f32*deg | pitch f32*deg | roll f32*deg", "q_x f32 | q_y f32 | q_z f32 | q_w f32"
RATE = "gyro_compensated_xyz f32 rad/s gyro, corrected by the device's own filter"
FORCE = "accel_compensated_xyz f32 m/s^2 accel, corrected by the device's own filter"
FIELD = "mag_compensated_xyz f32*gauss uT mag, corrected by the device's own filter"
DELTA_THETA = """delta_time f32 s time over which the increments were summed
  | delta_theta_xyz f32*deg rad rotation over the sample"""
DELTA_VELOCITY = "delta_velocity_xyz f32 m/s velocity increment"
FREE = "free_accel_xyz f32 m/s^2 acceleration without gravity"
FREE_NED = "free_accel_ned_xyz f32 m/s^2 acceleration without gravity, north, east, down"
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
REPEATS = {"SatInfo": (8, 0), "RawMeas": (28, 10)}  # bytes for each count of a byte in the field, its place
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
7 LinearAccelNed: {FREE_NED}
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
FIELDS = {group: table(text) for group, text in _TABLES.items()}
"""Fields of each group by their bits; of a further word they go on from 16."""
BY_PLACE = {(group, bit): item for group, fields in FIELDS.items() for bit, item in fields.items()}
PLACES = {
    f"{GROUP_NAMES[group]}.{item.name}": (group, bit)
    for (group, bit), item in BY_PLACE.items()
    if group < 8 and bit < 15 and item.columns
}
"""Group and bit of the fields that can be sent, by GROUP.FIELD: those that need no second byte or word."""
KNOWN_BITS = {group: sum(1 << bit for bit in fields) for group, fields in FIELDS.items()}
KNOWN_GROUPS = sum(1 << group - 1 for group in FIELDS)
SENTENCES = {
    name: Message(name, part(f"8 | {numbers.replace('f32', 'f64')}"))
    for name, numbers in {
        "YPR": YPR,
        "QTN": QUATERNION,
        "QMR": f"{QUATERNION} | {FIELD} | {FORCE} | {RATE}",
        "MAG": FIELD,
        "ACC": FORCE,
        "GYR": RATE,
        "MAR": f"{FIELD} | {FORCE} | {RATE}",
        "YMR": f"{YPR} | {FIELD} | {FORCE} | {RATE}",
        "YBA": f"{YPR} | {FREE} | {RATE}",
        "YIA": f"{YPR} | {FREE_NED} | {RATE}",
        "IMU": "mag f32*gauss | accel f32 | gyro f32 | temperature f32 | pressure f32*kPa",
        "DTV": f"{DELTA_THETA} | {DELTA_VELOCITY}",
    }.items()
}
"""What each ASCII sentence is as `_plain` writes it: eight bytes of $ and its name, and its numbers."""
XMODEM = Checksum("crc16-xmodem", first=1, big=True)
MOST_HEADER = 64  # bytes of a header that is believed, assumed


class Contents(NamedTuple):
    """What a binary packet holds: its fields, and where header and fields end."""

    fields: Placed
    header: int
    end: int

    @property
    def identifying(self) -> list[int]:
        """Places of the bytes that state what it holds: the header, and counts of repeated parts."""
        counts = [at + REPEATS[item.name][1] for item, at, _ in self.fields if item.name in REPEATS]
        return [*range(self.header), *counts]


def read_contents(packet: bytes) -> Contents | int:
    """Return what a packet holds, or the code of why that is not known; see `framing.Lengths`."""
    fields: Placed = []
    try:
        listed, header = _header(packet)
        end = header
        for item in listed:
            fields.append((item, end, item.size))
            if item.name in REPEATS:
                more_bytes, counter = REPEATS[item.name]
                end += more_bytes * packet[end + counter]
            end += item.size
            if end + 2 > LONGEST_PACKET:
                return IMPOSSIBLE
    except IndexError:  # the bytes end before that is known
        return INCOMPLETE
    return Contents(fields, header, end) if fields else IMPOSSIBLE


def _header(packet: bytes) -> tuple[list[Message], int]:
    """Return the fields that the header of a packet lists, none where one is not known, and where it ends."""
    groups, at = packet[1] & 0x7F, 2
    if packet[1] & 0x80:
        groups |= packet[2] << 7
        at = 3
    if groups & ~KNOWN_GROUPS and len(packet) > MOST_HEADER + 2:
        return [], at  # as found below, but faster: so are most FA that begin no packet
    listed = list[Message]()
    while groups:
        group = (groups & -groups).bit_length()  # the lowest
        groups &= groups - 1
        if group not in FIELDS:
            return [], at
        bits = 0
        shift = 0
        more = True
        while more:
            if at > MOST_HEADER:
                return [], at
            word = packet[at] | packet[at + 1] << 8
            more = group != COMMON and word >= 0x8000
            bits |= (word & 0x7FFF if more else word) << shift
            if bits & ~KNOWN_BITS[group]:
                return [], at
            at += 2
            shift += 16
        listed += [item for bit, item in FIELDS[group].items() if bits >> bit & 1]
    return listed, at


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the packet at each place, all that begin alike at once; see `framing.Lengths`."""
    data = held.tobytes()
    length = np.zeros(len(at), np.int64)
    while len(left := np.flatnonzero(length == 0)):
        for k, start in enumerate(map(int, at[left])):
            found = read_contents(data[start : start + LONGEST_PACKET])
            if not isinstance(found, int):
                places = found.identifying
                alike = left[k:][at[left[k:]] + places[-1] < len(held)]
                heads = windows(held, at[alike], places[-1] + 1)[:, places]
                length[alike[np.all(heads == heads[0], axis=1)]] = found.end + 2
                break  # fewer are left now
            length[left[k]] = found
    return length


def body_of(line: str) -> str | None:
    """Return what a sentence has before its checksum, of eight bits or a CRC, or None when that is wrong."""
    body = sentence_body(line.rstrip("\r\n"), XMODEM)
    return body if body is not None and body.isascii() else None


def _sentence(text: str) -> tuple[str, list[str], list[float]] | None:
    """Return name, words, numbers (of `SENTENCES`) of a right line, else None: a torn one's sum may fit."""
    body = body_of(text)
    if body is None:
        return None
    name, *fields = body[3:].split(",")
    if name not in SENTENCES:
        return name, fields, []
    size = len(SENTENCES[name].columns)
    if len(fields) > size and fields[-1][:1] in ("S", "T"):
        fields = fields[:size]  # the appendix with status or time
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        return None
    return (name, fields, numbers) if len(fields) == size and "_" not in body else None  # float("1_0") is 10


def words_of(names: Iterable[str]) -> dict[int, int]:
    """Return for each group of fields, in order, the word with their bits; raises as `chosen`."""
    words: dict[int, int] = {}
    for group, bit in sorted(chosen([*names], PLACES, "field")):
        words[group] = words.get(group, 0) | 1 << bit
    return words


def header_of(groups: int, words: Iterable[int]) -> bytes:
    """Return how a packet begins that has these groups, bits from the first on, and words."""
    return bytes([0xFA, groups & 0xFF]) + b"".join(word.to_bytes(2, "little") for word in words)


def _calibrated(numbers: Sequence[Number]) -> frozenset[str]:
    """Return of which quantities there are numbers as they were calibrated in the factory."""
    names = {number.name for number in numbers}
    return frozenset(base for base in FILTERED if f"{base}_x" in names)


def _renamed(numbers: Sequence[Number], calibrated: frozenset[str]) -> list[Number]:
    """Return the numbers; those of the filter have the plain names where nothing comes as calibrated."""
    bases = {*FILTERED} - calibrated
    plain = {f"{base}_compensated_{axis}": f"{base}_{axis}" for base in bases for axis in "xyz"}
    return [n._replace(column=KNOWN[plain[n.name]]) if n.name in plain else n for n in numbers]


class VectorNavDecoder(TableDecoder):
    """Decodes binary outputs with any fields and ASCII sentences, also mixed."""

    frames = (
        Frame({b"\xfa": "binary"}, _lengths, XMODEM),
        Frame({b"\xfb\x00": "split"}, partial(counted_lengths, 4, 2, 8, LONGEST_PACKET), XMODEM),
        line_frame({b"$VN": "ascii"}, _sentence),
    )
    timing = Timing(tick_ns=Fraction(1))
    messages = BY_PLACE
    side_groups, apart = SIDE_GROUPS, (*RECEIVERS.values(),)
    _have_come: frozenset[str] = frozenset()  # quantities, as they were calibrated in the factory

    def __init__(self) -> None:
        super().__init__()
        for name in ("roll", "pitch"):  # seldom sent: the columns of alignment keep their names
            del self._possible[name]

    def _by_layout(self, found: Found) -> Layouts:
        """Yield the layouts; where a calibrated quantity first comes, the filtered one gets another name."""
        if self._have_come == {*FILTERED}:
            yield from super()._by_layout(found)
            return
        begin = 0
        for _, rows, packet in self._alike(found):
            new = _calibrated(super()._numbers(packet)) - self._have_come
            if new:
                yield from self._between(found, begin, int(rows[0]))  # under the old names
                begin = int(rows[0])
                self._have_come |= new
                self._layouts.clear()
        yield from self._between(found, begin, len(found))

    def _between(self, found: Found, begin: int, end: int) -> Layouts:
        between = found.only(slice(begin, end))
        return ((layout, begin + rows) for layout, rows in super()._by_layout(between))

    def _signature(self, packet: bytes) -> Sequence[int]:
        if packet[:1] == b"$":
            return range(8)
        found = read_contents(packet)  # none of a split packet
        return () if isinstance(found, int) else found.identifying

    def _contents(self, packet: bytes) -> Placed:
        if packet[:1] == b"$":
            sentence = SENTENCES.get(packet[1:8].decode().strip())
            return [] if sentence is None else [(sentence, 0, sentence.size)]
        found = read_contents(packet)
        return [] if isinstance(found, int) else found.fields

    def _numbers(self, packet: bytes) -> list[Number]:
        return _renamed(super()._numbers(packet), self._have_come)

    def _layout(self, packet: bytes) -> Record | None:
        layout = super()._layout(packet)
        if layout is not None and "gyro_x" in layout.group_of and "gyro" not in self._have_come:
            self._report(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU",
                is_warning=True,
            )
        return layout

    def _plain(self, found: Found) -> Found:
        """Return sentences as records of their name and numbers; those that are no data are reported."""
        rows = np.flatnonzero(found.held[found.at] == ord("$"))
        records = dict[int, bytes]()
        lines = texts(found.held, found.at[rows], found.length[rows])
        for row, line in zip(rows.tolist(), lines, strict=True):
            read = _sentence(line)
            assert read is not None
            name, words, numbers = read
            records[row] = f"${name:<7}"[:8].encode() + array("d", numbers).tobytes()
            if name == "ERR":
                self._report(f"the device reports error {', '.join(words)}")
            elif name not in SENTENCES:
                self._report(f"sentence $VN{name} is counted and not read")
        return found.replaced(records)

    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of one binary output of fields GROUP.FIELD, sent in the order of their bits."""
        words = words_of(names)
        header = header_of(sum(1 << group - 1 for group in words), words.values())
        places = sorted({PLACES[name] for name in names})
        numbers = [number for place in places for number in BY_PLACE[place].numbers]
        sent = Message("binary output", tuple(_renamed(numbers, _calibrated(numbers))))
        return Encoder(partial(self._encode, lambda payload: XMODEM.sealed(header + payload), sent))
