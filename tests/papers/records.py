"""Drift of a gyro at rest and samples of it, for the tests of the published filters."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import ColumnArray, FloatArray, SampleBlock

DEG_PER_HOUR = math.pi / 180 / 3600
WHITE = 127 * DEG_PER_HOUR
"""rad/s/√Hz, with `flicker` that of an MTi-28A."""


def flicker(n: int, rng: np.random.Generator, sd: float = 12 * DEG_PER_HOUR) -> FloatArray:
    """Return second by second the sum of five Gauss-Markov processes of equal variance, a decade apart."""
    total = np.zeros(n)
    for tau in (1.0, 10.0, 100.0, 1e3, 1e4):
        decay = math.exp(-1.0 / tau)
        total += lfilter([sd * math.sqrt(1 - decay**2)], [1.0, -decay], rng.standard_normal(n))
    return total


def samples(drift: FloatArray, rate_hz: int, rng: np.random.Generator) -> SampleBlock:
    """Return a block of samples at rest, the same drift on each axis."""
    n = len(drift) * rate_hz
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.arange(n, dtype=np.int64) * (1_000_000_000 // rate_hz),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.ones(n, np.int64),
    }
    for axis in "xyz":
        noise = WHITE * math.sqrt(rate_hz) * rng.standard_normal(n)
        columns[f"gyro_{axis}"] = np.repeat(drift, rate_hz) + noise
    return SampleBlock(columns)
