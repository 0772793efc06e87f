"""Welch's estimate of a power spectral density, and the lines that stand out of it.

Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
Electroacoust. 15 (1967): eq 1-4 with half-overlapping Hann windows.  NumPy alone: scipy.signal takes 0.7 s to
import, in the middle of a measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray

MOST_PEAKS = 3
FALSE_ALARM = 0.01
"""Chance that white noise shows a peak anywhere in a spectrum."""
FLOOR_BINS = 15
"""The floor under a line is the median over so many bins on one side, beyond the bin itself."""
HALF_LINE = 2
"""A line of a Hann window has its power in its bin and so many on either side."""
OVERLAP_COST = 19.0 / 18.0
"""Variance of half-overlapping Hann segments over that of as many independent ones, for many: Welch, section
on overlapped segments, 1 + 2 ρ² with ρ² = (1/6)²."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A one-sided power spectral density, unit² per Hz, at frequencies, (n,) each, of so many segments."""

    frequency_hz: FloatArray
    density: FloatArray
    segments: int


class Peak(NamedTuple):
    """A line: where it is, and the rms of what oscillates there."""

    frequency_hz: float
    rms: float


def welch(values: FloatArray, interval_s: float, length: int) -> Spectrum:
    """Return the spectrum of evenly spaced values, (n,), in half-overlapping segments of an even length."""
    window = np.hanning(length + 1)[:-1]
    parts = np.lib.stride_tricks.sliding_window_view(values, length)[:: length // 2]
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power = np.abs(np.fft.rfft(parts, axis=1)) ** 2
    density = 2.0 * interval_s * power.mean(axis=0) / float(window @ window)
    density[[0, -1]] /= 2.0
    frequency = np.arange(len(density)) / (length * interval_s)
    return Spectrum(frequency, np.asarray(density), len(parts))


def peaks(spectrum: Spectrum) -> list[Peak]:
    """Return the strongest lines above what noise of this floor reaches, the strongest first."""
    density, frequency = spectrum.density, spectrum.frequency_hz
    if len(density) < 2 * FLOOR_BINS:
        return []
    from scipy.special import gammaincinv  # 0.1 s, which no command spends before the first spectrum

    # A mean of so many exponential variables has a gamma distribution of this shape.
    shape = spectrum.segments / OVERLAP_COST
    # The first bins are left out: subtracting the mean of a segment has lowered them.
    padded = np.pad(density[HALF_LINE:], (HALF_LINE + FLOOR_BINS, FLOOR_BINS), "edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, FLOOR_BINS), axis=1)
    # The higher of the medians below and above each bin, so that the flank of a steep floor is no line.
    sides = np.maximum(medians[: len(density)], medians[-len(density) :])
    floor = sides * shape / float(gammaincinv(shape, 0.5))
    limit = float(gammaincinv(shape, 1.0 - FALSE_ALARM / len(density))) / shape
    inner = np.arange(HALF_LINE + 1, len(density) - 1)
    top = (density[inner] >= density[inner - 1]) & (density[inner] > density[inner + 1])
    found = []
    for at in inner[top & (density[inner] > limit * floor[inner])].tolist():
        line = slice(at - HALF_LINE, at + HALF_LINE + 1)
        power = np.maximum(density[line] - floor[line], 0.0)
        middle = float(power @ frequency[line] / power.sum())
        found.append(Peak(middle, math.sqrt(power.sum() * frequency[1])))
    return sorted(found, key=lambda peak: -peak.rms)[:MOST_PEAKS]
