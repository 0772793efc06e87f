"""Means of a record under windows with smooth edges, of which the sharpest that the noise allows are taken.

The angle of a swaying unit is bounded.  Its rate therefore falls out of a mean whose weights begin and end
gradually, and it stays in one whose weights jump.  White noise is weighed best by weights that jump.  So the
record is cut into some dozens of overlapping Hann windows, which add up to weights that are flat but for
their ends, of several lengths; how the means of the windows scatter tells how good each length is, whatever
it is that sways.  What sways all the time has a spectrum, too, which says best how to weigh each cell: the
widest windows of which enough are left to scatter end too sharply for a strong sway of seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
BESIDE = 2
"""Neighbours, half a cycle in a record apart, either side of a frequency, with which its power is a mean."""
NOTHING = 1e-2
"""A window that weighs less than this share of another tells nothing."""
FLOOR = 1e-30
DEPENDENT = 1e-10
"""Windows that see the same cells differ by rounding: least over largest eigenvalue of their covariance."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows over n cells.

    Parameters
    ----------
    weights : array, (k, n)
        A window that looks at loud cells weighs less than the others.
    covariance : array, (k, k)
        Of the sums, over the variance of a cell that is not loud, when the noise of rows is white.
    white : array, (k, n)
        What makes the sums white.
    slow : array, (k, t)
        Orthonormal: what a trend is in the sums; the first is the constant.
    variance : float
        Of the mean of all cells under these windows, over that of a cell.
    count : float
        How many windows of full weight they are worth.
    """

    weights: FloatArray
    covariance: FloatArray
    white: FloatArray
    slow: FloatArray
    variance: float
    count: float

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
        parts = (self.white[first : first + ROWS] @ columns for first in range(0, len(self.white), ROWS))
        return np.asarray(np.sum([part.T @ part for part in parts], axis=0))


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
    cells, beside = len(quiet), _beside(hop)
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


def of_white(cells: int, hop: int) -> FloatArray:
    """Return the spectrum of cells of white rows, as of `spectrum`, over the variance of a cell."""
    return np.asarray(1.0 + 2.0 * _beside(hop) * np.cos(math.pi * np.arange(cells + 1.0) / cells))


def _beside(hop: int) -> float:
    """Return how much a cell of white rows correlates with its neighbour."""
    taps = layout(hop * CELLS)[1]
    return float(taps[:hop] @ taps[hop:] / (taps @ taps)) if hop > 1 else 0.0


def spectrum(data: FloatArray, quiet: FloatArray) -> FloatArray:
    """Return the power of data, (n, a), at 0 to n / 2 cycles in the record, (n + 1,), in variance of a cell.

    It is that of a cell that counts fully; each counts by so much, (n,).  The taper is Hann's: far from the
    frequency of a strong sway it leaves less than white noise of it.  Where trends and slow waves are, which
    are no noise, it is that of the rate of angles as strong as at the slowest that is left.
    """
    n, root = len(data), np.sqrt(quiet)[:, None]
    known = float(quiet.sum() ** 2 / (quiet @ quiet))
    slow = np.linalg.qr(slow_columns(slowly(n), known) * root)[0]
    left = root * data
    left = left - slow @ (slow.T @ left)
    taper = np.hanning(n + 2)[1:-1] * (quiet > NOTHING)
    power = (np.abs(np.fft.rfft(left * taper[:, None], 2 * n, axis=0)) ** 2).mean(1) / (taper @ taper)
    around = np.ones(2 * BESIDE + 1) / (2 * BESIDE + 1)
    power = np.convolve(np.pad(power, BESIDE, mode="reflect"), around, "valid")
    slowest = 2 * CYCLES
    power[:slowest] = power[slowest] * (np.arange(slowest) / slowest) ** 2
    return np.asarray(np.maximum(power, DEPENDENT * power.max()))


def coloured(quiet: FloatArray, density: FloatArray) -> Windows:
    """Return each cell for itself, made white, when they have a spectrum, (n + 1,), as of `spectrum`.

    Each counts by so much, (n,).  They are not added up first: between sums of cells a sway of their spacing
    would look like none.
    """
    n = len(quiet)
    white = _whitener(np.fft.irfft(density)[:n]) * np.sqrt(quiet)
    total, count = white.sum(1), float(quiet.sum() ** 2 / (quiet @ quiet))
    slow = np.linalg.qr(white @ slow_columns(slowly(n), count))[0]
    return Windows(white, np.eye(n), white, slow, 1.0 / float(total @ total), count)


def _whitener(covariance: FloatArray) -> FloatArray:
    """Return what makes a stationary series white, (n, n), from its covariance with itself later, (n,).

    Each row is a value less what those before predict of it, in standard deviations (Levinson and Durbin): of
    so large a matrix BLAS would wake other threads.
    """
    n = len(covariance)
    found = np.zeros((n, n))
    weights, variance = np.zeros(0), float(covariance[0])
    for k in range(n):
        if k:
            last = (covariance[k] - weights @ covariance[k - 1 : 0 : -1]) / variance
            weights = np.append(weights - last * weights[::-1], last)
            variance *= 1.0 - last**2
        found[k, :k], found[k, k] = -weights[::-1], 1.0
        found[k] /= math.sqrt(variance)
    return found


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
    white = np.linalg.solve(np.linalg.cholesky(covariance), weights)
    total = white.sum(1)
    return Windows(weights, covariance, white, slow, 1.0 / float(total @ total), count)


def _noisy(weights: FloatArray, beside: float) -> FloatArray:
    """Return weights times the covariance of cells."""
    found = weights.copy()
    found[..., 1:] += beside * weights[..., :-1]
    found[..., :-1] += beside * weights[..., 1:]
    return found
