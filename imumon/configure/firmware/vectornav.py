"""Firmware of a virtual VN-100."""

from __future__ import annotations

from imumon.configure.commands.core import BAUD, Message
from imumon.configure.commands.vectornav import ASCII, FAST_HZ, OUTPUT, REGISTERS, VectorNav, frame
from imumon.configure.commands.vectornav import Output as Register
from imumon.configure.firmware.core import Firmware, Output, nearest
from imumon.protocols.device import DeviceFile
from imumon.protocols.vectornav import VectorNavDevice, VectorNavEncoder
from imumon.protocols.vectornav_fields import GROUP_NAMES, GROUPS

INVALID_COMMAND, INVALID_PARAMETER, INVALID_REGISTER = 4, 7, 8
IDENTITY = {1: "VN-100-VIRTUAL", 3: "0100000001", 4: "2.1.0.0"}
NAMES = {number: name for name, number in REGISTERS.items()}
PLACES = {
    (group, bit): f"{GROUP_NAMES[group]}.{item.name}"
    for group, items in GROUPS.items()
    for bit, item in enumerate(items)
    if item is not None and item.values
}
"""Names of the fields that the encoder knows."""


class VectorNavFirmware(Firmware):
    """A VN-100."""

    family = VectorNav()

    def __init__(self, device: DeviceFile, rate_hz: float) -> None:
        assert isinstance(device, VectorNavDevice)
        places = [place for place, name in PLACES.items() if name in device.sends]
        off = Register(0, 1, 0, ()).value
        settings = dict.fromkeys(REGISTERS, off) | {
            OUTPUT: Register.of(1, nearest(FAST_HZ, rate_hz), places).value,
            ASCII: b"0",
        }
        super().__init__(device, settings)

    def answer(self, command: Message) -> bytes:
        """Carry a command out."""
        kind, text = str(command.kind), command.payload.decode()
        if kind == "ASY" and text in ("0", "1"):
            self.streaming = text == "1"
            return frame(f"VNASY,{text}")
        if kind == "WNV":
            self.save()
            return frame("VNWNV")
        first, _, value = text.partition(",")
        register = int(first) if first.isdigit() else -1
        if kind not in ("RRG", "WRG"):
            return frame(f"VNERR,{INVALID_COMMAND:02d}")
        if kind == "RRG" and register in IDENTITY:
            return frame(f"VNRRG,{register:02d},{IDENTITY[register]}")
        name = NAMES.get(register)
        if name is None:
            return frame(f"VNERR,{INVALID_REGISTER:02d}")
        if kind == "RRG":
            return frame(f"VNRRG,{register:02d},{self.volatile[name].decode()}")
        if not _possible(name, value.encode()):
            return frame(f"VNERR,{INVALID_PARAMETER:02d}")
        self.obey(name, value.encode())
        self.baudrate = self.baud()
        return frame(f"VNWRG,{register:02d},{value}")

    def outputs(self) -> tuple[float, list[Output]]:
        """Return the packets of the binary outputs that go to port 1."""
        found = []
        for name in NAMES.values():
            register = Register.read(self.volatile[name]) if "binary" in name else None
            if register is not None and register.on and register.port & 1:
                found.append(Output(VectorNavEncoder, dict.fromkeys(_names(register), register.by)))
        return FAST_HZ, found


def _names(register: Register) -> list[str]:
    groups = [bit + 1 for bit in range(7) if register.groups >> bit & 1]
    return [
        PLACES[group, bit]
        for group, word in zip(groups, register.words, strict=True)
        for bit in range(16)
        if word >> bit & 1
    ]


def _possible(name: str, value: bytes) -> bool:
    """Return whether the device takes a value."""
    if name == BAUD:
        return value in VectorNav.baud_codes.values()
    if name == ASCII:
        return value.isdigit()
    register = Register.read(value)
    if not register.on:
        return register.value == value
    try:
        return bool(_names(register))
    except (KeyError, ValueError):  # a field that the encoder lacks, or a word too many
        return False
