"""Configuring a MicroStrain device that speaks MIP.

From the data communications protocols and the public definitions of the vendor's SDK.  A command is a packet
of a command set; the answer is a packet of the same set with an acknowledgement (field 0xF1: command, code)
and perhaps a field with data.  Settings are applied (1), read (2) and saved (3) by a function selector, so
nothing is in flash unless it is saved.  Newer devices have one command for the format of any data set (0x0F),
older ones one for each (0x08, 0x0A): the device is queried for those it knows.
"""

import struct
from collections.abc import Mapping, Sequence

from imumon.errors import bad_config, bad_data
from imumon.protocols.base import Encoder
from imumon.protocols.mip import FILTER, SENSOR, SET_NAMES, MipDevice, mip_fields
from imumon.protocols.tagged import MIP

from . import core
from .core import BAUD, Family, Message, PacketKind, Request, Sent, Values
from .firmware import Firmware

BASE, THREE_DM = 0x01, 0x0C
PING, IDLE, DEVICE_INFO, RESUME, COMM_SPEED = 0x01, 0x02, 0x03, 0x06, 0x09
IMU_BASE_RATE, IMU_FORMAT, FILTER_FORMAT, FILTER_BASE_RATE = 0x06, 0x08, 0x0A, 0x0B
BASE_RATE, FORMAT, STREAM, UART_BAUD = 0x0E, 0x0F, 0x11, 0x40
APPLY, READ, SAVE = b"\x01", b"\x02", b"\x03"
ANSWERS = {(BASE, DEVICE_INFO): 0x81, (BASE, COMM_SPEED): 0x89, (THREE_DM, IMU_BASE_RATE): 0x83,
           (THREE_DM, FILTER_BASE_RATE): 0x8A, (THREE_DM, IMU_FORMAT): 0x80, (THREE_DM, FILTER_FORMAT): 0x82,
           (THREE_DM, BASE_RATE): 0x8E, (THREE_DM, FORMAT): 0x8F, (THREE_DM, STREAM): 0x85,
           (THREE_DM, UART_BAUD): 0x87}  # fmt: skip
"""Descriptor of the data in the answer to each command."""
ACK = 0xF1
"""Field of an acknowledgement: command and code."""
ERRORS = {1: "unknown command", 2: "invalid checksum", 3: "invalid parameter", 4: "failed", 5: "timed out"}
"""Codes of an acknowledgement that is none."""
MAIN_PORT = b"\x01"
OLD_SELECTOR = {SENSOR: 0x01, FILTER: 0x03}
"""How older devices name the streams of the data sets."""
SENSOR_FORMAT, FILTER_FORMAT_NAME = "sensor format", "filter format"
FORMATS = {SENSOR: SENSOR_FORMAT, FILTER: FILTER_FORMAT_NAME}
STREAMS = {SENSOR: "sensor stream", FILTER: "filter stream"}
OF_SET = {name: of for names in (FORMATS, STREAMS) for of, name in names.items()}
ON, OFF = b"\x01", b"\x00"
USUAL_BASE_HZ = 500
BAUD_CODES = {rate: rate.to_bytes(4, "big") for rate in (115_200, 230_400, 460_800, 921_600)}

SENSOR_FIELDS: Mapping[str, tuple[int, ...]] = {
    "inertial": (0x04, 0x05),
    "increments": (0x07, 0x08),
    "magnetometer": (0x06,),
    "temperature": (0x14,),
    "pressure": (0x17,),
    "status": (0x18,),
}
ITEM = ">BH"
"""Descriptor and decimation of a field."""
TIME = {"reference": (0xD5, 0xD5), "gps": (0x12, 0x11)}
"""Field that dates a packet of the sensors, and one of the filter."""


def fields_of(payload: bytes) -> list[tuple[int, bytes]]:
    """Return descriptor and data of the fields of a payload, as far as they make sense."""
    found = []
    while len(payload) >= 2 and 2 <= payload[0] <= len(payload):
        found.append((payload[1], payload[2 : payload[0]]))
        payload = payload[payload[0] :]
    return found


def request(
    command_set: int,
    command: int,
    data: bytes,
    meaning: str,
    repeated: bytes | None = None,
    timeout_s: float = core.ANSWER_S,
) -> Request:
    """Return a command; its answer is the data behind what is `repeated` of the question, if it has data."""

    def answer(message: Message) -> core.Answer:
        there = fields_of(message.payload) if message.kind == command_set else []
        acks = [ack for code, ack in there if code == ACK and len(ack) == 2 and ack[0] == command]
        if not acks:
            return None
        if refusal := acks[0][1]:
            return ERRORS.get(refusal, f"code {refusal}")
        if repeated is None:
            return b""
        wanted = ANSWERS[command_set, command]
        found = [value for code, value in there if code == wanted and value.startswith(repeated)]
        return found[0].removeprefix(repeated) if found else None

    return Request(meaning, MIP.sealed(command_set, (command, data)), answer, timeout_s)


