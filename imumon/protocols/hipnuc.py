"""HiPNUC CH0x, CH10x, HI12 ... HI14: the packets 0x91, 0x81 and 0x83.

Facts from the vendor's drivers.  0x83 lists the fields that follow by the bits of a word.  The temperature of
0x91 and 0x81 has steps of 1 degC: too coarse for a rate of change, so prefer 0x83 with bit 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import pi
from typing import Final

from imumon.columns import Column
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import Timing
from imumon.protocols.checks import Checksum, Rearranged
from imumon.protocols.framing import Frame, counted_length
from imumon.protocols.messages import FamilyDecoder, Message, part
from imumon.protocols.numbers import count, known, number, vector

SYNC = b"\x5a\xa5"
HEADER, LONGEST = 6, 512 + 6
DEGREE: Final = pi / 180
SHORT_FORCE: Final = 0.0048828
SHORT_MAG: Final = 0.030517
OF_BITS = 0x83

STATUS = part(1, "u16", "status")
INS_STATUS = part(3, "u8", [count("ins_status", "status of the filter")])
PLACE = known("longitude", "latitude", "altitude")
VELOCITY_ENU = vector("velocity_enu", "m/s", "velocity east, north, up")
FREE_ENU = vector("free_accel_enu", "m/s^2", "acceleration without gravity, east, north, up")

PACKETS = {
    0x91: Message("imu91", 76, (STATUS, part(3, "i8", "temperature"), part(4, "f32", "pressure"),
                                part(8, "u32", "device_ticks", 1000.0),
                                part(12, "f32", "accel", STANDARD_GRAVITY), part(24, "f32", "gyro", DEGREE),
                                part(36, "f32", "mag"), part(48, "f32", "angles", DEGREE),
                                part(60, "f32", "q"))),
    0x81: Message("ins81", 104, (STATUS, INS_STATUS, part(4, "u16", [count("gps_week", "GPS week")]),
                                 part(6, "u32", [count("gps_time_of_week", "GPS time of week", "ms")]),
                                 part(12, "i16", "gyro", 1e-3), part(18, "i16", "accel", SHORT_FORCE),
                                 part(24, "i16", "mag", SHORT_MAG), part(34, "i8", "temperature"),
                                 part(42, "i16", known("roll", "pitch"), DEGREE / 100),
                                 part(46, "u16", "yaw", DEGREE / 100), part(48, "i16", "q", 1e-4),
                                 part(56, "i32", PLACE[:2], 1e-7), part(64, "i32", PLACE[2:], 1e-3),
                                 part(78, "i16", VELOCITY_ENU, 0.01),
                                 part(84, "i16", FREE_ENU, SHORT_FORCE))),
}  # fmt: skip
"""Packets with one layout, by their tag."""

Bit = tuple[str, str | Sequence[Column], float, int]


def _several(name: str, unit: str, what: str) -> Sequence[Column]:
    return tuple(number(f"{axis}{name}", unit, f"{axis}: {what}") for axis in ("heave", "surge", "sway"))


BITS: dict[int, Bit] = {
    0: ("f32", "accel", 1.0, 12),
    1: ("f32", "gyro", DEGREE, 12),
    2: ("f32", "mag", 1.0, 12),
    3: ("f32", "angles", DEGREE, 12),
    4: ("f32", "q", 1.0, 16),
    5: ("u64", "device_ticks", 1.0, 8),
    6: ("", (), 1.0, 8),
    7: ("f32", "pressure", 1.0, 4),
    8: ("f32", "temperature", 1.0, 4),
    9: ("f32", vector("inclination", "deg", "of the axis"), 1.0, 12),
    10: ("f32", _several("", "m", "displacement"), 1.0, 12),
    11: ("f32", _several("_frequency", "Hz", "frequency"), 1.0, 12),
    12: ("f32", VELOCITY_ENU, 1.0, 12),
    13: ("f32", FREE_ENU, 1.0, 12),
    14: ("f64", PLACE, 1.0, 24),
    15: ("u8", [count(f"quality_{k}", "quality of the solution") for k in range(4)], 1.0, 4),
    16: ("f32", [number("odometer_speed", "m/s", "of the odometer")], 1.0, 4),
    17: ("f32", [number("undulation", "m", "of the geoid")], 1.0, 4),
    18: ("f32", [number("correction_age", "s", "of differential corrections")], 1.0, 4),
    19: ("u8", [count("node", "number of the node")], 1.0, 4),
    30: ("f64", [number(f"gnss_{c.name}", c.unit, "of the receiver") for c in PLACE], 1.0, 24),
    31: ("f32", vector("gnss_velocity", "m/s", "of the receiver"), 1.0, 12),
}
"""Fields of 0x83: number type, columns, factor, and bytes.

The unit of the rate, deg/s, is by analogy with 0x91: the vendor prints both under one name.
"""


def of_bits(bits: int) -> Message:
    """Return the message 0x83 with the fields of these bits; it ends at the first bit that nobody knows."""
    parts = [STATUS, INS_STATUS]
    at = 8
    for bit in (bit for bit in range(32) if bits >> bit & 1):
        if bit not in BITS:
            break
        kind, columns, factor, size = BITS[bit]
        if columns:
            parts.append(part(at, kind, columns, factor))
        at += size
    return Message(f"imu83:{bits:#x}", at, tuple(parts))


def _header_behind(size: int) -> list[int]:
    return [*range(4), *range(HEADER, size), 4, 5]


_XMODEM = Checksum("crc16-xmodem")
_RIGHT = Rearranged(_XMODEM, _header_behind)
"""The CRC stands in the header: as if it stood behind the payload."""


class HipnucDecoder(FamilyDecoder):
    """Decodes the first packet of each frame: devices send one."""

    messages = PACKETS | {OF_BITS: of_bits(sum(1 << bit for bit in BITS))}
    frames = (Frame({SYNC: "HiPNUC"}, counted_length(2, 2, HEADER, LONGEST), _RIGHT),)
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
