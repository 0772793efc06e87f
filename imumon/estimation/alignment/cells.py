"""A record in Hann-weighted cells: an angle that stays bounded falls out of their mean.

The windows overlap by half, and their sum is flat with smooth ends.  The scatter of the cells about a slow
trend is their noise; cells that knocks disturbed have less weight (Huber).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment.record import Levelled

CELLS = (96, 48, 24, 12, 6)
"""Candidate numbers of windows in a record."""
MIN_CELLS = 5
OVERLAP = 1.0 / 6.0
"""Correlation of white noise in neighbouring Hann cells: the mean of their product over that of a square."""
HUBER, OUTLIER = 2.0, 10.0
"""Residual, in standard deviations, above which the Huber weight of a cell falls (Huber 1981: 1.5 to 2), and
above which a cell is rejected."""
TREND_ORDER = 5
"""Coefficients of the polynomial trend that is removed before the scatter is computed; at most a quarter of
the cells."""
BETTER_BY = 2.0
"""Fewer, longer cells are selected only if they reduce the variance of the mean by this many standard
deviations of its estimate."""
MIN_VARIANCE = 1e-24
"""Lower bound of a variance, (rad/s)² or rad², for readings that do not change at all."""
CREEP_RATIO = 8.0
"""Ratio of the variance of 12 cells of the vertical gyro to their white noise above which the unit is taken
to rotate slowly about the vertical (creep of a tripod head)."""
CREEP_CELLS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A division of a record into J cells.

    Parameters
    ----------
    weight : array, (J,)
        Between 0 and 1; 0 where a row does not count or a knock disturbed the cell.
    rate : array of complex, (J,)
    variance : float
        Of a cell of full weight, of each part of the rate, (rad/s)².
    vertical, vertical_variance : float
        Mean of the vertical gyro, rad/s, and its variance.
    white : float
        White noise of the quietest axis, (rad/s)²/Hz.
    """

    weight: FloatArray
    rate: ColumnArray
    variance: float
    vertical: float
    vertical_variance: float
    white: float

    @property
    def used(self) -> BoolArray:
        """Cells that are not rejected, (J,)."""
        return self.weight > 0.0

    @property
    def variance_of_mean(self) -> float:
        """Variance of the weighted mean of all cells."""
        return self.variance * (1.0 + 2.0 * OVERLAP) / max(float(self.weight.sum()), 1e-9)


def hann_means(rows: FloatArray, cells: int) -> FloatArray:
    """Return the means of rows, (n, k), under Hann windows that overlap by half, (cells, k).

    Window j is 0.5 + 0.5 cos(pi t/h - pi j) within a half length h of its middle; as the second cosine is
    (-1)^j cos(pi t/h), sums over pieces of the rows, and of the rows times that, make all windows.
    """
    n = len(rows)
    at = (np.arange(n) + 0.5) * ((cells + 1) / n)
    first = np.ceil(np.arange(cells + 2) * (n / (cells + 1)) - 0.5).astype(np.int64)
    columns = np.column_stack([np.ones(n), rows])
    both = np.concatenate([columns, columns * np.cos(np.pi * at)[:, None]], axis=1)
    pieces = np.add.reduceat(both, first[:-1], axis=0)
    flat, wave = np.split(pieces[:-1] + pieces[1:], 2, axis=1)
    sign = np.where(np.arange(1, cells + 1) % 2, -1.0, 1.0)[:, None]
    sums = flat + sign * wave
    return np.asarray(sums[:, 1:] / sums[:, :1])


def all_valid(valid: BoolArray, cells: int) -> BoolArray:
    """Return which windows have only valid rows, (cells,)."""
    n = len(valid)
    first = np.ceil(np.arange(cells + 2) * (n / (cells + 1)) - 0.5).astype(np.int64)
    missing = np.add.reduceat((~valid).astype(np.int64), first[:-1])
    return np.asarray(missing[:-1] + missing[1:] == 0)


def trend(n: int, order: int) -> FloatArray:
    """Return the first Chebyshev polynomials over n points, (n, order)."""
    return np.asarray(np.polynomial.chebyshev.chebvander((np.arange(n) + 0.5) / n * 2.0 - 1.0, order - 1))


