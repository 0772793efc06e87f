"""VectorNav VN-100 to VN-310: binary output (FA) with any mask of groups, and ASCII sentences ($VN).

Facts from the vendor's SDK and the VN-100 manual.  A binary packet is FA, a byte that says which groups
follow, a word for each that says which of its fields, the fields, and a CRC; it has no length: that is the
sum of the fields.  So a packet with a field that nobody knows cannot be read, and is passed over.

`AngRate`, `Accel` and `Mag` are what the device's filter has left: its own estimate of the gyro bias is
already taken off.  `Uncomp...` and `Imu` are calibrated in the factory and no more; they make ``gyro``,
``accel`` and ``mag`` as soon as they come, and the others are then ``gyro_compensated`` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import pi
from typing import Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import MAIN, Encoder, Timing
from imumon.protocols.checksums import CRCS
from imumon.protocols.device import DeviceFile
from imumon.protocols.frame_checks import CyclicCheck, Xor
from imumon.protocols.framing import (
    IMPOSSIBLE,
    INCOMPLETE,
    BoolArray,
    Found,
    Frame,
)
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.payload import Layout, LayoutDecoder, Placed, written
from imumon.protocols.stream import LONGEST_PACKET, ByteArray
from imumon.protocols.tagged import NO_GROUP, Value
from imumon.protocols.tagged_columns import count, known, number, vector

DEGREE = pi / 180
GAUSS = 100.0
KILOPASCAL = 1000.0
COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2, GNSS3 = 1, 2, 3, 4, 5, 6, 7, 12
RECEIVERS = {GNSS1: "gnss1", GNSS2: "gnss2", GNSS3: "gnss3"}
SIDE_GROUPS = ("mag", "temperature", "pressure", "attitude", "filter", *RECEIVERS.values())
FILTERED = ("gyro", "accel", "mag")
"""What the device sends both as it was calibrated in the factory and as its filter has left it."""


@dataclass(frozen=True, slots=True)
class Item:
    """A field of a binary group: its name, its numbers, and the group of columns that it belongs to.

    A field that only counts bytes has none but `size`; one with `repeat` has so many more bytes for each
    count of the byte at `counter`.
    """

    name: str
    values: tuple[Value, ...] = ()
    group: str = MAIN
    size: int = 0
    repeat: int = 0
    counter: int = 0


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

    def real(name: str, unit: str, kind: str = "f32", factor: float = 1.0) -> Value:
        return Value(number(f"{prefix}_{name}", unit, f"receiver {prefix}: {name}"), kind, factor)

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


def _size(item: Item) -> int:
    return sum(NUMBER_TYPES[value.type].size for value in item.values) or item.size


MOST_HEADER = 64


def read_header(packet: bytes) -> Header | int:
    """Return what the header of a packet announces, or the code of why it is none; see `Lengths`."""
    groups: list[int] = []
    at = 1
    for first in (1, 8):
        if at >= len(packet):
            return INCOMPLETE
        groups += [first + bit for bit in range(7) if packet[at] >> bit & 1]
        at += 1
        if not packet[at - 1] & 0x80:
            break
    else:
        return IMPOSSIBLE
    items: list[Item] = []
    for group in groups:
        first, more = 0, group in GROUPS
        if not more:
            return IMPOSSIBLE
        while more:
            if at + 2 > len(packet):
                return INCOMPLETE
            word = int.from_bytes(packet[at : at + 2], "little")
            at += 2
            more = group != COMMON and bool(word >> 15)
            bits = [first + k for k in range(16 if group == COMMON else 15) if word >> k & 1]
            found = [GROUPS[group][bit] if bit < len(GROUPS[group]) else None for bit in bits]
            items += [item for item in found if item is not None]
            if None in found:
                return IMPOSSIBLE
            first += 16
    return Header(tuple(items), at) if items else IMPOSSIBLE


@dataclass(frozen=True, slots=True)
class Header:
    """What a header announces, in the order of the payload, and the bytes it has, FA included."""

    items: tuple[Item, ...]
    size: int

    def offsets(self, packet: ByteArray) -> list[int] | int:
        """Return where each field of a packet begins and where the last ends, or why that is not known."""
        at, places = self.size, []
        for item in self.items:
            places.append(at)
            if item.repeat:
                if at + item.counter >= len(packet):
                    return INCOMPLETE
                at += item.repeat * int(packet[at + item.counter])
            at += _size(item)
            if at + 2 > LONGEST_PACKET:
                return IMPOSSIBLE
        return [*places, at]


_POPCOUNT = np.array([bin(byte & 0x7F).count("1") for byte in range(256)])
_WIDEST = 16
"""Bytes of a header of all groups of the first byte."""


def _sizes() -> tuple[IntArray, BoolArray, BoolArray]:
    """Return by group, half of the word and its value: bytes of the fields; if all are known; if it goes on.

    Shapes (8, 2, 256).  A word goes on when its last bit or a field that counts itself is set.
    """
    sizes = np.zeros((8, 2, 256), np.int64)
    known, longer = np.zeros((8, 2, 256), np.bool_), np.zeros((8, 2, 256), np.bool_)
    for group, half, value in np.ndindex(sizes.shape):
        items = GROUPS.get(group, ())
        bits = [8 * half + k for k in range(8) if value >> k & 1]
        more = group != COMMON and 15 in bits
        found = [items[bit] if bit < len(items) else None for bit in bits if not (more and bit == 15)]
        known[group, half, value] = None not in found
        longer[group, half, value] = more or any(item is not None and item.repeat for item in found)
        sizes[group, half, value] = sum(_size(item) for item in found if item is not None)
    return sizes, known, longer


_SIZES, _KNOWN, _LONGER = _sizes()


def _headers(held: ByteArray, at: IntArray) -> ByteArray:
    """Return the bytes of each header as its first group byte has them, and zeros, (n, 16)."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(held, (0, _WIDEST)), _WIDEST)[at]
    size = 2 + 2 * _POPCOUNT[windows[:, 1]]
    return np.where(np.arange(_WIDEST) < size[:, np.newaxis], windows, np.uint8(0))


