"""Messages of Xsens devices that are not data: their names, and what they say in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from imumon.protocols.xsens.fields import FRAMES, IDENTIFIERS, PRECISIONS

MTDATA, MTDATA2 = 0x32, 0x36
DEVICE_ID, CONFIGURATION, FIRMWARE, PRODUCT_CODE = 0x01, 0x0D, 0x13, 0x1D
ERROR, WARNING, OUTPUT_CONFIGURATION = 0x42, 0x43, 0xC1
OUTPUT_MODE, OUTPUT_SETTINGS = 0xD1, 0xD3

_REQUESTS = {
    0x00: "ReqDeviceID",
    0x02: "InitMT",
    0x04: "SetPeriod",
    0x06: "SetBid",
    0x08: "BusPower",
    0x0A: "ReqDataLength",
    0x0C: "ReqConfiguration",
    0x0E: "RestoreFactoryDefaults",
    0x10: "GoToMeasurement",
    0x12: "ReqFirmwareRevision",
    0x14: "ReqBluetoothDisable",
    0x16: "SetXmOutputMode",
    0x18: "SetBaudrate",
    0x1A: "SetSyncMode",
    0x1C: "ReqProductCode",
    0x1E: "ReqHardwareVersion",
    0x20: "SetProcessingFlags",
    0x22: "SetNoRotation",
    0x24: "RunSelfTest",
    0x26: "SetInputTrigger",
    0x28: "SetOutputTrigger",
    0x2C: "SetSyncSettings",
    0x30: "GoToConfig",
    0x34: "ReqData",
    0x3E: "WakeUp",
    0x40: "Reset",
    0x48: "SetOptionFlags",
    0x60: "SetUtcTime",
    0x62: "ReqAvailableFilterProfiles",
    0x64: "SetFilterProfile",
    0x66: "SetGravityMagnitude",
    0x68: "SetGnssLeverArm",
    0x6A: "SetMagneticDeclination",
    0x6E: "SetLatLonAlt",
    0x74: "IccCommand",
    0x76: "SetGnssPlatform",
    0x82: "SetHeading",
    0x84: "SetLocationID",
    0x86: "SetExtOutputMode",
    0x88: "SetInitialTrackingMode",
    0x8A: "StoreFilterState",
    0x8C: "SetPortConfiguration",
    0x8E: "SetStringOutputType",
    0x9E: "SetCanOutputConfiguration",
    0xA0: "SetFilterSettings",
    0xA2: "SetAdaptToMagneticDisturbances",
    0xA4: "ResetOrientation",
    0xA6: "ReqGpsStatus",
    0xA8: "AdjustUtcTime",
    0xC0: "SetOutputConfiguration",
    0xD0: "SetOutputMode",
    0xD2: "SetOutputSettings",
    0xD4: "SetOutputSkipFactor",
    0xD6: "SetSyncInSettings",
    0xD8: "SetSyncOutSettings",
    0xDA: "SetErrorMode",
    0xDC: "SetTransmitDelay",
    0xE0: "SetObjectAlignment",
    0xEC: "SetAlignmentRotation",
}

_ANSWERS = {
    DEVICE_ID: "DeviceID",
    0x0B: "DataLength",
    CONFIGURATION: "Configuration",
    FIRMWARE: "FirmwareRevision",
    PRODUCT_CODE: "ProductCode",
    0x1F: "HardwareVersion",
    0x25: "SelfTestResults",
    MTDATA: "MTData",
    MTDATA2: "MTData2",
    ERROR: "Error",
    WARNING: "Warning",
    0x61: "UtcTime",
    0x63: "AvailableFilterProfiles",
    0xA7: "GpsStatus",
    OUTPUT_CONFIGURATION: "OutputConfiguration",
    OUTPUT_MODE: "OutputMode",
    OUTPUT_SETTINGS: "OutputSettings",
}

NAMES: dict[int, str] = {
    **{kind + 1: f"{name}Ack" for kind, name in _REQUESTS.items()},
    **_REQUESTS,
    **_ANSWERS,
}
"""Names of messages: a request has an even number, its answer the next."""

ERRORS = {
    1: "no communication on the bus",
    2: "the bus is not initialised",
    3: "the period is outside the valid range",
    4: "the message is invalid or not implemented",
    16: "a tracker did not answer while the bus was initialised",
    17: "a tracker answered wrongly while the bus was initialised",
    18: "a tracker was not found while the bus was initialised",
    20: "a tracker did not answer when its address was set",
    21: "a tracker answered wrongly when its address was set",
    24: "the period is too short to collect the data of all trackers",
    25: "a tracker sent something else than data",
    26: "the data of all trackers exceed a message",
    27: "timer overflow while measuring",
    28: "timer overflow while measuring",
    29: "a tracker did not answer while measuring",
    30: "timer overflow: the output rate is too high for what is computed",
    32: "the baud rate is not one of those that the device has",
    33: "a parameter is invalid or outside its range",
    35: "the transmit buffer is full: the baud rate is too low for the output",
    36: "the transmit buffer overflowed: the baud rate is too low for the output",
    40: "the device reports an error in itself; try a firmware update",
    41: "more data than the link can carry: raise the baud rate or lower the output rate",
    42: "the buffer of samples overflowed while the link was down",
}
"""What the codes of an Error message mean."""


def describe(kind: int, payload: bytes) -> Iterable[str]:
    """Say in words what a message tells the user; nothing for those that are only answers."""
    if kind == ERROR:
        code = payload[0] if payload else 0
        more = f" (more: {payload[1:].hex(' ')})" if len(payload) > 1 else ""
        yield f"the device reports error {code}: {ERRORS.get(code, 'not a known code')}{more}"
    elif kind == WARNING:
        yield f"the device reports a warning: {payload.hex(' ') or 'no details'}"
    elif kind == OUTPUT_CONFIGURATION and len(payload) % 4 == 0:
        outputs = ", ".join(_outputs(payload)) or "nothing"
        yield f"the device is configured to send {outputs}"
    elif kind == CONFIGURATION:
        yield from _configuration(payload)
    elif kind == DEVICE_ID and len(payload) in (4, 8):
        yield f"device id {payload.hex().upper()}"
    elif kind == PRODUCT_CODE:
        yield f"product code {payload.decode('ascii', 'replace').strip()}"
    elif kind == FIRMWARE and len(payload) >= 3:
        yield f"firmware {payload[0]}.{payload[1]}.{payload[2]}"


def _outputs(payload: bytes) -> Iterator[str]:
    """Describe each entry of an output configuration: identifier and rate."""
    for at in range(0, len(payload), 4):
        code, rate = (
            int.from_bytes(payload[at : at + 2], "big"),
            int.from_bytes(payload[at + 2 : at + 4], "big"),
        )
        often = "with every packet" if rate == 0xFFFF else f"at {rate} Hz"
        yield f"{identifier_name(code)} {often}"


def identifier_name(code: int) -> str:
    """Return the name of a data identifier with its format, or its number when it is not known."""
    found = next((item for item in IDENTIFIERS if item.code == code & 0xFFF0), None)
    if found is None:
        return f"0x{code:04X}"
    notes = []
    if found.framed:
        notes.append(next((name for name, bits in FRAMES.items() if bits == code & 0xC), "frame?"))
    if found.values and not found.values[0].type and not found.raw:
        notes.append(tuple(PRECISIONS)[code & 0x3])
    return f"{found.name} ({', '.join(notes)})" if notes else found.name


SAMPLING_CLOCK_HZ = 115_200
"""The sampling period in a Configuration message counts in this clock."""


def _configuration(payload: bytes) -> Iterator[str]:
    """Describe a Configuration message: 98 bytes, and 20 for each device."""
    if len(payload) < 98:
        yield f"the device sent a configuration of {len(payload)} bytes, too short to be understood"
        return
    period, skip = int.from_bytes(payload[4:6], "big"), int.from_bytes(payload[6:8], "big")
    rate = f", {SAMPLING_CLOCK_HZ / period / (skip + 1):g} Hz" if period and skip != 0xFFFF else ""
    yield f"configuration: master {payload[0:4].hex().upper()}{rate}"


def configured_devices(payload: bytes) -> Iterator[tuple[int, int, int]]:
    """Return data length, output mode and output settings of each device in a Configuration message."""
    for at in range(98, len(payload) - 19, 20):
        yield (
            int.from_bytes(payload[at + 4 : at + 6], "big"),
            int.from_bytes(payload[at + 6 : at + 8], "big"),
            int.from_bytes(payload[at + 8 : at + 12], "big"),
        )
