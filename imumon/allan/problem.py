"""Generalised least squares of Allan variances: what is fitted, and by which covariance.

A variance is distributed about as chi-square, and so its cube root about normally (Wilson and Hilferty 1931):
whether a sum of terms describes the curve, and which one does so better, is tested by that.  By the variance
itself no curve could be too low for a large random walk, which makes the variance of its variances large.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.special import gammaincc

from imumon.allan.covariance import Covariances
from imumon.blocks import FloatArray

GOOD = 1e-3
"""A fit is taken for good when chi-square is exceeded by chance with at least this probability."""
ITERATIONS = 20
CONVERGED = 1e-5

WHITE, FLICKER, WALK, QUANTIZATION, RAMP, MARKOV, TIME, FILTER = range(8)
"""Columns of the design: the shapes; the derivative by the correlation time, which is not fitted, but makes
the others uncertain; and the filter.

A low-pass filter takes from white noise, at averaging times longer than itself, what has the shape of
quantization: its column is that shape with a minus.
"""
EVERY = (WHITE, FLICKER, WALK, QUANTIZATION, RAMP, FILTER)
"""What is fitted without correlated noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What was fitted and how likely it is."""

    coefficients: FloatArray
    """By the columns, (8,), none negative."""
    chi_square: float
    log_likelihood: float
    design: FloatArray
    residual: FloatArray
    """Columns, (n, 8), and what is left of the variances, (n,), both scaled to white errors of one."""

    @property
    def columns(self) -> frozenset[int]:
        """Return the columns of the terms that are not zero."""
        return frozenset(np.flatnonzero(self.coefficients).tolist())

    @property
    def degrees_of_freedom(self) -> int:
        """Return those that are left, one at least."""
        return max(1, len(self.residual) - len(self.columns))

    def is_good(self) -> bool:
        """Return whether chi-square is in order for its degrees of freedom."""
        return float(gammaincc(0.5 * self.degrees_of_freedom, 0.5 * self.chi_square)) > GOOD

    def sd(self, columns: Iterable[int]) -> dict[int, float]:
        """Return the standard deviation of each of these coefficients, where all of them are unknown."""
        columns = sorted(columns)
        design = self.design[:, columns]
        scale = np.linalg.norm(design, axis=0)
        inverse = np.linalg.pinv((design / scale).T @ (design / scale))
        return dict(zip(columns, (np.sqrt(np.diag(inverse)) / scale).tolist(), strict=True))

    def called_for(self, column: int) -> float:
        """Return the significance of one more term in the residual, in standard deviations."""
        wanted = self.design[:, column]
        others = np.linalg.qr(self.design[:, sorted(self.columns)])[0]
        beyond = wanted - others @ (others.T @ wanted)
        if beyond @ beyond <= 1e-9 * (wanted @ wanted):
            return 0.0
        return float(wanted @ self.residual) / float(np.linalg.norm(beyond))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Variances from one averaging time to another, with the covariance of each set of coefficients."""

    variances: FloatArray
    """At all trusted averaging times, (n,)."""
    covariances: Covariances
    """At these and maybe further ones."""
    start: int
    stop: int
    """The averaging times that are to be described: start..stop, without the last."""
    model_error: float = 0.0
    """Part of each variance that no sum of the terms describes."""

    @property
    def design(self) -> FloatArray:
        """Return the expected variance per unit of each coefficient, (n, 8)."""
        shapes = self.covariances.shapes[: len(self.variances)]
        return np.column_stack([shapes, -shapes[:, QUANTIZATION]])

    def fit(self, columns: Iterable[int]) -> Solution:
        """Fit these terms; some may end at zero."""
        columns, part = sorted(columns), slice(self.start, self.stop)
        design, variances = self.design[part], self.variances[part]
        found = _bounded(columns, design, variances, np.diag(variances))
        for _ in range(ITERATIONS):
            before = found
            found = _bounded(columns, design, variances, self._root(design, before))
            if np.all(np.abs(found - before) <= CONVERGED * np.maximum(found, before)):
                break
        root = self._root(design, found)
        expected = np.maximum(design @ found, 1e-3 * variances)
        freedom = 2.0 * (expected / np.linalg.norm(root, axis=1)) ** 2
        ratio = variances / expected
        normal = np.linalg.solve(root, 3.0 * expected * (np.cbrt(ratio) - 1.0 + 2.0 / (9.0 * freedom)))
        chi_square = float(normal @ normal)
        # Of the density of the variances themselves: the last part is the derivative of `normal`.
        spread = float(2.0 * np.log(np.diag(root)).sum() + 4.0 / 3.0 * np.log(ratio).sum())
        left = np.column_stack([design, variances - design @ found])
        white = np.asarray(np.linalg.solve(root, left), np.float64)
        return Solution(found, chi_square, -0.5 * (chi_square + spread), white[:, :-1], white[:, -1])

    def _root(self, design: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the Cholesky factor of the covariance of the variances, (n, n), for coefficients."""
        part = slice(self.start, self.stop)
        expected = design @ coefficients
        matrix = self.covariances.matrix(signed(coefficients))[part, part].copy()
        diagonal = np.einsum("ii->i", matrix)  # a view
        diagonal += (self.model_error * expected) ** 2
        diagonal += 1e-12 * diagonal + 1e-9 * (np.abs(expected) + 1e-3 * self.variances[part]) ** 2
        return np.asarray(np.linalg.cholesky(matrix), np.float64)


def _bounded(columns: list[int], design: FloatArray, variances: FloatArray, root: FloatArray) -> FloatArray:
    """Return the coefficients, (8,), of these columns that fit best; they may differ by powers of ten."""
    whitened = np.linalg.solve(root, np.column_stack([design[:, columns], variances]))
    scale = np.linalg.norm(whitened[:, :-1], axis=0)
    coefficients = np.zeros(design.shape[1])
    coefficients[columns] = nnls(whitened[:, :-1] / scale, whitened[:, -1])[0] / scale
    return coefficients


def signed(coefficients: FloatArray) -> FloatArray:
    """Return the coefficients of the six shapes, (6,), with what a filter takes away."""
    found = coefficients[:TIME].copy()
    found[QUANTIZATION] -= coefficients[FILTER]
    return found