def _lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the packet at each place; see `imumon.protocols.framing.Lengths`.

    Read at once, but for headers of a second group byte or word, and fields that count themselves.
    """
    headers, rows = _headers(held, at), np.arange(len(at))
    place, length = np.full(len(at), 2), np.zeros(len(at), np.int64)
    good, alone = headers[:, 1] != 0, headers[:, 1] >= 0x80
    for group in range(1, 8):
        there = headers[:, 1] >> (group - 1) & 1 != 0
        for half in range(2):
            word = headers[rows, np.minimum(place, _WIDEST - 1)]
            length += np.where(there, _SIZES[group, half, word], 0)
            good &= ~there | _KNOWN[group, half, word]
            alone |= there & _LONGER[group, half, word]
            place += there
    result = np.where(good & (length > 0), place + length + 2, IMPOSSIBLE)
    for k in np.flatnonzero(good & alone | (at + place > len(held))).tolist():
        packet = held[at[k] :]
        result[k] = _length(packet, read_header(packet[:MOST_HEADER].tobytes()))
    return result


def _length(packet: ByteArray, header: Header | int) -> int:
    if isinstance(header, int):
        return header
    offsets = header.offsets(packet)
    return offsets if isinstance(offsets, int) else offsets[-1] + 2


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
LONGEST_SENTENCE = 512
XMODEM = CyclicCheck(CRCS["crc16-xmodem"], first=1, big=True)


def _sentence_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the line at each place, its end included."""
    ends = np.flatnonzero(held == 0x0A)
    k = np.searchsorted(ends, at)
    there = k < len(ends)
    length = np.full(len(at), INCOMPLETE, np.int64)
    length[there] = ends[k[there]] + 1 - at[there]
    length[~there & (len(held) - at > LONGEST_SENTENCE)] = IMPOSSIBLE
    length[length > LONGEST_SENTENCE] = IMPOSSIBLE
    return length


def _sentences_right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Check the sum and the number of fields of each line: torn lines may have a sum that fits."""
    spans = zip(at.tolist(), length.tolist(), strict=True)
    return np.array([_sentence(held[a : a + n].tobytes()) is not None for a, n in spans], np.bool_)


def _sentence(line: bytes) -> tuple[str, list[str]] | None:
    """Return header and fields of a line that is right, else None."""
    body, star, given = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or len(given) not in (2, 4) or not body.isascii():
        return None
    check = Xor(first=1) if len(given) == 2 else XMODEM
    try:
        if check.sealed(body) != body + bytes.fromhex(given.decode()):
            return None
    except ValueError:
        return None
    name, *fields = body[3:].decode("ascii").split(",")
    values = SENTENCES.get(name)
    if values is not None:
        if fields and fields[-1][:1] in ("S", "T") and len(fields) > len(values):
            fields = fields[: len(values)]  # the appendix with status or time
        if len(fields) != len(values) or any(_real(text) is None for text in fields):
            return None
    return name, fields


def _real(text: str) -> float | None:
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None


class SentenceLayout:
    """A line of text with one number a field."""

    def __init__(self, values: Sequence[Value]) -> None:
        self._values = values
        self.columns = tuple(value.column for value in values if value.column is not None)
        self.of_column = {column.name: MAIN for column in self.columns}

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a line for each column."""
        lines = (
            _sentence(found.held[a : a + n].tobytes())
            for a, n in zip(found.at.tolist(), found.length.tolist(), strict=True)
        )
        numbers: FloatArray = np.array([[float(t) for t in line[1]] for line in lines if line is not None])
        return {
            value.column.name: numbers[:, k] * value.factor
            for k, value in enumerate(self._values)
            if value.column is not None
        }


