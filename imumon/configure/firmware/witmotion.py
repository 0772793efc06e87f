"""Firmware of a virtual WitMotion module: registers behind a lock, and no answers to writes."""

from __future__ import annotations

from functools import partial

from imumon.configure.commands import witmotion
from imumon.configure.commands.core import Message, packets_among
from imumon.configure.commands.witmotion import WitMotion
from imumon.configure.firmware.core import Firmware, Output
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Frame, fixed_length, unchecked
from imumon.protocols.messages import TableEncoder
from imumon.protocols.witmotion import SIZE, TYPES, WitMotionDevice

WRITE = Frame("write", b"\xff\xaa", fixed_length(5), unchecked)
"""A command; it has no checksum."""
FASTEST_HZ = 200.0
FIRST_FRAME = 0x50
NOT_ENCODED = ("time", "position")


class WitMotionFirmware(Firmware):
    """A WitMotion module."""

    family = WitMotion()

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, WitMotionDevice)
        bits = {message.name: 1 << kind - FIRST_FRAME for kind, message in TYPES.items()}
        content = sum(bits[name] for name in device.sends)
        rate = min(witmotion.RATES, key=lambda code: abs(witmotion.RATES[code] - rate_hz))
        super().__init__(
            device, {witmotion.CONTENT: content.to_bytes(2, "little"), witmotion.RATE: bytes([rate, 0])}
        )
        self._locked = True

    def found(self, held: bytes) -> tuple[list[Message], int]:
        """Find writes, which are unlike answers."""
        packets, done = packets_among(held, WRITE)
        return [Message(packet[2], packet[3:]) for packet in packets], done

    def answer(self, command: Message) -> bytes:
        """Carry a command out; only a read is answered."""
        register, data = int(command.kind), command.payload
        if register == witmotion.UNLOCK[2]:
            self._locked = data != witmotion.UNLOCK[3:]
            return b""
        if register == witmotion.READ_ADDRESS:
            return self._four(data[0])
        if self._locked:
            return b""
        if register == witmotion.SAVE:
            self.save()
            return b""
        possible = {
            witmotion.RSW: data != b"\0\0",
            witmotion.RRATE: data[0] in witmotion.RATES,
            witmotion.BAUD_REGISTER: data in self.family.baud_codes.values(),
        }
        if possible.get(register):
            self.obey(next(name for name, number in witmotion.REGISTERS.items() if number == register), data)
            self.baudrate = self.baud()
        return b""

    def _four(self, first: int) -> bytes:
        there = {number: self.volatile[name] for name, number in witmotion.REGISTERS.items()}
        data = b"".join(there.get(first + k, b"\0\0") for k in range(4))
        packet = bytes([0x55, witmotion.REGISTER_ANSWER]) + data
        assert len(packet) == SIZE - 1
        return packet + bytes([sum(packet) & 0xFF])

    def outputs(self) -> tuple[float, list[Output]]:
        """Return the frames of a sample; what the encoder lacks is left out."""
        content = int.from_bytes(self.volatile[witmotion.CONTENT], "little")
        names = [TYPES[FIRST_FRAME + bit].name for bit in range(len(witmotion.BITS)) if content >> bit & 1]
        rate = witmotion.RATES[self.volatile[witmotion.RATE][0]]
        every = {name: round(FASTEST_HZ / rate) for name in names if name not in NOT_ENCODED}
        return FASTEST_HZ, [Output(partial(TableEncoder, WitMotionDevice.family), every)]
