"""Narrow-band sway of a record: its strongest spectral line, fitted beside a slow trend."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray

LEAST_ROWS = 60
"""Rows of the record that a line needs."""
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
    """Return rates, rad/s, and α, rad, of horizontal axes, (n,) each, without their line, (2, n).

    The line is found in the rate, and fitted beside slow functions of time, (n, m).  The second result,
    (n, 4) or (n, 0), are its basis functions times its amplitude, rad/s: its uncertainty.
    """
    n, given = len(rate), np.column_stack([rate, alpha])
    slow = slow / np.sqrt(np.sum(slow**2, axis=0)) * valid[:, None]
    rate = rate * valid
    left = rate - slow @ _least_squares(slow, rate)
    omega = _strongest(left * np.hanning(n + 2)[1:-1]) if n >= LEAST_ROWS else None
    if omega is None:
        return given.T, np.zeros((n, 0))
    line = _line(n, omega)
    columns = np.column_stack([slow, line * valid[:, None]])
    amplitudes = _least_squares(columns, given * valid[:, None])
    remains = rate - columns @ amplitudes[:, 0]
    reduced = np.vdot(remains, remains).real < RESIDUAL_SHARE * np.vdot(left, left).real
    if omega * n < FEW_PERIODS * math.tau and not reduced:
        return given.T, np.zeros((n, 0))
    swing = line @ amplitudes[-4:]
    size = math.sqrt(2.0 * float(np.mean(np.abs(swing[:, 0]) ** 2)))
    return np.asarray((given - swing).T), line * size


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


def _least_squares(columns: FloatArray, data: ColumnArray) -> ColumnArray:
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.asarray(np.linalg.solve(normal, columns.T @ data))
