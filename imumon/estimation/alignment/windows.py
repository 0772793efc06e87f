"""Means of a record under windows with smooth edges, of which the sharpest that the noise allows are taken.

The angle of a swaying unit is bounded.  Its rate therefore falls out of a mean whose weights begin and end
gradually, and it stays in one whose weights jump.  White noise is weighed best by weights that jump.  So the
record is cut into some dozens of overlapping Hann windows, which add up to weights that are flat but for
their ends, of several lengths; how the means of the windows scatter tells how good each length is, whatever
it is that sways.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imumon.blocks import FloatArray

CELLS, STEP = 160, 4
"""A record is first reduced to so many cells at most, and to a multiple of the step."""
ROWS = 40
"""Windows in a set at the most; more neighbours are added up.  Products of such matrices are small enough for
BLAS not to wake other threads, which would cost more than the product."""
LEAST_ROWS = 4
"""The scatter of fewer means tells nothing."""
TREND = (2.0, 8.0, 32.0, 128.0)
"""Time constants in a record of the exponentials that are no scatter: as a tripod settles."""
CYCLES = 4
"""Periods in a record of the fastest of the slow sways, which are fitted, and are no scatter either."""
BLUE = 4.0 ** np.arange(6.0)
"""Noise of angles that jitter, as in gusts, over that of gyros, where both are seen through windows: the
slowest that 40 windows show has a four-hundredth of the power of the fastest."""
SURE = 4.0
"""By this log likelihood ratio it must be likelier than none: by luck it is once in 200 records."""
NOTHING = 1e-2
"""A window that weighs less than this share of another tells nothing."""
FLOOR = 1e-30
DEPENDENT = 1e-10
"""Windows that see the same cells differ by rounding: least over largest eigenvalue of their covariance."""


@dataclass(frozen=True, slots=True)
class Whitened:
    """What makes sums white and takes a trend off, (f, k), and the log determinant of that trend and them."""

    rows: FloatArray
    log_determinant: float


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows over n cells.

    Parameters
    ----------
    weights : array, (k, n)
        A window that looks at loud cells weighs less than the others.
    covariance : array, (k, k)
        Of the sums, over the variance of a cell that is not loud, when the noise of rows is white.
    slow : array, (k, t)
        Orthonormal: what a trend is in the sums; the first is the constant.
    variance : float
        Of the mean of all cells under these windows, over that of a cell.
    count : float
        How many windows of full weight they are worth.
    whitened : (Whitened, Whitened)
        Without the constant; without a trend.
    bluer : tuple of Windows
        The same, when angles that jitter add ever more noise.
    """

    weights: FloatArray
    covariance: FloatArray
    slow: FloatArray
    variance: float
    count: float
    whitened: tuple[Whitened, Whitened]
    bluer: tuple[Windows, ...] = ()

    def likelihood(self, data: FloatArray, trends: bool = True) -> float:
        """Return the logarithm of that of the sums of data, (n, a), whatever variance and trend (REML)."""
        whitened = self.whitened[trends]
        left = whitened.rows @ (self.weights @ data)
        variance = float(np.vdot(left, left)) / left.size + FLOOR
        return -0.5 * (left.size * math.log(variance) + int(data.shape[1]) * whitened.log_determinant)

    def coloured(self, data: FloatArray, trends: bool = True) -> Windows:
        """Return these windows with the colour of noise that data, (n, a), show for sure; else white."""
        best, most = self, self.likelihood(data, trends) + SURE
        for windows in self.bluer:
            found = windows.likelihood(data, trends)
            if found > most:
                best, most = windows, found
        return best

    def scatter(self, data: FloatArray, trends: bool = True) -> tuple[float, float]:
        """Return the variance of a cell by the scatter of the sums of data, (n, a), and its uncertainty.

        Trends are no scatter, or they are.  The uncertainty is the relative standard deviation.  With few
        degrees of freedom a mean's distribution is that of Student, which is wider.
        """
        slow = self.slow if trends else self.slow[:, :1]
        sums = self.weights @ data
        left = sums - slow @ (slow.T @ sums)
        axes = int(data.shape[1])
        expected = axes * float(np.trace(self.covariance) - np.vdot(slow, self.covariance @ slow))
        free = axes * (self.count - int(slow.shape[1]))
        wider = free / max(free - 2.0, 1.0)
        return wider * float(np.vdot(left, left)) / expected + FLOOR, math.sqrt(2.0 / free)

    def products(self, columns: FloatArray) -> FloatArray:
        """Return the products of columns, (n, c), seen through windows and weighed by the covariance."""
        means = self.weights @ columns
        return np.asarray(means.T @ np.linalg.solve(self.covariance, means))


