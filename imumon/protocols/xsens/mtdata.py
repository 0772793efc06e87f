"""Messages of Xsens MTi: MTData2, which lists what it carries, MTData, which a profile describes, and others.

Facts from the MT Low Level Communication documentation of the MTi, MTi-G and MTx: of the first devices the
messages SetOutputMode (16 bits) and SetOutputSettings (32 bits), and the fixed order of the parts of MTData.
"""

import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import chain
from typing import Literal

from pydantic import Field as Key

from imumon.config import StrictModel

from ..base import Encoder, Timing, chosen
from ..device import DeviceFile
from ..messages import Message, TableDevice, part
from ..numbers import Number
from ..tagged import XBUS, XBUS_DATA, TaggedDecoder
from .fields import DERIVED, DEVICE_TICKS_OF_UTC, FRAMES, IDENTIFIERS, PRECISIONS, UTC, message_of

MTDATA, MTDATA2 = 0x32, 0x36
CONFIGURATION, ERROR, WARNING, OUTPUT_CONFIGURATION = 0x0D, 0x42, 0x43, 0xC1

_REQUESTS = {
    0x00: "ReqDeviceID", 0x0C: "ReqConfiguration", 0x10: "GoToMeasurement", 0x12: "ReqFirmwareRevision",
    0x18: "SetBaudrate", 0x1C: "ReqProductCode", 0x30: "GoToConfig", 0x3E: "WakeUp", 0x40: "Reset",
    0xC0: "SetOutputConfiguration", 0xD0: "SetOutputMode", 0xD2: "SetOutputSettings",
}  # fmt: skip
_ANSWERS = {
    0x01: "DeviceID", CONFIGURATION: "Configuration", 0x13: "FirmwareRevision", 0x1D: "ProductCode",
    MTDATA: "MTData", MTDATA2: "MTData2", ERROR: "Error", WARNING: "Warning",
    OUTPUT_CONFIGURATION: "OutputConfiguration", 0xD1: "OutputMode", 0xD3: "OutputSettings",
}  # fmt: skip
NAMES = {kind + 1: f"{name}Ack" for kind, name in _REQUESTS.items()} | _REQUESTS | _ANSWERS
"""Names of what is read, sent, or comes unasked: a request has an even number, its answer the next."""

ERRORS = {
    3: "the period is outside the valid range",
    4: "the message is invalid or not implemented",
    30: "timer overflow: the output rate is too high for what is computed",
    32: "the baud rate is not one of those that the device has",
    33: "a parameter is invalid or outside its range",
    35: "the transmit buffer is full: the baud rate is too low for the output",
    36: "the transmit buffer overflowed: the baud rate is too low for the output",
    40: "the device reports an error in itself; try a firmware update",
    41: "more data than the link can carry: raise the baud rate or lower the output rate",
    42: "the buffer of samples overflowed while the link was down",
}
"""What the codes of an Error message mean; others are those of trackers behind an Xbus Master."""


def describe(packet_type: int, payload: bytes) -> Iterable[str]:
    """Return in words what a message reports to the user; nothing for those that are only answers."""
    if packet_type == ERROR:
        code = payload[0] if payload else 0
        more = f" (more: {payload[1:].hex(' ')})" if len(payload) > 1 else ""
        yield f"the device reports error {code}: {ERRORS.get(code, 'not a known code')}{more}"
    elif packet_type == WARNING:
        yield f"the device reports a warning: {payload.hex(' ') or 'no details'}"
    elif packet_type == OUTPUT_CONFIGURATION and len(payload) % 4 == 0:
        outputs = [
            f"{identifier_name(code)} {'with every packet' if rate == 0xFFFF else f'at {rate} Hz'}"
            for code, rate in struct.iter_unpack(">HH", payload)
        ]
        yield f"the device is configured to send {', '.join(outputs) or 'nothing'}"
    elif packet_type == CONFIGURATION:  # 98 bytes, and 20 for each device
        for at in range(98, len(payload) - 19, 20):
            size, mode, settings = struct.unpack_from(">HHI", payload, at + 4)
            yield f"the device sends {size} bytes: output mode {mode:04X}, output settings {settings:08X}"


