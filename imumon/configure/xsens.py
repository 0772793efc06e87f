"""Configuring an Xsens MTi that sends MTData2.

From the MT Low Level Communication Protocol Documentation.  An MTi takes settings in its config state only,
and **writes what it receives into its non-volatile memory at once**: there is no trying out.  A new baud rate
counts after a reset.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace

from imumon.errors import bad_config
from imumon.protocols.tagged import XBUS, xbus_message
from imumon.protocols.xsens import mtdata
from imumon.protocols.xsens.fields import message_of

from . import core
from .core import BAUD, Family, Message, PacketKind, Request, Sent, Values
from .firmware import Firmware

GO_TO_MEASUREMENT, SET_BAUDRATE, REQ_PRODUCT_CODE, GO_TO_CONFIG = 0x10, 0x18, 0x1C, 0x30
REQ_FIRMWARE, RESET, SET_OUTPUT_CONFIGURATION = 0x12, 0x40, 0xC0
OUTPUT = "output configuration"
KINDS = {OUTPUT: SET_OUTPUT_CONFIGURATION, BAUD: SET_BAUDRATE}
ENTRY = ">HH"
"""Identifier and rate of an output."""
WITH_EVERY_PACKET = 0xFFFF
BAUD_CODES = {115_200: b"\x02", 921_600: b"\x0a", 460_800: b"\x00", 230_400: b"\x01", 57_600: b"\x04",
              38_400: b"\x05", 19_200: b"\x07", 9600: b"\x09", 2_000_000: b"\x0c"}  # fmt: skip
OLD_921600 = b"\x80"
"""Another code for 921600 baud, of older units."""

ALWAYS = (0x1020, 0x1060)
"""PacketCounter and SampleTimeFine."""
TIMELESS = {0x10, 0xE0}
"""Groups of identifiers that go with every packet: times and status."""
IDENTIFIERS: Mapping[str, tuple[int, ...]] = {
    "inertial": (0x4020, 0x8020),
    "increments": (0x4010, 0x8030),
    "magnetometer": (0xC020,),
    "temperature": (0x0810,),
    "pressure": (0x3010,),
    "attitude": (0x2010,),
    "status": (0xE020,),
}
MOST_HZ = {0x0810: 1, 0x3010: 50, 0xC020: 100}
"""Rates above which the documents have no temperature, pressure, field; the others go up to `FASTEST_HZ`."""
FASTEST_HZ = 400
RATES = tuple(rate for rate in range(1, FASTEST_HZ + 1) if FASTEST_HZ % rate == 0)
MAIN_CODES = (0x4020, 0x8020, 0x4010, 0x8030)


def frame(kind: int, payload: bytes = b"") -> bytes:
    """Return a message with its checksum."""
    return XBUS.check.sealed(xbus_message(kind, payload))


def request(kind: int, payload: bytes = b"", meaning: str = "", timeout_s: float = core.SAVE_S) -> Request:
    """Return a request; its answer has the next number, an Error message refuses."""

    def answer(message: Message) -> core.Answer:
        if message.kind == mtdata.ERROR:
            code = message.payload[0] if message.payload else 0
            return f"error {code}: {mtdata.ERRORS.get(code, 'not a known code')}"
        return message.payload if message.kind == kind + 1 else None

    return Request(meaning or mtdata.NAMES[kind], frame(kind, payload), answer, timeout_s)


def entries(value: bytes) -> list[tuple[int, int]]:
    """Return identifier and rate of each output in an output configuration."""
    return list(struct.iter_unpack(ENTRY, value[: len(value) // 4 * 4]))


def packed(outputs: Sequence[tuple[int, int]]) -> bytes:
    """Return the output configuration of identifiers and rates."""
    return b"".join(struct.pack(ENTRY, *output) for output in outputs)


class Xsens(Family):
    """Commands of an MTi."""

    settings = (OUTPUT, BAUD)
    answer_frame = replace(XBUS.frame, names={b"\xfa\xff": "Xbus"})
    title = "Xsens MTi"
    verified = "frames of other programs, and the virtual device; never a real unit"
    stores_at_once = True
    hello_quiets = True
    reset_s = 5.0
    baud_codes = BAUD_CODES
    hello = request(GO_TO_CONFIG, timeout_s=0.5)  # measuring, an MTi answers nothing else
    quiet = (hello,)
    resume = (request(GO_TO_MEASUREMENT),)
    questions = (request(REQ_PRODUCT_CODE), request(REQ_FIRMWARE))

    def message(self, packet: bytes) -> Message:
        """Return identifier and data."""
        return Message(packet[2], XBUS.payload(packet))

    def learn(self, ask: core.Ask) -> None:
        """Query what it is; a unit that does not answer can be configured all the same."""
        product, version = (core.known(ask, question) for question in self.questions)
        texts = [(product or b"").decode("ascii", "replace").strip(" \0")]
        texts += ["firmware " + ".".join(map(str, version[:3]))] if version else []
        self.identity = tuple(filter(None, texts))

    def read(self, name: str) -> Request:
        """Return a request without data, which reads."""
        kind = KINDS[name]
        return request(kind, meaning=f"read {name} ({mtdata.NAMES[kind]} without data)")

    def write(self, name: str, value: bytes) -> core.Requests:
        """Return the request with data; a baud rate needs a reset."""
        kind = KINDS[name]
        write = request(kind, value, f"{mtdata.NAMES[kind]}: {self.describe(name, value)}")
        return (write,) if name == OUTPUT else (write, request(RESET))

    def of_wish(self, present: Values, rate_hz: float, outputs: Sequence[str] | None) -> dict[str, bytes]:
        """Return the output configuration; see `Family.wanted`."""
        if rate_hz not in RATES:
            raise core.no_rate(rate_hz, RATES, f"the device divides {FASTEST_HZ} Hz by a whole number")
        if outputs is None:
            main = self.rate_hz(present)
            chosen = [(code, rate_hz if hz == main else hz) for code, hz in entries(present[OUTPUT])]
        else:
            codes = (*ALWAYS, *(code for name in outputs for code in IDENTIFIERS[name]))
            chosen = [(code, WITH_EVERY_PACKET if code >> 8 in TIMELESS else rate_hz) for code in codes]
        timed = {
            code: round(min(hz, rate_hz, MOST_HZ.get(code & 0xFFF0, FASTEST_HZ)))
            for code, hz in chosen
            if hz != WITH_EVERY_PACKET
        }
        if not timed:
            raise bad_config("a status alone has no rate" if chosen else "nothing to send", "add inertial")
        fastest = max(timed.values())
        if fastest < rate_hz:
            raise core.no_rate(rate_hz, [fastest], "these outputs are slower")
        return {OUTPUT: packed([(code, timed.get(code, WITH_EVERY_PACKET)) for code, _ in chosen])}

    def settled(self, name: str, wanted: bytes, found: bytes) -> bool:
        """Return whether it reads back; a unit may send what is not inertial more slowly than it was set."""
        if name != OUTPUT:
            return self.baud_of(wanted) == self.baud_of(found)
        return len(wanted) == len(found) and all(
            code == same and (a == b or (code & 0xFFF0 not in MAIN_CODES and 0 < b < a))
            for (code, a), (same, b) in zip(entries(wanted), entries(found), strict=True)
        )

    def kinds(self, values: Values) -> list[PacketKind]:
        """Return MTData2 messages."""
        pairs = entries(values[OUTPUT])
        fastest = max((rate for _, rate in pairs if rate != WITH_EVERY_PACKET), default=0)
        fields = []
        for code, rate in pairs if fastest else ():
            item = message_of(code)
            named, size = (item.name, item.size) if item else ("", 0)
            fields += [Sent(named, 3 + size, min(rate, fastest))] if rate else []
        return [PacketKind(mtdata.MTDATA2, 5, fields)] if fields else []

    def meaning(self, name: str, value: bytes) -> str:
        """Return each output with its rate."""
        del name
        outputs = [
            f"{mtdata.identifier_name(code)} {'always' if rate == WITH_EVERY_PACKET else f'{rate} Hz'}"
            for code, rate in entries(value)
        ]
        return ", ".join(outputs) or "nothing"

    def baud_of(self, value: bytes) -> int | None:
        """Return the baud rate of a code."""
        return 921_600 if value == OLD_921600 else super().baud_of(value)


IDENTITY = {REQ_PRODUCT_CODE: b"MTi-VIRTUAL", REQ_FIRMWARE: bytes([1, 2, 3])}
NAMED = {kind: name for name, kind in KINDS.items()}
INVALID_MESSAGE = 4


class XsensFirmware(Firmware):
    """An MTi that sends MTData2."""

    family = Xsens()
    base_hz = FASTEST_HZ

    def __init__(self, device: mtdata.MTData2Device, rate_hz: float) -> None:
        keys = [key for key, _ in mtdata.find_fields(device.sends, device.precision)]
        output = [(key, WITH_EVERY_PACKET if key >> 8 in TIMELESS else round(rate_hz)) for key in keys]
        super().__init__(device, {OUTPUT: packed(output)})

    def answer(self, command: Message) -> bytes:
        """Carry a command out; in the state of measurement only that which ends it."""
        kind, data = int(command.kind), command.payload
        if self.streaming and kind != GO_TO_CONFIG:
            return b""
        answer = IDENTITY.get(kind, b"")
        if kind in (GO_TO_CONFIG, GO_TO_MEASUREMENT):
            self.streaming = kind == GO_TO_MEASUREMENT
        elif kind == RESET:
            self.power_on()
        elif kind in NAMED:
            name = NAMED[kind]
            if data:
                self.obey(name, data)
                self.save(name)
            answer = b"" if data and name == BAUD else self.volatile[name]
        elif kind not in IDENTITY:
            return frame(mtdata.ERROR, bytes([INVALID_MESSAGE]))
        return frame(kind + 1, answer)

    def obey(self, name: str, value: bytes) -> None:
        """Set a setting; a baud rate counts after a reset."""
        self.volatile[name] = value
