"""What became of every byte that arrived on a link."""

from dataclasses import dataclass, field
from typing import ClassVar


@dataclass(frozen=True)
class StreamCounters:
    """What came of a stream of a device.

    `rate_hz` is the rate where nothing is missing, `incomplete` rows lack fields that all rows before them
    had.  `dated_by` states where the times are from: "clock" of the device, its "counter" or the "rows" at a
    nominal rate, "arrival"; empty of a side stream, and where it was not noted.
    """

    __pydantic_config__: ClassVar = {"strict": False, "extra": "forbid"}  # it is read from session.yaml
    packets: int
    rows: int
    rate_hz: float | None
    gaps: int
    incomplete: int
    restarts: int
    dated_by: str = ""


@dataclass(frozen=True)
class Counters:
    """What became of every byte: received = in packets + skipped + pending."""

    bytes_received: int = 0
    bytes_in_packets: int = 0
    bytes_skipped: int = 0
    packets: int = 0
    checksum_errors: int = 0
    length_errors: int = 0
    packets_by_type: dict[str, int] = field(default_factory=dict)

    @property
    def bytes_pending(self) -> int:
        """Bytes that may still become part of a packet."""
        return self.bytes_received - self.bytes_in_packets - self.bytes_skipped
