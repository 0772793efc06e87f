"""Simulated drift, and the means or samples that a gyro at rest makes of it."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.estimation.random_error.slots import Slots

DEG_PER_HOUR = math.pi / 180 / 3600
WHITE = 127 * DEG_PER_HOUR
"""rad/s/√Hz, with `FLICKER` that of an MTi-28A."""
FLICKER = 12 * DEG_PER_HOUR


def flicker(n: int, rng: np.random.Generator, sd: float = FLICKER) -> FloatArray:
    """Return second by second the sum of five processes of equal variance, a decade apart, from nought."""
    total = np.zeros(n)
    for tau in (1.0, 10.0, 100.0, 1e3, 1e4):
        a = math.exp(-1.0 / tau)
        drive = sd * math.sqrt(1 - a * a) * rng.standard_normal(n)
        state = 0.0
        for k in range(n):
            state = a * state + drive[k]
            total[k] += state
    return total


def seconds(mean: FloatArray) -> Slots:
    """Return slots of a second each with these means."""
    m = len(mean)
    covered = np.isfinite(mean).astype(np.float64)
    first = np.arange(m) == 0
    return Slots(np.arange(m), first, np.ones(m), covered, mean, np.full(m, 0.01))


def samples(drift: FloatArray, rate_hz: int, rng: np.random.Generator, white: float = WHITE) -> SampleBlock:
    """Return a block of samples at rest, the same drift on each axis."""
    n = len(drift) * rate_hz
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.arange(n, dtype=np.int64) * (1_000_000_000 // rate_hz),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.ones(n, np.int64),
    }
    for axis in "xyz":
        noise = white * math.sqrt(rate_hz) * rng.standard_normal(n)
        columns[f"gyro_{axis}"] = np.repeat(drift, rate_hz) + noise
    return SampleBlock(columns)
