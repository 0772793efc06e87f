"""Safran (Sensonor) STIM300, STIM318 and STIM210: datagrams of normal mode.

Facts from the data sheet TS1524 and third-party drivers.  A datagram begins with its identifier, has the
blocks that this stands for, and ends with a CRC over all of it and zeros, which are not sent, up to a
multiple of four bytes.  What the numbers mean - rates or increments, the range of the accelerometers - is
set in the unit and is not in the datagram: the device file has to state it.
"""

from fractions import Fraction
from math import pi
from typing import Literal

import numpy as np
from pydantic import PositiveFloat

from imumon.blocks import IntArray
from imumon.geodesy import STANDARD_GRAVITY

from .base import ByteArray, Encoder, Timing
from .device import DeviceFile
from .framing import Checksum, Frame
from .messages import FamilyDecoder, Message, part

TICK_NS = 500_000  # the counter counts samples of the internal 2000 Hz, not datagrams
CRC_SIZE = 4
LINE_END = b"\r\n"
PLAIN = {
    0x90: "gyro", 0x91: "gyro acc", 0x92: "gyro incl", 0x93: "gyro acc incl", 0x94: "gyro gyro_temp",
    0xA5: "gyro acc gyro_temp acc_temp", 0xA6: "gyro incl gyro_temp incl_temp",
    0xA7: "gyro acc incl gyro_temp acc_temp incl_temp",
}  # fmt: skip
"""Blocks of each datagram."""
DATAGRAMS = {
    key: names
    for k, (plain, blocks) in enumerate(PLAIN.items())
    for key, names in ((plain, blocks), (0xF0 + k, f"{blocks} pps"))
}
"""The same with those from F0 on, which have a block for the pulse (PPS)."""
RANGE_BITS = {5: 20, 10: 19, 30: 18, 80: 16}
"""Bits behind the point of an acceleration in g, by the range in g; of an increment in m/s three more."""

AccelRange = Literal[5, 10, 30, 80]
Output = Literal["rate", "increment"]


def datagrams(output: Output, accel_range_g: AccelRange, rate_hz: float | None) -> dict[int, Message]:
    """Return the datagrams of normal mode by their identifier, which is byte 0 of the payload."""
    is_rate = output == "rate"
    per_sample = rate_hz or 1.0
    bits = RANGE_BITS[accel_range_g]
    rate = pi / 180 * (2.0**-14 if is_rate else 2.0**-21 * per_sample)
    force = STANDARD_GRAVITY * 2.0**-bits if is_rate else 2.0 ** -(bits + 3) * per_sample
    tilt = STANDARD_GRAVITY * 2.0**-22 if is_rate else 2.0**-25 * per_sample
    blocks = {
        "gyro": f"gyro i24*{rate!r}",
        "acc": f"accel i24*{force!r}",
        "incl": f"inclinometer_xyz i24*{tilt!r} m/s^2 specific force of the inclinometer",
        "gyro_temp": "temperature_x i16/256 | temperature_y i16/256 | temperature_z i16/256",
        "acc_temp": "accel_temperature_xyz i16/256 degC of the accelerometer",
        "incl_temp": "inclinometer_temperature_xyz i16/256 degC of the inclinometer",
        "pps": "time_since_pps u24*1.0 us since the edge of the pulse",
    }
    with_status = {
        name: f"{block} | {name}_status u8 1 status of {name}, bits; 0 is good"
        for name, block in blocks.items()
    }
    end = "device_ticks u8 | latency u16*1.0 us measurement to transmission"
    return {
        key: Message(f"{key:02X}", part(" | ".join(["1", *map(with_status.__getitem__, names.split()), end])))
        for key, names in DATAGRAMS.items()
    }


CHECK = Checksum("crc32-mpeg2", big=True, align=4)
SIZES = np.zeros(256, np.int64)
SIZES[[*DATAGRAMS]] = [message.size + CRC_SIZE for message in datagrams("rate", 10, None).values()]
"""Bytes of each datagram by its identifier, which are the same for any output and range."""


def _length(held: ByteArray, at: IntArray) -> IntArray:
    return SIZES[held[at]]


class StimDecoder(FamilyDecoder):
    """Decodes the datagrams of normal mode, with and without a line end behind them."""

    frames = (Frame({bytes([key]): f"datagram {key:02X}" for key in DATAGRAMS}, _length, CHECK, LINE_END),)
    timing = Timing(tick_ns=Fraction(TICK_NS), tick_bits=8)
    start, overhead, head, big = 0, CRC_SIZE, (0,), True

    def __init__(self, device: "StimDevice") -> None:
        self.messages = datagrams(device.output, device.accel_range_g, device.rate_hz)
        self._end = LINE_END if device.line_end else b""
        self._assumed = (
            f"read as {device.output}s with accelerometers of {device.accel_range_g} g, as the device file "
            "states: the datagrams do not hold it"
        )
        super().__init__()

    def wrap(self, key: int, payload: bytes) -> bytes:
        """Make a datagram."""
        return CHECK.sealed(bytes([key]) + payload[1:]) + self._end

    def _key(self, packet: bytes) -> int:
        self._report(self._assumed)
        return packet[0]


class StimDevice(DeviceFile):
    """Device file of a STIM300; `sends` and `line_end` are for its virtual twin alone."""

    protocol: Literal["stim300"]
    output: Output
    accel_range_g: AccelRange
    rate_hz: PositiveFloat
    sends: str = "A5"
    line_end: bool = False

    def decoder(self) -> StimDecoder:
        """Make a decoder for this device."""
        return StimDecoder(self)

    def encoder(self) -> Encoder:
        """Make an encoder that sends what the device would send."""
        return self.decoder().encoder([self.sends])