BINARY, SPLIT, SENTENCE = range(3)


def _split_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of the parts of a long message (FB), which are counted and not read."""
    length = np.full(len(at), INCOMPLETE, np.int64)
    there = np.flatnonzero(at + 6 <= len(held))
    size = held[at[there] + 4].astype(np.int64) | held[at[there] + 5].astype(np.int64) << 8
    length[there] = np.where(held[at[there] + 1] == 0, size + 8, IMPOSSIBLE)
    length[length > LONGEST_PACKET] = IMPOSSIBLE
    return length


class VectorNavDecoder(LayoutDecoder):
    """Decodes binary outputs with any fields and ASCII sentences, mixed as they may come."""

    def __init__(self, rate_hz: float | None = None) -> None:
        frames = (
            Frame("binary", b"\xfa", _lengths, XMODEM),
            Frame("split", b"\xfb", _split_lengths, XMODEM),
            Frame("ascii", b"$VN", _sentence_lengths, _sentences_right),
        )
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        super().__init__(frames, timing, SIDE_GROUPS, apart=tuple(RECEIVERS.values()))
        self._kinds: dict[bytes, int] = {}
        self._known: list[_Kind] = []
        self._factory: frozenset[str] = frozenset()
        self._numbers: dict[tuple[int, frozenset[str]], int] = {}

    def _layout_numbers(self, found: Found) -> IntArray:
        kinds = self._kinds_of(found)
        numbers = np.full(len(found), -1, np.int64)
        begin = 0
        firsts = sorted(zip(*np.unique(kinds, return_index=True)[::-1], strict=True))
        for first, kind in [(int(f), int(k)) for f, k in firsts if k >= 0] + [(len(found), -1)]:
            new = frozenset() if kind < 0 else self._known[kind].factory - self._factory
            if new or kind < 0:
                numbers[begin:first] = self._numbered(kinds[begin:first])
                self._factory |= new
                begin = first
        return numbers

    def _kinds_of(self, found: Found) -> IntArray:
        """Return the number of the kind of each packet, its header; -1: one that is only counted."""
        kinds = np.full(len(found), -1, np.int64)
        binary = np.flatnonzero(found.frame == BINARY)
        headers = np.ascontiguousarray(_headers(found.held, found.at[binary])).view(f"S{_WIDEST}")
        _, first, same = np.unique(headers.reshape(-1), return_index=True, return_inverse=True)
        of_header = np.array([self._kind(found, k) for k in binary[first].tolist()], np.int64)
        kinds[binary] = of_header[same.reshape(-1)]
        alone = np.array([self._known[k].alone for k in of_header.tolist()], np.bool_)[same.reshape(-1)]
        for k in [*binary[alone].tolist(), *np.flatnonzero(found.frame == SENTENCE).tolist()]:
            kinds[k] = self._kind(found, k)
        return kinds

    def _kind(self, found: Found, k: int) -> int:
        """Return the number of the kind of one packet."""
        packet = found.held[found.at[k] : found.at[k] + found.length[k]]
        if found.frame[k] == SENTENCE:
            key = packet[:6].tobytes()
            if key not in self._kinds:
                self._tell(packet.tobytes())
            placed = [(value, 0, MAIN) for value in SENTENCES.get(key[3:].decode("ascii", "replace"), ())]
            return self._known_kind(key, placed, alone=False)
        header = read_header(packet[:MOST_HEADER].tobytes())
        assert not isinstance(header, int)
        repeats = any(item.repeat for item in header.items)
        key = packet[: header.size].tobytes() + (len(packet).to_bytes(2, "big") if repeats else b"")
        if key in self._kinds:
            return self._kinds[key]
        offsets = header.offsets(packet)
        assert not isinstance(offsets, int)
        placed = []
        for item, at in zip(header.items, offsets[:-1], strict=True):
            for value in item.values:
                placed.append((value, at, item.group))
                at += NUMBER_TYPES[value.type].size
        alone = repeats or packet[1] >= 0x80 or header.size != 2 + 2 * int(_POPCOUNT[packet[1]])
        return self._known_kind(key, placed, alone)

    def _known_kind(self, key: bytes, placed: Sequence[tuple[Value, int, str]], alone: bool) -> int:
        if key not in self._kinds:
            there = {value.column.name for value, _, _ in placed if value.column is not None}
            factory = frozenset(base for base in FILTERED if f"{base}_x" in there)
            self._kinds[key] = len(self._known)
            self._known.append(_Kind(tuple(placed), factory, alone, key[:1] != b"\xfa"))
        return self._kinds[key]

    def _numbered(self, kinds: IntArray) -> IntArray:
        """Return the number of the layout of each kind, as what is known of the stream has it."""
        numbers = np.full(len(kinds), -1, np.int64)
        for kind in np.unique(kinds[kinds >= 0]).tolist():
            key = kind, self._factory
            if key not in self._numbers:
                self._numbers[key] = self._layout(self._known[kind])
            numbers[kinds == kind] = self._numbers[key]
        return numbers

    def _layout(self, kind: _Kind) -> int:
        """Add the layout of a kind of packet; return its number, or -1 when it has nothing for a row."""
        alone = [base for base in FILTERED if base not in self._factory | kind.factory]
        placed = [(_without_suffix(value, alone), at, group) for value, at, group in kind.placed]
        layout: Layout = SentenceLayout([v for v, _, _ in placed]) if kind.text else Placed(placed)
        if "gyro_x" in layout.of_column and "gyro" in alone:
            self._warn(
                "the angular rate is that of the device's filter, which has taken its own estimate of "
                "the gyro bias off: what imumon finds is the rest of it; send UncompGyro, Imu or $VNIMU"
            )
        return self._add(layout) if layout.columns else -1

    def _tell(self, line: bytes) -> None:
        """Say what a sentence says that is not data."""
        read = _sentence(line)
        assert read is not None
        if read[0] == "ERR":
            self._say(f"the device reports error {', '.join(read[1])}")
        elif read[0] not in SENTENCES:
            self._say(f"sentence $VN{read[0]} is counted and not read")


@dataclass(frozen=True, slots=True)
class _Kind:
    """Packets with one header: their numbers, and which quantities they have as calibrated in the factory."""

    placed: tuple[tuple[Value, int, str], ...]
    factory: frozenset[str]
    alone: bool
    """Whether other packets may have the same first bytes."""
    text: bool


def _without_suffix(value: Value, bases: Sequence[str]) -> Value:
    """Return the number for the column without "compensated" when it is of one of these."""
    name = "" if value.column is None else value.column.name
    base, _, axis = name.partition("_compensated_")
    return Value(KNOWN[f"{base}_{axis}"], value.type, value.factor) if axis and base in bases else value


class VectorNavEncoder(Encoder):
    """Makes binary packets of one output.

    Parameters
    ----------
    names : sequence of str
        GROUP.FIELD, for example ``Imu.UncompGyro``; sent in the order of their bits.

    Raises
    ------
    ImumonError
        BAD_CONFIG when there is no such field.
    """

    def __init__(self, names: Sequence[str]) -> None:
        places = {
            f"{GROUP_NAMES[group]}.{item.name}": (group, bit, item)
            for group, items in GROUPS.items()
            for bit, item in enumerate(items)
            if item is not None and item.values
        }
        for name in names:
            if name not in places:
                raise ImumonError(
                    Reason.BAD_CONFIG, f"no field {name!r}", f"there are: {', '.join(sorted(places))}"
                )
        sent = sorted((places[name] for name in names), key=lambda place: place[:2])
        words: dict[int, int] = {}
        for group, bit, _ in sent:
            words[group] = words.get(group, 0) | 1 << bit
        groups = sum(1 << group - 1 for group in words if group < 8)
        self._header = bytes([0xFA, groups]) + b"".join(word.to_bytes(2, "little") for word in words.values())
        factory = {base for base in FILTERED for *_, item in sent if f"{base}_x" in _names(item)}
        bases = [base for base in FILTERED if base not in factory]
        self._values = [_without_suffix(value, bases) for *_, item in sent for value in item.values]

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; see `imumon.protocols.base.Encoder`."""
        payload = written(self._values, block, "binary output")
        bodies = [self._header + row.tobytes() for row in payload]
        return [XMODEM.sealed(body) for body in bodies]


def _names(item: Item) -> set[str]:
    return {value.column.name for value in item.values if value.column is not None}


class VectorNavDevice(DeviceFile):
    """Device file of a VectorNav; `sends` is for its virtual twin alone."""

    protocol: Literal["vectornav"]
    sends: list[str]

    def decoder(self) -> VectorNavDecoder:
        """Make a decoder for this device."""
        return VectorNavDecoder(self.rate_hz)

    def encoder(self) -> VectorNavEncoder:
        """Make an encoder that sends what the device would send."""
        return VectorNavEncoder(self.sends)
