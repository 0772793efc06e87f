"""Narrow lines of a spectrum, as a sway of one frequency: fitted as sines, and taken off."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import ColumnArray, FloatArray

LARGEST = 3
"""Lines that are taken off."""
LEAST_ROWS = 48
"""Twelve seconds: a line needs some periods."""
LOWEST_CYCLES = 5
"""A line of fewer periods in the record is no line, but one of the slow sways; and with so few less than two
rows to a period, sine and cosine are one."""
PADDED = 2
OUTSTANDING = 30.0
"""Power of a line over the median: exp(-30 ln 2 / 2) of four values per cell in 1024 cells is 0.1 %."""
NARROW, BESIDE = 0.1, 3 * PADDED
"""A line takes all but this share of the power beside it; a resonance shaken at random leaves more."""
ROUNDS = 4
"""Gauss-Newton steps to the frequency."""


def without_lines(values: ColumnArray, trend: FloatArray, quiet: FloatArray) -> ColumnArray:
    """Return a complex series, (n,), without its narrow lines, which are fitted beside a trend, (n, t).

    Each row counts by so much, (n,).  A line stands out of the median of the spectrum (Hann taper) by more
    than noise does once in a thousand records.  Its frequency is refined by Gauss and Newton: the derivative
    of a sine by its frequency is one that grows with time.
    """
    found: list[FloatArray] = []
    time = np.arange(float(len(values))) - 0.5 * (len(values) - 1)
    left = values - _fit(trend, values, quiet)
    power = _spectrum(quiet * left)
    while len(found) < LARGEST and len(values) >= LEAST_ROWS:
        k = int(np.argmax(power))
        if power[k] < OUTSTANDING * np.median(power):
            break
        line = _refined(left, quiet, time, math.pi * (k + 1) / (len(power) + 1))
        after = values - _fit(np.hstack([trend, *found, line]), values, quiet)
        reduced = _spectrum(quiet * after)
        around = slice(max(k - BESIDE, 0), k + BESIDE + 1)
        if reduced[around].sum() > NARROW * power[around].sum():
            break
        found.append(line)
        left, power = after, reduced
    if not found:
        return values
    columns = np.hstack([trend, *found])
    lines = _solved(columns, values, quiet)[trend.shape[1] :]
    return np.asarray(values - np.einsum("nk,k->n", columns[:, trend.shape[1] :], lines))


def _spectrum(values: ColumnArray) -> FloatArray:
    """Return the power at the positive frequencies, both axes together, where a line may be."""
    n = len(values)
    size = PADDED * n
    spectrum = np.abs(np.fft.fft(np.hanning(n) * values, size)) ** 2
    power = spectrum[1 : size // 2] + spectrum[: -(size // 2) : -1]
    power[: LOWEST_CYCLES * PADDED - 1] = 0.0
    power[len(power) - LOWEST_CYCLES * PADDED :] = 0.0
    return np.asarray(power)


def _refined(values: ColumnArray, quiet: FloatArray, time: FloatArray, frequency: float) -> FloatArray:
    """Return the columns of a line, (n, 4): its sines, and those growing with time, as sway may swell."""
    columns = _line(time, frequency)
    grown = 1.0 / time[-1]
    for _ in range(ROUNDS):
        a, b, by_a, by_b = _solved(columns, values, quiet).tolist()
        shift = (by_a * b.conjugate() - by_b * a.conjugate()).real / (abs(a) ** 2 + abs(b) ** 2) * grown
        frequency += min(max(shift, -grown), grown)
        columns = _line(time, frequency)
        if abs(shift) < 1e-4 * grown:
            break
    return columns


def _line(time: FloatArray, frequency: float) -> FloatArray:
    phase = frequency * time
    grow = time / time[-1]
    cos, sin = np.cos(phase), np.sin(phase)
    return np.column_stack([cos, sin, grow * cos, grow * sin])


def _solved(columns: FloatArray, values: ColumnArray, quiet: FloatArray) -> ColumnArray:
    """Return the coefficients of columns, (k,), by least squares; einsum wakes no threads, as BLAS does."""
    weighted = columns * quiet[:, None]
    right = np.einsum("nk,n->k", weighted, values)
    return np.asarray(np.linalg.solve(np.einsum("nk,nj->kj", weighted, columns), right))


def _fit(columns: FloatArray, values: ColumnArray, quiet: FloatArray) -> ColumnArray:
    return np.asarray(np.einsum("nk,k->n", columns, _solved(columns, values, quiet)))
