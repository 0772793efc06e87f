"""The noise terms behind a curve of Allan variances, with their uncertainties.

The variances are a sum of known shapes with coefficients that are not negative.  They are fitted by
generalised least squares whose covariance matrix, over all averaging times together, is that of the fitted
noise itself, until both agree: the quasi-likelihood of variances.  No slope is picked by eye.

Of all sets of terms the smallest is fitted to which no further term would add by more than `FITTED` standard
deviations, by the covariance without that term.  A term of it is in the result when it adds by more
than `SHOWN`; the others keep what is there, but not certain, out of the rest.
Flicker and random walk look alike in a short record.  Where one of them is fitted, so is the other, and each
must be called for beside the other.

A first-order Gauss-Markov process, noise that is correlated for a while, is a term where the terms alone are
far less likely (`correlated`).

Conventions (IEEE Std 952-1997, annex C), sigma the Allan deviation, tau the averaging time:

====================  ===================================  =======================
term                  Allan deviation                      read at
====================  ===================================  =======================
angle random walk N   N / sqrt(tau)                        tau = 1 s
bias instability B    sqrt(2 ln 2 / pi) B = 0.664 B        the flat part
rate random walk K    K sqrt(tau / 3)                      tau = 3 s
quantization Q        sqrt(3) Q / tau                      tau = sqrt(3) s
rate ramp R           R tau / sqrt(2)                      tau = sqrt(2) s
correlated noise s,   s sqrt(2 T / tau (1 - T / (2 tau)    highest, 0.617 s, at
correlation time T    (3 - 4 exp(-tau/T) + exp(-2tau/T)))  1.89 T
====================  ===================================  =======================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from imumon.allan.correlated import SHOWN, Correlated, Search
from imumon.allan.covariance import FLOOR_PER_INSTABILITY, SHAPES, Covariances, Family, markov_shape
from imumon.allan.parameters import NAMES
from imumon.allan.problem import (
    COLUMNS,
    EVERY,
    FILTER,
    MARKOV,
    QUANTIZATION,
    RAMP,
    WHITE,
    WITH_MARKOV,
    Problem,
    Solution,
    signed,
)
from imumon.blocks import FloatArray

FITTED, SHORT_FITTED = 2.0, 3.0
"""A term is in the fit when the data call for it by this many standard deviations; the second number is that
of quantization and filter, at the short averaging times: with 2 the error of N in white noise is a quarter
larger."""
LONGEST_START_S = 1.0
"""The shortest averaging times are left out, up to this one, where a filter of the device has shaped them."""
FILTERED = 1.02
"""A filter takes noise away: what is left out for it may not lie higher above what the terms say of it."""
NO_SUM = 0.4
"""With a larger model error nothing can be said of the terms from the whole curve: a sine of any size puts
angle random walk or quantization in the place of its own bump."""
ROUNDS, CLOSE, LARGEST_ERROR = 8, 0.05, 3.0
"""The model error is found to 5 %: chi-square falls with its square where it counts."""
FEWEST, FEWEST_BEFORE = 5, 4
"""Averaging times that a fit must keep; and that one before a disturbance must have."""

ALIKE = frozenset(map(COLUMNS.index, ("flicker", "walk")))
"""Each of these can stand in the place of the other at the longest averaging times."""

Scale = Callable[[float], float]


class Term(NamedTuple):
    """A term, and its square per unit of its coefficient by the sample interval in s.

    The coefficient is the Allan variance at one sample.
    """

    name: str
    per_unit: Scale


TERMS = (
    Term("angle_random_walk", lambda dt: dt),
    Term("bias_instability", lambda _: FLOOR_PER_INSTABILITY**-2),
    Term("rate_random_walk", lambda dt: 3.0 / dt),
    Term("quantization", lambda dt: dt**2 / 3.0),
    Term("rate_ramp", lambda dt: 2.0 / dt**2),
    Term("correlated_noise", lambda _: 1.0),
)
"""In the order of the columns of what is fitted."""
CORRELATION_TIME = NAMES[-1]
AMBIGUOUS, DIGITS = "ambiguous", "digits"


class Estimate(NamedTuple):
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The terms of one channel."""

    terms: dict[str, Estimate | None]
    """By `NAMES`; None for what the data do not show."""
    coefficients: FloatArray
    """Allan variance at one sample of all that was fitted, and the variance of the correlated noise, (6,);
    that of quantization is negative where a filter in the device takes away more than quantization adds."""
    time: float
    """Correlation time of the correlated noise, samples; NaN without any."""
    first: int
    last: int
    """The averaging times that were fitted: first..last.  Where `last` is not the longest trusted one, no
    sum of the terms describes the longer ones, and only the angle random walk is reported."""
    model_error: float
    """Part of each variance by which the curve differs from any sum of the terms beyond its noise, as far
    as the fit can tell; it is in the standard deviations.  0 when chi-square is in order; above `NO_SUM`
    no term is reported."""
    withheld: str
    """`AMBIGUOUS`: bias instability and random walk are not reported, because noise that is correlated for a
    while would be as likely.  `DIGITS`: nothing is, because the steps of the readings hide the noise."""

    def less_certain(self, error: float) -> Fit:
        """Return the terms where rounding, or what is missing, may change the variance by this part: less
        certain, or none."""
        if error > NO_SUM:
            return replace(self, terms=dict.fromkeys(NAMES), withheld=DIGITS)
        terms = {
            name: term
            if term is None or name == CORRELATION_TIME
            else Estimate(term.value, math.hypot(term.sd, 0.5 * error * term.value))
            for name, term in self.terms.items()
        }
        return replace(self, terms=terms)

    def with_tails(self, kurtosis: float, samples: int) -> Fit:
        """Return the angle random walk of samples with an excess kurtosis: their variance is known less well.

        That of a mean square of n samples is (2 + kurtosis)/n of its square, and the covariance of the curve
        has the 2.
        """
        white = self.terms["angle_random_walk"]
        if white is None:
            return self
        sd = math.hypot(white.sd, 0.5 * white.value * math.sqrt(max(kurtosis, 0.0) / samples))
        return replace(self, terms={**self.terms, "angle_random_walk": Estimate(white.value, sd)})

    def shares(self, m: FloatArray) -> FloatArray:
        """Return the Allan variance that each of `TERMS` makes at averaging factors, (n, 6)."""
        shapes = [shape(m) for shape in SHAPES.values()]
        shapes.append(markov_shape(m, self.time) if self.coefficients[MARKOV] else np.zeros(len(m)))
        return np.column_stack(shapes) * self.coefficients


