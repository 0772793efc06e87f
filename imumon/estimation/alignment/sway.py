"""Narrow sways of a record: sines that are fitted to the gyros beside a slow course, strongest first.

Each has an amplitude and a frequency that may change along the record, as a sway that swells or wanders.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray

MAX_LINES, ROWS_PER_LINE = 3, 60
"""Largest number of lines, and rows of the record needed for each."""
LINE_RATIO = 40.0
"""Ratio of the power of a line to the median of the spectrum; white noise exceeds it with probability e^-40
a bin."""
MIN_PERIODS = 1.5
"""A line with fewer periods in the record is left to the trend and the settling hypotheses."""


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """Fitted lines of a record.

    `columns` (n, 4 l) are cosine and sine of each line, and both times the time from -1 to 1, of its
    amplitude, rad/s; `rate` and `level` (n,) the sway of gyros and accelerometers, rad/s and rad.
    """

    columns: FloatArray
    rate: ColumnArray
    level: ColumnArray


def find_sway(rate: ColumnArray, level: ColumnArray, valid: BoolArray, slow: FloatArray) -> Sway:
    """Return the sway of level rates and level, (n,), beside slow courses, (n, m)."""
    n = len(rate)
    slow = slow / np.sqrt(np.sum(slow**2, axis=0)) * valid[:, None]
    inverse = np.linalg.inv(slow.T @ slow + 1e-9 * np.eye(slow.shape[1]))

    def beside(values: FloatArray) -> FloatArray:
        values = values * valid[:, None]
        return np.asarray(values - slow @ (inverse @ (slow.T @ values)))

    data = beside(np.column_stack([rate.real, rate.imag, level.real, level.imag]))
    left, taper = data[:, :2], (np.hanning(n + 2)[1:-1] * valid)[:, None]
    columns, fitted, size = np.zeros((n, 0)), np.zeros((0, 4)), np.zeros(0)
    for _ in range(min(MAX_LINES, n // ROWS_PER_LINE)):
        start = _strongest(left * taper)
        if start is None:
            break
        omega = _refined(start, left, beside)
        periods = omega * n / math.tau
        line = np.column_stack([columns, _line(n, omega)])
        clean = beside(line)
        coefficients = _least_squares(clean, data)
        remains = data[:, :2] - clean @ coefficients[:, :2]
        if periods < MIN_PERIODS or abs(omega - start) * n > math.tau:
            break
        columns, fitted, left = line, coefficients, remains
        swing = _line(n, omega) @ coefficients[-4:, :2]
        size = np.r_[size, np.full(4, math.sqrt(2.0 * float(np.mean(swing**2))))]
    sways = columns @ fitted
    return Sway(columns * size, sways[:, 0] + 1j * sways[:, 1], sways[:, 2] + 1j * sways[:, 3])


def _line(n: int, omega: float) -> FloatArray:
    """Return cosine, sine, and both times the time, (n, 4); omega in rad a row."""
    row = np.arange(n) - 0.5 * (n - 1)
    wave = np.column_stack([np.cos(omega * row), np.sin(omega * row)])
    return np.column_stack([wave, wave * (row / (0.5 * n))[:, None]])


def _least_squares(columns: FloatArray, data: FloatArray) -> FloatArray:
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.asarray(np.linalg.solve(normal, columns.T @ data))


def _strongest(left: FloatArray) -> float | None:
    """Return the frequency of the strongest line, rad a row, or None when there is none."""
    n = len(left)
    bins = 1 << (4 * n - 1).bit_length()  # at least four to a period in the record
    least = math.ceil(MIN_PERIODS * bins / n)
    power = np.sum(np.abs(np.fft.rfft(left, bins, axis=0)) ** 2, axis=1)[: bins // 2]
    power[:least] = 0.0
    peak = int(np.argmax(power))
    return 2.0 * math.pi * peak / bins if power[peak] > LINE_RATIO * np.median(power[least:]) else None


def _refined(omega: float, left: FloatArray, beside: Callable[[FloatArray], FloatArray]) -> float:
    """Return the frequency of a line after four Gauss-Newton steps, of 0.3 periods in the record at most."""
    n = len(left)
    for _ in range(4):
        a, b, by_a, by_b = _least_squares(beside(_line(n, omega)), left)
        step = float(np.sum(by_a * b - by_b * a) / np.sum(a * a + b * b)) / (0.5 * n)
        omega += min(max(step, -0.3 * math.tau / n), 0.3 * math.tau / n)
    return omega
