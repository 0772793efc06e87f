"""Firmware of a virtual MTi: it answers in the config state, and stores at once what it is told."""

from __future__ import annotations

from imumon.configure.commands import xsens
from imumon.configure.commands.core import BAUD, Message
from imumon.configure.commands.xsens import Xsens, entries, frame
from imumon.configure.firmware.core import Firmware, Output, nearest
from imumon.protocols.device import DeviceFile
from imumon.protocols.xsens.fields import MTDATA2_FIELDS
from imumon.protocols.xsens.messages import ERROR
from imumon.protocols.xsens.mtdata2 import MTData2Device, MTData2Encoder, find_fields

INVALID_PARAMETER, INVALID_MESSAGE, NO_SUCH_BAUDRATE = 33, 4, 32
TIMELESS = {0x10, 0xE0}
"""Groups of identifiers that go with every packet: times and status."""


class XsensFirmware(Firmware):
    """An MTi that sends MTData2."""

    family = Xsens()

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, MTData2Device)
        keys = [field.key for field in find_fields(device.sends, device.precision)]
        output = [(key, xsens.WITH_EVERY_PACKET if key >> 8 in TIMELESS else round(rate_hz)) for key in keys]
        super().__init__(device, {xsens.OUTPUT: xsens.packed(output)})

    def answer(self, command: Message) -> bytes:
        """Carry a command out; in the state of measurement only that which ends it."""
        kind, data = int(command.kind), command.payload
        if kind == xsens.GO_TO_CONFIG:
            self.streaming = False
            return frame(kind + 1)
        if self.streaming:
            return b""
        if kind == xsens.GO_TO_MEASUREMENT:
            self.streaming = True
            return frame(kind + 1)
        if kind == xsens.RESET:
            self.power_on()
            return frame(kind + 1)
        if kind == xsens.SET_OUTPUT_CONFIGURATION:
            return self._output(data)
        if kind == xsens.SET_BAUDRATE:
            return self._baudrate(data)
        identity = {xsens.REQ_PRODUCT_CODE: b"MTi-VIRTUAL", xsens.REQ_FIRMWARE: bytes([1, 2, 3])}
        return frame(kind + 1, identity[kind]) if kind in identity else frame(ERROR, bytes([INVALID_MESSAGE]))

    def _output(self, data: bytes) -> bytes:
        if data:
            if len(data) % 4 or not all(_sendable(code, rate) for code, rate in entries(data)):
                return frame(ERROR, bytes([INVALID_PARAMETER]))
            self.obey(xsens.OUTPUT, data)
            self.save(xsens.OUTPUT)
        return frame(xsens.SET_OUTPUT_CONFIGURATION + 1, self.volatile[xsens.OUTPUT])

    def _baudrate(self, data: bytes) -> bytes:
        if data:
            if data not in self.family.baud_codes.values():
                return frame(ERROR, bytes([NO_SUCH_BAUDRATE]))
            self.obey(BAUD, data)
            self.save(BAUD)
        return frame(xsens.SET_BAUDRATE + 1, b"" if data else self.volatile[BAUD])

    def outputs(self) -> tuple[float, list[Output]]:
        """Return MTData2 messages; each holds what is due."""
        pairs = entries(self.volatile[xsens.OUTPUT])
        fastest = max((rate for _, rate in pairs if rate != xsens.WITH_EVERY_PACKET), default=0)
        names = {field.key: field.name for field in MTDATA2_FIELDS}
        every = {
            names[code]: nearest(xsens.FASTEST_HZ, fastest if rate == xsens.WITH_EVERY_PACKET else rate)
            for code, rate in pairs
            if fastest and rate
        }
        return xsens.FASTEST_HZ, [Output(MTData2Encoder, every)]


def _sendable(code: int, rate: int) -> bool:
    there = any(field.key == code and field.values for field in MTDATA2_FIELDS)
    return there and (rate == xsens.WITH_EVERY_PACKET or rate <= xsens.FASTEST_HZ)
