"""Firmware of a virtual MicroStrain device, of the newer kind or of the older."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from imumon.configure.commands import mip
from imumon.configure.commands.core import BAUD, Message
from imumon.configure.commands.mip import Mip, fields, formatted
from imumon.configure.firmware.core import Firmware, Output, nearest
from imumon.protocols.device import DeviceFile
from imumon.protocols.mip import FILTER, SENSOR, MipDevice, MipEncoder, mip_fields
from imumon.protocols.tagged import Field

DONE, UNKNOWN, INVALID = 0, 1, 3
STREAMS = {SENSOR: mip.SENSOR_STREAM, FILTER: mip.FILTER_STREAM}
FORMATS = {SENSOR: mip.SENSOR_FORMAT, FILTER: mip.FILTER_FORMAT_NAME}


class MipFirmware(Firmware):
    """A MicroStrain device with sensors and a filter."""

    family = Mip()
    old = False
    """Whether it knows the formats of single data sets only."""

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, MipDevice)
        self._device = device
        by = nearest(mip.USUAL_BASE_HZ, rate_hz)
        codes = {field.name: field.key & 0xFF for field in self._fields(SENSOR)}
        settings = {
            mip.SENSOR_FORMAT: mip.message_format([(codes[name], by) for name in device.sends]),
            mip.FILTER_FORMAT_NAME: mip.message_format([]),
            mip.SENSOR_STREAM: mip.ON,
            mip.FILTER_STREAM: mip.ON,
        }
        super().__init__(device, settings)

    def _fields(self, of: int) -> list[Field]:
        there = mip_fields(self._device.attitude, self._device.clock)
        return [field for field in there if field.key >> 8 == of and field.values]

    def answer(self, command: Message) -> bytes:
        """Carry a command out."""
        there = fields(command.payload)
        code, data = there[0] if there else (0, b"")
        if command.kind == mip.BASE:
            return self._base(command, code)
        if self.old and code in (mip.FORMAT, mip.BASE_RATE):
            return acknowledged(command, UNKNOWN)
        if code in (mip.BASE_RATE, mip.IMU_BASE_RATE, mip.FILTER_BASE_RATE):
            return acknowledged(command, DONE, data[:1] + mip.USUAL_BASE_HZ.to_bytes(2, "big"))
        name, of = self._named(code, data[1:])
        if not name:
            return acknowledged(command, UNKNOWN)
        if data[:1] == mip.READ:
            return acknowledged(command, DONE, of + self.volatile[name])
        if data[:1] == mip.SAVE:
            self.save(name)
            return acknowledged(command, DONE)
        value = data[1 + len(of) :]
        if data[:1] != mip.APPLY or not self._possible(name, value):
            return acknowledged(command, INVALID)
        self.obey(name, value)
        self.baudrate = self.baud()
        return acknowledged(command, DONE)

    def _base(self, command: Message, code: int) -> bytes:
        if code == mip.DEVICE_INFO:
            texts = ("VIRTUAL", "0000-0001", "1", "", "")
            info = b"\x04\x01" + b"".join(text.rjust(16).encode() for text in texts)
            return acknowledged(command, DONE, info)
        if code not in (mip.PING, mip.IDLE, mip.RESUME):
            return acknowledged(command, UNKNOWN)
        if code != mip.PING:
            self.streaming = code == mip.RESUME
        return acknowledged(command, DONE)

    def _named(self, code: int, data: bytes) -> tuple[str, bytes]:
        """Return the setting that a command is about, and the selector that it carries."""
        if code == mip.UART_BAUD:
            return BAUD, b""
        if code in (mip.IMU_FORMAT, mip.FILTER_FORMAT) and self.old:
            return (mip.SENSOR_FORMAT if code == mip.IMU_FORMAT else mip.FILTER_FORMAT_NAME), b""
        selectors = (
            {value: key for key, value in mip.OLD_SELECTOR.items()} if self.old else {s: s for s in STREAMS}
        )
        of = selectors.get(data[0]) if data else None
        if of is None or code not in (mip.STREAM, mip.FORMAT):
            return "", b""
        return (STREAMS if code == mip.STREAM else FORMATS)[of], data[:1]

    def _possible(self, name: str, value: bytes) -> bool:
        if name == BAUD:
            return value in Mip.baud_codes.values()
        if name in (mip.SENSOR_STREAM, mip.FILTER_STREAM):
            return len(value) == 1
        of = SENSOR if name == mip.SENSOR_FORMAT else FILTER
        there = {field.key & 0xFF for field in self._fields(of)}
        items = formatted(value)
        return len(value) == 1 + 3 * len(items) and all(code in there and by > 0 for code, by in items)

    def outputs(self) -> tuple[float, list[Output]]:
        """Return packets of the sensors and of the filter."""
        found = []
        for of, name in FORMATS.items():
            names = {field.key & 0xFF: field.name for field in self._fields(of)}
            on = self.volatile[STREAMS[of]] == mip.ON
            every = {names[code]: by for code, by in formatted(self.volatile[name]) if on}
            found.append(Output(partial(self._encoder, of), every))
        return mip.USUAL_BASE_HZ, found

    def _encoder(self, of: int, names: Sequence[str]) -> MipEncoder:
        return MipEncoder(names, of, self._device.attitude, self._device.clock)


def acknowledged(command: Message, code: int, data: bytes | None = None) -> bytes:
    """Return an answer with its code, zero when the command was carried out, and data."""
    there = fields(command.payload)
    number = there[0][0] if there else 0
    parts = [(mip.ACK, bytes([number, code]))]
    kind = int(command.kind)
    if data is not None and (kind, number) in mip.ANSWERS:
        parts.append((mip.ANSWERS[kind, number], data))
    return mip.frame(kind, *parts)
