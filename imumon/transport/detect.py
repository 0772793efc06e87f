"""Find baud rate and protocol of a device by listening, and show the evidence."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from imumon.errors import ImumonError, Reason

from .port import open_port
from .ports import silent_error, wrong_baud_error
from .settings import PortSettings

COMMON_BAUDRATES = (
    115200, 921600, 460800, 230400, 57600, 38400, 9600, 19200,
    1000000, 2000000, 3000000, 500000, 1500000, 4000000, 4800,
)  # fmt: skip
"""Rates that devices are delivered with, the most common first."""
PLENTY_OF_PACKETS = 50
"""With so many packets in good order, listening on at this rate proves nothing more."""
ENOUGH_PACKETS = 5
FRAMED = 0.8
"""Share of bytes in packets from which a stream frames; the packets cut at both ends are missing from 1."""
FRAMED_IN_PART = 0.2
TRIED_BYTES = 2048
"""With so many bytes, four of the longest packets, and none valid, rate or protocol is another."""
ENOUGH_TEXT = 100
MOSTLY_TEXT = 0.95
"""Share of printable bytes from which a stream is text: at a wrong rate a third of all bytes is."""
HEADER_BYTES, WRONG_CHECKSUM = 200, "is its checksum, or its length, another than in the device file?"
"""One right header in so many bytes is no chance, if a file describes the packet; and what that means."""
SILENT_RATES = 3
"""After so many rates without a byte it is silent: a wrong rate garbles bytes, it does not stop them."""
POLL_S = 0.05
TEXT, ODD = b"\t\r\n" + bytes(range(0x20, 0x7F)), b"\x00\xff"
Candidates = Mapping[str, Callable[[], Any]]
"""By name what makes a fresh decoder (`imumon.protocols.decoder.Decoder`)."""


class Verdict(Enum):
    """What a protocol makes of the bytes at a rate, best first; see `Evidence.verdict`."""

    FRAMES = "frames"
    UNREAD = "frames, and nothing in it is known"
    PARTLY = "frames in part"
    NOTHING = "does not frame"
    SILENT = "silent"


@dataclass(frozen=True)
class Evidence:
    """What a candidate found at one baud rate, in bit/s; None where there is no line (``socket://``).

    Of the bytes received some are in valid packets, and some pending, of a packet cut off at the end.  Errors
    are of what looked like a packet and was none.  A device of the same family may frame all packets and find
    no samples in them.  Odd bytes are 0x00 or 0xFF, which a wrong rate or an inverted line gives; text is
    printable ASCII or line ends.
    """

    protocol: str
    baudrate: int | None
    seconds: float
    bytes_received: int
    bytes_in_packets: int
    bytes_pending: int
    packets: int
    checksum_errors: int
    length_errors: int
    samples: int
    odd_share: float
    text_share: float

    @property
    def bytes_per_s(self) -> float:
        """Rate at which bytes arrived."""
        return self.bytes_received / self.seconds

    @property
    def share_framed(self) -> float:
        """Share of the bytes that are in valid packets, apart from a packet cut off at the end."""
        complete = self.bytes_received - self.bytes_pending
        return self.bytes_in_packets / complete if complete else 0.0

    @property
    def tells_the_rate(self) -> bool:
        """Whether these bytes came at the right rate: they frame, or they are text."""
        is_text = self.bytes_received >= ENOUGH_TEXT and self.text_share > MOSTLY_TEXT
        return is_text or self.verdict in (Verdict.FRAMES, Verdict.UNREAD)

    @property
    def verdict(self) -> Verdict:
        """What follows from the numbers."""
        if self.bytes_received == 0:
            return Verdict.SILENT
        if self.packets >= ENOUGH_PACKETS and self.share_framed >= FRAMED:
            return Verdict.FRAMES if self.samples else Verdict.UNREAD
        return Verdict.PARTLY if self.packets and self.share_framed >= FRAMED_IN_PART else Verdict.NOTHING


def is_wrong_checksum(protocol: str, checksum_errors: int, bytes_received: int) -> bool:
    """Return whether so many bytes have too many right headers for another device or a wrong baud rate."""
    return protocol.startswith("fixed") and checksum_errors * HEADER_BYTES > bytes_received


def baudrates_to_try(first: Iterable[int]) -> list[int]:
    """Return the rates in the order to try them: those of the known devices, then the common ones."""
    return list(dict.fromkeys((*first, *COMMON_BAUDRATES)))


def detect(
    url: str,
    candidates: Candidates,
    baudrates: Sequence[int] = COMMON_BAUDRATES,
    seconds_each: float = 1.5,
    before_rate: Callable[[PortSettings], bytearray] = lambda _: bytearray(),
) -> list[Evidence]:
    """Listen at one rate after the other until the bytes frame; return the evidence, the best first.

    Raises ImumonError when the port cannot be opened or is lost.  A rate that the adapter does not offer is
    passed over.

    `url`: the port; where it has no line, it is listened to once.
    `candidates`: what is tried on the bytes.
    `baudrates`: rates in bit/s, in the order to try them.
    `seconds_each`: time to listen at each rate; less when there is enough evidence.
    `before_rate`: given what is tried next; returns what the bytes that come are added to.
    """
    rates = baudrates if PortSettings(url).has_line else baudrates[:1]
    evidence: list[Evidence] = []
    for rate in rates:
        settings = PortSettings(url, baudrate=rate)
        data = before_rate(settings)
        try:
            evidence += listen(settings, candidates, seconds_each, data, others=len(rates) > 1)
        except ImumonError as error:
            if error.reason is not Reason.BAD_CONFIG or (rate == rates[-1] and not evidence):
                raise
        is_silent = not any(item.bytes_received for item in evidence)
        tried = {item.baudrate for item in evidence}
        if any(item.tells_the_rate for item in evidence) or (is_silent and len(tried) >= SILENT_RATES):
            break
    order = [*Verdict]
    return sorted(
        evidence,
        key=lambda e: (order.index(e.verdict), not e.samples, -e.share_framed, -e.packets, e.checksum_errors),
    )


def listen(
    settings: PortSettings, candidates: Candidates, seconds: float, data: bytearray, others: bool
) -> list[Evidence]:
    """Feed what arrives within `seconds` to every candidate, and add it to `data`; return the evidence.

    Bytes without a packet end it early only where there are other rates to try: else all that comes may
    serve a proposal.
    """
    decoders = {name: factory() for name, factory in candidates.items()}
    elapsed = 0.0
    with open_port(settings) as port:
        start = time.monotonic() + (POLL_S if settings.has_line else 0.0)
        while time.monotonic() < start:  # what has waited is of no rate
            port.read(POLL_S)
        while elapsed < seconds and not (
            _has_plenty(decoders.values()) or (others and _is_foreign(decoders.values(), data))
        ):
            read = port.read(min(POLL_S, seconds - elapsed))
            data += read
            for decoder in decoders.values():
                decoder.feed(read, time.time_ns())
            elapsed = time.monotonic() - start
    evidence = []
    rate = settings.baudrate if settings.has_line else None
    shares = _share(data, ODD), _share(data, TEXT)
    for name, decoder in decoders.items():
        decoder.finish()
        n = decoder.counters()
        of_bytes = n.bytes_received, n.bytes_in_packets, n.bytes_pending
        of_packets = n.packets, n.checksum_errors, n.length_errors, len(decoder.take())
        evidence.append(Evidence(name, rate, elapsed, *of_bytes, *of_packets, *shares))
    return evidence


def _share(data: bytearray, of: bytes) -> float:
    """Return the share of the bytes that are among these; 0 without bytes."""
    return 1.0 - len(data.translate(None, of)) / len(data) if data else 0.0


def failure(url: str, evidence: Sequence[Evidence]) -> ImumonError | None:
    """Return why nothing was detected (SILENT, WRONG_BAUD), with the likely causes; None when something was.

    `evidence` is what `detect` returned, the best first.
    """
    best = evidence[0]
    if best.verdict is Verdict.FRAMES:
        return None
    settings = PortSettings(url, best.baudrate or COMMON_BAUDRATES[0])
    if best.verdict is Verdict.SILENT:
        return silent_error(settings, sum({item.baudrate: item.seconds for item in evidence}.values()))
    seen = wrong_baud_error(settings, best.bytes_per_s, best.share_framed, best.odd_share).seen
    return ImumonError(Reason.WRONG_BAUD, seen, _likely_cause(evidence))


def _likely_cause(evidence: Sequence[Evidence]) -> str:
    """Tell what patterns in the bytes point to."""
    best = evidence[0]
    if best.verdict is Verdict.PARTLY:
        return (
            f"{best.protocol} frames in part with {best.checksum_errors} checksum errors: bytes are damaged"
            " or missing.  Check ground and cable, and that no other program reads the port."
        )
    text = max(evidence, key=lambda item: item.text_share)
    if text.text_share > MOSTLY_TEXT:
        rate = "" if text.baudrate is None else f" at {text.baudrate}"
        return (
            f"The bytes{rate} are text that no device file here describes: the device may be in command mode,"
            " or needs a device file (with --seconds 10 enough lines arrive to propose one)."
        )
    if best.verdict is Verdict.UNREAD:
        return (
            f"{best.protocol} frames, but nothing that it sends is known: see what the device is set to send."
        )
    tried = ", ".join(dict.fromkeys(str(item.baudrate) for item in evidence))
    inverted = (
        "\nMost bytes are 0x00 or 0xFF at every rate: the line may also be inverted (RS-232 on TTL, RS-422)."
    )
    return (
        f"Another protocol, or another rate than those tried ({tried}); the manual of the device has them."
        + (inverted if all(item.odd_share > 0.5 for item in evidence) else "")
    )


def _has_plenty(decoders: Iterable[Any]) -> bool:
    """Return whether a candidate frames so many packets that listening on would prove nothing more."""
    counts = (decoder.counters() for decoder in decoders)
    return any(
        count.packets >= PLENTY_OF_PACKETS
        and count.bytes_in_packets >= FRAMED * (count.bytes_received - count.bytes_pending)
        for count in counts
    )


def _is_foreign(decoders: Iterable[Any], data: bytearray) -> bool:
    """Return whether so many bytes without a packet, and no text, come from another rate or protocol."""
    packets = any(decoder.counters().packets for decoder in decoders)
    return len(data) >= TRIED_BYTES and not packets and _share(data, TEXT) <= MOSTLY_TEXT