def formatted(value: bytes) -> list[tuple[int, int]]:
    """Return descriptor and decimation of each field in a message format."""
    count = min(value[0], (len(value) - 1) // 3) if value else 0
    return list(struct.iter_unpack(ITEM, value[1 : 1 + 3 * count]))


def message_format(items: Sequence[tuple[int, int]]) -> bytes:
    """Return a message format: how many fields, and each with its decimation."""
    return bytes([len(items)]) + b"".join(struct.pack(ITEM, *item) for item in items)


def _base_rate(modern: bool, of: int) -> Request:
    data = bytes([of]) if modern else b""
    older = IMU_BASE_RATE if of == SENSOR else FILTER_BASE_RATE
    return request(THREE_DM, BASE_RATE if modern else older, data, f"GetBaseRate of {SET_NAMES[of]}", data)


class Mip(Family):
    """Commands of a MicroStrain device.

    `base_hz`: base rate of each data set that the device has, of those that are configured.
    `modern`: whether one command has the format of any data set.
    `speed_in_base`: whether the baud rate is set by a base command.
    """

    base_hz: Mapping[int, int] = {SENSOR: USUAL_BASE_HZ, FILTER: USUAL_BASE_HZ}
    modern = True
    speed_in_base = False
    settings = (*OF_SET, BAUD)
    answer_frame = MIP.frame
    title = "MicroStrain"
    verified = "frames of other programs (0x08, 0x0A), and the virtual device; never a real unit"
    baud_codes = BAUD_CODES
    columns = core.USUAL_COLUMNS | {"status": "overrange"}
    assumed = (
        f"base rate {USUAL_BASE_HZ} Hz for sensors and filter; the device is queried for it first",
        "message format by command 0x0F; older devices are set by 0x08 and 0x0A",
    )
    hello = request(BASE, PING, b"", "Ping")
    quiet = (request(BASE, IDLE, b"", "SetToIdle: no data while settings change"),)
    resume = (request(BASE, RESUME, b"", "Resume: data again"),)
    questions = (
        request(BASE, DEVICE_INFO, b"", "GetDeviceInfo", b"", core.SAVE_S),
        _base_rate(True, SENSOR),
        _base_rate(True, FILTER),
        request(THREE_DM, UART_BAUD, READ, "read baud rate (UARTBaudRate)", b""),
    )

    def __init__(self, device: MipDevice) -> None:
        self.device, self.fields = device, mip_fields(device.attitude, device.clock)

    def message(self, packet: bytes) -> Message:
        """Return descriptor set and fields."""
        return Message(packet[2], packet[4:-2])

    def learn(self, ask: core.Ask) -> None:
        """Ask what it is, which commands it knows and its base rates."""
        about, *_, uart = self.questions
        info = ask(about)
        texts = [info[at : at + 16].decode("ascii", "replace").strip(" \0") for at in (2, 18, 34)]
        for modern in (True, False):
            answers = {of: core.known(ask, _base_rate(modern, of)) for of in FORMATS}
            known_hz = {of: int.from_bytes((answer or b"")[:2], "big") for of, answer in answers.items()}
            rates = {of: base for of, base in known_hz.items() if base}
            if SENSOR in rates:
                break
        else:
            raise bad_data("the device reports no base rate of its sensors")
        self.identity, self.modern, self.base_hz = tuple(filter(None, texts)), modern, rates
        self.settings = (*(name for name, of in OF_SET.items() if of in rates), BAUD)
        self.speed_in_base = core.known(ask, uart) is None

    def command(self, name: str) -> tuple[int, int, bytes]:
        """Return command set, command, and what follows the function selector."""
        if name == BAUD:
            return (BASE, COMM_SPEED, MAIN_PORT) if self.speed_in_base else (THREE_DM, UART_BAUD, b"")
        of = OF_SET[name]
        if name in STREAMS.values():
            return THREE_DM, STREAM, bytes([of if self.modern else OLD_SELECTOR[of]])
        if self.modern:
            return THREE_DM, FORMAT, bytes([of])
        return THREE_DM, IMU_FORMAT if of == SENSOR else FILTER_FORMAT, b""

    def read(self, name: str) -> Request:
        """Return the command with the function selector READ."""
        command_set, command, of = self.command(name)
        return request(command_set, command, READ + of, f"read {name}", of)

    def write(self, name: str, value: bytes) -> core.Requests:
        """Return the command with the function selector WRITE."""
        command_set, command, of = self.command(name)
        return (request(command_set, command, APPLY + of + value, f"{name}: {self.describe(name, value)}"),)

    def save(self, names: Sequence[str]) -> core.Requests:
        """Return the commands with the function selector SAVE: these settings only."""
        return tuple(
            request(command_set, command, SAVE + of, f"save {name}", timeout_s=core.SAVE_S)
            for name in names
            for command_set, command, of in [self.command(name)]
        )

    def _fields(self, outputs: Sequence[str], of: int) -> list[int]:
        """Return the descriptors of outputs in a data set, the time first."""
        own = FILTER if self.device.attitude == "filter" else SENSOR
        found = [code for name in outputs for code in SENSOR_FIELDS.get(name, ())] if of == SENSOR else []
        if "attitude" in outputs and of == own:
            found.append(0x03 if of == FILTER else 0x0A)
        return [TIME[self.device.clock][of == FILTER], *found] if found else []

    def of_wish(self, present: Values, rate_hz: float, outputs: Sequence[str] | None) -> dict[str, bytes]:
        """Return formats and streams; see `Family.wanted`."""
        if "attitude" in (outputs or ()) and self.device.attitude == "filter" and FILTER not in self.base_hz:
            raise bad_config("this device has no filter to take an attitude from",
                "use a device file with attitude: imu (imumon devices microstrain)")  # fmt: skip
        result: dict[str, bytes] = {}
        for of, base_hz in self.base_hz.items():
            kept = [code for code, _ in formatted(present.get(FORMATS[of], b""))]
            codes = kept if outputs is None else self._fields(outputs, of)
            by = core.divisor(base_hz, rate_hz) if codes else 1
            result[FORMATS[of]] = message_format([(code, by) for code in codes])
            if codes:
                result[STREAMS[of]] = ON
        if ON not in result.values():
            raise core.nothing_to_keep("--outputs")
        return result

    def kinds(self, values: Values) -> list[PacketKind]:
        """Return packets of both data sets, as long as they do not exceed 255 bytes of fields."""
        found = list[PacketKind]()
        for of, name in FORMATS.items():
            fields = []
            for code, by in formatted(values.get(name, b"") if values.get(STREAMS[of]) != OFF else b""):
                item = self.fields.get(of << 8 | code)
                named, size = (item.name, item.size) if item else ("", 0)
                fields += [Sent(named, 2 + size, self.base_hz[of] / by)] if by else []
            found += [PacketKind(of, 6, fields)] if fields else []
        return found

    def meaning(self, name: str, value: bytes) -> str:
        """Return whether a stream is on, or each field of a format with its rate."""
        if name in STREAMS.values():
            return "off" if value == OFF else "on"
        of = OF_SET[name]
        names = {key: item.name for key, item in self.fields.items()}
        base = self.base_hz[of]
        shown = [
            f"{names.get(of << 8 | code, f'0x{code:02X}')} {f'{base / by:.6g} Hz' if by else 'never'}"
            for code, by in formatted(value)
        ]
        return ", ".join(shown) or "nothing"


DONE, UNKNOWN, INVALID = 0, 1, 3
INFO = b"\x04\x01" + b"".join(text.rjust(16).encode() for text in ("VIRTUAL", "0000-0001", "1", "", ""))
"""What the virtual device reports of itself."""


class MipFirmware(Firmware):
    """A MicroStrain device with sensors and a filter."""

    family: Mip
    device: MipDevice
    base_hz = USUAL_BASE_HZ

    def __init__(self, device: MipDevice, rate_hz: float) -> None:
        self.family = Mip(device)
        by = core.nearest(USUAL_BASE_HZ, rate_hz)
        codes = {item.name: key & 0xFF for key, item in self.family.fields.items() if key >> 8 == SENSOR}
        settings = {
            SENSOR_FORMAT: message_format([(codes[name], by) for name in device.sends]),
            FILTER_FORMAT_NAME: message_format([]),
            **dict.fromkeys(STREAMS.values(), ON),
        }
        super().__init__(device, settings)

    def answer(self, command: Message) -> bytes:
        """Carry a command out."""
        return acknowledged(command, *self._carried_out(command))

    def _carried_out(self, command: Message) -> tuple[int, bytes | None]:
        """Carry a command out and return the code of its acknowledgement, and data."""
        code, data = next(iter(fields_of(command.payload)), (0, b""))
        if command.kind == BASE:
            if code in (IDLE, RESUME):
                self.streaming = code == RESUME
            known = code in (PING, IDLE, RESUME, DEVICE_INFO)
            return DONE if known else UNKNOWN, INFO if code == DEVICE_INFO else None
        if code in (BASE_RATE, IMU_BASE_RATE, FILTER_BASE_RATE) and (self.family.modern or code != BASE_RATE):
            return DONE, data[:1] + USUAL_BASE_HZ.to_bytes(2, "big")
        selector, rest = data[:1], data[1:]
        for name in self.family.settings:
            command_set, number, of = self.family.command(name)
            if (command.kind, code) == (command_set, number) and rest.startswith(of):
                if selector == READ:
                    return DONE, of + self.volatile[name]
                if selector == SAVE:
                    self.save(name)
                elif selector == APPLY:
                    self.obey(name, rest.removeprefix(of))
                else:
                    return INVALID, None
                return DONE, None
        return UNKNOWN, None

    def encoder(self, key: int, names: Sequence[str]) -> Encoder:
        """Return the encoder of fields of a data set."""
        return self.device.decoder().encoder(names, key)


def acknowledged(command: Message, code: int, data: bytes | None = None) -> bytes:
    """Return an answer with its code, zero when the command was carried out, and data."""
    number, _ = next(iter(fields_of(command.payload)), (0, b""))
    parts = [(ACK, bytes([number, code]))]
    kind = int(command.kind)
    if data is not None and (kind, number) in ANSWERS:
        parts.append((ANSWERS[kind, number], data))
    return MIP.sealed(kind, *parts)
