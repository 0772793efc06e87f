"""What talking to a device takes, whatever the family: requests, answers among data, settings by name.

A family knows which requests read, write and save a setting, which values make a rate and outputs, and how
answers are distinguished from data.  `imumon.configure.configuration` sends.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import NamedTuple

import numpy as np

from imumon.errors import ImumonError, bad_config
from imumon.protocols.device import DeviceFile
from imumon.protocols.framing import Frame, search

from . import WING

USUAL_COLUMNS = {
    "inertial": "gyro_x",
    "increments": "delta_velocity_x",
    "magnetometer": "mag_x",
    "temperature": "temperature",
    "pressure": "pressure",
    "attitude": "q_w",
    "status": "status",
}
"""What can be requested, whatever the family, and a column that must come then, in most families."""

BAUD = "baud rate"
"""Name of the setting that changes the line itself."""
ANSWER_S = 0.5
"""Time for an answer: at 9600 baud a packet of 200 bytes before it takes 0.2 s."""
SAVE_S = 3.0
"""Time for an answer to a write into flash, which takes devices up to a second."""
CLOSE_ENOUGH = 1e-3
"""A rate is the device's own when it differs by less: 266.67 Hz is 800 / 3."""
MOST_DIVISOR = 65_535
"""Sixteen bits."""


class Message(NamedTuple):
    """An answer, or what may be one: which kind, and what it carries."""

    kind: int | str
    payload: bytes


Answer = bytes | str | None
"""What a message answers to a request: a value, or in words why it is refused; None when it is no answer."""


@dataclass(frozen=True)
class Request:
    """Something to send: what it means in words, and the bytes that go over the line.

    `answer` finds the answer, for which `timeout_s` is waited; None when the device does not answer to it.
    """

    meaning: str
    frame: bytes
    answer: Callable[[Message], Answer] | None
    timeout_s: float = ANSWER_S

    @property
    def shown(self) -> str:
        """The frame as people read it: text as text, anything else as hexadecimal bytes."""
        text = self.frame.rstrip(b"\r\n").decode("latin-1")
        return text if text.isascii() and text.isprintable() else self.frame.hex(" ").upper()

    def as_dict(self) -> dict[str, str]:
        """Return what JSON has of it."""
        return {"meaning": self.meaning, "bytes": self.frame.hex(" ").upper(), "text": self.shown}


class CommandError(Exception):
    """A request was `refused`, or else not answered."""

    def __init__(self, request: Request, why: str, refused: bool) -> None:
        super().__init__(f"{request.meaning}: {why}")
        self.why, self.refused = why, refused


Requests = tuple[Request, ...]
Ask = Callable[[Request], bytes]
"""Sends a request and returns the answer; raises CommandError."""
Values = Mapping[str, bytes]
"""Settings by their names."""


def known(ask: Ask, question: Request) -> bytes | None:
    """Return the answer, or None when the device refuses; raises CommandError when it does not answer."""
    try:
        return ask(question)
    except CommandError as error:
        if not error.refused:
            raise
        return None


@dataclass(frozen=True)
class Wish:
    """What a user requested, None: as it is; and whether it is written into flash."""

    rate_hz: float | None = None
    outputs: Sequence[str] | None = None
    baudrate: int | None = None
    save: bool = False

    @property
    def only_reads(self) -> bool:
        """Whether nothing is to be changed."""
        return self == Wish(save=self.save)


class Sent(NamedTuple):
    """A field that a device sends.

    `name` is that of encoders, empty when it cannot be encoded; `size` has what precedes it in the packet.
    """

    name: str
    size: int
    rate_hz: float


class PacketKind(NamedTuple):
    """Fields that are sent in packets of one kind, which the family distinguishes by `key`.

    `around`: bytes of a packet besides its fields.
    """

    key: int
    around: int
    fields: list[Sent]

    @property
    def rate_hz(self) -> float:
        """Rate of the packets."""
        return max((field.rate_hz for field in self.fields), default=0.0)


def packets_among(data: bytes, frame: Frame) -> tuple[list[bytes], int]:
    """Return the packets among bytes, and how many bytes are done with.

    A packet that is cut off hides none behind it, as it may be none: an answer would come too late.
    """
    _, found, done, _ = search([frame], np.frombuffer(data, np.uint8), final=True, end=0)
    spans = zip(found.at.tolist(), found.length.tolist(), strict=True)
    return [data[at : at + size] for at, size in spans], done


