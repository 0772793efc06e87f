"""What a virtual device does with commands, whatever its family."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cache
from math import gcd

from imumon.blocks import SampleBlock
from imumon.protocols.base import Encoder
from imumon.protocols.messages import TableDevice

from .core import BAUD, Family, Message, nearest


class Sending:
    """What a device sends of the samples of its unit, as it is configured."""

    def __init__(self, firmware: "Firmware") -> None:
        base_hz, kinds = firmware.base_hz, firmware.family.kinds(firmware.volatile)
        every = [{field.name: nearest(base_hz, field.rate_hz) for field in kind.fields} for kind in kinds]
        shared = gcd(*(by for fields in every for by in fields.values())) or 1
        self.rate_hz = base_hz / shared
        """Samples per second that the unit must take."""
        self._every = [
            (kind.key, {name: by // shared for name, by in fields.items() if name})
            for kind, fields in zip(kinds, every, strict=True)
        ]
        self._encoder = cache(firmware.encoder)
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
    """Answers commands and states what is sent; `settings`: those as delivered, without the baud rate.

    `family` finds commands, which have the same form as answers, and knows what settings mean; `base_hz` is
    the rate that those of the outputs divide; `volatile` and `flash` are the settings as they are, and there.
    """

    family: Family
    base_hz: float

    def __init__(self, device: TableDevice, settings: dict[str, bytes]) -> None:
        self.device = device
        self.baudrate, known = device.serial.baudrates[0], self.family.baud_codes
        named = self.baudrate if self.baudrate in known else next(iter(known))
        self.delivered = settings | {BAUD: known[named]}
        self.volatile, self.flash = dict(self.delivered), dict(self.delivered)
        self.streaming = True
        self._held = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answers."""
        held = self._held + data
        messages, done = self.found(held)
        self._held = held[done:]
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

    def encoder(self, key: int, names: Sequence[str]) -> Encoder:
        """Return the encoder of fields in packets of a kind; most devices have one."""
        del key
        return self.device.decoder().encoder(names)

    def sending(self) -> Sending | None:
        """Return what is sent; None when that is what the device file states, at the rate of the start."""
        if self.volatile == self.delivered | {BAUD: self.volatile[BAUD]}:
            return None
        return Sending(self)
