"""Xsens MTData, the data message of the first MTi and MTx: only the profile says what it carries."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Literal

from imumon.columns import KNOWN
from imumon.protocols.base import Timing
from imumon.protocols.device import DeviceFile
from imumon.protocols.numbers import Derived
from imumon.protocols.tagged import XBUS, FieldTable, TaggedDecoder, TaggedEncoder
from imumon.protocols.xsens.fields import DERIVED, DEVICE_TICKS_OF_UTC
from imumon.protocols.xsens.messages import (
    CONFIGURATION,
    MTDATA,
    MTDATA2,
    NAMES,
    OUTPUT_MODE,
    OUTPUT_SETTINGS,
    configured_devices,
    describe,
)
from imumon.protocols.xsens.profile import Profile, mtdata_field, profile_lines

_DERIVED: tuple[Derived, ...] = (DEVICE_TICKS_OF_UTC, *DERIVED)


class MTDataDecoder(TaggedDecoder):
    """Decodes MTData by a profile; one row per message.

    Parameters
    ----------
    profile : Profile
        Output mode and settings of the device.
    rate_hz : float or None
        Nominal rate of the messages; with the sample counter it dates them.
    """

    def __init__(self, profile: Profile, rate_hz: float | None = None) -> None:
        field = mtdata_field(profile)
        sent = {column.name for column in field.columns}
        timing = Timing(
            counter_bits=16 if KNOWN["packet_counter"].name in sent else None,
            tick_ns=Fraction(1) if "_utc_year" in sent else None,
            rate_hz=rate_hz,
        )
        super().__init__(FieldTable([field], _DERIVED), XBUS, [MTDATA], NAMES, timing, bare=True)
        self.reference_frame: Literal["NWU", "NED"] = profile.output_settings.frame

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data, and a length that does not fit."""
        self._search(final=False)
        if self.wrong_length:
            expected = self.table.fields[0].size
            self._say(
                f"MTData of {self.wrong_length} bytes came where the profile makes {expected}: "
                "change output_mode or output_settings in a copy of the device file"
            )
        return super().notices()

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        yield from describe(kind, payload)
        if kind == MTDATA2:
            yield "the device sends MTData2, which needs the device xsens"
        elif kind == CONFIGURATION:
            for size, mode, settings in configured_devices(payload):
                intro = f"the device says that it sends {size} bytes with this profile"
                yield _as_profile(mode, settings, intro)
        elif kind == OUTPUT_MODE and len(payload) == 2:
            yield _as_profile(int.from_bytes(payload, "big"), None, "the device says that its mode is")
        elif kind == OUTPUT_SETTINGS and len(payload) == 4:
            yield _as_profile(None, int.from_bytes(payload, "big"), "the device says that its settings are")


def _as_profile(mode: int | None, settings: int | None, intro: str) -> str:
    return "\n".join([f"{intro}:", *profile_lines(mode, settings)])


class MTDataEncoder(TaggedEncoder):
    """Makes MTData messages by a profile."""

    def __init__(self, profile: Profile) -> None:
        super().__init__([mtdata_field(profile)], _DERIVED, XBUS, MTDATA, bare=True)


class MTDataDevice(DeviceFile, Profile):
    """Device file of an MTi that sends MTData, with its profile."""

    protocol: Literal["xsens-mtdata"]

    def decoder(self) -> MTDataDecoder:
        """Make a decoder for this device."""
        return MTDataDecoder(self, self.rate_hz)

    def encoder(self) -> MTDataEncoder:
        """Make an encoder that sends what the device would send."""
        return MTDataEncoder(self)