def identifier_name(code: int) -> str:
    """Return the name of a data identifier with its format, or its number when it is not known."""
    found = next((item for item in IDENTIFIERS if item.code == code & 0xFFF0), None)
    if found is None:
        return f"0x{code:04X}"
    frame = [name for name, bits in FRAMES.items() if bits == code & 0xC] or ["frame?"]
    notes = [*(frame if found.framed else ()), *([tuple(PRECISIONS)[code & 0x3]] if found.is_real else ())]
    return f"{found.name} ({', '.join(notes)})" if notes else found.name


Precision = Literal["float32", "fp12.20", "fp16.32", "float64"]

TICK_NS = Fraction(100_000)
"""SampleTimeFine counts in 10 kHz."""
_MESSAGES = dict(enumerate(filter(None, (item.message() for item in IDENTIFIERS))))
_FRAMED = {item.code for item in IDENTIFIERS if item.framed}


class MTData2Decoder(TaggedDecoder):
    """Decodes MTData2; one row per message, with the columns that the device has sent so far.

    `precision`: that of the fields that are encoded.
    """

    form, data, type_names = XBUS, (MTDATA2,), NAMES
    timing = Timing(counter_bits=16, tick_ns=TICK_NS, tick_bits=32)
    messages = _MESSAGES
    derived, apart = DERIVED, ("gnss",)

    def __init__(self, precision: Precision = "float32") -> None:
        self._precision = precision
        super().__init__()

    def encoder(self, names: Sequence[str]) -> Encoder:
        """Return an encoder of data identifiers; see `TableDecoder.encoder`."""
        return self.field_encoder(MTDATA2, find_fields(names, self._precision))

    def _field(self, key: int, size: int) -> Message | None:
        found = message_of(key, size)
        if found is not None and key & 0xFFF0 in _FRAMED:
            frame = next(name for name, bits in FRAMES.items() if bits == key & 0xC)
            self._report(f"orientation and velocity are given in the frame {frame}")
        return found

    def _describe(self, packet_type: int, payload: bytes) -> Iterable[str]:
        if packet_type == MTDATA:
            return ["the device sends legacy MTData, which needs the device xsens-legacy with its profile"]
        return describe(packet_type, payload)

    def _field_name(self, key: int) -> str:
        return identifier_name(key)


def find_fields(names: Sequence[str], precision: Precision) -> list[tuple[int, Message]]:
    """Return codes and fields of these data identifiers in a precision, in the order given.

    Raises BAD_CONFIG when a name is not that of a data identifier.
    """
    found = []
    there = {item.name: item for item in reversed(IDENTIFIERS)}
    for item in chosen(names, there, "data identifier"):
        form = [*PRECISIONS].index(precision) if item.is_real else 0
        message = item.message(form)
        assert message is not None
        found.append((item.code | form, message))
    return found


class MTData2Device(TableDevice):
    """Device file of an MTi that sends MTData2; `sends` and `precision` are for its virtual twin alone."""

    protocol: Literal["xsens-mtdata2"]
    precision: Precision = "float32"

    def decoder(self) -> MTData2Decoder:
        """Make a decoder for this device."""
        return MTData2Decoder(self.precision)


Part = Literal[
    "temperature", "calibrated", "orientation", "auxiliary", "position", "velocity", "status", "raw_gps",
    "raw_inertial",
]  # fmt: skip


class OutputSettings(StrictModel):
    """How each part of MTData is sent; the defaults are those of the device."""

    timestamp: Literal["none", "sample_counter", "utc", "sample_counter_and_utc"] = "sample_counter"
    orientation: Literal["quaternion", "euler", "matrix"] = "quaternion"
    calibrated: list[Literal["accel", "gyro", "mag"]] = Key(default=["accel", "gyro", "mag"], min_length=1)
    number_format: Precision = "float32"
    analog: list[Literal[1, 2]] = Key(default=[1, 2], min_length=1)
    status: Literal["compact", "detailed"] = "compact"
    frame: Literal["NWU", "NED"] = "NWU"


class Profile(StrictModel):
    """Output mode and settings as the device file has them."""

    output_mode: list[Part] = Key(min_length=1)
    output_settings: OutputSettings = OutputSettings()


