"""WitMotion (JY901, WT901, HWT905, WT61, ...): frames of 11 bytes, one quantity each, and the 0x61 form.

Facts from the vendor's sample code and third-party descriptions.  A sample is several frames one after the
other (0x51 specific force, 0x52 rate, 0x53 attitude, 0x54 magnetic field, ...), which have no time: a row
begins when a quantity comes again.  Modules with Bluetooth or a card send 0x61 instead, with rate, force and
attitude in one frame of 20 or 28 bytes, without a checksum: it counts when the next one follows at once.

Many units send a rate of exactly zero while they take themselves to be at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import pi
from typing import Final, Literal

import numpy as np

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.base import MAIN, Encoder, Timing
from imumon.protocols.device import DeviceFile
from imumon.protocols.frame_checks import Sum, unchecked
from imumon.protocols.framing import INCOMPLETE, NO_PACKET, Found, Frame, fixed_length
from imumon.protocols.payload import LayoutDecoder, Placed, written
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged import NO_GROUP, Columns, Derived, Value
from imumon.protocols.tagged_columns import count, known, number, vector

FORCE_FACTOR, RATE_FACTOR, ANGLE_FACTOR = (
    16 * STANDARD_GRAVITY / 32768,
    2000 * pi / 180 / 32768,
    pi / 32768,
)
SIZE, SHORT, LONG = 11, 20, 28
PAYLOAD = 8
SIDE_GROUPS = ("attitude", "mag", "pressure", "status", "gnss")
ZEROS: Final = 10
"""Frames in a row with three rates of zero, after which it is said: with noise that needs much luck."""

Item = tuple[str, tuple[Value, ...]]


def _numbers(columns: Sequence[Column | None], kind: str = "i16", factor: float = 1.0) -> tuple[Value, ...]:
    return tuple(Value(column, kind, factor) for column in columns)


def _parts(*names_and_kinds: tuple[str, str]) -> tuple[Value, ...]:
    """Return integers that are sources of something derived."""
    return tuple(Value(count(f"_{name}", name), kind) for name, kind in names_and_kinds)


DATE = _parts(("year", "u8"), ("month", "u8"), ("day", "u8"), ("hour", "u8"), ("minute", "u8"),
              ("second", "u8"), ("millisecond", "u16"))  # fmt: skip
FORCE = _numbers(known("accel_x", "accel_y", "accel_z"), factor=FORCE_FACTOR)
RATE = _numbers(known("gyro_x", "gyro_y", "gyro_z"), factor=RATE_FACTOR)
ANGLES = _numbers(known("roll", "pitch", "yaw"), factor=ANGLE_FACTOR)
CLOCK = count("device_clock", "calendar of the device as Unix time; not that of the sample", "ns")
ITEMS: dict[int, Item] = {
    0x50: (NO_GROUP, DATE),
    0x51: (MAIN, (*FORCE, *_numbers(known("temperature"), factor=0.01))),
    0x52: (MAIN, RATE),
    0x53: ("attitude", ANGLES),
    0x54: ("mag", _numbers(vector("mag", "a.u.", "magnetic field, raw counts"))),
    0x55: ("status", _numbers([count(f"port_d{k}", f"port D{k}") for k in range(4)], "u16")),
    0x56: ("pressure", (*_numbers(known("pressure"), "u32"),
                        *_numbers([number("pressure_altitude", "m", "from the pressure")], "i32", 0.01))),
    0x57: ("gnss", _parts(("longitude", "i32"), ("latitude", "i32"))),
    0x58: ("gnss", (*_numbers([number("gnss_altitude", "m", "of the receiver")], factor=0.1),
                    *_numbers([number("gnss_course", "rad", "of the receiver")], factor=pi / 1800),
                    *_numbers([number("gnss_speed", "m/s", "over ground")], "u32", 1 / 3600))),
    0x59: ("attitude", _numbers(known("q_w", "q_x", "q_y", "q_z"), factor=1 / 32768)),
    0x5A: ("gnss", (*_numbers([count("gnss_satellites", "in use")], "u16"),
                    *_numbers([number(f"gnss_{c}dop", "1", "dilution") for c in "phv"], "u16", 0.01))),
}  # fmt: skip
"""Group and numbers of each type; the fourth number of 0x52 and 0x54 depends on the model and is left out."""
NAMES = {0x50: "time", 0x51: "accel", 0x52: "gyro", 0x53: "angle", 0x54: "mag", 0x55: "ports",
         0x56: "pressure", 0x57: "position", 0x58: "speed", 0x59: "quaternion", 0x5A: "satellites",
         0x5F: "register"}  # fmt: skip


def _unix_ms(columns: Columns) -> IntArray:
    """Return milliseconds since 1970 of a date."""
    year, month, day, hour, minute, second, ms = (columns[f"_{value.column.name[1:]}"] for value in DATE
                                                  if value.column is not None)  # fmt: skip
    months = (year + 30) * 12 + np.clip(month, 1, 12) - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + day - 1
    result: IntArray = (days * 86_400 + hour * 3600 + minute * 60 + second) * 1000 + ms
    return result


def _no_encoder(columns: Columns) -> list[ColumnArray]:
    del columns
    raise ImumonError(Reason.BAD_CONFIG, "dates and positions of this protocol are not encoded")


def _degrees(value: ColumnArray) -> ColumnArray:
    """Return degrees of a number whose digits are degrees and, the last seven, minutes times 1e5."""
    whole = np.sign(value) * (np.abs(value) // 10_000_000)
    return np.asarray(whole + np.sign(value) * (np.abs(value) % 10_000_000) / 6e6)


_DATE_NAMES = tuple(value.column.name for value in DATE if value.column is not None)
DERIVED = (
    Derived(_DATE_NAMES, (CLOCK,), lambda c: [_unix_ms(c) * 1_000_000], _no_encoder),
    Derived(
        ("_longitude", "_latitude"),
        known("longitude", "latitude"),
        lambda c: [_degrees(c["_longitude"]), _degrees(c["_latitude"])],
        _no_encoder,
    ),
)
OF_SAMPLE = (Derived(_DATE_NAMES, known("device_ticks"), lambda c: [_unix_ms(c)], _no_encoder),)
"""The 28 bytes of 0x61 have the time of the sample itself."""


def _standing(items: Sequence[Item], at: int) -> list[tuple[Value, int, str]]:
    """Return numbers with their places, those of one item behind the other."""
    sizes = {"u8": 1, "i16": 2, "u16": 2, "i32": 4, "u32": 4}
    placed = []
    for group, values in items:
        for value in values:
            placed.append((value, at, group))
            at += sizes[value.type]
    return placed


def _typed(kind: int) -> Frame:
    """Return the frame of a type."""
    return Frame(NAMES[kind], bytes([0x55, kind]), fixed_length(SIZE), Sum())


def _combined_lengths(held: ByteArray, at: IntArray) -> IntArray:
    """Return the length of 0x61 by where the next one begins."""
    result = np.full(len(at), NO_PACKET, np.int64)
    for size in (LONG, SHORT):
        there = at + size + 1 < len(held)
        next_at = np.where(there, at + size, 0)
        result[there & (held[next_at] == 0x55) & (held[next_at + 1] == 0x61)] = size
    waits = at + LONG + 1 >= len(held)
    return np.where(waits & (result < 0), INCOMPLETE, result)


KINDS = (*ITEMS, 0x5F)


class WitMotionDecoder(LayoutDecoder):
    """Decodes frames of all types, and 0x61 in both lengths."""

    def __init__(self, rate_hz: float | None = None) -> None:
        frames = [
            *(_typed(kind) for kind in KINDS),
            Frame("combined", b"\x55\x61", _combined_lengths, unchecked),
        ]
        timing = Timing(tick_ns=Fraction(1_000_000), rate_hz=rate_hz)
        super().__init__(frames, timing, SIDE_GROUPS, apart=("gnss",))
        self._of_frame = [self._add(Placed(_standing([item], 2), derived=DERIVED)) for item in ITEMS.values()]
        self._of_frame += [-1, -1]
        self._combined: dict[int, int] = {}
        self._zeros = 0

    def _layout_numbers(self, found: Found) -> IntArray:
        numbers = np.array(self._of_frame, np.int64)[found.frame]
        combined = found.frame == len(KINDS)
        for size in np.unique(found.length[combined]).tolist():
            if size not in self._combined:
                tail: list[Item] = [(NO_GROUP, DATE)] if size == LONG else []
                items = [(MAIN, FORCE), (MAIN, RATE), ("attitude", ANGLES), *tail]
                self._combined[size] = self._add(Placed(_standing(items, 2), derived=OF_SAMPLE))
            numbers[combined & (found.length == size)] = self._combined[size]
        self._look_for_zeros(found)
        return numbers

    def _look_for_zeros(self, found: Found) -> None:
        """Say when the rates of frames in a row are exactly zero."""
        combined = found.frame == len(KINDS)
        rates = np.flatnonzero((found.frame == KINDS.index(0x52)) | combined)
        at = found.at[rates] + np.where(combined[rates], 8, 2)
        still = ~np.any(found.held[at[:, np.newaxis] + np.arange(6)], axis=1)
        run = np.arange(1, len(still) + 1) + self._zeros
        moved = np.maximum.accumulate(np.where(still, 0, run)) if len(still) else run
        run = run - moved
        self._zeros = int(run[-1]) if len(run) else self._zeros
        if np.any(run >= ZEROS):
            self._warn(
                "the device sends rates of exactly zero: at rest it takes off what it holds for bias, "
                "so bias and noise found from them mean nothing"
            )


class WitMotionEncoder(Encoder):
    """Makes the frames of a sample, one packet a row.

    Parameters
    ----------
    names : sequence of str
        Names of types, in the order in which they are sent.

    Raises
    ------
    ImumonError
        BAD_CONFIG when there is no such type, or it is one that cannot be encoded.
    """

    def __init__(self, names: Sequence[str]) -> None:
        kinds = {NAMES[kind]: kind for kind in ITEMS if kind not in (0x50, 0x57)}
        for name in names:
            if name not in kinds:
                raise ImumonError(Reason.BAD_CONFIG, f"no frame {name!r}", f"there are: {', '.join(kinds)}")
        self._kinds = [kinds[name] for name in names]

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the frames of each row; see `imumon.protocols.base.Encoder`."""
        frames = []
        for kind in self._kinds:
            payload = written(ITEMS[kind][1], block, NAMES[kind])
            padded = np.zeros((len(block), PAYLOAD), np.uint8)
            padded[:, : payload.shape[1]] = payload
            frames.append([bytes([0x55, kind]) + row.tobytes() for row in padded])
        return [b"".join(map(Sum().sealed, row)) for row in zip(*frames, strict=True)]


class WitMotionDevice(DeviceFile):
    """Device file of a WitMotion module; `sends` is for its virtual twin alone."""

    protocol: Literal["witmotion"]
    sends: list[str]

    def decoder(self) -> WitMotionDecoder:
        """Make a decoder for this device."""
        return WitMotionDecoder(self.rate_hz)

    def encoder(self) -> WitMotionEncoder:
        """Make an encoder that sends what the device would send."""
        return WitMotionEncoder(self.sends)
