"""Xsens MTData, the data message of the first MTi and MTx: only a profile says what it carries.

Facts from the MT Low Level Communication documentation of the MTi, MTi-G and MTx: messages SetOutputMode (16
bits) and SetOutputSettings (32 bits), and the fixed order of the parts of MTData.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Literal

from pydantic import Field as Key
from pydantic import model_validator

from imumon.columns import KNOWN
from imumon.config import StrictModel
from imumon.protocols.base import Timing
from imumon.protocols.device import DeviceFile
from imumon.protocols.messages import Message, field
from imumon.protocols.numbers import Number
from imumon.protocols.quantities import MATRIX, count, known, number
from imumon.protocols.tagged import XBUS_DATA, TaggedDecoder, TaggedEncoder
from imumon.protocols.xsens.fields import (
    DEGREE,
    DERIVED,
    DEVICE_TICKS_OF_UTC,
    MAG,
    PRECISIONS,
    RAW,
    RAW_TEMPERATURE,
    UTC_VALUES,
    VELOCITY,
)
from imumon.protocols.xsens.messages import MTDATA, MTDATA2, NAMES, describe

Part = Literal[
    "temperature", "calibrated", "orientation", "auxiliary", "position", "velocity", "status", "raw_gps",
    "raw_inertial",
]  # fmt: skip


class OutputSettings(StrictModel):
    """How each part of MTData is sent; the defaults are those of the device."""

    timestamp: Literal["none", "sample_counter", "utc", "sample_counter_and_utc"] = "sample_counter"
    orientation: Literal["quaternion", "euler", "matrix"] = "quaternion"
    calibrated: list[Literal["accel", "gyro", "mag"]] = Key(default=["accel", "gyro", "mag"], min_length=1)
    number_format: Literal["float32", "fp12.20", "fp16.32", "float64"] = "float32"
    analog: list[Literal[1, 2]] = Key(default=[1, 2], min_length=1)
    status: Literal["compact", "detailed"] = "compact"
    frame: Literal["NWU", "NED"] = "NWU"


class Profile(StrictModel):
    """Output mode and settings as the device file has them."""

    output_mode: list[Part] = Key(min_length=1)
    output_settings: OutputSettings = OutputSettings()

    @model_validator(mode="after")
    def _raw_goes_alone(self) -> Profile:
        others = set(self.output_mode) - {"raw_inertial", "raw_gps"}
        if "raw_inertial" in self.output_mode and others:
            raise ValueError(f"output_mode: raw_inertial cannot be combined with {', '.join(sorted(others))}")
        return self


def _gps(name: str, unit: str, kind: str, factor: float) -> Number:
    return Number(number(f"gnss_{name}", unit, f"GNSS receiver: {name.replace('_', ' ')}"), kind, factor)


_RAW_GPS = (
    Number(KNOWN["pressure"], "u16", 2.0),
    Number(count("pressure_age", "age of the pressure, in packets"), "u8"),
    _gps("time_of_week", "s", "u32", 1e-3),
    _gps("latitude", "deg", "i32", 1e-7),
    _gps("longitude", "deg", "i32", 1e-7),
    _gps("altitude", "m", "i32", 1e-3),
    _gps("velocity_north", "m/s", "i32", 0.01),
    _gps("velocity_east", "m/s", "i32", 0.01),
    _gps("velocity_down", "m/s", "i32", 0.01),
    _gps("horizontal_accuracy", "m", "u32", 1e-3),
    _gps("vertical_accuracy", "m", "u32", 1e-3),
    _gps("speed_accuracy", "m/s", "u32", 0.01),
    Number(count("gnss_age", "age of the GNSS data, in packets"), "u8"),
)

_CALIBRATED = {"accel": known("accel"), "gyro": known("gyro"), "mag": MAG}
_ORIENTATION = {"quaternion": (known("q"), 1.0), "euler": (known("angles"), DEGREE), "matrix": (MATRIX, 1.0)}


def mtdata_field(profile: Profile) -> Message:
    """Return what the payload of MTData is with this profile, in the fixed order of its parts."""
    settings = profile.output_settings
    kind, factor = PRECISIONS[settings.number_format]
    orientation, to_radian = _ORIENTATION[settings.orientation]
    calibrated = [c for part, columns in _CALIBRATED.items() if part in settings.calibrated for c in columns]
    analog = [number(f"analog_{line}", "1", f"analog input {line}, raw counts") for line in (1, 2)]
    parts: dict[str, list[Number]] = {
        "raw_inertial": [Number(column, "u16") for column in (*RAW, RAW_TEMPERATURE)],
        "raw_gps": list(_RAW_GPS),
        "temperature": [Number(column, kind, factor) for column in known("temperature")],
        "calibrated": [Number(column, kind, factor) for column in calibrated],
        "orientation": [Number(column, kind, factor * to_radian) for column in orientation],
        "auxiliary": [Number(analog[line - 1], "u16") for line in sorted({*settings.analog})],
        "position": [Number(column, kind, factor) for column in known("place")],
        "velocity": [Number(column, kind, factor) for column in VELOCITY],
        "status": [Number(KNOWN["status"], "u8" if settings.status == "compact" else "u32")],
    }
    values = [value for part, content in parts.items() if part in profile.output_mode for value in content]
    if "sample_counter" in settings.timestamp:
        values.append(Number(KNOWN["packet_counter"], "u16"))
    if "utc" in settings.timestamp:
        values.extend(UTC_VALUES)
    return field("MTData", values)


_DERIVED = (DEVICE_TICKS_OF_UTC, *DERIVED)


class MTDataDecoder(TaggedDecoder):
    """Decodes MTData by a profile; one row per message.

    Parameters
    ----------
    profile : Profile
        Output mode and settings of the device.
    rate_hz : float or None
        Nominal rate of the messages; with the sample counter it dates them.
    """

    _type_names = NAMES

    def __init__(self, profile: Profile, rate_hz: float | None = None) -> None:
        self._data = mtdata_field(profile)
        sent = {column.name for column in self._data.columns}
        timing = Timing(
            counter_bits=16 if KNOWN["packet_counter"].name in sent else None,
            tick_ns=Fraction(1) if "_utc_year" in sent else None,
            rate_hz=rate_hz,
        )
        super().__init__(XBUS_DATA, timing, [self._data], [MTDATA], _DERIVED)

    def _field(self, key: int, size: int) -> Message | None:
        del key
        return self._data if size == self._data.size else None

    def _is_filled(self, packet: bytes) -> bool:
        size = len(self._form.payload(packet))
        if size != self._data.size:
            self._say(
                f"MTData of {size} bytes came where the profile makes {self._data.size}: "
                "change output_mode or output_settings in a copy of the device file"
            )
        return size == self._data.size

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        yield from describe(kind, payload)
        if kind == MTDATA2:
            yield "the device sends MTData2, which needs the device xsens"


class MTDataEncoder(TaggedEncoder):
    """Makes MTData messages by a profile."""

    def __init__(self, profile: Profile) -> None:
        super().__init__(XBUS_DATA, MTDATA, [(0, mtdata_field(profile))], _DERIVED)


class MTDataDevice(DeviceFile, Profile):
    """Device file of an MTi that sends MTData, with its profile."""

    protocol: Literal["xsens-mtdata"]

    def decoder(self) -> MTDataDecoder:
        """Make a decoder for this device."""
        return MTDataDecoder(self, self.rate_hz)

    def encoder(self) -> MTDataEncoder:
        """Make an encoder that sends what the device would send."""
        return MTDataEncoder(self)
