"""A record without its sway, in Hann-weighted cells: an angle that stays bounded falls out of their mean.

The strongest spectral line of the sway is fitted beside a slow trend.  The windows overlap by half, and their
sum is flat with smooth ends.  The scatter of the cells about a slow trend is their noise, and a cell far
beyond that is a knock.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment.record import HorizontalRows

CELLS = (96, 24, 6)
"""Candidate numbers of windows in a record; ablation: 48 alone makes 2.6 times the error."""
MIN_CELLS = 5
"""Fewer used cells give no scatter about a trend."""
OVERLAP = 1.0 / 6.0
"""Correlation of white noise in neighbouring Hann cells: the mean of their product over that of a square."""
TREND_ORDER = 5
"""Coefficients of the polynomial trend that is removed before the scatter is computed; at most a quarter of
the cells."""
KNOCK = 10.0
"""Residual, in medians of the residuals, above which a cell is rejected.  Ablation: without it, a knock that
tilts the unit by 0.005° leaves a heading error of 1.1° after 2 minutes, not 0.01°."""
MIN_VARIANCE = 1e-24
"""Lower bound of a variance, (rad/s)² or rad², for readings that do not change at all."""
CREEP_CELLS, CREEP_YAW, CREEP_NOISE = 12, 3e-4, 4.0
"""A unit creeps about the vertical whose angle by means of 12 cells of the vertical gyro, less their mean,
varies by more than 0.3 mrad and more than 4 times what the white noise turns in this time."""


class Cells(NamedTuple):
    """A division of a record of n rows into J cells.

    `windows` (J, n) are the weights of the rows, `used` (J,) the cells of valid rows without a knock, and
    `rate` (J,) their horizontal rates, rad/s, with the variance of each part; `vertical` is the mean of the
    vertical gyro, and `white` the white noise of the quietest axis, (rad/s)²/Hz.
    """

    windows: FloatArray
    used: BoolArray
    rate: ColumnArray
    variance: float
    vertical: float
    vertical_variance: float
    white: float

    @property
    def mean_rate(self) -> complex:
        """Mean of the used cells, rad/s."""
        return complex(self.rate[self.used].mean())


def correlation(used: BoolArray) -> FloatArray:
    """Return the correlation of white noise in those of the cells that are used, (m, m)."""
    apart = np.abs(np.subtract.outer(np.flatnonzero(used), np.flatnonzero(used)))
    return np.asarray((apart == 0) + OVERLAP * (apart == 1))


def hann_windows(n: int, cells: int) -> FloatArray:
    """Return the weights of n rows in Hann windows that overlap by half, (cells, n); each sums to one."""
    row = (np.arange(n) + 0.5) * ((cells + 1) / n)
    from_middle = np.minimum(np.abs(row - np.arange(1, cells + 1)[:, None]), 1.0)
    windows = 1.0 + np.cos(np.pi * from_middle)
    return np.asarray(windows / windows.sum(axis=1, keepdims=True))


def trend(n: int, order: int) -> FloatArray:
    """Return the first Chebyshev polynomials over n points, (n, order)."""
    return np.asarray(np.polynomial.chebyshev.chebvander((np.arange(n) + 0.5) / n * 2.0 - 1.0, order - 1))


def scatter(values: ColumnArray, used: BoolArray, order: int) -> tuple[float, BoolArray, float]:
    """Return the variance of cells about a trend, those used without knocks, and the degrees of freedom.

    `values` (cells,) are real, or complex with the same variance in both parts.
    """
    order = max(1, min(order, len(values) // 4))
    basis, square = trend(len(values), order), np.zeros(len(values))
    for _ in range(3):  # a knock hides smaller ones
        square = np.abs(values - basis @ np.linalg.lstsq(basis[used], values[used], rcond=None)[0]) ** 2
        used = used & (square <= KNOCK**2 * np.median(square[used]) + MIN_VARIANCE)
    freedom = (2 if np.iscomplexobj(values) else 1) * max(int(used.sum()) - order, 0.5)
    return max(float(square[used].sum()), MIN_VARIANCE) / max(freedom - 2.0, 1.0), used, freedom


def steady_from(data: HorizontalRows) -> int | None:
    """Return the row from which on the unit does not creep about the vertical; None if it does to the end."""
    n = len(data.valid)
    for start in (0, n // 4, n // 2, 3 * n // 4):
        vertical, valid = data.vertical[start:], data.valid[start:]
        if len(valid) < 2 * (CREEP_CELLS + 1):
            return None if start else 0
        windows = hann_windows(len(valid), CREEP_CELLS)
        means = (windows @ vertical)[windows @ ~valid == 0.0]
        if len(means) < MIN_CELLS:
            continue
        yaw = np.cumsum(means - means.mean()) * data.row_s * len(valid) / (CREEP_CELLS + 1)
        noise = math.sqrt(0.5 * np.mean(np.diff(vertical[valid]) ** 2) * len(valid)) * data.row_s
        if np.ptp(yaw) < max(CREEP_YAW, CREEP_NOISE * noise):
            return start
    return None


def divide(data: HorizontalRows, rate: ColumnArray) -> Cells | None:
    """Return the division into cells with the smallest variance of the mean; None if the record is too short.

    Longer cells suppress more sway, but estimate the noise from fewer degrees of freedom: they must be better
    by the standard deviation of that estimate.
    """
    best, smallest, n = None, math.inf, len(rate)
    for count in CELLS:
        if n < 2 * (count + 1):
            continue
        windows = hann_windows(n, count)
        used = windows @ ~data.valid == 0.0
        if used.sum() < MIN_CELLS:
            continue
        cells, vertical = windows @ rate, windows @ data.vertical
        up_variance, up_used, _ = scatter(vertical, used, 1)
        variance, used, freedom = scatter(cells, used, TREND_ORDER)
        of_mean = (1.0 + 2.0 * OVERLAP) / float(used.sum())
        if variance * of_mean * (1.0 + math.sqrt(2.0 / max(freedom, 1.0))) < smallest:
            smallest = variance * of_mean
            best = Cells(
                windows=windows,
                used=used,
                rate=cells,
                variance=variance,
                vertical=float(vertical[up_used].mean()),
                vertical_variance=up_variance * of_mean,
                white=min(variance, up_variance) * data.row_s / float(np.sum(windows[0] ** 2)),
            )
    return best


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
