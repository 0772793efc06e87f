"""Configuring a VectorNav by its ASCII commands.

From the VN-100 manual and the vendor's SDK.  Registers 75 to 77 are the binary outputs (port, divisor of the
base rate, groups, a word of fields for each group), 6 the ASCII output, 5 the baud rate; $VNWRG writes into
volatile memory and $VNWNV saves **all** registers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from imumon.protocols import vectornav
from imumon.protocols.messages import TableDevice
from imumon.protocols.text import line_frame, sentence

from . import core
from .core import BAUD, Family, Message, PacketKind, Request, Sent, Values
from .firmware import Firmware

ERRORS = {1: "hard fault", 2: "serial buffer overflow", 3: "invalid checksum", 4: "invalid command",
          5: "not enough parameters", 6: "too many parameters", 7: "invalid parameter", 8: "invalid register",
          9: "unauthorized access", 10: "watchdog reset", 11: "output buffer overflow",
          12: "insufficient baud rate", 255: "error buffer overflow"}  # fmt: skip
OUTPUT, SECOND, THIRD, ASCII = "binary output 1", "binary output 2", "binary output 3", "ASCII output"
BINARY = (OUTPUT, SECOND, THIRD)
REGISTERS = {OUTPUT: 75, SECOND: 76, THIRD: 77, ASCII: 6, BAUD: 5}
FIELDS: Mapping[str, tuple[str, ...]] = {
    "inertial": ("Imu.UncompAccel", "Imu.UncompGyro"),
    "increments": ("Imu.DeltaTheta", "Imu.DeltaVelocity"),
    "magnetometer": ("Imu.UncompMag",),
    "temperature": ("Imu.Temperature",),
    "pressure": ("Imu.Pressure",),
    "attitude": ("Attitude.Quaternion",),
    "status": ("Attitude.VpeStatus",),
}
"""AngRate and Accel have the filter's bias taken off and are never requested."""
FIELD_OF_PLACE = {place: name for name, place in vectornav.PLACES.items()}
FAST_HZ, SLOW_HZ = 800, 400
"""Base rate of the binary outputs of a VN-100 (and 110), and of the others."""
BAUDRATES = (9600, 19_200, 38_400, 57_600, 115_200, 128_000, 230_400, 460_800, 921_600)
BAUD_CODES = {rate: str(rate).encode() for rate in BAUDRATES}


def frame(text: str) -> bytes:
    """Return a command: $, text, checksum, line end."""
    return sentence(f"${text}") + b"\r\n"


def request(
    command: str,
    meaning: str,
    register: int | None = None,
    timeout_s: float = 0.5,
    read: Callable[[bytes], bytes] = bytes,
) -> Request:
    """Return a command; its answer has the same letters, and the register if there is one before its value.

    `read`: returns the value in the form that it is written in.
    """

    def answer(message: Message) -> core.Answer:
        text = message.payload.decode("ascii", "replace")
        first, _, rest = text.partition(",")
        number = int(first) if first.isdecimal() else -1
        if message.kind == "ERR":
            return f"error {text}: {ERRORS.get(number, 'not a known code')}"
        if message.kind != command[2:5] or register not in (None, number):
            return None
        return message.payload if register is None else read(rest.encode())

    return Request(meaning, frame(command), answer, timeout_s)


@dataclass(frozen=True)
class Output:
    """What a binary output register holds: port, divisor, and the words of each group in order."""

    port: int
    by: int
    groups: int
    words: tuple[int, ...]

    @classmethod
    def read(cls, value: bytes) -> "Output":
        """Read a register; what makes no sense is an output that is off."""
        try:
            port, by, *hexadecimal = value.decode("ascii", "replace").split(",")
            groups, *words = (int(text, 16) for text in hexadecimal)
            found = cls(int(port), int(by), groups, tuple(words))
        except ValueError:
            return NO_OUTPUT
        fits = all(0 <= number <= 0xFFFF for number in (found.port, found.by, groups, *words))
        return found if fits else NO_OUTPUT

    @classmethod
    def of(cls, port: int, by: int, names: Sequence[str]) -> "Output":
        """Return the output of fields."""
        words = vectornav.words_of(names)
        return cls(port, by, sum(1 << group - 1 for group in words), tuple(words.values()))

    @property
    def on(self) -> bool:
        """Whether anything is sent."""
        return self.port > 0 and self.by > 0 and self.groups > 0

    @property
    def value(self) -> bytes:
        """The register."""
        words = "".join(f",{word:04X}" for word in self.words)
        return f"{self.port},{self.by},{self.groups:02X}{words}".encode()

    @property
    def names(self) -> list[str]:
        """Its fields as encoders have them; empty where one cannot be encoded."""
        groups = [bit + 1 for bit in range(7) if self.groups >> bit & 1]
        return [
            FIELD_OF_PLACE.get((group, bit), "")
            for group, word in zip(groups, self.words, strict=False)
            for bit in range(16)
            if word >> bit & 1
        ]

    @property
    def contents(self) -> vectornav.Contents | None:
        """What its packets hold; None when that is not known."""
        found = vectornav.read_contents(vectornav.header_of(self.groups, self.words) + bytes(512))
        return found if isinstance(found, vectornav.Contents) and self.groups <= 0x7F else None


NO_OUTPUT = Output(0, 0, 0, ())


def _canonical(name: str, value: bytes) -> bytes:
    """Return what is read as it would be written: newer firmware adds the number of the port."""
    return Output.read(value).value if name in BINARY else value.split(b",")[0].lstrip(b"0") or b"0"