def fit(basis: FloatArray, data: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the coefficients of weighted least squares, (m, ...)."""
    weighted = basis.T * weight
    normal = weighted @ basis
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-10
    return np.asarray(np.linalg.solve(normal, weighted @ data))


def scatter(values: FloatArray, ok: BoolArray, order: int) -> tuple[float, FloatArray, float]:
    """Return variance of a cell about a trend, weights of the cells, and degrees of freedom.

    Parameters
    ----------
    values : array, (cells, axes)
        Of equal variance.
    ok : array of bool, (cells,)
    order : int
    """
    cells, axes = values.shape
    basis = trend(cells, max(1, min(order, cells // 4)))
    weight, variance, free = ok.astype(np.float64), MIN_VARIANCE, 0.5
    for k in range(8):  # until no weight changes by a thousandth
        left = values - basis @ fit(basis, values, weight)
        square = np.mean(left**2, axis=1)
        free = max(weight.sum() - basis.shape[1], 0.5)
        # The first round is by the median of squares, which is 0.7 of the mean of those of two axes.
        variance = float(weight @ square / free) if k else float(np.median(square[weight > 0.0])) / 0.7
        variance = max(variance, MIN_VARIANCE)
        before, weight = weight, ok / np.maximum(1.0, square / (HUBER**2 * variance))
        weight[square > OUTLIER**2 * variance] = 0.0
        if k and np.abs(weight - before).max() < 1e-3:
            break
    freedom = axes * free
    return variance * freedom / max(freedom - 2.0, 1.0), weight, freedom


def rotates_slowly(data: Levelled) -> bool:
    """Return whether the vertical gyro varies by more than its noise: a slow rotation about the vertical."""
    if len(data.valid) < 2 * (CREEP_CELLS + 1):
        return False
    ok = all_valid(data.valid, CREEP_CELLS)
    means = hann_means(data.vertical[:, None], CREEP_CELLS)[ok, 0]
    return bool(len(means) > MIN_CELLS and np.var(means) > CREEP_RATIO * white_variance(data, CREEP_CELLS))


def white_variance(data: Levelled, cells: int) -> float:
    """Return the variance of a cell of the vertical gyro if it has only the white noise of the rows."""
    steps = np.diff(data.vertical[data.valid])
    # The sum of the squared weights of a Hann window of 2 n/(cells + 1) rows is 0.75 (cells + 1)/n.
    return 0.5 * float(np.mean(steps**2)) * 0.75 * (cells + 1) / len(data.vertical)


def divide(data: Levelled, rate: ColumnArray, creeps: bool) -> Cells | None:
    """Return the division into cells with the smallest variance of the mean; None if the record is too short.

    Longer cells suppress more sway but estimate the noise from fewer degrees of freedom, so they must be
    better by more than the uncertainty of that estimate (BETTER_BY).
    """
    best, limit = None, np.inf
    n = len(rate)
    for cells in CELLS:
        if n < 2 * (cells + 1):
            continue
        ok = all_valid(data.valid, cells)
        if ok.sum() < MIN_CELLS:
            continue
        means = hann_means(np.column_stack([rate.real, rate.imag, data.vertical]), cells)
        variance, weight, freedom = scatter(means[:, :2], ok, TREND_ORDER)
        up_variance, up_weight, _ = scatter(means[:, 2:], ok, 1)
        if not creeps:
            variance = max(variance, 0.5 * up_variance)
        total = float(up_weight.sum())
        vertical_variance = up_variance * (1.0 + 2.0 * OVERLAP) / total
        if creeps and up_variance > CREEP_RATIO * white_variance(data, cells):
            vertical_variance = 2.0 * float(np.var(means[ok, 2]))  # it contains the rotation itself
        white = min(variance, up_variance) * 4.0 / 3.0 * n * data.row_s / (cells + 1)
        one = Cells(
            weight=weight,
            rate=means[:, 0] + 1j * means[:, 1],
            variance=variance,
            vertical=float(up_weight @ means[:, 2]) / total,
            vertical_variance=vertical_variance,
            white=white,
        )
        if one.variance_of_mean * (1.0 + BETTER_BY * np.sqrt(2.0 / max(freedom, 1.0))) < limit:
            best, limit = one, one.variance_of_mean
    return best
