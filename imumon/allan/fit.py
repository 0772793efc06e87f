"""The noise terms behind a curve of Allan variances, with their uncertainties.

The variances are a sum of known shapes with coefficients that are not negative.  They are fitted by
generalised least squares whose covariance matrix, over all averaging times together, is that of the fitted
noise itself, until both agree: the quasi-likelihood of variances.  No slope is picked by eye.

Of all sets of terms the smallest is fitted to which no further term would add by more than `FITTED` (or
`SHORT_FITTED`) standard deviations, judged by the covariance without that term.  A term of it is in the
result when it adds by more than `SHOWN`; the others keep what is there, but not certain, out of the rest.
Flicker and random walk look alike in a short record.  Where one of them is fitted, so is the other, and each
must be called for beside the other.

Conventions (IEEE Std 952-1997, annex C), sigma the Allan deviation, tau the averaging time:

====================  ===================================  =======================
term                  Allan deviation                      read at
====================  ===================================  =======================
angle random walk N   N / sqrt(tau)                        tau = 1 s
bias instability B    sqrt(2 ln 2 / pi) B = 0.664 B        the flat part
rate random walk K    K sqrt(tau / 3)                      tau = 3 s
quantization Q        sqrt(3) Q / tau                      tau = sqrt(3) s
rate ramp R           R tau / sqrt(2)                      tau = sqrt(2) s
====================  ===================================  =======================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls
from scipy.special import gammaincc

from imumon.allan.covariance import SHAPES, Covariances
from imumon.blocks import FloatArray, IntArray
from imumon.filters.noise import FLOOR_PER_INSTABILITY

FITTED = 2.0
"""A term is in the fit when the data call for it by this many standard deviations."""
SHORT_FITTED = 3.0
"""The same for quantization and filter, which concern the short averaging times, where all is certain."""
SHOWN = 3.5
"""It is in the result when they do so by this many; noise alone does that once in some hundred curves."""
RAMP_SHOWN = 6.0
"""The same for the ramp, which one realisation of a random walk resembles at the longest averaging times."""
GOOD = 1e-3
"""A fit is taken for good when chi-square is exceeded by chance with at least this probability."""
ITERATIONS = 20
CONVERGED = 1e-5
LONGEST_START_S = 1.0
"""The shortest averaging times are left out, up to this one, where a filter of the device has shaped them."""
FILTERED = 1.02
"""A filter takes noise away: what is left out for it may not lie higher above what the terms say of it."""
NEARLY_LEAST = 1.5
"""Where no sum of the terms describes the curve, as many averaging times are kept as leave about the least
model error."""
NO_SUM = 0.4
"""With a larger model error nothing can be said of the terms from the whole curve: a sine of any size puts
angle random walk or quantization in the place of its own bump."""
ROUNDS, CLOSE, LARGEST_ERROR = 8, 0.05, 3.0
"""The model error is found to 5 %: chi-square falls with its square where it counts."""
FEWEST, FEWEST_BEFORE = 5, 4
"""Averaging times that a fit must keep; and that one before a disturbance must have."""

COLUMNS = (*SHAPES, "filter")
"""What is fitted, by the columns of the design.

