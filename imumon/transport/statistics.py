"""What arrives on a link: how full it is, and what became of every byte."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from imumon.transport.settings import PortSettings

BUCKET_NS = 100_000_000
"""Bytes are counted per 0.1 s."""
WINDOW_BUCKETS = 20
"""The rate is that of the last 2 s."""
WARN_ABOVE = 0.80
"""Load at which the warning comes: above it, a packet that grows or a device that sends more overruns."""
CALM_BELOW = 0.70
"""Load at which the warning goes, so that it does not flicker."""


class LinkStatistics:
    """Counts what arrives; fed and asked by one thread.

    Parameters
    ----------
    settings : PortSettings
        Give what the line can carry; without a line (``socket://``) there is no load.
    """

    def __init__(self, settings: PortSettings) -> None:
        self._capacity = settings.capacity_bytes_per_s
        self._buckets: deque[tuple[int, int]] = deque()  # number of the 0.1 s, bytes in it
        self._first_bucket: int | None = None
        self._warning = False

    def add(self, n_bytes: int, time_ns: int) -> None:
        """Count bytes that arrived at `time_ns`, which must not go back."""
        bucket = time_ns // BUCKET_NS
        if self._first_bucket is None:
            self._first_bucket = bucket
        in_bucket = n_bytes
        if self._buckets and self._buckets[-1][0] == bucket:
            in_bucket += self._buckets.pop()[1]
        self._buckets.append((bucket, in_bucket))
        self._forget(bucket)

    def bytes_per_s(self, now_ns: int) -> float:
        """Return the mean rate over the last 2 s (over the time since the first byte, when that is shorter).

        The 0.1 s that is not over yet does not count.
        """
        if self._first_bucket is None:
            return 0.0
        bucket = now_ns // BUCKET_NS
        self._forget(bucket)
        n_buckets = min(WINDOW_BUCKETS, bucket - self._first_bucket)
        if n_buckets <= 0:
            return 0.0
        complete = sum(count for number, count in self._buckets if number < bucket)
        return complete / (n_buckets * BUCKET_NS * 1e-9)

    def load(self, now_ns: int) -> float | None:
        """Return the share of the line's capacity in use, or None when there is no line."""
        return self.load_of(self.bytes_per_s(now_ns))

    def load_of(self, bytes_per_s: float) -> float | None:
        """Return the share of the line's capacity that a rate takes, or None when there is no line."""
        return None if self._capacity is None else bytes_per_s / self._capacity

    def overloaded(self, now_ns: int) -> bool:
        """Tell whether to warn: above 80 % load, until it is below 70 %.

        Not in the first 2 s: what had queued up before the port was opened comes at once.
        """
        load = self.load(now_ns)
        if load is not None and now_ns // BUCKET_NS - (self._first_bucket or 0) > WINDOW_BUCKETS:
            self._warning = load > (CALM_BELOW if self._warning else WARN_ABOVE)
        return self._warning

    def _forget(self, bucket: int) -> None:
        while self._buckets and self._buckets[0][0] < bucket - WINDOW_BUCKETS:
            self._buckets.popleft()


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
