"""MicroStrain MIP (3DM-GX3 to GX5, CV5, CV7, GQ7, GV7): packets of one descriptor set, each a list of fields.

Facts from the data communications protocols of the devices and the public definitions of the vendor's SDK.
The fields of one moment may come in several packets, of which often only the first carries the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, ColumnArray
from imumon.protocols.base import Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.messages import ANY_SIZE, Message
from imumon.protocols.mip_fields import FILTER, GNSS, SENSOR, SYSTEM, Attitude, Clock, mip_fields
from imumon.protocols.numbers import FROM_MATRIX, Columns, Derived, known
from imumon.protocols.tagged import MIP, TaggedDecoder, TaggedEncoder

WEEK_NS = 7 * 86_400 * 10**9

SET_NAMES = {
    0x01: "base commands",
    0x0C: "3DM commands",
    0x0D: "filter commands",
    0x0E: "GNSS commands",
    0x0F: "RTK commands",
    0x13: "aiding commands",
    0x7F: "system commands",
    SENSOR: "sensor data",
    FILTER: "filter data",
    SYSTEM: "system data",
    **{code: f"{prefix.upper()} data" for code, prefix in GNSS.items()},
}
"""Names of the descriptor sets."""

DATA_SETS = range(0x80, 0x100)
"""Those without fields for a row are counted; commands and replies are messages."""

ERRORS = {1: "unknown command", 2: "invalid checksum", 3: "invalid parameter", 4: "failed", 5: "timed out"}
"""Codes of an acknowledgement that is none."""


def _gps_to_ticks(columns: Columns) -> list[ColumnArray]:
    """GPS time in ns since the GPS epoch."""
    week, second = columns["gps_week"], columns["gps_time_of_week"]
    there = (week != NO_INT) & np.isfinite(second) & (np.abs(second) < 1e6)
    of_week = np.rint(np.where(there, second, 0) * 1e9).astype(np.int64)
    return [np.where(there, np.where(there, week, 0) * WEEK_NS + of_week, NO_INT)]


def _ticks_to_gps(columns: Columns) -> list[ColumnArray]:
    ticks = columns["device_ticks"]
    there = ticks != NO_INT
    week, of_week = np.divmod(np.where(there, ticks, 0), WEEK_NS)
    return [np.where(there, week, NO_INT), np.where(there, of_week / 1e9, np.nan)]


_GPS_CLOCK = Derived(("gps_week", "gps_time_of_week"), known("device_ticks"), _gps_to_ticks, _ticks_to_gps)


def _derived(clock: Clock) -> tuple[Derived, ...]:
    return (FROM_MATRIX, _GPS_CLOCK) if clock == "gps" else (FROM_MATRIX,)


class MipDecoder(TaggedDecoder):
    """Decodes MIP data packets; commands and replies are counted by descriptor set.

    `attitude`: whether ``roll``, ``pitch``, ``yaw`` and ``q_*`` are those of the "filter" set or of the "imu"
        set (devices without a navigation filter); the others get columns of their own.
    `clock`: whether ``device_ticks`` is the "reference" time of newer devices, or "gps" time.
    """

    def __init__(
        self, attitude: Attitude = "filter", clock: Clock = "reference", rate_hz: float | None = None
    ) -> None:
        timing = Timing(tick_ns=Fraction(1), rate_hz=rate_hz)
        self._fields = mip_fields(attitude, clock)
        sets = (SENSOR, FILTER, *GNSS)
        super().__init__(MIP, timing, self._fields.values(), sets, _derived(clock), [*GNSS.values()])

    def _field(self, key: int, size: int) -> Message | None:
        found = self._fields.get(key)
        return found if found is not None and found.size in (size, ANY_SIZE) else None

    def _type_name(self, kind: int) -> str:
        return SET_NAMES.get(kind, f"set 0x{kind:02X}")

    def _field_name(self, key: int) -> str:
        name = self._fields[key].name if key in self._fields else f"0x{key & 0xFF:02X}"
        return f"{name} of {self._type_name(key >> 8)}"

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        while kind not in DATA_SETS and len(payload) >= 2 and 2 <= payload[0] <= len(payload):
            if payload[1] == 0xF1 and payload[0] >= 4 and payload[3]:
                why = ERRORS.get(payload[3], f"code {payload[3]}")
                yield f"the device refused command 0x{payload[2]:02X} of the {self._type_name(kind)}: {why}"
            payload = payload[payload[0] :]


class MipEncoder(TaggedEncoder):
    """Makes MIP data packets of one descriptor set.

    Raises BAD_CONFIG when there is no such field in the set.

    `names` are sent in their order.
    """

    def __init__(
        self,
        names: Sequence[str],
        descriptor_set: int = SENSOR,
        attitude: Attitude = "filter",
        clock: Clock = "reference",
    ) -> None:
        there = {
            item.name: (key, item)
            for key, item in mip_fields(attitude, clock).items()
            if key >> 8 == descriptor_set and item.columns
        }
        fields = chosen(names, there, f"field of descriptor set 0x{descriptor_set:02X}")
        super().__init__(MIP, descriptor_set, fields, _derived(clock))


class MipDevice(DeviceFile):
    """Device file of a MicroStrain device; `sends` is for its virtual twin alone."""

    protocol: Literal["mip"]
    attitude: Attitude = "filter"
    clock: Clock = "reference"
    sends: list[str]

    def decoder(self) -> MipDecoder:
        """Make a decoder for this device."""
        return MipDecoder(self.attitude, self.clock, self.rate_hz)

    def encoder(self) -> MipEncoder:
        """Make an encoder that sends what the device would send."""
        return MipEncoder(self.sends, SENSOR, self.attitude, self.clock)
