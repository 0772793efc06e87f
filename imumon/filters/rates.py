"""What every method of a temperature's rate returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imumon.blocks import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RateEstimate:
    """Temperature and its rate with their standard deviations, one value per sample."""

    temperature: FloatArray
    rate: FloatArray
    temperature_sd: FloatArray
    rate_sd: FloatArray
    """°C, °C/s, °C and °C/s, (n,); NaN where there is no estimate."""

    @classmethod
    def empty(cls, n: int) -> RateEstimate:
        """Return n samples without an estimate."""
        return cls(*(np.full(n, np.nan) for _ in range(4)))


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""