def layout(rows: int) -> tuple[int, FloatArray]:
    """Return how many cells a record has, and the weights of the rows in a cell, (2 hop,), whose sum is one.

    A cell overlaps its neighbours as a triangle: what has about a period in a hop would else turn up as slow.
    """
    hop = -(-rows // CELLS)
    if hop == 1:
        return (rows - rows % STEP if rows > CELLS // 2 else rows), np.ones(1)
    rise = (np.arange(hop) + 0.5) / hop**2
    cells = rows // hop - 1
    return cells - cells % STEP, np.r_[rise, rise[::-1]]


def in_cells(columns: FloatArray, cells: int, weights: FloatArray) -> FloatArray:
    """Return the means of the cells of columns, (cells, c), from (rows, c)."""
    hop = len(weights) // 2
    if not hop:
        return columns[:cells]
    blocks = columns[: (cells + 1) * hop].reshape(cells + 1, hop, -1)
    rising = np.einsum("h,bhc->bc", weights[:hop], blocks[:-1])
    return np.asarray(rising + np.einsum("h,bhc->bc", weights[hop:], blocks[1:]))


def trend(rows: int) -> FloatArray:
    """Return a constant and the exponentials of a trend over so many rows, (rows, 5)."""
    at = (np.arange(rows) + 0.5) / rows
    return np.stack([np.ones(rows), *(np.exp(-rate * at) for rate in TREND)], 1)


def slowly(rows: int) -> FloatArray:
    """Return a trend and slow waves, which are no scatter either, (rows, 13)."""
    at = (np.arange(rows) + 0.5) / rows
    return np.concatenate([trend(rows), np.cos(math.pi * np.outer(at, np.arange(1, 2 * CYCLES + 1)))], 1)


@lru_cache(maxsize=64)
def bank(cells: int, hop: int) -> tuple[Windows, ...]:
    """Return sets of windows over cells, `hop` rows from one to the next, with ever wider edges."""
    return weighted_bank(np.ones(cells), hop)


def weighted_bank(quiet: FloatArray, hop: int) -> tuple[Windows, ...]:
    """Return such sets over cells of which each counts by so much, (n,); none when that is too little."""
    cells, beside = len(quiet), 0.0
    if hop > 1:
        _, taps = layout(hop * CELLS)
        beside = float(taps[:hop] @ taps[hop:] / (taps @ taps))
    narrow = _made(np.eye(cells), quiet, beside)
    if narrow is None:
        return ()
    found, wide = [narrow], 2
    while cells // wide - 1 >= LEAST_ROWS:
        middle = np.arange(wide - 1, cells - wide + 1, wide)[:, None]
        apart = np.abs(np.arange(cells) - middle) / wide
        made = _made(np.where(apart < 1.0, 0.5 + 0.5 * np.cos(math.pi * apart), 0.0), quiet, beside)
        if made is None:
            break
        found.append(made)
        wide *= 2
    return tuple(found)


def slow_columns(basis: FloatArray, count: float) -> FloatArray:
    """Return as many columns of `slowly` as so many values can bear beside their scatter."""
    pairs = max(int(count - LEAST_ROWS) // LEAST_ROWS, 0)
    return basis[:, : 1 + min(2 * pairs, basis.shape[1] - 1)]


def _made(weights: FloatArray, quiet: FloatArray, beside: float) -> Windows | None:
    """Return windows of these weights, (k, n), over cells that correlate so much with their neighbours.

    None when they are worth too few, as where hardly any cell counts: nothing is left to scatter.
    """
    together = -(-len(weights) // ROWS)
    weights = np.add.reduceat(weights, np.arange(0, len(weights), together), axis=0)
    weights = weights / weights.sum(1, keepdims=True) * quiet
    mass = weights.sum(1)
    weights = weights[mass > NOTHING * mass.max()]
    noise = weights / np.sqrt(np.maximum(quiet, FLOOR))
    covariance = _noisy(noise, beside) @ noise.T
    own = np.diagonal(covariance)
    count = float(own.sum() ** 2 / (own @ own))
    if count < LEAST_ROWS:
        return None
    eigenvalues = np.linalg.eigvalsh(covariance)
    if eigenvalues[0] < DEPENDENT * eigenvalues[-1]:
        return None
    slow = np.linalg.qr(weights @ slow_columns(slowly(weights.shape[1]), count))[0]
    jitter = np.diff(weights, axis=1, prepend=0.0, append=0.0)
    angles = jitter @ jitter.T
    angles *= own.sum() / np.trace(angles)
    shapes = (covariance, *(covariance + blue * angles for blue in BLUE))
    found = [_coloured(weights, shape, slow, count) for shape in shapes]
    return replace(found[0], bluer=tuple(found[1:]))


def _coloured(weights: FloatArray, covariance: FloatArray, slow: FloatArray, count: float) -> Windows:
    """Return windows whose sums have this covariance."""
    lower = np.linalg.cholesky(covariance)
    white = np.linalg.solve(lower, np.column_stack([slow, weights.sum(1), np.eye(len(weights))]))
    total, inverse = white[:, slow.shape[1]], white[:, slow.shape[1] + 1 :]
    whitened = []
    for columns in (1, slow.shape[1]):
        basis, triangle = np.linalg.qr(white[:, :columns], mode="complete")
        own = np.log(np.diagonal(lower)).sum() + np.log(np.abs(np.diagonal(triangle))).sum()
        whitened.append(Whitened(basis[:, columns:].T @ inverse, 2.0 * float(own)))
    variance = 1.0 / float(total @ total)
    return Windows(weights, covariance, slow, variance, count, (whitened[0], whitened[1]))


def _noisy(weights: FloatArray, beside: float) -> FloatArray:
    """Return weights times the covariance of cells."""
    found = weights.copy()
    found[..., 1:] += beside * weights[..., :-1]
    found[..., :-1] += beside * weights[..., 1:]
    return found
