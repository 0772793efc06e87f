"""Noise with known terms, made without the package under test."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import FloatArray


def flicker(rng: np.random.Generator, n: int, instability: float, interval_s: float) -> FloatArray:
    """Return noise of two-sided density B² / (2 pi f), by shaping a spectrum four times as long."""
    long = 4 * n
    frequency = np.fft.rfftfreq(long, interval_s)
    density = np.zeros(len(frequency))
    density[1:] = instability**2 / (2.0 * np.pi * frequency[1:])
    lines = rng.normal(size=len(frequency)) + 1j * rng.normal(size=len(frequency))
    return np.fft.irfft(lines * np.sqrt(density * long / (2.0 * interval_s)), long)[:n]


def correlated(seed: int, n: int, interval_s: float, sd: float, time_s: float) -> FloatArray:
    """Return a first-order Gauss-Markov process, (n,)."""
    kept = np.exp(-interval_s / time_s)
    driving = sd * np.sqrt(1.0 - kept**2) * np.random.default_rng(seed).normal(size=n)
    driving[0] /= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], driving))


def noise(
    seed: int,
    n: int,
    interval_s: float,
    *,
    white: float = 0.0,
    instability: float = 0.0,
    walk: float = 0.0,
    quantization: float = 0.0,
    ramp: float = 0.0,
) -> FloatArray:
    """Return samples with these terms, (n,)."""
    rng = np.random.default_rng(seed)
    values = white / np.sqrt(interval_s) * rng.normal(size=n)
    if instability:
        values += flicker(rng, n, instability, interval_s)
    if walk:
        values += np.cumsum(walk * np.sqrt(interval_s) * rng.normal(size=n))
    if quantization:
        values += np.diff(quantization * rng.normal(size=n + 1)) / interval_s
    return np.asarray(values + ramp * interval_s * np.arange(n), np.float64)


def nist_1000() -> FloatArray:
    """Return the 1000 frequencies of NIST SP 1065, section 12.4."""
    numbers = [1234567890]
    while len(numbers) < 1000:
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647
