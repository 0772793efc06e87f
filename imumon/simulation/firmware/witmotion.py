"""Firmware of a virtual WitMotion module: registers behind a lock, and no answers to writes."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.protocols.commands.core import BAUD, Message, search
from imumon.protocols.commands.witmotion import (
    BAUD_CODES,
    BAUD_REGISTER,
    BITS,
    CONTENT,
    RATE,
    RATES,
    READ_ADDRESS,
    REGISTER_ANSWER,
    REGISTERS,
    RRATE,
    RSW,
    SAVE,
    SIZE,
    UNLOCK,
)
from imumon.protocols.device import DeviceFile
from imumon.protocols.messages import TableEncoder
from imumon.protocols.witmotion import TYPES, WitMotionDevice
from imumon.simulation.firmware.core import Firmware, Output

SYNC = b"\xff\xaa"
WRITE_SIZE = 5
FASTEST_HZ = 200.0
FIRST_FRAME = 0x50
NOT_ENCODED = ("time", "position")


def _sized(held: bytes, at: int) -> tuple[int, Message | None]:
    packet = held[at : at + WRITE_SIZE]
    return (WRITE_SIZE, Message(packet[2], packet[3:])) if len(packet) == WRITE_SIZE else (-1, None)


class WitMotionFirmware(Firmware):
    """A WitMotion module."""

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, WitMotionDevice)
        baudrate = device.serial.baudrates[0]
        bits = {message.name: 1 << kind - FIRST_FRAME for kind, message in TYPES.items()}
        content = sum(bits[name] for name in device.sends)
        rate = min(RATES, key=lambda code: abs(RATES[code] - rate_hz))
        code = next(code for code, there in BAUD_CODES.items() if there == baudrate)
        settings = {CONTENT: content.to_bytes(2, "little"), RATE: bytes([rate, 0]), BAUD: bytes([code, 0])}
        super().__init__(settings, baudrate)
        self._locked = True

    def baud(self) -> int:
        """Return the baud rate of the settings."""
        return BAUD_CODES[self.settings.volatile[BAUD][0]]

    def found(self, held: bytes) -> tuple[list[Message], int]:
        """Find writes; they have no checksum."""
        return search(held, SYNC, _sized)

    def refusal(self, command: Message) -> bytes:
        """Do nothing, and say nothing."""
        del command
        return b""

    def answer(self, command: Message) -> bytes:
        """Carry a command out; only a read is answered."""
        register, data = int(command.kind), command.payload
        if register == UNLOCK[2]:
            self._locked = data != UNLOCK[3:]
            return b""
        if register == READ_ADDRESS:
            return self._four(data[0])
        if self._locked:
            return b""
        if register == SAVE:
            self.save()
            return b""
        possible = {RSW: data != b"\0\0", RRATE: data[0] in RATES, BAUD_REGISTER: data[0] in BAUD_CODES}
        if possible.get(register):
            self.obey(next(name for name, number in REGISTERS.items() if number == register), data)
            self.baudrate = self.baud()
        return b""

    def _four(self, first: int) -> bytes:
        there = {number: self.settings.volatile[name] for name, number in REGISTERS.items()}
        data = b"".join(there.get(first + k, b"\0\0") for k in range(4))
        packet = bytes([0x55, REGISTER_ANSWER]) + data
        assert len(packet) == SIZE - 1
        return packet + bytes([sum(packet) & 0xFF])

    def outputs(self) -> tuple[float, list[Output]]:
        """Return the frames of a sample; what the encoder lacks is left out."""
        content = int.from_bytes(self.settings.volatile[CONTENT], "little")
        names = [TYPES[FIRST_FRAME + bit].name for bit in range(len(BITS)) if content >> bit & 1]
        rate = RATES[self.settings.volatile[RATE][0]]
        every = {name: round(FASTEST_HZ / rate) for name in names if name not in NOT_ENCODED}
        return FASTEST_HZ, [Output(_encoder, every)]


def _encoder(names: Sequence[str]) -> TableEncoder:
    return WitMotionDevice.family.encoder(names)
