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
LEAST_ROWS, MIN_PERIODS = 60, 1.5
"""Rows of the record, and periods in it, that a line needs; a slower sway is left to the trend and the
settling hypotheses."""
FEW_PERIODS, RESIDUAL_SHARE = 5.0, 0.3
"""A line with fewer periods than this must reduce the residual variance to this share: a knock has power at
all frequencies, too."""
LINE_RATIO = 40.0
"""Ratio of the power of a line to the median of the spectrum; white noise exceeds it with probability e^-40
a bin."""


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


def creeps(data: HorizontalRows) -> bool:
    """Return whether the unit turns slowly about the vertical, at a rate that changes."""
    n = len(data.valid)
    windows = hann_windows(n, CREEP_CELLS)
    means = (windows @ data.vertical)[windows @ ~data.valid == 0.0]
    if n < 2 * (CREEP_CELLS + 1) or len(means) < MIN_CELLS:
        return False
    yaw = np.cumsum(means - means.mean()) * data.row_s * n / (CREEP_CELLS + 1)
    steps = np.diff(data.vertical[data.valid])
    steps = steps[steps != 0.0]  # a sample may fill several rows
    noise = math.sqrt(0.5 * steps @ steps) * data.row_s * n / max(len(steps), 1)
    return float(np.ptp(yaw)) > max(CREEP_YAW, CREEP_NOISE * noise)


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


def without_sway(rate: ColumnArray, alpha: ColumnArray, valid: BoolArray, slow: FloatArray) -> ColumnArray:
    """Return rates, rad/s, and α, rad, of horizontal axes, (n,) each, without the strongest line, (2, n).

    The line is found in the rate, and fitted beside slow functions of time, (n, m).
    """
    n, given = len(rate), np.column_stack([rate, alpha])
    slow = slow / np.sqrt(np.sum(slow**2, axis=0))
    left = rate - slow @ _amplitudes(slow, rate, valid)
    omega = _strongest(left * valid * np.hanning(n + 2)[1:-1]) if n >= LEAST_ROWS else None
    if omega is None:
        return given.T
    line = _line(n, omega)
    swing = line @ _amplitudes(np.column_stack([slow, line]), given, valid)[-4:]
    remains = left - swing[:, 0]
    share = np.sum(np.abs(remains[valid]) ** 2) / np.sum(np.abs(left[valid]) ** 2)
    if omega * n < FEW_PERIODS * math.tau and share > RESIDUAL_SHARE:
        return given.T
    return np.asarray((given - swing).T)


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


def _amplitudes(columns: FloatArray, data: ColumnArray, valid: BoolArray) -> ColumnArray:
    """Return the least-squares solution over the valid rows."""
    columns = columns[valid]
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.asarray(np.linalg.solve(normal, columns.T @ data[valid]))