def fit_terms(variances: FloatArray, family: Family, interval_s: float, last: int) -> Fit | None:
    """Fit the terms to Allan variances at the averaging factors 0..last of `family`; None if too few.

    The shortest averaging times are left out, one by one, while no sum of the terms describes the curve:
    a low-pass filter of the device shapes those that are not longer than itself, and lowers them.  What
    still does not fit becomes a model error: a part of every variance, so that the many samples behind the
    short averaging times do not outvote the long ones.  When that is large, only the angle random walk is
    reported, from the averaging times before the disturbance.
    """
    n = last + 1
    if n < 2 or not np.all(variances[:n] > 0.0):
        return None
    variances, covariances = variances[:n], family.of(None).part(0, n)
    start, stop, error = _range_and_error(variances, covariances, interval_s)
    first = start if error == 0.0 and stop == n else 0
    search = Search(variances[first:], family, first)
    correlated = search.found()
    if correlated is not None:
        start, stop, error, covariances = first, n, 0.0, correlated.covariances
    problem = Problem(variances[start:stop], covariances.part(start, stop), error)
    smallest = _smallest(problem, EVERY if correlated is None else WITH_MARKOV)
    solution = problem.fit(_with_alike(smallest), ALIKE)
    columns, withheld = _called_for(problem, smallest, solution), ""
    rest = tuple(column for column in _columns_of(smallest) if column not in ALIKE)
    if error > NO_SUM:
        columns = []
    elif stop < n:
        columns = [column for column in columns if column == WHITE]
    elif correlated is None and error == 0.0 and ALIKE & {*columns} and search.stands_for(rest):
        columns, withheld = [column for column in columns if column not in ALIKE], AMBIGUOUS
    terms = _estimates(problem, solution, columns, correlated, interval_s)
    time = np.nan if correlated is None else correlated.time
    return Fit(terms, signed(solution.coefficients), time, start, stop - 1, error, withheld)


def _estimates(
    problem: Problem, solution: Solution, columns: list[int], correlated: Correlated | None, interval_s: float
) -> dict[str, Estimate | None]:
    """Return the terms of these columns, and None for every other."""
    terms: dict[str, Estimate | None] = dict.fromkeys(NAMES)
    covariance = solution.covariance
    if correlated is not None:
        covariance, of_time = correlated.uncertainty(problem, solution)
        if MARKOV in columns:
            time_s = correlated.time * interval_s
            terms[CORRELATION_TIME] = Estimate(time_s, time_s * math.sqrt(of_time))
    for column in columns:
        coefficient, sd = float(solution.coefficients[column]), math.sqrt(covariance[column, column])
        value = math.sqrt(coefficient * TERMS[column].per_unit(interval_s))
        terms[TERMS[column].name] = Estimate(value, 0.5 * value * sd / coefficient)
    return terms


