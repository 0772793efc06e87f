"""Configuring a WitMotion module by its registers.

From the vendor's sample code.  A write is unlocked first, has **no answer**, and counts at once; a read is
answered by a frame 0x5F with four registers that does not name them.  So every write is proved by
reading back, and one query waits for its answer before the next.  Saving stores **all** registers.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import or_

from imumon.protocols.framing import Checksum, Frame
from imumon.protocols.messages import TableDevice
from imumon.protocols.witmotion import SIZE, TYPES

from . import core
from .core import BAUD, Family, Message, PacketKind, Request, Sent, Values
from .firmware import Firmware

REGISTER_ANSWER = 0x5F
CONTENT, RATE = "output content", "output rate"
SAVE, READ_ADDRESS = 0x00, 0x27
REGISTERS = {CONTENT: 0x02, RATE: 0x03, BAUD: 0x04}
UNLOCK = b"\xff\xaa\x69\x88\xb5"
PAUSE_S = 0.1
"""Between writes: the vendor's code leaves 1 to 200 ms."""
OPENING = Request("unlock", UNLOCK, None, PAUSE_S)
RATES = {1: 0.2, 2: 0.5, 3: 1.0, 4: 2.0, 5: 5.0, 6: 10.0, 7: 20.0, 8: 50.0, 9: 100.0, 11: 200.0}
FIRST_FRAME = 0x50
BAUDRATES = (4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600)
BAUD_CODES = {rate: bytes([code, 0]) for code, rate in enumerate(BAUDRATES, 1)}
FRAMES: Mapping[str, int] = {
    "inertial": 0x02 | 0x04,
    "magnetometer": 0x10,
    "temperature": 0x02,
    "pressure": 0x40,
    "attitude": 0x08,
}


def frame(register: int, value: bytes) -> bytes:
    """Return a write of a register."""
    return b"\xff\xaa" + bytes([register]) + value


def _registers(message: Message) -> core.Answer:
    """Return the first of the four registers of an answer."""
    return message.payload[:2] if message.kind == REGISTER_ANSWER else None


def _read(name: str) -> Request:
    return Request(f"read {name}", frame(READ_ADDRESS, bytes([REGISTERS[name], 0])), _registers)


def _frames(content: bytes) -> list[str]:
    """Return the frames that the content register lists, the first is 0x50."""
    bits = int.from_bytes(content, "little")
    return [frame.name for kind, frame in TYPES.items() if bits >> kind - FIRST_FRAME & 1]


class WitMotion(Family):
    """Commands of a WitMotion module."""

    answer_frame = Frame({b"\x55": "register"}, SIZE, Checksum("sum8"))
    title = "WitMotion"
    verified = "codes of the vendor's sample code, and the virtual device; never a real unit"
    baud_codes = BAUD_CODES
    columns = {name: core.USUAL_COLUMNS[name] for name in FRAMES} | {"attitude": "roll"}
    settings = tuple(REGISTERS)
    hello = _read(RATE)
    save_all = (OPENING, Request("save all registers", frame(SAVE, b"\0\0"), None, 0.5))

    def message(self, packet: bytes) -> Message:
        """Return type and data."""
        return Message(packet[1], packet[2:10])

    def read(self, name: str) -> Request:
        """Return a read; its answer has four registers, of which the first is meant."""
        return _read(name)

    def write(self, name: str, value: bytes) -> core.Requests:
        """Return the unlocking and the write, which nothing answers."""
        meaning = f"{name}: {self.describe(name, value)}"
        return OPENING, Request(meaning, frame(REGISTERS[name], value), None, PAUSE_S)

    def of_wish(self, present: Values, rate_hz: float, outputs: Sequence[str] | None) -> dict[str, bytes]:
        """Return content and rate."""
        if outputs is not None:
            content = reduce(or_, (FRAMES[name] for name in outputs), 0).to_bytes(2, "little")
        elif not any(content := present[CONTENT]):
            raise core.nothing_to_keep("--outputs")
        near = [code for code, rate in RATES.items() if abs(rate / rate_hz - 1) <= core.CLOSE_ENOUGH]
        if not near:
            raise core.no_rate(rate_hz, RATES.values(), "the device has a list of rates")
        return {CONTENT: content, RATE: bytes([near[0], 0])}

    def kinds(self, values: Values) -> list[PacketKind]:
        """Return a frame for each quantity of a sample."""
        rate = RATES.get(values[RATE][0], 0.0)
        return [PacketKind(0, 0, [Sent(name, SIZE, rate) for name in _frames(values[CONTENT])])]

    def meaning(self, name: str, value: bytes) -> str:
        """Return the rate, or the frames of a sample."""
        code = int.from_bytes(value, "little")
        if name == RATE:
            return f"{RATES[code]:g} Hz" if code in RATES else f"code {code}"
        return ", ".join(_frames(value)) or "nothing"


WRITE = Frame({b"\xff\xaa": "write"}, 5)
"""A command; it has no checksum."""


class WitMotionFirmware(Firmware):
    """A WitMotion module."""

    family = WitMotion()
    base_hz = max(RATES.values())

    def __init__(self, device: TableDevice, rate_hz: float) -> None:
        content = sum(1 << kind - FIRST_FRAME for kind, frame in TYPES.items() if frame.name in device.sends)
        rate = min(RATES, key=lambda code: abs(RATES[code] - rate_hz))
        super().__init__(device, {CONTENT: content.to_bytes(2, "little"), RATE: bytes([rate, 0])})
        self._locked = True

    def found(self, held: bytes) -> tuple[list[Message], int]:
        """Find writes, which are unlike answers."""
        packets, done = core.packets_among(held, WRITE)
        return [Message(packet[2], packet[3:]) for packet in packets], done

    def answer(self, command: Message) -> bytes:
        """Carry a command out; only a read is answered."""
        register, data = int(command.kind), command.payload
        there = {number: name for name, number in REGISTERS.items()}
        if register == READ_ADDRESS:
            names = (there.get(data[0] + k) for k in range(4))
            four = b"".join(self.volatile[name] if name else b"\0\0" for name in names)
            return Checksum("sum8").sealed(bytes([0x55, REGISTER_ANSWER]) + four)
        if register == UNLOCK[2]:
            self._locked = data != UNLOCK[3:]
        elif not self._locked and register == SAVE:
            self.save()
        elif not self._locked and register in there:
            self.obey(there[register], data)
        return b""
