"""Narrow lines of a spectrum, as a sway of one frequency: fitted as sines, and taken off."""

from __future__ import annotations

import numpy as np

from imumon.blocks import ColumnArray, FloatArray

LARGEST = 3
"""Lines that are taken off."""
LEAST_ROWS = 48
"""Twelve seconds: a line needs some periods."""
LOWEST_CYCLES = 2
"""A line of fewer periods in the record is no line, but a drift; and with so few less than two rows to a
period, sine and cosine are the same."""
PADDED = 2
OUTSTANDING = 30.0
"""Power of a line over the median: exp(-30 ln 2 / 2) of four values per cell in 1024 cells is 0.1 %."""
ROUNDS = 4
"""Gauss-Newton steps to the frequency."""


def without_lines(values: ColumnArray, trend: FloatArray) -> ColumnArray:
    """Return a complex series, (n,), without its narrow lines, which are fitted beside a trend, (n, t).

    A line stands out of the median of the spectrum (Hann taper) by more than noise does once in a thousand
    records.  Its frequency is refined by Gauss and Newton: the derivative of a sine by its frequency is one
    that grows with time.
    """
    n = len(values)
    taper, time = np.hanning(n), np.arange(float(n)) - 0.5 * (n - 1)
    size = PADDED * n
    found: list[FloatArray] = []
    left = values - _fit(trend, values)
    for _ in range(LARGEST if n >= LEAST_ROWS else 0):
        spectrum = np.abs(np.fft.fft(taper * left, size)) ** 2
        power = spectrum[1 : size // 2] + spectrum[: -(size // 2) : -1]
        power[: LOWEST_CYCLES * PADDED - 1] = 0.0
        k = int(np.argmax(power))
        if k > len(power) - LOWEST_CYCLES * PADDED or power[k] < OUTSTANDING * np.median(power):
            break
        found.append(_refined(left, time, 2.0 * np.pi * (k + 1) / size))
        columns = np.hstack([trend, *found])
        left = values - _fit(columns, values)
    if not found:
        return values
    columns = np.hstack([trend, *found])
    solved = _solved(columns, values)
    return np.asarray(values - columns[:, trend.shape[1] :] @ solved[trend.shape[1] :])


def _refined(values: ColumnArray, time: FloatArray, frequency: float) -> FloatArray:
    """Return the columns of a line, (n, 4): its sines, and those growing with time, as sway may swell."""
    columns = _line(time, frequency)
    grown = 1.0 / time[-1]
    for _ in range(ROUNDS):
        a, b, by_a, by_b = _solved(columns, values).tolist()
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


def _solved(columns: FloatArray, values: ColumnArray) -> ColumnArray:
    """Return the coefficients of columns by least squares, (k,)."""
    return np.asarray(np.linalg.solve(columns.T @ columns, columns.T @ values))


def _fit(columns: FloatArray, values: ColumnArray) -> ColumnArray:
    return np.asarray(columns @ _solved(columns, values))
