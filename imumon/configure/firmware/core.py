"""What a virtual device does with commands, whatever its family, and what can go wrong with it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import gcd, lcm

import numpy as np

from imumon.blocks import SampleBlock
from imumon.configure.commands.core import BAUD, MOST_DIVISOR, Family, Message
from imumon.protocols.base import Encoder
from imumon.protocols.device import DeviceFile


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong; commands count from 1."""

    refused: frozenset[int] = frozenset()
    unheard: frozenset[int] = frozenset()
    ignored: frozenset[int] = frozenset()
    """Commands that the device refuses, does not hear, or confirms and does not carry out."""
    dies_after: int | None = None
    unplugged_after: int | None = None
    """Command after which the device says and sends nothing more, or after which the cable is pulled."""


@dataclass(frozen=True, slots=True)
class Output:
    """Fields that are sent in packets of one kind: each by name, with every how many samples it is sent."""

    make: Callable[[list[str]], Encoder]
    every: Mapping[str, int]


class Sending:
    """What a configured device sends of the samples of its unit.

    Parameters
    ----------
    base_hz : float
        Rate that the outputs divide.
    outputs : sequence of Output
        In the order in which their packets are sent.
    """

    def __init__(self, base_hz: float, outputs: list[Output]) -> None:
        shared = gcd(*(by for output in outputs for by in output.every.values())) or 1
        self.rate_hz = base_hz / shared
        """Samples per second that the unit must take."""
        self._outputs = [
            Output(o.make, {name: by // shared for name, by in o.every.items()}) for o in outputs
        ]
        self._cycle = lcm(*(by for output in self._outputs for by in output.every.values()))
        self._encoders: dict[tuple[int, tuple[str, ...]], Encoder] = {}
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
            self._sample = (self._sample + 1) % self._cycle
        return b"".join(packets)

    def _encoder(self, number: int, names: tuple[str, ...]) -> Encoder:
        key = number, names
        if key not in self._encoders:
            self._encoders[key] = self._outputs[number].make(list(names))
        return self._encoders[key]


@dataclass
class Settings:
    """Settings as they are, in flash, and as delivered."""

    delivered: dict[str, bytes]
    volatile: dict[str, bytes] = field(init=False)
    flash: dict[str, bytes] = field(init=False)

    def __post_init__(self) -> None:
        """Begin as delivered."""
        self.volatile, self.flash = dict(self.delivered), dict(self.delivered)


class Firmware(ABC):
    """Answers commands and says what is to be sent.

    Parameters
    ----------
    device : DeviceFile
        Its first baud rate is that of the line as delivered.
    settings : mapping of str to bytes
        The others as delivered, by the names of `imumon.configure.commands`.
    """

    family: Family
    """Tells commands, which have the same form as answers, and what baud rates are called."""

    def __init__(self, device: DeviceFile, settings: dict[str, bytes]) -> None:
        self.baudrate, known = device.serial.baudrates[0], self.family.baud_codes
        named = self.baudrate if self.baudrate in known else next(iter(known))
        self.settings = Settings(settings | {BAUD: known[named]})
        self.streaming = True
        self.faults = Faults()
        self.commands = 0
        """Commands that came whole."""
        self._held = b""

    @property
    def dead(self) -> bool:
        """Whether the device says and sends nothing more."""
        return self.faults.dies_after is not None and self.commands > self.faults.dies_after

    @property
    def unplugged(self) -> bool:
        """Whether the cable is pulled now."""
        after = self.faults.unplugged_after
        return after is not None and self.commands > after

    def hear(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answers."""
        messages, done = self.found(self._held + data)
        self._held = (self._held + data)[done:]
        answers = b""
        for message in messages:
            self.commands += 1
            if self.dead or self.unplugged or self.commands in self.faults.unheard:
                continue
            refused = self.commands in self.faults.refused
            answers += self.refusal(message) if refused else self.answer(message)
        return answers

    def obey(self, name: str, value: bytes) -> None:
        """Set a setting, unless the device only says so."""
        if self.commands not in self.faults.ignored:
            self.settings.volatile[name] = value

    def save(self, *names: str) -> None:
        """Write settings into flash; all when none is named."""
        for name in names or tuple(self.settings.volatile):
            self.settings.flash[name] = self.settings.volatile[name]

    def power_on(self) -> None:
        """Begin with the settings in flash."""
        self.settings.volatile = dict(self.settings.flash)
        self.streaming, self._held = True, b""
        self.started()

    def started(self) -> None:
        """Take the baud rate of the settings; a family that does it at other times has its own."""
        self.baudrate = self.baud()

    def baud(self) -> int:
        """Return the baud rate of the settings."""
        return self.family.baud_of(self.settings.volatile[BAUD]) or self.baudrate

    def found(self, held: bytes) -> tuple[list[Message], int]:
        """Return the commands among bytes, and how many of these are done with."""
        return self.family.messages(held)

    @abstractmethod
    def answer(self, command: Message) -> bytes:
        """Carry a command out and return the answer."""

    @abstractmethod
    def refusal(self, command: Message) -> bytes:
        """Return how the device says no."""

    @abstractmethod
    def outputs(self) -> tuple[float, list[Output]]:
        """Return the base rate and what is sent with the settings as they are."""

    def sending(self) -> Sending | None:
        """Return what is sent; None when that is what the device file says, at the rate of the start."""
        lines = {name for name in self.settings.volatile if "baud" not in name}
        if all(self.settings.volatile[name] == self.settings.delivered[name] for name in lines):
            return None
        base_hz, outputs = self.outputs()
        return Sending(base_hz, [output for output in outputs if output.every])


def nearest(base_hz: float, rate_hz: float) -> int:
    """Return the divisor of a base rate that comes nearest to a rate."""
    return int(np.clip(round(base_hz / rate_hz), 1, MOST_DIVISOR))
