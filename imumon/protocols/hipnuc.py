"""HiPNUC CH0x, CH10x, HI12 ... HI14: the packets 0x91, 0x81 and 0x83.

Facts from the vendor's drivers.  0x83 lists the fields that follow by the bits of a word.  The temperature of
0x91 and 0x81 has steps of 1 degC: too coarse for a rate of change, so prefer 0x83 with bit 8.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import pi

import numpy as np

from imumon.blocks import BoolArray, IntArray
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import ByteArray, Timing
from imumon.protocols.framing import Checksum, Frame, counted_length, windows
from imumon.protocols.messages import FamilyDecoder, Message, Part, axes, counted, field, floats, gap, real
from imumon.protocols.numbers import count, known, number, vector

SYNC = b"\x5a\xa5"
HEADER, LONGEST = 6, 512 + 6
DEGREE = pi / 180
SHORT_FORCE = 0.0048828
SHORT_MAG = 0.030517
OF_BITS = 0x83

TAG, STATUS = gap(1), floats("status", kind="u16")
INS_STATUS = counted("ins_status", "status of the filter", "u8")
PLACE = known("longitude", "latitude", "altitude")
VELOCITY_ENU = vector("velocity_enu", "m/s", "velocity east, north, up")
FREE_ENU = vector("free_accel_enu", "m/s^2", "acceleration without gravity, east, north, up")

PACKETS = {
    0x91: field("imu91", TAG, STATUS, floats("temperature", kind="i8"), floats("pressure"),
                floats("device_ticks", 1000.0, "u32"), floats("accel", STANDARD_GRAVITY),
                floats("gyro", DEGREE), floats("mag"), floats("angles", DEGREE), floats("q")),
    0x81: field("ins81", TAG, STATUS, INS_STATUS, counted("gps_week", "GPS week", "u16"),
                counted("gps_time_of_week", "GPS time of week", "u32", "ms"), gap(2),
                floats("gyro", 1e-3, "i16"), floats("accel", SHORT_FORCE, "i16"),
                floats("mag", SHORT_MAG, "i16"), gap(4), floats("temperature", kind="i8"), gap(7),
                floats(known("roll", "pitch"), DEGREE / 100, "i16"), floats("yaw", DEGREE / 100, "u16"),
                floats("q", 1e-4, "i16"), floats(PLACE[:2], 1e-7, "i32"), floats(PLACE[2:], 1e-3, "i32"),
                gap(10), floats(VELOCITY_ENU, 0.01, "i16"), floats(FREE_ENU, SHORT_FORCE, "i16"), gap(14)),
}  # fmt: skip
"""Packets with one layout, by their tag."""


def _several(name: str, unit: str, what: str) -> Part:
    return floats([number(f"{axis}{name}", unit, f"{axis}: {what}") for axis in ("heave", "surge", "sway")])


BITS: dict[int, Part] = {
    0: floats("accel"),
    1: floats("gyro", DEGREE),
    2: floats("mag"),
    3: floats("angles", DEGREE),
    4: floats("q"),
    5: floats("device_ticks", kind="u64"),
    6: gap(8),
    7: floats("pressure"),
    8: floats("temperature"),
    9: axes("inclination", "deg", "of the axis"),
    10: _several("", "m", "displacement"),
    11: _several("_frequency", "Hz", "frequency"),
    12: floats(VELOCITY_ENU),
    13: floats(FREE_ENU),
    14: floats(PLACE, kind="f64"),
    15: floats([count(f"quality_{k}", "quality of the solution") for k in range(4)], kind="u8"),
    16: real("odometer_speed", "m/s", "of the odometer"),
    17: real("undulation", "m", "of the geoid"),
    18: real("correction_age", "s", "of differential corrections"),
    19: counted("node", "number of the node", "u8") + gap(3),
    30: floats([number(f"gnss_{c.name}", c.unit, "of the receiver") for c in PLACE], kind="f64"),
    31: axes("gnss_velocity", "m/s", "of the receiver"),
}
"""Fields of 0x83.

The unit of the rate, deg/s, is by analogy with 0x91: the vendor prints both under one name.
"""
HEAD = (TAG, STATUS, INS_STATUS, gap(4))


def of_bits(bits: int) -> Message:
    """Return the message 0x83 with the fields of these bits; it ends at the first bit that nobody knows."""
    there = [BITS.get(bit) for bit in range(32) if bits >> bit & 1]
    end = there.index(None) if None in there else len(there)
    return field(f"imu83:{bits:#x}", *HEAD, *filter(None, there[:end]))


_XMODEM = Checksum("crc16-xmodem")
"""The CRC stands in the header: as if it stood behind the payload."""


def _right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    right = np.zeros(len(at), np.bool_)
    for size in np.flatnonzero(np.bincount(length)).tolist():
        which = np.flatnonzero(length == size)
        moved = windows(held, at[which], size)[:, [*range(4), *range(HEADER, size), 4, 5]]
        right[which] = _XMODEM(moved.reshape(-1), np.arange(len(which)) * size, np.full(len(which), size))
    return right


class HipnucDecoder(FamilyDecoder):
    """Decodes the first packet of each frame: devices send one."""

    messages = PACKETS | {OF_BITS: of_bits(sum(1 << bit for bit in BITS))}
    frames = (Frame({SYNC: "HiPNUC"}, counted_length(2, 2, HEADER, LONGEST), _right),)
    timing = Timing(tick_ns=Fraction(1000))
    start, more = HEADER, HEADER

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a frame of a packet: its tag, and the bits of 0x83 above it, go before its numbers."""
        first = bytes([key]) if key < 0x100 else bytes([OF_BITS, 0, 0, 0]) + (key >> 8).to_bytes(4, "little")
        payload = first + payload[len(first) :]
        head = SYNC + len(payload).to_bytes(2, "little")
        return head + _XMODEM.sealed(head + payload)[-2:] + payload

    def named(self, names: Sequence[str]) -> dict[str, tuple[int, Message]]:
        """Return ``imu91``, ``ins81``, and 0x83 with the bits that these names have, as ``imu83:0x123``."""
        bits = [int(name.partition(":")[2], 16) for name in names if name.startswith("imu83:0x")]
        there = PACKETS | {one << 8 | OF_BITS: of_bits(one) for one in bits}
        return {message.name: (key, message) for key, message in there.items()}

    def _message(self, key: int) -> Message | None:
        return of_bits(key >> 8) if key & 0xFF == OF_BITS else super()._message(key)

    def _signature(self, packet: bytes) -> Sequence[int]:
        places = (HEADER, *range(HEADER + 4, HEADER + 8)) if packet[HEADER:][:1] == b"\x83" else (HEADER,)
        return [place for place in places if place < len(packet)]

    def _key(self, packet: bytes) -> int:
        tag, bits = packet[HEADER:][:1], packet[HEADER + 4 : HEADER + 8]
        if tag and tag[0] not in (*PACKETS, OF_BITS):
            self._report("packets with other tags than 0x81, 0x83 and 0x91 are counted and not read")
        key = int.from_bytes(tag, "little")
        return int.from_bytes(bits, "little") << 8 | key if key == OF_BITS and len(bits) == 4 else key
