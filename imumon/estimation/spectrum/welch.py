"""Welch's estimate of a power spectral density, and the lines that stand out of it.

Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
Electroacoust. 15 (1967): eq 1-4 with half-overlapping Hann windows.  NumPy alone: scipy.signal takes 0.7 s to
import, in the middle of a measurement.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray

MOST_PEAKS = 3
FALSE_ALARM = 0.01
"""Chance that white noise shows a peak anywhere in a spectrum."""
FLOOR_BINS = 15
"""The floor under a line is the median over so many bins beside it: a line of a Hann window covers four."""
HALF_LINE = 2
"""A line of a Hann window has its power in so many bins on either side."""
OVERLAP_COST = 19.0 / 18.0
"""Variance of half-overlapping Hann segments over that of as many independent ones, for many: Welch, section
on overlapped segments, 1 + 2 ρ² with ρ² = (1/6)²."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A one-sided power spectral density."""

    frequency_hz: FloatArray
    """From 0 to half the rate, (n,)."""
    density: FloatArray
    """Unit² per Hz, (n,)."""
    segments: int
    """Segments that were averaged."""


@dataclass(frozen=True, slots=True)
class Peak:
    """A line: where it is, and the rms of what oscillates there."""

    frequency_hz: float
    rms: float


def fast_length(most: int) -> int:
    """Return the greatest number up to `most` without other factors than 2, 3 and 5.

    A transform of 8570 = 2 x 5 x 857 takes eight times as long as one of 8640.
    """
    for length in range(most, 0, -1):
        rest = length
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return length
    return 1


def welch(values: FloatArray, interval_s: float, length: int) -> Spectrum:
    """Return the spectrum of evenly spaced values, (n,), in half-overlapping segments of `length`."""
    step = length // 2
    window = np.hanning(length + 1)[:-1]
    parts = np.lib.stride_tricks.sliding_window_view(values, length)[::step]
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power = np.abs(np.fft.rfft(parts, axis=1)) ** 2
    density = 2.0 * interval_s * power.mean(axis=0) / float(window @ window)
    density[0] /= 2.0
    if length % 2 == 0:
        density[-1] /= 2.0
    frequency = np.arange(len(density)) / (length * interval_s)
    return Spectrum(frequency, np.asarray(density), len(parts))


def peaks(spectrum: Spectrum) -> list[Peak]:
    """Return the strongest lines that noise of this floor does not make, the strongest first."""
    density, frequency = spectrum.density, spectrum.frequency_hz
    if len(density) < 2 * FLOOR_BINS:
        return []
    from scipy.special import gammaincinv  # 0.13 s, which no command spends before the first spectrum

    shape = spectrum.segments / OVERLAP_COST
    floor = _floor(density) * shape / float(gammaincinv(shape, 0.5))
    limit = float(gammaincinv(shape, 1.0 - FALSE_ALARM / len(density))) / shape
    ratio = density / np.maximum(floor, np.finfo(float).tiny)
    # The mean is taken out of each segment: its window leaks into the first bins.
    inner = np.arange(HALF_LINE + 1, len(density) - 1)
    top = (density[inner] >= density[inner - 1]) & (density[inner] > density[inner + 1])
    found = []
    for at in inner[top & (ratio[inner] > limit)].tolist():
        line = slice(max(at - HALF_LINE, 0), at + HALF_LINE + 1)
        power = np.maximum(density[line] - floor[line], 0.0)
        if power.sum() > 0:
            middle = float(power @ frequency[line] / power.sum())
            found.append(Peak(middle, float(np.sqrt(power.sum() * frequency[1]))))
    return sorted(found, key=lambda peak: -peak.rms)[:MOST_PEAKS]


def _floor(density: FloatArray) -> FloatArray:
    """Return the higher of the medians below and above each bin: on a slope that is the one to beat."""
    padded = np.pad(density, FLOOR_BINS, constant_values=np.nan)
    padded[: FLOOR_BINS + 1] = np.nan  # the mean is taken out of bin 0
    windows = np.lib.stride_tricks.sliding_window_view(padded, FLOOR_BINS)
    whole = slice(FLOOR_BINS + 1, len(density) + 1)
    medians = np.empty(len(windows))
    medians[whole] = np.median(windows[whole], axis=1)  # a tenth of the time of the other
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing is below the first bin
        for part in (slice(whole.start), slice(whole.stop, None)):
            medians[part] = np.nanmedian(windows[part], axis=1)
    sides = np.fmax(medians[: len(density)], medians[FLOOR_BINS + 1 :])
    return np.nan_to_num(sides, nan=np.inf)