A low-pass filter takes from white noise, at averaging times longer than itself, what has the shape of
quantization: its column is that shape with a minus.
"""
WHITE, QUANTIZATION, RAMP, FILTER = map(COLUMNS.index, ("white", "quantization", "ramp", "filter"))
EVERY = tuple(range(len(COLUMNS)))
ALIKE = frozenset(map(COLUMNS.index, ("flicker", "walk")))
"""Each of these can stand in the place of the other at the longest averaging times."""

Scale = Callable[[float], float]


@dataclass(frozen=True, slots=True)
class Term:
    """A term, its square per unit of its coefficient, and by how many sigmas it must be called for.

    `per_unit` takes the sample interval in s; the coefficient is the Allan variance at one sample.
    """

    name: str
    per_unit: Scale
    shown: float = SHOWN


TERMS = (
    Term("angle_random_walk", lambda dt: dt),
    Term("bias_instability", lambda _: FLOOR_PER_INSTABILITY**-2),
    Term("rate_random_walk", lambda dt: 3.0 / dt),
    Term("quantization", lambda dt: dt**2 / 3.0),
    Term("rate_ramp", lambda dt: 2.0 / dt**2, RAMP_SHOWN),
)
"""In the order of `imumon.allan.covariance.NOISES`, the ramp last."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The terms of one channel.

    Parameters
    ----------
    terms : mapping of str to Estimate or None
        By the name in `TERMS`; None for what the data do not show.
    coefficients : array, (5,)
        Allan variance at one sample of all that was fitted; that of quantization is negative where a filter
        in the device takes away more than quantization adds.
    first, last : int
        The averaging times that were fitted: first..last.  Where `last` is not the longest trusted one, no
        sum of the terms describes the longer ones, and only the angle random walk is told.
    model_error : float
        Part of each variance by which the curve differs from any sum of the terms beyond its noise, as far
        as the fit can tell; it is in the standard deviations.  0 when chi-square is in order; above `NO_SUM`
        no term is told.
    """

    terms: dict[str, Estimate | None]
    coefficients: FloatArray
    first: int
    last: int
    model_error: float


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    coefficients: FloatArray
    covariance: FloatArray
    chi_square: float
    log_likelihood: float
    factor: tuple[FloatArray, bool]
    residual: FloatArray


class _Problem:
    """Variances at some averaging times, and the covariance that goes with each set of coefficients."""

    def __init__(self, variances: FloatArray, covariances: Covariances, model_error: float = 0.0) -> None:
        m = covariances.m.astype(np.float64)
        shapes = [shape(m) for shape in SHAPES.values()]
        self.design = np.column_stack([*shapes, -shapes[QUANTIZATION]])
        self.variances = variances
        self.covariances = covariances
        self.model_error = model_error

    def fit(self, columns: tuple[int, ...], uncertain: frozenset[int] = frozenset()) -> _Solution:
        """Fit these terms; some may end at zero, and are then not in the covariance, if not uncertain."""
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
        matrix = self.covariances.matrix(_signed(coefficients)) + np.diag((self.model_error * expected) ** 2)
        least = 1e-9 * (np.abs(expected) + 1e-3 * self.variances) ** 2
        return matrix + np.diag(1e-12 * np.diag(matrix) + least)

    def _solution(self, columns: tuple[int, ...], found: FloatArray, uncertain: frozenset[int]) -> _Solution:
        factor = cho_factor(self._matrix(columns, found), lower=True)
        pairs = zip(columns, found, strict=True)
        active = [column for column, value in pairs if value > 0.0 or column in uncertain]
        design = self.design[:, active]
        covariance = np.zeros((len(COLUMNS), len(COLUMNS)))
        scale = np.linalg.norm(design, axis=0)
        information = (design / scale).T @ cho_solve(factor, design / scale)
        covariance[np.ix_(active, active)] = np.linalg.pinv(information) / np.outer(scale, scale)
        coefficients = _spread(columns, found)
        residual = self.variances - self.design @ coefficients
        chi_square = float(residual @ cho_solve(factor, residual))
        determinant = 2.0 * float(np.log(np.diag(factor[0])).sum())
        return _Solution(
            coefficients, covariance, chi_square, -0.5 * (chi_square + determinant), factor, residual
        )

    def called_for(self, solution: _Solution, column: int) -> float:
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


def _bounded(design: FloatArray, target: FloatArray) -> FloatArray:
    """Return the least-squares solution that is not negative; columns may differ by many powers of ten."""
    scale = np.linalg.norm(design, axis=0)
    return np.asarray(nnls(design / scale, target)[0] / scale)


def _spread(columns: tuple[int, ...], values: FloatArray) -> FloatArray:
    coefficients = np.zeros(len(COLUMNS))
    coefficients[list(columns)] = values
    return coefficients


def _signed(coefficients: FloatArray) -> FloatArray:
    """Return the coefficients of the five shapes, (5,), with what a filter takes away."""
    signed = coefficients[:FILTER].copy()
    signed[QUANTIZATION] -= coefficients[FILTER]
    return signed


def fit_terms(variances: FloatArray, covariances: Covariances, interval_s: float, last: int) -> Fit | None:
    """Fit the terms to Allan variances at the averaging factors 0..last of `covariances`; None if too few.

    The shortest averaging times are left out, one by one, while no sum of the terms describes the curve:
    a low-pass filter of the device shapes those that are not longer than itself, and lowers them.  What
    still does not fit becomes a model error: a part of every variance, so that the many samples behind the
    short averaging times do not outvote the long ones.  When that is large, only the angle random walk is
    told, from the averaging times before the disturbance.
    """
    n = last + 1
    if n < 2 or not np.all(variances[:n] > 0.0):
        return None
    start, stop, error = _range_and_error(variances[:n], covariances, interval_s)
    problem = _Problem(variances[start:stop], _part(covariances, start, stop), error)
    smallest = _smallest(problem)
    solution = problem.fit(_with_alike(smallest), ALIKE)
    told = TERMS if stop == n else TERMS[:1]
    terms: dict[str, Estimate | None] = dict.fromkeys(term.name for term in TERMS)
    for column, term in enumerate(told if error <= NO_SUM else ()):
        coefficient = float(solution.coefficients[column])
        if coefficient > 0.0 and _is_shown(problem, smallest, column):
            value = math.sqrt(coefficient * term.per_unit(interval_s))
            spread = math.sqrt(float(solution.covariance[column, column]))
            terms[term.name] = Estimate(value, 0.5 * value * spread / coefficient)
    return Fit(terms, _signed(solution.coefficients), start, stop - 1, error)


def _is_shown(problem: _Problem, solution: _Solution, column: int) -> bool:
    """Tell whether the fit without a term calls for it, whatever may stand in its place."""
    beside = _with_alike(solution) if column in ALIKE else np.flatnonzero(solution.coefficients).tolist()
    others = tuple(other for other in beside if other != column)
    return not others or problem.called_for(problem.fit(others), column) > TERMS[column].shown


def _with_alike(solution: _Solution) -> tuple[int, ...]:
    """Return the columns of a solution, with what is not called for, but could stand in their place."""
    found = frozenset(np.flatnonzero(solution.coefficients).tolist())
    return tuple(sorted(found | ALIKE if found & ALIKE else found))


def _range_and_error(
    variances: FloatArray, covariances: Covariances, interval_s: float
) -> tuple[int, int, float]:
    """Return the first averaging time to fit, the one after the last, and the model error that is left."""
    n = len(variances)
    tried: list[tuple[float, int]] = []
    for start in range(max(1, n - FEWEST + 1)):
        if start and covariances.m[start] * interval_s > LONGEST_START_S:
            break
        error, solution = _model_error(variances[start:], _part(covariances, start, n))
        if start and not _is_filtered(variances[:start], covariances.m[:start], solution):
            continue
        if error == 0.0:
            return start, n, 0.0
        tried.append((error, start))
    least = min(error for error, _ in tried)
    error, start = next((error, start) for error, start in tried if error <= NEARLY_LEAST * least)
    if error > NO_SUM:
        stop = _good_beginning(variances, covariances)
        if stop:
            return 0, stop, 0.0
    return start, n, error


def _is_filtered(variances: FloatArray, m: IntArray, solution: _Solution) -> bool:
    """Tell whether what was left out lies below what the terms say of it, as behind a low-pass filter.

    Quantization is none behind a filter; where it is called for, it stands for the end of a bump.
    """
    coefficients = solution.coefficients[:FILTER]
    if coefficients[QUANTIZATION] > 0.0:
        return False
    shapes = np.column_stack([shape(m.astype(np.float64)) for shape in SHAPES.values()])
    return bool(np.all(variances <= FILTERED * (shapes @ coefficients)))


def _good_beginning(variances: FloatArray, covariances: Covariances) -> int:
    """Return how many averaging times from the shortest on a sum of the terms describes; 0 if too few.

    What disturbs the longer ones, such as a sine, begins like a ramp.  The last that would do is not taken:
    chi-square does not see a disturbance that has only just begun.
    """
    for stop in range(len(variances) - 1, FEWEST_BEFORE, -1):
        if _is_good(*_everything(variances[:stop], _part(covariances, 0, stop), 0.0)):
            return stop - 1
    return 0


def _is_good(solution: _Solution, free: int) -> bool:
    return float(gammaincc(0.5 * free, 0.5 * solution.chi_square)) > GOOD


def _everything(variances: FloatArray, covariances: Covariances, error: float) -> tuple[_Solution, int]:
    """Return the fit of all terms and its degrees of freedom."""
    solution = _Problem(variances, covariances, error).fit(EVERY)
    return solution, max(1, len(variances) - int(np.count_nonzero(solution.coefficients)))


def _model_error(variances: FloatArray, covariances: Covariances) -> tuple[float, _Solution]:
    """Return the relative error per variance that brings chi-square to its degrees of freedom, or 0."""
    solution, free = _everything(variances, covariances, 0.0)
    if _is_good(solution, free):
        return 0.0, solution
    error = 1.0
    for _ in range(ROUNDS):
        solution, free = _everything(variances, covariances, error)
        change = math.sqrt(solution.chi_square / free)
        error = min(error * change, LARGEST_ERROR)
        if abs(change - 1.0) < CLOSE:
            break
    return error, solution


def _smallest(problem: _Problem) -> _Solution:
    """Return the fit of the smallest set of terms that leaves no other called for."""
    everything = problem.fit(EVERY)
    for size in range(1, len(EVERY) - 1):
        found: list[_Solution] = []
        for columns in combinations(EVERY, size):
            if FILTER in columns and (QUANTIZATION in columns or WHITE not in columns):
                continue
            solution = problem.fit(columns)
            if np.count_nonzero(solution.coefficients) < size:
                continue
            others = [column for column in EVERY if column not in columns]
            if all(problem.called_for(solution, column) <= _needed(column) for column in others):
                found.append(solution)
        if found:
            return max(found, key=_merit)
    return everything


def _needed(column: int) -> float:
    return SHORT_FITTED if column in (QUANTIZATION, FILTER) else FITTED


def _merit(solution: _Solution) -> float:
    """Return the logarithm of the likelihood; a ramp must be far more likely than another noise."""
    return solution.log_likelihood - (0.5 * RAMP_SHOWN**2 if solution.coefficients[RAMP] else 0.0)


def _part(covariances: Covariances, start: int, stop: int) -> Covariances:
    part = slice(start, stop)
    factors: IntArray = covariances.m[part]
    return Covariances(factors, covariances.quadratic[part, part], covariances.linear[part, part])
