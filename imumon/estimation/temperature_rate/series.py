"""What every temperature-rate method shares: its result, and time in seconds since a segment's start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from imumon.blocks import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RateEstimate:
    """Temperature and its rate with their standard deviations, one value per sample.

    Parameters
    ----------
    temperature, rate, temperature_sd, rate_sd : array, (n,)
        °C, °C/s, °C and °C/s; NaN where there is no estimate.
    """

    temperature: FloatArray
    rate: FloatArray
    temperature_sd: FloatArray
    rate_sd: FloatArray

    @classmethod
    def empty(cls, n: int) -> RateEstimate:
        """Return n samples without an estimate."""
        return cls(*(np.full(n, np.nan) for _ in range(4)))

    def rows(self, start: int, stop: int) -> RateEstimate:
        """Return samples start..stop as views."""
        parts = (self.temperature, self.rate, self.temperature_sd, self.rate_sd)
        return RateEstimate(*(part[start:stop] for part in parts))


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""


class SegmentClock:
    """Seconds since the first sample of a segment of the device clock.

    Within a segment the time may stand still but does not run back; a time that does begins anew, too.
    """

    def __init__(self) -> None:
        self._segment: int | None = None
        self._origin_ns = 0
        self._last_ns = 0

    def runs(self, time_ns: IntArray, segment: IntArray) -> Iterator[tuple[int, int, bool, FloatArray]]:
        """Yield start, stop, whether a segment begins here, and seconds since its beginning, run by run."""
        n = len(time_ns)
        if n == 0:
            return
        breaks = (np.diff(segment) != 0) | (np.diff(time_ns) < 0)
        edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), n]
        for start, stop in pairwise(edges):
            first, label = int(time_ns[start]), int(segment[start])
            begins = start > 0 or label != self._segment or first < self._last_ns
            if begins:
                self._segment, self._origin_ns = label, first
            self._last_ns = int(time_ns[stop - 1])
            elapsed = (time_ns[start:stop] - self._origin_ns).astype(np.float64)
            yield start, stop, begins, elapsed * 1e-9
