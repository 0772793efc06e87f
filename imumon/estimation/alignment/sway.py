"""Narrow-band sways of a record: spectral lines that are fitted beside a slow trend, strongest first."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray

MAX_LINES, ROWS_PER_LINE = 3, 60
"""Largest number of lines, and rows of the record needed for each."""
LINE_RATIO = 40.0
"""Ratio of the power of a line to the median of the spectrum; white noise exceeds it with probability e^-40
a bin."""
MIN_PERIODS = 1.5
"""A line with fewer periods in the record is left to the trend and the settling hypotheses."""
FEW_PERIODS, RESIDUAL_SHARE = 5.0, 0.3
"""A line with fewer periods than this must reduce the residual variance to this share: a knock has power at
all frequencies, too."""


def without_sway(
    rate: ColumnArray, alpha: ColumnArray, valid: BoolArray, slow: FloatArray
) -> tuple[ColumnArray, FloatArray]:
    """Return rates, rad/s, and α, rad, of horizontal axes, (n,) each, without their lines, (2, n).

    Lines are found in the rate; they are fitted beside slow functions of time, (n, m).  The second result,
    (n, 4 l), are the basis functions of each line times its amplitude, rad/s: its uncertainty.
    """
    n = len(rate)
    slow = slow / np.sqrt(np.sum(slow**2, axis=0)) * valid[:, None]
    inverse = np.linalg.inv(slow.T @ slow + 1e-9 * np.eye(slow.shape[1]))

    def beside(values: ColumnArray) -> ColumnArray:
        """Return valid values, (n, ...), less the slow functions fitted to them."""
        values = values * valid[:, None]
        return np.asarray(values - slow @ (inverse @ (slow.T @ values)))

    given = np.column_stack([rate, alpha])
    data, taper = beside(given), np.hanning(n + 2)[1:-1]
    columns, left, found, size = np.zeros((n, 0)), data[:, 0], given, np.zeros(0)
    for _ in range(min(MAX_LINES, n // ROWS_PER_LINE)):
        start = _strongest(left * taper)
        if start is None:
            break
        omega = _refined(start, left, beside)
        basis = np.column_stack([columns, _line(n, omega)])
        fitted = beside(basis)
        amplitudes = _least_squares(fitted, data)
        remains = data[:, 0] - fitted @ amplitudes[:, 0]
        reduced = np.vdot(remains, remains).real < RESIDUAL_SHARE * np.vdot(left, left).real
        if (omega * n < FEW_PERIODS * math.tau and not reduced) or abs(omega - start) * n > math.tau:
            break
        columns, left, found = basis, remains, given - basis @ amplitudes
        swing = columns[:, -4:] @ amplitudes[-4:, 0]
        size = np.r_[size, np.full(4, math.sqrt(2.0 * float(np.mean(np.abs(swing) ** 2))))]
    return np.asarray(found.T), columns * size


def _line(n: int, omega: float) -> FloatArray:
    """Return the basis functions of a line, (n, 4); omega in rad a row.

    They are cosine and sine, and both times the time from -1 to 1: so the amplitude may change along the
    record, and the frequency by a fraction of a period in the record.
    """
    row = np.arange(n) - 0.5 * (n - 1)
    wave = np.column_stack([np.cos(omega * row), np.sin(omega * row)])
    return np.column_stack([wave, wave * (row / (0.5 * n))[:, None]])


def _strongest(left: ColumnArray) -> float | None:
    """Return the frequency of the strongest line, rad a row, or None when there is none."""
    n = len(left)
    bins = 1 << (8 * n - 1).bit_length()  # at least eight to a period in the record
    least = math.ceil(MIN_PERIODS * bins / n)
    axes = np.column_stack([left.real, left.imag])
    power = np.sum(np.abs(np.fft.rfft(axes, bins, axis=0)) ** 2, axis=1)[least : bins // 2]
    peak = int(np.argmax(power))
    return math.tau * (least + peak) / bins if power[peak] > LINE_RATIO * np.median(power) else None


def _refined(omega: float, left: ColumnArray, beside: Callable[[ColumnArray], ColumnArray]) -> float:
    """Return the frequency of a line after four Gauss-Newton steps, of 0.3 periods in the record at most.

    A frequency that is off turns cosine into sine in proportion to the time.
    """
    n = len(left)
    for _ in range(4):
        a, b, a_slope, b_slope = _least_squares(beside(_line(n, omega)), left)
        across = (np.conj(a_slope) * b - np.conj(b_slope) * a).real
        step = float(across / (abs(a) ** 2 + abs(b) ** 2)) / (0.5 * n)
        omega += min(max(step, -0.3 * math.tau / n), 0.3 * math.tau / n)
    return omega


def _least_squares(columns: ColumnArray, data: ColumnArray) -> ColumnArray:
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.asarray(np.linalg.solve(normal, columns.T @ data))