class Family(ABC):
    """How a device of a family is configured: its settings are bytes under names.

    `columns`: for each output a column that must come when it is on; `baud_codes`: value of the baud setting
    for each baud rate; `verified`: against what the commands were checked; `assumed`: what is taken for
    granted where no device is queried; `settings`: those that are read, the baud rate last; `identity`: what
    the device reports of itself, after `learn`.

    `stores_at_once`: whether the device writes into flash whatever is written; `hello_quiets`: whether the
    first question stops the data; `reset_s`: how long it does not answer after a change of its baud rate.

    `answer_frame` distinguishes what may be an answer from other bytes.  `hello` changes no setting, and
    every device of the family answers it; `quiet` stops the data while the settings change, `resume` lets
    them come again; `save_all` writes all settings into flash, and is empty where they are there already;
    `questions` is what `learn` queries of a device of the newest kind.
    """

    title: str
    columns: Mapping[str, str] = USUAL_COLUMNS
    baud_codes: Mapping[int, bytes]
    verified: str
    assumed: tuple[str, ...] = ()
    settings: tuple[str, ...]
    identity: tuple[str, ...] = ()
    stores_at_once = False
    hello_quiets = False
    reset_s = 0.0
    answer_frame: Frame
    hello: Request
    quiet: Requests = ()
    resume: Requests = ()
    save_all: Requests = ()
    questions: Requests = ()

    def __init__(self, device: DeviceFile | None = None) -> None:
        del device

    @abstractmethod
    def message(self, packet: bytes) -> Message:
        """Return what a packet carries."""

    def messages(self, held: bytes) -> tuple[list[Message], int]:
        """Return what in these bytes may be an answer, and how many of them are done with."""
        packets, done = packets_among(held, self.answer_frame)
        return [self.message(packet) for packet in packets], done

    def learn(self, ask: Ask) -> None:
        """Find out what this device has: its commands, its base rate."""
        del ask

    @abstractmethod
    def read(self, name: str) -> Request:
        """Return the request that reads a setting."""

    @abstractmethod
    def write(self, name: str, value: bytes) -> Requests:
        """Return what sets a setting."""

    def save(self, names: Sequence[str]) -> Requests:
        """Return what writes these settings, or all where a device cannot choose, into flash."""
        del names
        return self.save_all

    def wanted(self, present: Values, wish: Wish) -> dict[str, bytes]:
        """Return the settings that make the wish true; without present ones it has rate and outputs, or none.

        Raises BAD_CONFIG when the device has no such rate, or nothing is sent that could be kept.
        """
        speed = {} if wish.baudrate is None else {BAUD: self.baud_codes[wish.baudrate]}
        if wish.rate_hz is None and wish.outputs is None:
            return speed
        rate_hz = wish.rate_hz or self.rate_hz(present)
        if rate_hz is None:
            raise nothing_to_keep("--rate")
        return self.of_wish(present, rate_hz, wish.outputs) | speed

    @abstractmethod
    def of_wish(self, present: Values, rate_hz: float, outputs: Sequence[str] | None) -> dict[str, bytes]:
        """Return the settings for a rate and outputs; None: those of the present settings."""

    def settled(self, name: str, wanted: bytes, found: bytes) -> bool:
        """Return whether what reads back is what was wanted."""
        del name
        return wanted == found

    @abstractmethod
    def kinds(self, values: Values) -> list[PacketKind]:
        """Return what these settings send, the inertial data first."""

    def bytes_per_s(self, values: Values) -> float:
        """Return how many bytes these settings send."""
        return sum(
            kind.around * kind.rate_hz + sum(field.size * field.rate_hz for field in kind.fields)
            for kind in self.kinds(values)
        )

    def rate_hz(self, values: Values) -> float | None:
        """Return the rate of the inertial data, or None when none come."""
        return next((kind.rate_hz for kind in self.kinds(values) if kind.rate_hz), None)

    def describe(self, name: str, value: bytes) -> str:
        """Return what a value of a setting means, in words."""
        if name == BAUD:
            return str(self.baud_of(value) or f"code {value.hex()}")
        return self.meaning(name, value)

    @abstractmethod
    def meaning(self, name: str, value: bytes) -> str:
        """Return what a value of any other setting means, in words."""

    def baud_of(self, value: bytes) -> int | None:
        """Return the baud rate of a value of the setting; None when it is not known."""
        return next((rate for rate, code in self.baud_codes.items() if code == value), None)

    def check(self, wish: Wish) -> None:
        """Refuse what no device of the family has, before anything is sent.

        Raises BAD_CONFIG, naming what there is.
        """
        for name in wish.outputs or ():
            if name not in self.columns:
                what = f"{self.title} devices have no output {name!r}"
                raise bad_config(what, f"there are: {', '.join(self.columns)}")
        if wish.baudrate is not None and wish.baudrate not in self.baud_codes:
            there = ", ".join(map(str, self.baud_codes))
            raise bad_config(f"no baud rate {wish.baudrate}", f"there are: {there}")


def no_rate(rate_hz: float, there: Collection[float], why: str) -> ImumonError:
    """Return the error that a device has no such rate, with the two that are nearest."""
    nearest_two = sorted(sorted(there, key=lambda rate: abs(rate - rate_hz))[:2])
    near = " and ".join(f"{rate:.6g}" for rate in nearest_two)
    return bad_config(f"no rate of {rate_hz:g} Hz ({why})", f"nearest: {near} Hz")


def nothing_to_keep(option: str) -> ImumonError:
    """Return the error that what an option sets is to stay as it is, and there is nothing."""
    return bad_config("the device sends nothing now, so there is nothing to keep", f"give {option}")


def nearest(base_hz: float, rate_hz: float) -> int:
    """Return the divisor of a base rate that comes nearest to a rate."""
    return min(max(round(base_hz / rate_hz), 1), MOST_DIVISOR)


def divisor(base_hz: float, rate_hz: float) -> int:
    """Return the whole number by which a base rate is divided to give this one.

    Raises BAD_CONFIG when there is none, with the nearest rates.
    """
    by = nearest(base_hz, rate_hz)
    if abs(base_hz / by / rate_hz - 1) <= CLOSE_ENOUGH:
        return by
    low = max(int(base_hz / rate_hz), 1)
    there = [base_hz / low, base_hz / (low + 1)]
    raise no_rate(rate_hz, there, f"the device divides {base_hz:g} Hz by a whole number")


def family_of(device: DeviceFile) -> Family:
    """Return the commands for a device.

    Raises BAD_CONFIG when imumon has none for it.
    """
    if device.protocol not in WING.firmware:
        raise bad_config(
            f"imumon does not configure {device.name} devices",
            "those that it does: xsens, microstrain, vectornav, witmotion; use the vendor's software",
        )
    place = WING.firmware[device.protocol].removesuffix("Firmware")  # both are in one module, named alike
    family: type[Family] = resolve_name(place)
    return family(device)
