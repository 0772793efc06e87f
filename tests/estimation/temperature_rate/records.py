"""Temperature records for the tests of this folder."""

from __future__ import annotations

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock

PER_HOUR = 3600.0


def clock(n: int, rate_hz: float = 10.0) -> tuple[IntArray, IntArray]:
    """Return device time and segment of n samples."""
    return np.arange(n, dtype=np.int64) * int(1e9 / rate_hz), np.zeros(n, np.int64)


def block(time_ns: IntArray | None = None, **columns: ColumnArray) -> SampleBlock:
    """Return a block of one segment, at 10 Hz where no times are given."""
    n = len(next(iter(columns.values())))
    usual_ns, segment = clock(n)
    times = usual_ns if time_ns is None else time_ns
    return SampleBlock({"device_time_ns": times, "segment": segment, **columns})


def quantized(temperature: FloatArray, noise: float, seed: int = 3, step: float = 0.05) -> FloatArray:
    """Return what a sensor with white noise and this step reads."""
    noisy = temperature + noise * np.random.default_rng(seed).standard_normal(len(temperature))
    return np.asarray(step * np.round(noisy / step), np.float64)


def self_heating(hours: float, rate_hz: float = 10.0) -> tuple[FloatArray, FloatArray]:
    """Return temperature and rate of a unit that warms up by 30 °C with two time constants."""
    t = np.arange(int(hours * PER_HOUR * rate_hz)) / rate_hz
    slow, fast = 22.0 * np.exp(-t / 5400), 8.0 * np.exp(-t / 1500)
    return 60.0 - slow - fast, slow / 5400 + fast / 1500


def steady(rate: float, hours: float, rate_hz: float = 10.0) -> FloatArray:
    """Return a temperature that rises by `rate` °C/h."""
    t = np.arange(int(hours * PER_HOUR * rate_hz)) / rate_hz
    return np.asarray(30.013 + rate / PER_HOUR * t, np.float64)