class VectorNav(Family):
    """Commands of a VectorNav."""

    base_hz = FAST_HZ
    settings = tuple(REGISTERS)
    answer_frame = line_frame({b"$VN": "ascii"}, vectornav.body_of)
    title = "VectorNav"
    verified = "lines of other programs and of the vendor's, and the virtual device; never a real unit"
    baud_codes = BAUD_CODES
    assumed = (
        f"base rate {FAST_HZ} Hz (VN-100, 110); {SLOW_HZ} Hz for the others: the model is queried first",
        "binary output 1 goes to serial port 1, or where it goes now",
        "binary outputs 2 and 3 are off; where they are not, they are switched off",
    )
    hello = request("VNRRG,01", "read the model", 1)
    quiet = (request("VNASY,0", "no data while settings change"),)
    resume = (request("VNASY,1", "data again"),)
    save_all = (request("VNWNV", "save all registers", timeout_s=core.SAVE_S),)
    questions = (hello, request("VNRRG,04", "read the firmware", 4))

    def message(self, packet: bytes) -> Message:
        """Return the letters of the command, and what follows them."""
        body = vectornav.body_of(packet.decode("ascii", "replace"))
        assert body is not None
        return Message(body[3:6], body[7:].encode())

    def learn(self, ask: core.Ask) -> None:
        """Ask the model, of which the base rate depends, and the firmware."""
        model, firmware = (ask(question).decode("ascii", "replace") for question in self.questions)
        self.base_hz = FAST_HZ if model.upper().startswith("VN-1") else SLOW_HZ
        self.identity = (model, f"firmware {firmware}")

    def read(self, name: str) -> Request:
        """Return $VNRRG."""
        register = REGISTERS[name]
        return request(f"VNRRG,{register:02d}", f"read {name}", register, read=partial(_canonical, name))

    def write(self, name: str, value: bytes) -> core.Requests:
        """Return $VNWRG."""
        register = REGISTERS[name]
        command = f"VNWRG,{register:02d},{value.decode('ascii')}"
        return (request(command, f"{name}: {self.describe(name, value)}", register),)

    def of_wish(self, present: Values, rate_hz: float, outputs: Sequence[str] | None) -> dict[str, bytes]:
        """Return the first binary output; for new outputs all others are off.  See `Family.wanted`."""
        now = {name: Output.read(present[name]) for name in BINARY if name in present}
        old = now.get(OUTPUT, NO_OUTPUT)
        by, port = core.divisor(self.base_hz, rate_hz), old.port or 1
        if outputs is not None:
            names = ["Common.TimeStartup", *(field for name in outputs for field in FIELDS[name])]
            off = {n: replace(one, port=0).value for n, one in now.items() if n != OUTPUT and one.on}
            return {ASCII: b"0", **off, OUTPUT: Output.of(port, by, names).value}
        if old.on:
            return {OUTPUT: replace(old, by=by).value}
        raise core.nothing_to_keep("--outputs")

    def settled(self, name: str, wanted: bytes, found: bytes) -> bool:
        """Return whether it reads back; of an output that is off the rest does not matter."""
        off = name in BINARY and not (Output.read(wanted).on or Output.read(found).on)
        return off or wanted == found

    def kinds(self, values: Values) -> list[PacketKind]:
        """Return the packets of the binary outputs."""
        outputs = [Output.read(values[name]) for name in BINARY if name in values]
        return [
            PacketKind(one.port, found.end + 2, [Sent(name, 0, self.base_hz / one.by) for name in one.names])
            for one in outputs
            if one.on and (found := one.contents) is not None
        ]

    def meaning(self, name: str, value: bytes) -> str:
        """Return fields, rate and port of a binary output, or the type of the ASCII output."""
        if name == ASCII:
            return "off" if value == b"0" else f"type {value.decode('ascii', 'replace')}"
        output = Output.read(value)
        if not output.on:
            return "off"
        rate = f"{self.base_hz / output.by:.6g} Hz ({self.base_hz}/{output.by})"
        found, fields = output.contents, "fields that imumon does not know"
        if found is not None:
            groups = [name for group, name in vectornav.GROUP_NAMES.items() if output.groups >> group - 1 & 1]
            fields = f"{' '.join(groups)}: {', '.join(item.name for item, *_ in found.fields)}"
        return f"{rate} on serial port {output.port}, {fields}"


INVALID_COMMAND, INVALID_REGISTER = 4, 8
IDENTITY = {1: "VN-100-VIRTUAL", 4: "2.1.0.0"}
NAMES = {number: name for name, number in REGISTERS.items()}


class VectorNavFirmware(Firmware):
    """A VN-100."""

    family = VectorNav()
    base_hz = FAST_HZ

    def __init__(self, device: TableDevice, rate_hz: float) -> None:
        off = Output(0, 1, 0, ()).value
        settings = dict.fromkeys(REGISTERS, off) | {
            OUTPUT: Output.of(1, core.nearest(FAST_HZ, rate_hz), device.sends).value,
            ASCII: b"0",
        }
        super().__init__(device, settings)

    def answer(self, command: Message) -> bytes:
        """Carry a command out."""
        kind, text = command.kind, command.payload.decode()
        if kind == "ASY" and text in ("0", "1"):
            self.streaming = text == "1"
            return frame(f"VNASY,{text}")
        if kind == "WNV":
            self.save()
            return frame("VNWNV")
        first, _, value = text.partition(",")
        register = int(first) if first.isdigit() else -1
        name = NAMES.get(register)
        if kind == "RRG" and (name or register in IDENTITY):
            value = self.volatile[name].decode() if name else IDENTITY[register]
        elif kind == "WRG" and name:
            self.obey(name, value.encode())
        else:
            return frame(f"VNERR,{INVALID_REGISTER if kind in ('RRG', 'WRG') else INVALID_COMMAND:02d}")
        return frame(f"VN{kind},{register:02d},{value}")
