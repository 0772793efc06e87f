"""WitMotion (JY901, WT901, HWT905, WT61, ...): frames of 11 bytes, one quantity each, and the 0x61 form.

Facts from the vendor's sample code and third-party descriptions.  A sample is several frames one after the
other (0x51 specific force, 0x52 rate, 0x53 attitude, 0x54 magnetic field, ...), which have no time: a row
begins when a quantity comes again.  Modules with Bluetooth or a card send 0x61 instead, with rate, force and
attitude in one frame of 20 or 28 bytes, without a checksum: it counts when the next one follows at once.

Many units send a rate of exactly zero while they take themselves to be at rest.
"""

from fractions import Fraction

import numpy as np

from imumon.blocks import ColumnArray, Columns, IntArray
from imumon.columns import KNOWN, Column

from .base import ByteArray, Packets, Timing
from .framing import INCOMPLETE, NO_PACKET, Checksum, Found, Frame
from .messages import FamilyDecoder, Message, part, table
from .numbers import Derived, known, utc_time

HEADER, SIZE = 2, 11
SHORT, LONG = 20, 28
COMBINED = 0x61
ZEROS = 10
"""Frames in a row with three rates of zero, after which it is reported: with noise that needs much luck."""

_DATE = """_{0}year u8+2000 1 year | _{0}month u8 1 month | _{0}day u8 1 day | _{0}hour u8 1 hour
  | _{0}minute u8 1 minute | _{0}second u8 1 second | _{0}of_second u16*{1} 1 ms"""
"""Parts of a date, by its name, and how many counts of the time that is made of them a millisecond has."""
CLOCK = Column("device_clock", "ns", "int64", "calendar of the device as Unix time; not that of the sample")


def _degrees_of(columns: Columns) -> list[ColumnArray]:
    """Return degrees of numbers whose digits are degrees and, the last seven, minutes times 1e5."""
    values = [columns[name] for name in ("_longitude", "_latitude")]
    return [np.sign(v) * (np.abs(v) // 10_000_000 + np.abs(v) % 10_000_000 / 60e5) for v in values]


_ACCEL, _GYRO, _ANGLES = "accel i16*16*g/32768", "gyro i16*2000*pi/180/32768", "angles i16*pi/32768"
TYPES = table(f"""
0x50 time []: {_DATE.format("clock_", 1_000_000)}
0x51 accel: {_ACCEL} | temperature i16*0.01
0x52 gyro: {_GYRO} | 2
0x53 angle [attitude]: {_ANGLES} | 2
0x54 mag [mag]: mag_xyz i16*1.0 a.u. magnetic field, raw counts | 2
0x55 ports [status]: port_d0 u16 1 port D0 | port_d1 u16 1 port D1 | port_d2 u16 1 port D2
  | port_d3 u16 1 port D3
0x56 pressure [pressure]: pressure u32 | pressure_altitude i32*0.01 m from the pressure
0x57 position [gnss]: _longitude i32 1 longitude | _latitude i32 1 latitude
0x58 speed [gnss]: gnss_altitude i16*0.1 m of the receiver | gnss_course i16*pi/1800 rad of the receiver
  | gnss_speed u32/3600 m/s over ground
0x59 quaternion [attitude]: q i16/32768
0x5A satellites [gnss]: gnss_satellites u16 1 in use
  | gnss_pdop u16*0.01 1 dilution | gnss_hdop u16*0.01 1 dilution | gnss_vdop u16*0.01 1 dilution
""")
"""What each type carries; the fourth number of 0x52 and 0x54 depends on the model and is left out."""
IN_ONE = (*part(f"{_ACCEL} | {_GYRO}"), *(angle._replace(group="attitude") for angle in part(_ANGLES)))
COMBINED_FORMS = {
    COMBINED << 8 | SHORT: Message("combined", IN_ONE),
    COMBINED << 8 | LONG: Message("timed", IN_ONE + part(_DATE.format("sample_", 1))),
}
"""The frame of several quantities, by its length."""


def _combined_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of 0x61 by where the next one begins."""
    result = np.full(len(at), NO_PACKET, np.int64)
    padded = np.pad(held, (0, LONG + 1))
    for size in (LONG, SHORT):
        result[(padded[at + size] == 0x55) & (padded[at + size + 1] == COMBINED)] = size
    waits = at + LONG + 1 >= len(held)
    return np.where(waits & (result < 0), INCOMPLETE, result)


class WitMotionDecoder(FamilyDecoder):
    """Decodes frames of all types, and 0x61 in both lengths."""

    messages = TYPES | COMBINED_FORMS
    frames = (
        Frame(
            {bytes([0x55, kind]): item.name for kind, item in TYPES.items()} | {b"\x55\x5f": "register"},
            SIZE,
            Checksum("sum8"),
        ),
        Frame({bytes([0x55, COMBINED]): "combined"}, _combined_lengths),
    )
    timing = Timing(tick_ns=Fraction(1_000_000))
    start, overhead, head = HEADER, HEADER, (1,)  # the checksum, which 0x61 lacks, is passed over
    apart = ("gnss",)
    derived = (
        utc_time("clock_", CLOCK),
        utc_time("sample_", KNOWN["device_ticks"], per_s=1000),  # 0x61 has the time of the sample itself
        Derived(("_longitude", "_latitude"), known("longitude", "latitude"), _degrees_of),
    )
    _still = np.zeros(ZEROS, np.bool_)  # whether the last rates were zero

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
        if np.convolve(still, np.ones(ZEROS), "valid").max(initial=0) == ZEROS:  # all of so many
            self._report(
                "the device sends rates of exactly zero: at rest it takes off what it holds for bias, "
                "so bias and noise found from them mean nothing",
                is_warning=True,
            )
        return packets