def _called_for(problem: Problem, smallest: Solution, solution: Solution) -> list[int]:
    """Return the columns of the terms that the fit without them calls for, whatever may stand for them."""
    found = []
    for column in np.flatnonzero(solution.coefficients[: len(TERMS)]).tolist():
        beside = _with_alike(smallest) if column in ALIKE else _columns_of(smallest)
        others = tuple(other for other in beside if other != column)
        alone = column == MARKOV or not others
        if alone or problem.called_for(problem.fit(others), column) > SHOWN:
            found.append(column)
    return found


def _columns_of(solution: Solution) -> tuple[int, ...]:
    return tuple(np.flatnonzero(solution.coefficients).tolist())


def _with_alike(solution: Solution) -> tuple[int, ...]:
    """Return the columns of a solution, with what is not called for, but could stand in their place."""
    found = frozenset(_columns_of(solution))
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
        error, solution = _model_error(variances[start:], covariances.part(start, n))
        if start and not _is_filtered(variances[:start], covariances.shapes[:start], solution):
            continue
        if error == 0.0:
            return start, n, 0.0
        tried.append((error, start))
    error, start = min(tried)
    if error > NO_SUM:
        stop = _good_beginning(variances, covariances)
        if stop:
            return 0, stop, 0.0
    return start, n, error


def _is_filtered(variances: FloatArray, shapes: FloatArray, solution: Solution) -> bool:
    """Return whether what was left out lies below what the terms say of it, as behind a low-pass filter.

    Quantization is none behind a filter; where it is called for, it stands for the end of a bump.
    """
    coefficients = solution.coefficients[:FILTER]
    if coefficients[QUANTIZATION] > 0.0:
        return False
    return bool(np.all(variances <= FILTERED * (shapes @ coefficients)))


def _good_beginning(variances: FloatArray, covariances: Covariances) -> int:
    """Return how many averaging times from the shortest on a sum of the terms describes; 0 if too few.

    What disturbs the longer ones, such as a sine, begins like a ramp.  The last that would do is not taken:
    chi-square does not see a disturbance that has only just begun.
    """
    for stop in range(len(variances) - 1, FEWEST_BEFORE, -1):
        if Problem(variances[:stop], covariances.part(0, stop)).fit(EVERY).is_good():
            return stop - 1
    return 0


def _model_error(variances: FloatArray, covariances: Covariances) -> tuple[float, Solution]:
    """Return the relative error per variance that brings chi-square to its degrees of freedom, or 0."""
    solution = Problem(variances, covariances).fit(EVERY)
    if solution.is_good():
        return 0.0, solution
    error = 1.0
    for _ in range(ROUNDS):
        solution = Problem(variances, covariances, error).fit(EVERY)
        change = math.sqrt(solution.chi_square / solution.degrees_of_freedom())
        error = min(error * change, LARGEST_ERROR)
        if abs(change - 1.0) < CLOSE:
            break
    return error, solution


def _smallest(problem: Problem, every: tuple[int, ...]) -> Solution:
    """Return the fit of the smallest set of these terms that leaves no other called for."""
    everything = problem.fit(every)
    for size in range(1, len(every) - 1):
        found: list[Solution] = []
        for columns in combinations(every, size):
            solution = problem.fit(columns)
            if np.count_nonzero(solution.coefficients) < size:
                continue
            others = [column for column in every if column not in columns]
            if not any(_is_missing(problem, solution, column) for column in others):
                found.append(solution)
        if found:
            return max(found, key=_merit)
    return everything


def _is_missing(problem: Problem, solution: Solution, column: int) -> bool:
    """Return whether the data call for one more term."""
    least = SHORT_FITTED if column in (QUANTIZATION, FILTER) else FITTED
    return problem.called_for(solution, column) > least


def _merit(solution: Solution) -> float:
    """Return the logarithm of the likelihood; one piece of a random walk resembles a ramp, which must be more
    likely by as much as a term that is shown."""
    return solution.log_likelihood - (0.5 * SHOWN**2 if solution.coefficients[RAMP] else 0.0)
