"""HiPNUC CH0x, CH10x, HI12 ... HI14: the packets 0x91, 0x81 and 0x83.

Facts from the vendor's drivers.  0x83 lists the fields that follow by the bits of a word.  The temperature of
0x91 and 0x81 has steps of 1 degC: too coarse for a rate of change, so prefer 0x83 with bit 8.
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from itertools import takewhile

import numpy as np

from imumon.blocks import BoolArray, IntArray

from .base import ByteArray, Timing
from .framing import Checksum, Frame, counted_lengths, windows
from .messages import FamilyDecoder, Message, part, table

SYNC = b"\x5a\xa5"
HEADER, LONGEST = 6, 512 + 6  # bytes of the header, and of a frame that is believed; the latter assumed
OF_BITS = 0x83

_INS = "1 | status u16 | ins_status u8 1 status of the filter"
PACKETS = table(f"""
0x91 imu91: 1 | status u16 | temperature i8 | pressure f32 | device_ticks u32*1000 | accel f32*g
  | gyro f32*deg | mag f32 | angles f32*deg | q f32
0x81 ins81: {_INS} | gps_week u16 1 GPS week | gps_time_of_week u32 ms GPS time of week | 2 | gyro i16*0.001
  | accel i16*0.0048828 | mag i16*0.030517 | 4 | temperature i8 | 7 | roll i16*deg/100 | pitch i16*deg/100
  | yaw u16*deg/100 | q i16*0.0001 | longitude i32*1e-7 | latitude i32*1e-7 | altitude i32*0.001 | 10
  | velocity_enu_xyz i16*0.01 m/s velocity east, north, up
  | free_accel_enu_xyz i16*0.0048828 m/s^2 acceleration without gravity, east, north, up | 14
""")
"""Packets with one layout, by their tag."""

BITS = table("""
0 accel: accel f32
1 gyro: gyro f32*deg
2 mag: mag f32
3 angles: angles f32*deg
4 q: q f32
5 time: device_ticks u64
6 pulse: 8
7 pressure: pressure f32
8 temperature: temperature f32
9 inclination: inclination_xyz f32 deg of the axis
10 displacement: heave f32 m heave: displacement | surge f32 m surge: displacement
  | sway f32 m sway: displacement
11 frequency: heave_frequency f32 Hz heave: frequency | surge_frequency f32 Hz surge: frequency
  | sway_frequency f32 Hz sway: frequency
12 velocity: velocity_enu_xyz f32 m/s velocity east, north, up
13 free: free_accel_enu_xyz f32 m/s^2 acceleration without gravity, east, north, up
14 place: longitude f64 | latitude f64 | altitude f64
15 quality: quality_0 u8 1 quality of the solution | quality_1 u8 1 quality of the solution
  | quality_2 u8 1 quality of the solution | quality_3 u8 1 quality of the solution
16 odometer: odometer_speed f32 m/s of the odometer
17 undulation: undulation f32 m of the geoid
18 correction: correction_age f32 s of differential corrections
19 node: node u8 1 number of the node | 3
30 receiver: gnss_longitude f64 deg of the receiver | gnss_latitude f64 deg of the receiver
  | gnss_altitude f64 m of the receiver
31 moving: gnss_velocity_xyz f32 m/s of the receiver
""")
"""Fields of 0x83.

The unit of the rate, deg/s, is by analogy with 0x91: the vendor prints both under one name.
"""
HEAD = part(f"{_INS} | 4")


def of_bits(bits: int) -> Message:
    """Return the message 0x83 with the fields of these bits; it ends at the first bit that is not known."""
    there = takewhile(BITS.__contains__, (bit for bit in range(32) if bits >> bit & 1))
    return Message(f"imu83:{bits:#x}", (*HEAD, *(number for bit in there for number in BITS[bit].numbers)))


_XMODEM = Checksum("crc16-xmodem")  # the CRC stands in the header: as if it stood behind the payload


def _right(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    right = np.zeros(len(at), np.bool_)
    for size in np.flatnonzero(np.bincount(length)).tolist():
        which = np.flatnonzero(length == size)
        moved = windows(held, at[which], size)[:, [*range(4), *range(HEADER, size), 4, 5]]
        right[which] = np.all(_XMODEM.sealed_rows(moved[:, :-2]) == moved, axis=1)
    return right


class HipnucDecoder(FamilyDecoder):
    """Decodes the first packet of each frame: devices send one."""

    messages = PACKETS | {OF_BITS: of_bits(sum(1 << bit for bit in BITS))}
    frames = (Frame({SYNC: "HiPNUC"}, partial(counted_lengths, 2, 2, HEADER, LONGEST), _right),)
    timing = Timing(tick_ns=Fraction(1000))
    start, overhead = HEADER, HEADER

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a frame of a packet with one layout: its tag goes before its numbers."""
        payload = bytes([key]) + payload[1:]
        head = SYNC + len(payload).to_bytes(2, "little")
        return head + _XMODEM.sealed(head + payload)[-2:] + payload

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
        return int.from_bytes(bits, "little") << 8 | key if key == OF_BITS else key
