"""What arrives on a link: how full it is, and what became of every byte."""

from collections import Counter
from dataclasses import dataclass, field
from typing import ClassVar

from imumon.transport.settings import PortSettings

BUCKET_NS = 100_000_000
"""Bytes are counted per 0.1 s."""
WINDOW_BUCKETS = 20
"""The rate is that of the last 2 s, and of the silence before it."""
LONGEST_WINDOW = 600
"""A silence of the last 60 s may have been a late read."""
WARN_ABOVE = 0.80
"""Load at which the warning comes: above it, a packet that grows or a device that sends more overruns."""
CALM_BELOW = 0.70
"""Load at which the warning goes, so that it does not flicker."""


class LinkStatistics:
    """Counts what arrives; fed and read by one thread.

    `settings`: give what the line can carry; without a line (``socket://``) there is no load.
    """

    def __init__(self, settings: PortSettings) -> None:
        self._capacity = settings.capacity_bytes_per_s
        self._buckets = Counter[int]()  # bytes by the number of the 0.1 s
        self._first_bucket: int | None = None  # behind what had queued up before the port was opened
        self._warning = False

    def add(self, n_bytes: int, time_ns: int) -> None:
        """Count bytes that arrived at `time_ns`, which must not go back."""
        bucket = time_ns // BUCKET_NS
        if self._first_bucket is None:
            self._first_bucket = bucket + 1
        if bucket >= self._first_bucket:
            self._buckets[bucket] += n_bytes
            self._forget(bucket)

    def bytes_per_s(self, now_ns: int) -> float:
        """Return the rate at which bytes were sent, over the last 2 s.

        The first 0.1 s does not count: it holds what had queued up before the port was opened.  Nor does the
        one that is not over yet.
        A read that comes late brings what was sent during the silence before it, so a silence that ended
        within the 2 s counts from its beginning.
        """
        bucket, first = now_ns // BUCKET_NS, self._first_bucket
        if first is None or bucket <= first:
            return 0.0
        self._forget(bucket)
        before = (number for number in self._buckets if number < bucket - WINDOW_BUCKETS)
        begin = max(max(before, default=first - 1) + 1, bucket - LONGEST_WINDOW)
        sent = sum(count for number, count in self._buckets.items() if begin <= number < bucket)
        return sent / (bucket - begin) / (BUCKET_NS * 1e-9)

    def load(self, now_ns: int) -> float | None:
        """Return the share of the line's capacity in use, or None when there is no line."""
        return self.load_of(self.bytes_per_s(now_ns))

    def load_of(self, bytes_per_s: float) -> float | None:
        """Return the share of the line's capacity that a rate takes, or None when there is no line."""
        return None if self._capacity is None else bytes_per_s / self._capacity

    def overloaded(self, now_ns: int) -> bool:
        """Return whether to warn: above 80 % load, until it is below 70 %.

        Not in the first 2 s: what had queued up before the port was opened comes at once.
        """
        load = self.load(now_ns)
        if load is not None and now_ns // BUCKET_NS - (self._first_bucket or 0) >= WINDOW_BUCKETS:
            self._warning = load > (CALM_BELOW if self._warning else WARN_ABOVE)
        return self._warning

    def _forget(self, bucket: int) -> None:
        while self._buckets and (oldest := next(iter(self._buckets))) < bucket - LONGEST_WINDOW:
            del self._buckets[oldest]


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
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
