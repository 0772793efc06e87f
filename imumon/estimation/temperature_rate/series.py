"""What every temperature-rate method shares: its result, and time in seconds since a segment's start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit


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


class Rates(Protocol):
    """What a method returns: the arrays of `RateEstimate`."""

    @property
    def temperature(self) -> FloatArray: ...  # noqa: D102  (see RateEstimate)
    @property
    def rate(self) -> FloatArray: ...  # noqa: D102
    @property
    def temperature_sd(self) -> FloatArray: ...  # noqa: D102
    @property
    def rate_sd(self) -> FloatArray: ...  # noqa: D102


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> Rates:
        """Return the estimates of samples that follow those of the last call."""


class SegmentClock:
    """Seconds since the first sample of a segment of the device clock.

    Within a segment the time may stand still but does not run back; a time that does begins anew, too.
    """

    def __init__(self) -> None:
        # Whether there was a sample; the segment, its first time and the last time, ns.
        self.state: IntArray = np.zeros(4, np.int64)

    def runs(self, time_ns: IntArray, segment: IntArray) -> Iterator[tuple[int, int, bool, FloatArray]]:
        """Yield start, stop, whether a segment begins here, and seconds since its beginning, run by run."""
        n = len(time_ns)
        if n == 0:
            return
        edges = [0, n]
        if not _steady(time_ns, segment):
            breaks = (np.diff(segment) != 0) | (np.diff(time_ns) < 0)
            edges[1:1] = (np.flatnonzero(breaks) + 1).tolist()
        for start, stop in pairwise(edges):
            known, label, origin, last = self.state.tolist()
            first = int(time_ns[start])
            begins = not known or start > 0 or int(segment[start]) != label or first < last
            self.state[:] = 1, segment[start], first if begins else origin, time_ns[stop - 1]
            elapsed = (time_ns[start:stop] - self.state[2]).astype(np.float64)
            yield start, stop, begins, elapsed * 1e-9


@njit
def _steady(time_ns: IntArray, segment: IntArray) -> bool:
    """Tell whether all is one segment in which the time does not run back: nearly every block is."""
    for i in range(1, len(time_ns)):
        if segment[i] != segment[i - 1] or time_ns[i] < time_ns[i - 1]:
            return False
    return True
