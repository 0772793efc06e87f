"""WitMotion (JY901, WT901, HWT905, WT61, ...): frames of 11 bytes, one quantity each, and the 0x61 form.

Facts from the vendor's sample code and third-party descriptions.  A sample is several frames one after the
other (0x51 specific force, 0x52 rate, 0x53 attitude, 0x54 magnetic field, ...), which have no time: a row
begins when a quantity comes again.  Modules with Bluetooth or a card send 0x61 instead, with rate, force and
attitude in one frame of 20 or 28 bytes, without a checksum: it counts when the next one follows at once.

Many units send a rate of exactly zero while they take themselves to be at rest.
"""

from fractions import Fraction
from math import pi

import numpy as np

from imumon.blocks import ColumnArray, IntArray
from imumon.columns import KNOWN
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import NO_GROUP, ByteArray, Packets, Timing
from imumon.protocols.framing import INCOMPLETE, NO_PACKET, Checksum, Found, Frame, fixed_length, unchecked
from imumon.protocols.messages import FamilyDecoder, Part, axes, counted, field, floats, gap, real
from imumon.protocols.numbers import Columns, Derived, Number, count, date, known, number, utc_time

FORCE_FACTOR, RATE_FACTOR, ANGLE_FACTOR = (16 * STANDARD_GRAVITY / 32768, 2000 * pi / 180 / 32768, pi / 32768)
HEADER, SIZE = 2, 11
SHORT, LONG = 20, 28
COMBINED = 0x61
ZEROS = 10
"""Frames in a row with three rates of zero, after which it is reported: with noise that needs much luck."""


def _date(prefix: str, per_ms: int) -> Part:
    """Return the parts of a date, sources of a time; so many counts a millisecond."""
    of_second, year, *parts = date(prefix)
    return (Number(year, "u8", offset=2000), *floats(parts, kind="u8"), *floats([of_second], per_ms, "u16"))


CLOCK = count("device_clock", "calendar of the device as Unix time; not that of the sample", "ns")
DILUTIONS = [number(f"gnss_{c}dop", "1", "dilution") for c in "phv"]


def _degrees_of(columns: Columns) -> list[ColumnArray]:
    """Return degrees of numbers whose digits are degrees and, the last seven, minutes times 1e5."""
    values = [columns[name] for name in ("_longitude", "_latitude")]
    return [np.sign(v) * (np.abs(v) // 10_000_000 + np.abs(v) % 10_000_000 / 6e6) for v in values]


def _digits_of(columns: Columns) -> list[ColumnArray]:
    values = [columns[name] for name in ("longitude", "latitude")]
    return [np.rint(np.trunc(v) * 1e7 + (v - np.trunc(v)) * 6e6).astype(np.int64) for v in values]


PORTS = [count(f"port_d{k}", f"port D{k}") for k in range(4)]
PLACE = [count("_longitude", "longitude"), count("_latitude", "latitude")]
DERIVED = (
    utc_time("clock_", CLOCK),
    utc_time("sample_", KNOWN["device_ticks"], per_s=1000),  # 0x61 has the time of the sample itself
    Derived(("_longitude", "_latitude"), known("longitude", "latitude"), _degrees_of, _digits_of),
)

ACCEL, GYRO = floats("accel", FORCE_FACTOR, "i16"), floats("gyro", RATE_FACTOR, "i16")
ANGLES = floats("angles", ANGLE_FACTOR, "i16")
TYPES = {
    0x50: field("time", _date("clock_", 1_000_000), group=NO_GROUP),
    0x51: field("accel", ACCEL, floats("temperature", 0.01, "i16")),
    0x52: field("gyro", GYRO, gap(2)),
    0x53: field("angle", ANGLES, gap(2), group="attitude"),
    0x54: field("mag", axes("mag", "a.u.", "magnetic field, raw counts", kind="i16"), gap(2),
                group="mag"),
    0x55: field("ports", floats(PORTS, kind="u16"), group="status"),
    0x56: field("pressure", floats("pressure", kind="u32"),
                real("pressure_altitude", "m", "from the pressure", "i32", 0.01), group="pressure"),
    0x57: field("position", floats(PLACE, kind="i32"), group="gnss"),
    0x58: field("speed", real("gnss_altitude", "m", "of the receiver", "i16", 0.1),
                real("gnss_course", "rad", "of the receiver", "i16", pi / 1800),
                real("gnss_speed", "m/s", "over ground", "u32", 1 / 3600), group="gnss"),
    0x59: field("quaternion", floats("q", 1 / 32768, "i16"), group="attitude"),
    0x5A: field("satellites", counted("gnss_satellites", "in use", "u16"), floats(DILUTIONS, 0.01, "u16"),
                group="gnss"),
}  # fmt: skip
"""What each type carries; the fourth number of 0x52 and 0x54 depends on the model and is left out."""
IN_ONE = (ACCEL, GYRO, tuple(angle._replace(group="attitude") for angle in ANGLES))
COMBINED_FORMS = {
    COMBINED << 8 | SHORT: field("combined", *IN_ONE),
    COMBINED << 8 | LONG: field("timed", *IN_ONE, _date("sample_", 1)),
}
"""The frame of several quantities, by its length."""


def _combined_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of 0x61 by where the next one begins."""
    result = np.full(len(at), NO_PACKET, np.int64)
    for size in (LONG, SHORT):
        there = at + size + 1 < len(held)
        next_at = np.where(there, at + size, 0)
        result[there & (held[next_at] == 0x55) & (held[next_at + 1] == COMBINED)] = size
    waits = at + LONG + 1 >= len(held)
    return np.where(waits & (result < 0), INCOMPLETE, result)


class WitMotionDecoder(FamilyDecoder):
    """Decodes frames of all types, and 0x61 in both lengths."""

    messages = TYPES | COMBINED_FORMS
    frames = (
        Frame(
            {bytes([0x55, kind]): item.name for kind, item in TYPES.items()} | {b"\x55\x5f": "register"},
            fixed_length(SIZE),
            Checksum("sum8"),
        ),
        Frame({bytes([0x55, COMBINED]): "combined"}, _combined_lengths, unchecked),
    )
    timing = Timing(tick_ns=Fraction(1_000_000))
    start, more, head = HEADER, HEADER, (1,)
    apart = ("gnss",)
    derived = DERIVED
    _still = np.zeros(ZEROS, np.bool_)
    """Whether the last rates were zero."""

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a frame of a type, or the combined one."""
        if key in COMBINED_FORMS:
            return bytes([0x55, COMBINED]) + payload
        return Checksum("sum8").sealed(bytes([0x55, key]) + payload)

    def _key(self, packet: bytes) -> int:
        return packet[1] << 8 | len(packet) if packet[1] == COMBINED else packet[1]

    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        """Read the packets, and warn when the rates of many in a row are exactly zero."""
        packets = super()._read(found, arrival_ns)
        if "gyro_x" not in packets.block:
            return packets
        rates = np.column_stack([packets.block[f"gyro_{axis}"] for axis in "xyz"])
        still = np.append(self._still, ~np.any(rates[~np.isnan(rates[:, 0])], axis=1))
        self._still = still[1 - ZEROS :]
        if np.convolve(still, np.ones(ZEROS), "valid").max(initial=0) == ZEROS:
            self._warn(
                "the device sends rates of exactly zero: at rest it takes off what it holds for bias, "
                "so bias and noise found from them mean nothing"
            )
        return packets
