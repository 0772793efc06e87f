"""What a virtual device does with commands, whatever its family."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from math import gcd

import numpy as np

from imumon.blocks import SampleBlock
from imumon.configure.core import BAUD, MOST_DIVISOR, Family, Message, PacketKind
from imumon.protocols.base import Encoder
from imumon.protocols.messages import TableDevice

EncoderOf = Callable[[int, tuple[str, ...]], Encoder]


class Sending:
    """What a configured device sends of the samples of its unit.

    `base_hz`: the rate that those of the fields divide.  `make`: makes the encoder of a kind of packets.
    """

    def __init__(self, base_hz: float, kinds: list[PacketKind], make: EncoderOf) -> None:
        every = [
            {field.name: max(round(base_hz / field.rate_hz), 1) for field in kind.fields} for kind in kinds
        ]
        shared = gcd(*(by for fields in every for by in fields.values())) or 1
        self.rate_hz = base_hz / shared
        """Samples per second that the unit must take."""
        self._every = [
            (kind.key, {name: by // shared for name, by in fields.items() if name})
            for kind, fields in zip(kinds, every, strict=True)
        ]
        self._encoder = cache(make)
        self._sample = 0

    def encode(self, block: SampleBlock) -> bytes:
        """Return the packets of the next samples."""
        packets: list[bytes] = []
        for row in range(len(block)):
            for key, every in self._every:
                names = tuple(name for name, by in every.items() if self._sample % by == 0)
                if names:
                    packets += self._encoder(key, names).encode(block.rows(row, row + 1))
            self._sample += 1
        return b"".join(packets)


class Firmware(ABC):
    """Answers commands and states what is sent; `settings`: those as delivered, without the baud rate."""

    family: Family
    """Tells commands, which have the same form as answers, and what settings mean."""
    base_hz: float
    """Rate that those of the outputs divide."""

    def __init__(self, device: TableDevice, settings: dict[str, bytes]) -> None:
        self.device = device
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

    def kinds(self) -> list[PacketKind]:
        """Return what is sent with the settings as they are."""
        return self.family.kinds(self.volatile)

    def encoder(self, key: int, names: Sequence[str]) -> Encoder:
        """Return the encoder of fields in packets of a kind; most devices have one."""
        del key
        return self.device.decoder().encoder(names)

    def sending(self) -> Sending | None:
        """Return what is sent; None when that is what the device file states, at the rate of the start."""
        if all(value == self.delivered[name] for name, value in self.volatile.items() if name != BAUD):
            return None
        return Sending(self.base_hz, self.kinds(), self.encoder)


def nearest(base_hz: float, rate_hz: float) -> int:
    """Return the divisor of a base rate that comes nearest to a rate."""
    return int(np.clip(round(base_hz / rate_hz), 1, MOST_DIVISOR))
