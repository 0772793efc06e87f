"""Firmware of a virtual MicroStrain device, of the newer kind or of the older."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from imumon.configure.commands.core import BAUD, Message
from imumon.configure.commands.mip import (
    ACK,
    ANSWERS,
    APPLY,
    BASE,
    BASE_RATE,
    DEVICE_INFO,
    FILTER_BASE_RATE,
    FILTER_FORMAT,
    FILTER_FORMAT_NAME,
    FILTER_STREAM,
    FORMAT,
    IDLE,
    IMU_BASE_RATE,
    IMU_FORMAT,
    OLD_SELECTOR,
    ON,
    PING,
    READ,
    RESUME,
    SAVE,
    SENSOR_FORMAT,
    SENSOR_STREAM,
    STREAM,
    UART_BAUD,
    USUAL_BASE_HZ,
    Mip,
    fields,
    formatted,
    frame,
    message_format,
)
from imumon.configure.firmware.core import Firmware, Output, nearest
from imumon.protocols.device import DeviceFile
from imumon.protocols.mip import FILTER, SENSOR, MipDevice, MipEncoder, mip_fields
from imumon.protocols.tagged import Field

DONE, UNKNOWN, INVALID = 0, 1, 3
STREAMS = {SENSOR: SENSOR_STREAM, FILTER: FILTER_STREAM}
FORMATS = {SENSOR: SENSOR_FORMAT, FILTER: FILTER_FORMAT_NAME}


class MipFirmware(Firmware):
    """A MicroStrain device with sensors and a filter."""

    family = Mip()
    old = False
    """Whether it knows the formats of single data sets only."""

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, MipDevice)
        self._device = device
        by = nearest(USUAL_BASE_HZ, rate_hz)
        codes = {field.name: field.key & 0xFF for field in self._fields(SENSOR)}
        settings = {
            SENSOR_FORMAT: message_format([(codes[name], by) for name in device.sends]),
            FILTER_FORMAT_NAME: message_format([]),
            SENSOR_STREAM: ON,
            FILTER_STREAM: ON,
        }
        super().__init__(device, settings)

    def _fields(self, of: int) -> list[Field]:
        there = mip_fields(self._device.attitude, self._device.clock)
        return [field for field in there if field.key >> 8 == of and field.values]

    def refusal(self, command: Message) -> bytes:
        """Return an acknowledgement that says no."""
        return _acknowledged(command, INVALID)

    def answer(self, command: Message) -> bytes:
        """Carry a command out."""
        there = fields(command.payload)
        code, data = there[0] if there else (0, b"")
        if command.kind == BASE:
            return self._base(command, code)
        if self.old and code in (FORMAT, BASE_RATE):
            return _acknowledged(command, UNKNOWN)
        if code in (BASE_RATE, IMU_BASE_RATE, FILTER_BASE_RATE):
            return _acknowledged(command, DONE, data[:1] + USUAL_BASE_HZ.to_bytes(2, "big"))
        name, of = self._named(code, data[1:])
        if not name:
            return _acknowledged(command, UNKNOWN)
        if data[:1] == READ:
            return _acknowledged(command, DONE, of + self.settings.volatile[name])
        if data[:1] == SAVE:
            self.save(name)
            return _acknowledged(command, DONE)
        value = data[1 + len(of) :]
        if data[:1] != APPLY or not self._possible(name, value):
            return _acknowledged(command, INVALID)
        self.obey(name, value)
        self.baudrate = self.baud()
        return _acknowledged(command, DONE)

    def _base(self, command: Message, code: int) -> bytes:
        if code == DEVICE_INFO:
            texts = ("VIRTUAL", "0000-0001", "1", "", "")
            info = b"\x04\x01" + b"".join(text.rjust(16).encode() for text in texts)
            return _acknowledged(command, DONE, info)
        if code not in (PING, IDLE, RESUME):
            return _acknowledged(command, UNKNOWN)
        if code != PING:
            self.streaming = code == RESUME
        return _acknowledged(command, DONE)

    def _named(self, code: int, data: bytes) -> tuple[str, bytes]:
        """Return the setting that a command is about, and the selector that it carries."""
        if code == UART_BAUD:
            return BAUD, b""
        if code in (IMU_FORMAT, FILTER_FORMAT) and self.old:
            return (SENSOR_FORMAT if code == IMU_FORMAT else FILTER_FORMAT_NAME), b""
        selectors = (
            {value: key for key, value in OLD_SELECTOR.items()} if self.old else {s: s for s in STREAMS}
        )
        of = selectors.get(data[0]) if data else None
        if of is None or code not in (STREAM, FORMAT):
            return "", b""
        return (STREAMS if code == STREAM else FORMATS)[of], data[:1]

    def _possible(self, name: str, value: bytes) -> bool:
        if name == BAUD:
            return value in Mip.baud_codes.values()
        if name in (SENSOR_STREAM, FILTER_STREAM):
            return len(value) == 1
        of = SENSOR if name == SENSOR_FORMAT else FILTER
        there = {field.key & 0xFF for field in self._fields(of)}
        items = formatted(value)
        return len(value) == 1 + 3 * len(items) and all(code in there and by > 0 for code, by in items)

    def outputs(self) -> tuple[float, list[Output]]:
        """Return packets of the sensors and of the filter."""
        found = []
        for of, name in FORMATS.items():
            names = {field.key & 0xFF: field.name for field in self._fields(of)}
            on = self.settings.volatile[STREAMS[of]] == ON
            every = {names[code]: by for code, by in formatted(self.settings.volatile[name]) if on}
            found.append(Output(partial(self._encoder, of), every))
        return USUAL_BASE_HZ, found

    def _encoder(self, of: int, names: Sequence[str]) -> MipEncoder:
        return MipEncoder(names, of, self._device.attitude, self._device.clock)


def _acknowledged(command: Message, code: int, data: bytes | None = None) -> bytes:
    there = fields(command.payload)
    number = there[0][0] if there else 0
    parts = [(ACK, bytes([number, code]))]
    kind = int(command.kind)
    if data is not None and (kind, number) in ANSWERS:
        parts.append((ANSWERS[kind, number], data))
    return frame(kind, *parts)
