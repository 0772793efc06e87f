"""Messages of Xsens devices that are not data: their names, and what they say in words."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from imumon.protocols.xsens.fields import FRAMES, IDENTIFIERS, PRECISIONS

MTDATA, MTDATA2 = 0x32, 0x36
DEVICE_ID, CONFIGURATION, FIRMWARE, PRODUCT_CODE = 0x01, 0x0D, 0x13, 0x1D
ERROR, WARNING, OUTPUT_CONFIGURATION = 0x42, 0x43, 0xC1
OUTPUT_MODE, OUTPUT_SETTINGS = 0xD1, 0xD3

_REQUESTS = {
    0x00: "ReqDeviceID",
    0x0C: "ReqConfiguration",
    0x10: "GoToMeasurement",
    0x12: "ReqFirmwareRevision",
    0x18: "SetBaudrate",
    0x1C: "ReqProductCode",
    0x30: "GoToConfig",
    0x3E: "WakeUp",
    0x40: "Reset",
    0xC0: "SetOutputConfiguration",
    0xD0: "SetOutputMode",
    0xD2: "SetOutputSettings",
}
_ANSWERS = {
    DEVICE_ID: "DeviceID",
    CONFIGURATION: "Configuration",
    FIRMWARE: "FirmwareRevision",
    PRODUCT_CODE: "ProductCode",
    MTDATA: "MTData",
    MTDATA2: "MTData2",
    ERROR: "Error",
    WARNING: "Warning",
    OUTPUT_CONFIGURATION: "OutputConfiguration",
    OUTPUT_MODE: "OutputMode",
    OUTPUT_SETTINGS: "OutputSettings",
}
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


def describe(kind: int, payload: bytes) -> Iterable[str]:
    """Say in words what a message tells the user; nothing for those that are only answers."""
    if kind == ERROR:
        code = payload[0] if payload else 0
        more = f" (more: {payload[1:].hex(' ')})" if len(payload) > 1 else ""
        yield f"the device reports error {code}: {ERRORS.get(code, 'not a known code')}{more}"
    elif kind == WARNING:
        yield f"the device reports a warning: {payload.hex(' ') or 'no details'}"
    elif kind == OUTPUT_CONFIGURATION and len(payload) % 4 == 0:
        outputs = []
        for code, rate in struct.iter_unpack(">HH", payload):
            often = "with every packet" if rate == 0xFFFF else f"at {rate} Hz"
            outputs.append(f"{identifier_name(code)} {often}")
        yield f"the device is configured to send {', '.join(outputs) or 'nothing'}"
    elif kind == CONFIGURATION:  # 98 bytes, and 20 for each device
        for at in range(98, len(payload) - 19, 20):
            size, mode, settings = struct.unpack_from(">HHI", payload, at + 4)
            yield f"the device sends {size} bytes: output mode {mode:04X}, output settings {settings:08X}"
    elif kind in (OUTPUT_MODE, OUTPUT_SETTINGS) and payload:
        what = "mode" if kind == OUTPUT_MODE else "settings"
        yield f"the device has the output {what} {payload.hex().upper()}"


def identifier_name(code: int) -> str:
    """Return the name of a data identifier with its format, or its number when it is not known."""
    found = next((item for item in IDENTIFIERS if item.code == code & 0xFFF0), None)
    if found is None:
        return f"0x{code:04X}"
    notes = []
    if found.framed:
        notes.append(next((name for name, bits in FRAMES.items() if bits == code & 0xC), "frame?"))
    if found.is_real:
        notes.append(tuple(PRECISIONS)[code & 0x3])
    return f"{found.name} ({', '.join(notes)})" if notes else found.name
