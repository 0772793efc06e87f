"""A record in Hann-weighted cells: an angle that stays bounded falls out of their mean.

The windows overlap by half, and their sum is flat with smooth ends.  The scatter of the cells about a slow
trend is their noise, and a cell far beyond that is a knock.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment.record import Levelled

CELLS = (96, 24, 6)
"""Candidate numbers of windows in a record; ablation: 48 alone makes 2.4 times the error."""
MIN_CELLS = 5
OVERLAP = 1.0 / 6.0
"""Correlation of white noise in neighbouring Hann cells: the mean of their product over that of a square."""
TREND_ORDER = 5
"""Coefficients of the polynomial trend that is removed before the scatter is computed; at most a quarter of
the cells."""
KNOCK = 10.0
"""Residual, in medians of the residuals, above which a cell is rejected: else a knock that leaves
0.005° makes sigma 5 times as large."""
MIN_VARIANCE = 1e-24
"""Lower bound of a variance, (rad/s)² or rad², for readings that do not change at all."""
CREEP_CELLS, CREEP_RATIO = 12, 8.0
"""Ratio of the variance of 12 cells of the vertical gyro to their white noise above which the unit is taken
to rotate slowly about the vertical (creep of a tripod head)."""


class Cells(NamedTuple):
    """A division of a record into J cells.

    `used` (J,) are those of valid rows without a knock, `rate` (J,) their level rates, rad/s, `variance` that
    of each part of a rate; `vertical` is the mean of the vertical gyro, and `white` the white noise of the
    quietest axis, (rad/s)²/Hz.
    """

    used: BoolArray
    rate: ColumnArray
    variance: float
    vertical: float
    vertical_variance: float
    white: float


def hann_means(rows: FloatArray, cells: int) -> FloatArray:
    """Return the means of rows, (n, k), under Hann windows that overlap by half, (cells, k).

    Window j is 0.5 + 0.5 cos(pi t/h - pi j) within a half length h of its middle; as the second cosine is
    (-1)^j cos(pi t/h), sums over pieces of the rows, and of the rows times that, make all windows.
    """
    n = len(rows)
    at = (np.arange(n) + 0.5) * ((cells + 1) / n)
    columns = np.column_stack([np.ones(n), rows])
    both = np.concatenate([columns, columns * np.cos(np.pi * at)[:, None]], axis=1)
    flat, wave = np.split(_sums(both, cells), 2, axis=1)
    sums = flat + np.where(np.arange(1, cells + 1) % 2, -1.0, 1.0)[:, None] * wave
    return np.asarray(sums[:, 1:] / sums[:, :1])


def _sums(rows: NDArray[np.floating], cells: int) -> FloatArray:
    """Return the sums of the rows in each window, (cells, ...)."""
    first = np.ceil(np.arange(cells + 2) * (len(rows) / (cells + 1)) - 0.5).astype(np.int64)
    pieces = np.add.reduceat(rows, first[:-1], axis=0)
    return np.asarray(pieces[:-1] + pieces[1:])


def trend(n: int, order: int) -> FloatArray:
    """Return the first Chebyshev polynomials over n points, (n, order)."""
    return np.asarray(np.polynomial.chebyshev.chebvander((np.arange(n) + 0.5) / n * 2.0 - 1.0, order - 1))


def scatter(values: FloatArray, used: BoolArray, order: int) -> tuple[float, BoolArray, float]:
    """Return the variance of cells, (cells, axes), about a trend, those used, and degrees of freedom."""
    order = max(1, min(order, len(values) // 4))
    basis, square = trend(len(values), order), np.zeros(len(values))
    for _ in range(3):
        left = values - basis @ np.linalg.lstsq(basis[used], values[used], rcond=None)[0]
        square = np.sum(left**2, axis=1)
        used = used & (square <= KNOCK**2 * np.median(square[used]) + MIN_VARIANCE)
    freedom = values.shape[1] * max(int(used.sum()) - order, 0.5)
    return max(float(square[used].sum()), MIN_VARIANCE) / max(freedom - 2.0, 1.0), used, freedom


def rotates_slowly(data: Levelled) -> bool:
    """Return whether the vertical gyro varies by more than its noise: a slow rotation about the vertical."""
    if len(data.valid) < 2 * (CREEP_CELLS + 1):
        return False
    used = _sums(1.0 - data.valid, CREEP_CELLS) == 0
    means = hann_means(data.vertical[:, None], CREEP_CELLS)[used, 0]
    return len(means) > MIN_CELLS and bool(np.var(means) > CREEP_RATIO * white_variance(data, CREEP_CELLS))


def white_variance(data: Levelled, cells: int) -> float:
    """Return the variance of a cell of the vertical gyro if it has only the white noise of the rows."""
    steps = np.diff(data.vertical[data.valid])
    # The sum of the squared weights of a Hann window of 2 n/(cells + 1) rows is 0.75 (cells + 1)/n.
    return 0.5 * float(np.mean(steps**2)) * 0.75 * (cells + 1) / len(data.vertical)


def divide(data: Levelled, rate: ColumnArray, creeps: bool) -> Cells | None:
    """Return the division into cells with the smallest variance of the mean; None if the record is too short.

    Longer cells suppress more sway but estimate the noise from fewer degrees of freedom, so they must be
    better by the standard deviation of that estimate.
    """
    best, limit, n = None, math.inf, len(rate)
    for cells in CELLS:
        used = _sums(1.0 - data.valid, cells) == 0 if n >= 2 * (cells + 1) else np.zeros(0, bool)
        if used.sum() < MIN_CELLS:
            continue
        means = hann_means(np.column_stack([rate.real, rate.imag, data.vertical]), cells)
        up_variance, up_used, _ = scatter(means[:, 2:], used, 1)
        variance, used, freedom = scatter(means[:, :2], used, TREND_ORDER)
        if not creeps:
            variance = max(variance, 0.5 * up_variance)
        of_mean = (1.0 + 2.0 * OVERLAP) / float(used.sum())
        if variance * of_mean * (1.0 + math.sqrt(2.0 / max(freedom, 1.0))) < limit:
            limit = variance * of_mean
            vertical = means[up_used, 2]
            best = Cells(
                used=used,
                rate=means[:, 0] + 1j * means[:, 1],
                variance=variance,
                vertical=float(vertical.mean()),
                # The scatter of a unit that creeps contains the rotation itself.
                vertical_variance=2.0 * float(vertical.var()) if creeps else up_variance * of_mean,
                white=min(variance, up_variance) * 4.0 / 3.0 * n * data.row_s / (cells + 1),
            )
    return best
