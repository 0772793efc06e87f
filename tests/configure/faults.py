"""Firmware that goes wrong, command by command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from imumon.configure.core import Message
from imumon.configure.firmware import Firmware
from imumon.configure.mip import INVALID, acknowledged
from imumon.configure.vectornav import frame as sentence
from imumon.configure.xsens import frame as xbus
from imumon.protocols.xsens.mtdata import ERROR

REFUSALS: dict[str, Callable[[Message], bytes]] = {
    "MicroStrain": lambda command: acknowledged(command, INVALID),
    "VectorNav": lambda _: sentence("VNERR,07"),
    "WitMotion": lambda _: b"",
    "Xsens MTi": lambda _: xbus(ERROR, b"\x21"),
}
"""How devices of each family say no."""


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong; commands count from 1."""

    refused: frozenset[int] = frozenset()
    unheard: frozenset[int] = frozenset()
    ignored: frozenset[int] = frozenset()
    """Commands that the device refuses, does not receive, or confirms and does not carry out."""
    dies_after: int | None = None
    unplugged_after: int | None = None
    """Command after which the device says and sends nothing more, or after which the cable is pulled."""


@dataclass(slots=True)
class Spoilt:
    """A firmware whose commands are counted, and of which some go wrong."""

    faults: Faults = field(default_factory=Faults)
    unplug: Callable[[], object] = lambda: None
    commands: int = 0

    @property
    def dead(self) -> bool:
        return self.faults.dies_after is not None and self.commands > self.faults.dies_after

    @property
    def unplugged(self) -> bool:
        return self.faults.unplugged_after is not None and self.commands > self.faults.unplugged_after

    def spoil(self, firmware: Firmware) -> Spoilt:
        """Let the commands of a firmware go through here."""
        answer, obey = firmware.answer, firmware.obey

        def answered(message: Message) -> bytes:
            self.commands += 1
            if self.unplugged:
                self.unplug()
            if self.dead or self.unplugged or self.commands in self.faults.unheard:
                return b""
            refused = self.commands in self.faults.refused
            return REFUSALS[firmware.family.title](message) if refused else answer(message)

        def obeyed(name: str, value: bytes) -> None:
            if self.commands not in self.faults.ignored:
                obey(name, value)

        setattr(firmware, "answer", answered)  # noqa: B010  (methods of one firmware alone)
        setattr(firmware, "obey", obeyed)  # noqa: B010
        return self