_RAW_GPS = """
pressure u16*2 | pressure_age u8 1 age of the pressure, in packets | gnss:time_of_week u32*1e-3 s
  | gnss:latitude,longitude i32*1e-7 deg | gnss:altitude i32*1e-3 m
  | gnss:velocity_north,velocity_east,velocity_down i32*0.01 m/s
  | gnss:horizontal_accuracy,vertical_accuracy u32*1e-3 m | gnss:speed_accuracy u32*0.01 m/s
  | gnss_age u8 1 age of the GNSS data, in packets
"""
_CALIBRATED = {"accel": "Acceleration", "gyro": "RateOfTurn", "mag": "MagneticField"}
_ORIENTATION = {"quaternion": "Quaternion", "euler": "EulerAngles", "matrix": "RotationMatrix"}
_NUMBERS = {item.name: item.numbers for item in IDENTIFIERS}


def _typed(kind: str, factor: float, *names: str) -> tuple[Number, ...]:
    """Return the numbers of identifiers in a type, whose unit is so many times theirs."""
    numbers = [number for name in names for number in _NUMBERS[name]]
    return tuple(number._replace(type=kind, factor=number.factor * factor) for number in numbers)


def mtdata_field(profile: Profile) -> Message:
    """Return what the payload of MTData is with this profile, in the fixed order of its parts."""
    settings = profile.output_settings
    real = PRECISIONS[settings.number_format]
    calibrated = [name for sensor, name in _CALIBRATED.items() if sensor in settings.calibrated]
    parts = {
        "raw_inertial": _typed("u16", 1.0, "RawAccGyrMagTemp"),
        "raw_gps": part(_RAW_GPS),
        "temperature": _typed(*real, "Temperature"),
        "calibrated": _typed(*real, *calibrated),
        "orientation": _typed(*real, _ORIENTATION[settings.orientation]),
        "auxiliary": _typed("u16", 1.0, *(f"AnalogIn{line}" for line in sorted({*settings.analog}))),
        "position": _typed(*real, "LatLon", "AltitudeEllipsoid"),
        "velocity": _typed(*real, "VelocityXYZ"),
        "status": part("status u8" if settings.status == "compact" else "status u32"),
    }
    sent = [content for name, content in parts.items() if name in profile.output_mode]
    if "sample_counter" in settings.timestamp:
        sent.append(part("packet_counter u16"))
    if "utc" in settings.timestamp:
        sent.append(part(UTC))
    return Message("MTData", tuple(chain(*sent)))


class MTDataDecoder(TaggedDecoder):
    """Decodes MTData by a profile; one row per message."""

    form, data, type_names = XBUS_DATA, (MTDATA,), NAMES
    derived = (DEVICE_TICKS_OF_UTC, *DERIVED)

    def __init__(self, profile: Profile) -> None:
        self._data = mtdata_field(profile)
        self.messages = {0: self._data}
        sent = {column.name for column in self._data.columns}
        self.timing = Timing(
            counter_bits=16 if "packet_counter" in sent else None,
            tick_ns=Fraction(1) if "_utc_year" in sent else None,
        )
        super().__init__()

    def encoder(self, names: Sequence[str] = ()) -> Encoder:
        """Return an encoder of messages of the profile."""
        del names
        return self.field_encoder(MTDATA, [(0, self._data)])

    def _field(self, _key: int, size: int) -> Message | None:
        return self._data if size == self._data.size else None

    def _is_filled(self, packet: bytes) -> bool:
        size = len(self.form.payload(packet))
        if size != self._data.size:
            self._report(
                f"MTData of {size} bytes came where the profile makes {self._data.size}: "
                "change output_mode or output_settings in a copy of the device file"
            )
        return size == self._data.size

    def _describe(self, packet_type: int, payload: bytes) -> Iterable[str]:
        yield from describe(packet_type, payload)
        if packet_type == MTDATA2:
            yield "the device sends MTData2, which needs the device xsens"


class MTDataDevice(DeviceFile, Profile):
    """Device file of an MTi that sends MTData, with its profile."""

    protocol: Literal["xsens-mtdata"]

    def decoder(self) -> MTDataDecoder:
        """Make a decoder for this device."""
        return MTDataDecoder(self)

    def encoder(self) -> Encoder:
        """Make an encoder that sends what the device would send."""
        return self.decoder().encoder()
