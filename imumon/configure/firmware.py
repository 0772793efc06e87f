"""What a virtual device does with commands, whatever its family."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cache
from math import gcd
from typing import NamedTuple

import numpy as np

from imumon.blocks import SampleBlock
from imumon.configure.core import BAUD, MOST_DIVISOR, Family, Message
from imumon.protocols.base import Encoder
from imumon.protocols.device import DeviceFile


class PacketKind(NamedTuple):
    """Fields that are sent in packets of one kind: each by name, with every how many samples it is sent."""

    make: Callable[[list[str]], Encoder]
    every: Mapping[str, int]


class Sending:
    """What a configured device sends of the samples of its unit.

    `base_hz` is the rate that the outputs divide; these are sent in their order.
    """

    def __init__(self, base_hz: float, outputs: list[PacketKind]) -> None:
        shared = gcd(*(by for output in outputs for by in output.every.values())) or 1
        self.rate_hz = base_hz / shared
        """Samples per second that the unit must take."""
        self._outputs = [
            PacketKind(o.make, {name: by // shared for name, by in o.every.items()}) for o in outputs
        ]
        self._encoder = cache(lambda number, names: self._outputs[number].make([*names]))
        self._sample = 0

    def encode(self, block: SampleBlock) -> bytes:
        """Return the packets of the next samples."""
        packets: list[bytes] = []
        for row in range(len(block)):
            one = SampleBlock({name: values[row : row + 1] for name, values in block.columns.items()})
            for number, output in enumerate(self._outputs):
                names = tuple(name for name, by in output.every.items() if self._sample % by == 0)
                if names:
                    packets += self._encoder(number, names).encode(one)
            self._sample += 1
        return b"".join(packets)


class Firmware(ABC):
    """Answers commands and states what is to be sent.

    `settings` are those as delivered, by the names of their family, without the baud rate.
    """

    family: Family
    """Tells commands, which have the same form as answers, and what baud rates are called."""

    def __init__(self, device: DeviceFile, settings: dict[str, bytes]) -> None:
        self.baudrate, known = device.serial.baudrates[0], self.family.baud_codes
        named = self.baudrate if self.baudrate in known else next(iter(known))
        self.delivered = settings | {BAUD: known[named]}
        self.volatile, self.flash = dict(self.delivered), dict(self.delivered)
        """Settings as they are, and in flash."""
        self.streaming = True
        self._held = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answers."""
        messages, done = self.found(self._held + data)
        self._held = (self._held + data)[done:]
        return b"".join(map(self.answer, messages))

    def obey(self, name: str, value: bytes) -> None:
        """Set a setting; a baud rate counts at once."""
        self.volatile[name] = value
        self.baudrate = self.baud()

    def save(self, *names: str) -> None:
        """Write settings into flash; all when none is named."""
        self.flash |= {name: self.volatile[name] for name in names or self.volatile}

    def power_on(self) -> None:
        """Begin with the settings in flash."""
        self.volatile = dict(self.flash)
        self.streaming, self._held = True, b""
        self.baudrate = self.baud()

    def baud(self) -> int:
        """Return the baud rate of the settings."""
        return self.family.baud_of(self.volatile[BAUD]) or self.baudrate

    def found(self, held: bytes) -> tuple[list[Message], int]:
        """Return the commands among bytes, and how many of these are done with."""
        return self.family.messages(held)

    @abstractmethod
    def answer(self, command: Message) -> bytes:
        """Carry a command out and return the answer."""

    @abstractmethod
    def outputs(self) -> tuple[float, list[PacketKind]]:
        """Return the base rate and what is sent with the settings as they are."""

    def sending(self) -> Sending | None:
        """Return what is sent; None when that is what the device file states, at the rate of the start."""
        if all(value == self.delivered[name] for name, value in self.volatile.items() if name != BAUD):
            return None
        base_hz, outputs = self.outputs()
        return Sending(base_hz, [output for output in outputs if output.every])


def nearest(base_hz: float, rate_hz: float) -> int:
    """Return the divisor of a base rate that comes nearest to a rate."""
    return int(np.clip(round(base_hz / rate_hz), 1, MOST_DIVISOR))
