"""Generalised least squares of Allan variances: what is fitted, and by which covariance.

A variance is distributed about as chi-square, and so its cube root about normally (Wilson and Hilferty 1931):
whether a sum of terms describes the curve, and which one does so better, is judged by that.  By the variance
itself no curve could be too low for a large random walk, which makes the variance of its variances large.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls
from scipy.special import gammaincc

from imumon.allan.covariance import SHAPES, Covariances
from imumon.blocks import FloatArray

GOOD = 1e-3
"""A fit is taken for good when chi-square is exceeded by chance with at least this probability."""
ITERATIONS = 20
CONVERGED = 1e-5

COLUMNS = (*SHAPES, "markov", "filter")
"""What is fitted, by the columns of the design.

A low-pass filter takes from white noise, at averaging times longer than itself, what has the shape of
quantization: its column is that shape with a minus.
"""
WHITE, QUANTIZATION, RAMP, MARKOV, FILTER = map(
    COLUMNS.index, ("white", "quantization", "ramp", "markov", "filter")
)
WITH_MARKOV = tuple(range(len(COLUMNS)))
EVERY = tuple(column for column in WITH_MARKOV if column != MARKOV)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What was fitted, (7,) and (7, 7) by `COLUMNS`, how likely it is, and what is left, (n,)."""

    coefficients: FloatArray
    covariance: FloatArray
    chi_square: float
    log_likelihood: float
    factor: tuple[FloatArray, bool]
    residual: FloatArray

    @property
    def columns(self) -> frozenset[int]:
        """Return the columns of the terms that are not zero."""
        return frozenset(np.flatnonzero(self.coefficients).tolist())

    @property
    def degrees_of_freedom(self) -> int:
        """Return those that are left, one at least."""
        return max(1, len(self.residual) - int(np.count_nonzero(self.coefficients)))

    def is_good(self) -> bool:
        """Return whether chi-square is in order for its degrees of freedom."""
        return float(gammaincc(0.5 * self.degrees_of_freedom, 0.5 * self.chi_square)) > GOOD


class Problem:
    """Variances at some averaging times, and the covariance that goes with each set of coefficients."""

    def __init__(self, variances: FloatArray, covariances: Covariances, model_error: float = 0.0) -> None:
        shapes = covariances.shapes
        self.design = np.column_stack([shapes, -shapes[:, QUANTIZATION]])
        self.variances = variances
        self.covariances = covariances
        self.model_error = model_error

    def __len__(self) -> int:
        """Return the number of averaging times."""
        return len(self.variances)

    def part(self, start: int, stop: int, model_error: float = 0.0) -> Problem:
        """Return the problem of some of the averaging times."""
        return Problem(self.variances[start:stop], self.covariances.part(start, stop), model_error)

    def with_covariances(self, every: Covariances) -> Problem:
        """Return the problem with other covariances, of these averaging times among others."""
        start = int(np.searchsorted(every.m, self.covariances.m[0]))
        return Problem(self.variances, every.part(start, start + len(self)), self.model_error)

    def fit(self, columns: Iterable[int], uncertain: frozenset[int] = frozenset()) -> Solution:
        """Fit these terms; some may end at zero, and are then not in the covariance, if not uncertain."""
        columns = tuple(sorted(columns))
        design = self.design[:, columns]
        found = _bounded(design / self.variances[:, np.newaxis], np.ones(len(self.variances)))
        for _ in range(ITERATIONS):
            before = found
            lower = np.linalg.cholesky(self._matrix(columns, found))
            whitened = np.linalg.solve(lower, np.column_stack([design, self.variances]))
            found = _bounded(whitened[:, :-1], whitened[:, -1])
            if np.all(np.abs(found - before) <= CONVERGED * np.maximum(found, before)):
                break
        return self._solution(columns, found, uncertain)

    def _matrix(self, columns: tuple[int, ...], found: FloatArray) -> FloatArray:
        coefficients = _spread(columns, found)
        expected = self.design @ coefficients
        matrix = self.covariances.matrix(signed(coefficients))
        diagonal = np.einsum("ii->i", matrix)  # a view
        diagonal += (self.model_error * expected) ** 2
        diagonal += 1e-12 * diagonal + 1e-9 * (np.abs(expected) + 1e-3 * self.variances) ** 2
        return matrix

    def _solution(self, columns: tuple[int, ...], found: FloatArray, uncertain: frozenset[int]) -> Solution:
        matrix = self._matrix(columns, found)
        factor = cho_factor(matrix, lower=True)
        pairs = zip(columns, found, strict=True)
        active = [column for column, value in pairs if value > 0.0 or column in uncertain]
        covariance = np.zeros((len(COLUMNS), len(COLUMNS)))
        covariance[np.ix_(active, active)] = inverse_information(self.design[:, active], factor)
        coefficients = _spread(columns, found)
        expected = np.maximum(self.design @ coefficients, 1e-3 * self.variances)
        ratio = self.variances / expected
        freedom = 2.0 * expected**2 / np.diag(matrix)
        normal = 3.0 * expected * (np.cbrt(ratio) - 1.0 + 2.0 / (9.0 * freedom))
        chi_square = float(normal @ cho_solve(factor, normal))
        # Of the density of the variances themselves: the last part is the derivative of `normal`.
        spread = 2.0 * float(np.log(np.diag(factor[0])).sum()) + 4.0 / 3.0 * float(np.log(ratio).sum())
        residual = self.variances - self.design @ coefficients
        return Solution(coefficients, covariance, chi_square, -0.5 * (chi_square + spread), factor, residual)

    def called_for(self, solution: Solution, column: int) -> float:
        """Return by how many standard deviations the residual asks for one more term."""
        active = np.flatnonzero(solution.coefficients)
        wanted = self.design[:, column]
        whitened = cho_solve(solution.factor, wanted)
        design = self.design[:, active]
        across = design.T @ whitened
        explained = float(across @ solution.covariance[np.ix_(active, active)] @ across)
        information = float(wanted @ whitened) - explained
        if information <= 1e-9 * float(wanted @ whitened):
            return 0.0
        return float(whitened @ solution.residual) / math.sqrt(information)


def inverse_information(design: FloatArray, factor: tuple[FloatArray, bool]) -> FloatArray:
    """Return the covariance of coefficients, (k, k), by their columns, (n, k), and a `Solution.factor`."""
    scale = np.linalg.norm(design, axis=0)
    information = (design / scale).T @ cho_solve(factor, design / scale)
    return np.asarray(np.linalg.pinv(information) / np.outer(scale, scale))


def _bounded(design: FloatArray, target: FloatArray) -> FloatArray:
    """Return the least-squares solution that is not negative; columns may differ by many powers of ten."""
    scale = np.linalg.norm(design, axis=0)
    return np.asarray(nnls(design / scale, target)[0] / scale)


def _spread(columns: tuple[int, ...], values: FloatArray) -> FloatArray:
    coefficients = np.zeros(len(COLUMNS))
    coefficients[list(columns)] = values
    return coefficients


def signed(coefficients: FloatArray) -> FloatArray:
    """Return the coefficients of the six shapes, (6,), with what a filter takes away."""
    signed = coefficients[:FILTER].copy()
    signed[QUANTIZATION] -= coefficients[FILTER]
    return signed
