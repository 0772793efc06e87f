"""What every method of a temperature's rate returns, and how fast a temperature may change unobserved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from imumon.blocks import FloatArray, IntArray

FASTEST_RATE = 20.0 / 60.0
"""Fastest that a thermometer beside an IMU moves, °C/s: 20 °C/min, twice a fast chamber."""
UNSEEN_RATE = 200.0 / 3600.0
"""Standard deviation of an unobserved rate, °C/s: of a board that warms by 20 °C with 6 min, at its start."""
START_ACCELERATION = UNSEEN_RATE / 300.0
"""Standard deviation of its change, °C/s²: it comes about within 5 min."""


@dataclass(frozen=True, slots=True, eq=False)
class RateEstimate:
    """Temperature and its rate with their standard deviations, one value per sample."""

    temperature: FloatArray
    rate: FloatArray
    temperature_sd: FloatArray
    rate_sd: FloatArray
    """°C, °C/s, °C and °C/s, (n,); NaN where there is no estimate."""


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""
