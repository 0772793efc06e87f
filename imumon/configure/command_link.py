"""The line to a device: finds it, sends requests, finds answers among the data, measures what it sends."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from imumon.errors import ImumonError, Reason
from imumon.protocols.device import DeviceFile
from imumon.protocols.numbers import is_missing
from imumon.transport.detect import Evidence, Verdict, detect, failure
from imumon.transport.port import Port, open_port

from .core import Answer, CommandError, Family, Message, Request

TRIES = 3
"""A request and two repetitions: a byte may be lost on the line, and one that is lost thrice is no chance."""
LATE_S = 0.2
"""How long an answer to the first try may still come when a later one has been answered."""
POLL_S = 0.05
HEAR_S = 1.2
"""How long a port is listened to before it counts as silent: one packet a second would come."""


LEAST_S, MOST_S = 1.5, 5.0
"""Shortest and longest time for `PACKETS`; what comes once a second is received in the shortest."""
PACKETS = 20
"""With so many packets, delays of a USB adapter (16 ms) move the rate by less than `TOLERANCE`."""
TOLERANCE = 0.1
"""Difference of rates that no clock explains; the next whole divisor differs by less only above ten."""
PERIODS = 2.5
"""At any rate so many samples are waited for."""
SETTLE_S = 0.3
"""Time after a change of which nothing is measured: what was kept back comes at once."""
FEWEST = 4
"""A rate is determined by two intervals behind a first packet that may have waited."""
MAIN_COLUMNS = ("gyro_x", "accel_x", "delta_velocity_x", "q_w", "roll", "mag_x", "temperature", "pressure")
"""What the rate is measured on: the first of them that comes."""


class CommandLink:
    """A device at the end of an open port.

    `port` is owned from now on; `streaming`: whether the device sent data when it was found.
    """

    def __init__(self, port: Port, family: Family) -> None:
        self.port, self.family, self.streaming = port, family, False
        self.sent: list[tuple[Request, bool | None]] = []
        """What went over the line, and whether it was answered; None where devices do not answer."""

    def ask(self, request: Request, tries: int = TRIES) -> bytes:
        """Send a request and return its answer; empty for one that devices do not answer.

        Raises CommandError when the device refused, or did not answer; LOST when the port failed.
        """
        for number in range(tries):
            self.discard()
            self.port.write(request.frame)
            if request.answer is None:
                self.sent.append((request, None))
                self.discard(request.timeout_s)
                return b""
            answer = self._answer(request.answer, request.timeout_s)
            self.sent.append((request, answer is not None))
            if answer is None:
                continue
            if number:
                self.discard(LATE_S)
            if isinstance(answer, str):
                raise CommandError(request, answer, refused=True)
            return answer
        why = f"no answer within {request.timeout_s:g} s, queried {tries} times"
        raise CommandError(request, why, refused=False)

    def _answer(self, find: Callable[[Message], Answer], timeout_s: float) -> Answer:
        held = b""
        for data in self._arriving(timeout_s):
            messages, done = self.family.messages(held + data)
            held = (held + data)[done:]
            for message in messages:
                if (answer := find(message)) is not None:
                    return answer
        return None

    def _arriving(self, seconds: float) -> Iterator[bytes]:
        """Yield what has come, and what comes within so many seconds, also while the host stalled."""
        end = time.monotonic() + seconds
        while True:
            left = end - time.monotonic()
            data = self.port.read(max(min(left, POLL_S), 0.0))
            yield data
            if left <= 0.0 and (not data or left < -POLL_S):
                return

    def discard(self, seconds: float = 0.0) -> int:
        """Take what has come, and what comes within so many seconds; return how many bytes that was."""
        return sum(map(len, self._arriving(seconds)))

    def answers_at(self, baudrate: int, seconds: float) -> bool:
        """Return whether the device answers at a rate, asking for so many seconds."""
        self.port.set_baudrate(baudrate)
        end = time.monotonic() + seconds
        while True:
            try:
                self.ask(self.family.hello, tries=1)
                return True
            except CommandError as error:
                if error.refused or time.monotonic() >= end:
                    return error.refused


@dataclass(frozen=True)
class Stream:
    """What a device sent within a time: the columns with values, and why the numbers fit no estimate.

    Number and rate of samples are of the first of `MAIN_COLUMNS` that came; no rate when they were too few.
    """

    seconds: float
    columns: tuple[str, ...]
    samples: int
    rate_hz: float | None
    warnings: tuple[str, ...]

    def problem(self, wanted: Sequence[str], rate_hz: float | None) -> str:
        """Return why these are not the columns and the rate that were requested; empty when they are."""
        if not self.columns:
            return f"no data came within {self.seconds:.1f} s"
        if missing := [name for name in wanted if name not in self.columns]:
            return f"{', '.join(missing)} did not come within {self.seconds:.1f} s"
        due = (rate_hz or 0.0) * (1 - TOLERANCE) * self.seconds
        if self.samples and self.rate_hz is None and due >= FEWEST:
            return f"{self.samples} samples came within {self.seconds:.1f} s, not at {rate_hz:.6g} Hz"
        if rate_hz and self.rate_hz and abs(self.rate_hz / rate_hz - 1) > TOLERANCE:
            return f"data come at {self.rate_hz:.4g} Hz, not at {rate_hz:.6g} Hz"
        return ""


def measure(link: CommandLink, device: DeviceFile, rate_hz: float | None) -> Stream:
    """Listen to a device and return what it sends; raises LOST when the port failed."""
    decoder = device.decoder()
    seconds = max(min(max(PACKETS / rate_hz, LEAST_S), MOST_S), PERIODS / rate_hz) if rate_hz else LEAST_S
    link.discard(SETTLE_S)
    start = time.monotonic()
    while (left := start + seconds - time.monotonic()) > 0:
        decoder.feed(link.port.read(min(left, POLL_S)), time.time_ns())
    columns = dict(decoder.take().columns)
    arrivals_ns = columns.pop("arrival_time_ns")
    there = {name: ~is_missing(values) for name, values in columns.items()}
    received = {name: arrivals_ns[known] for name, known in there.items() if known.any()}
    main = next((received[name] for name in MAIN_COLUMNS if name in received), arrivals_ns[:0])
    after = main[main > main[:1]]  # the first may have waited together
    rate = len(after) * 1e9 / float(after[-1] - main[0]) if len(after) >= 2 else None
    return Stream(seconds, tuple(received), len(main), rate, tuple(decoder.warnings()))


def connect(url: str, device: DeviceFile, family: Family, baudrate: int | None) -> CommandLink:
    """Open a port at the rate of the device, found by listening if not given, and ask if it is of the family.

    Raises ImumonError what opening a port raises; WRONG_BAUD when something else is there; SILENT when
    nothing answers.
    """
    candidates = {device.name: device.decoder}
    evidence = detect(url, candidates, device.serial.baudrates, HEAR_S) if baudrate is None else []
    rates = [baudrate] if baudrate is not None else _rates_received(url, device, evidence)
    link = CommandLink(open_port(device.port_settings(url, rates[0])), family)
    try:
        link.streaming = any(item.packets for item in evidence) or link.discard(HEAR_S) > 0
        for rate in rates:
            if link.answers_at(rate, 1.0 if len(rates) == 1 else 0.0):
                return link
        port = link.port.settings
        where = f"{port} sends, but" if link.streaming else f"{port.url}: no data, and"
        raise ImumonError(
            Reason.SILENT,
            f"{where} no {device.name} device answers (queried at {', '.join(map(str, rates))} baud)",
            "is the line to the device (TX of the adapter) connected, does it take commands on this port?"
            if link.streaming
            else "check power, wiring (RX and TX swapped?) and the rate (--at)",
        )
    except BaseException:
        with suppress(ImumonError):
            for request in family.resume if family.hello_quiets and link.streaming else ():
                link.port.write(request.frame)  # it may have received the query and be quiet since
        link.port.close()
        raise


def _rates_received(url: str, device: DeviceFile, evidence: list[Evidence]) -> list[int]:
    """Return the rate at which packets of the device came; when nothing came, all of its rates."""
    best = evidence[0]
    if best.verdict not in (Verdict.NOTHING, Verdict.SILENT):
        return [best.baudrate or device.serial.baudrates[0]]
    if not any(item.bytes_received for item in evidence):
        return list(device.serial.baudrates)
    wrong = failure(url, evidence)
    assert wrong is not None
    raise ImumonError(
        Reason.WRONG_BAUD,
        f"{wrong.seen}: this is no {device.name} device, or it talks at none of its usual rates",
        f"nothing was sent.  imumon detect {url} reports what it is; --at sets the rate",
    )
