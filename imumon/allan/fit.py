"""The noise terms behind a curve of Allan variances, with their uncertainties.

The variances are a sum of known shapes with coefficients that are not negative.  They are fitted by
generalised least squares whose covariance matrix, over all averaging times together, is that of the fitted
noise itself, until both agree: the quasi-likelihood of variances.  No slope is picked by eye.

1. `usable_range`: the shortest averaging times are left out where a filter of the device has shaped them, the
   longest where something else than noise has, such as a vibration; or the curve gets a model error.
2. `find_correlated`: a first-order Gauss-Markov process is a term where the curve is far less likely without.
3. Of all sets of terms the smallest is fitted to which no further term would add by more than `FITTED`
   standard deviations, by the covariance without that term.
4. A term of it is reported when it adds by more than `SHOWN`; the others keep what is there, but not certain,
   out of the rest.  Flicker and random walk look alike in a short record: where one of them is fitted, so is
   the other, and each must be called for beside the other.

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from imumon.allan.correlated import SHOWN, Family, find_correlated, may_be_correlated, uncertainty
from imumon.allan.covariance import FLOOR_PER_INSTABILITY, SHAPES, markov_shape
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
BEYOND_FILTER = 1
"""Octaves that are left out besides: chi-square does not see the end of a filter, and the error of N would be
up to 4.8 of its standard deviations (rms); with one octave it is up to 1.1."""
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

TERMS: dict[str, Callable[[float], float]] = {
    "angle_random_walk": lambda dt: dt,
    "bias_instability": lambda _: FLOOR_PER_INSTABILITY**-2,
    "rate_random_walk": lambda dt: 3.0 / dt,
    "quantization": lambda dt: dt**2 / 3.0,
    "rate_ramp": lambda dt: 2.0 / dt**2,
    "correlated_noise": lambda _: 1.0,
}
"""The terms in the order of the columns of what is fitted, and their squares per unit of their coefficients,
the Allan variances at one sample, by the sample interval in s."""
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
    withheld: str = ""
    """`AMBIGUOUS`: bias instability and random walk are not reported, because noise that is correlated for a
    while would be as likely.  `DIGITS`: nothing is, because the steps of the readings hide the noise."""

    def less_certain(self, error: float, names: Sequence[str] = NAMES[:-1]) -> Fit:
        """Return the terms where the squares of some may be wrong by this part: less certain, or none."""
        if error > NO_SUM:
            return replace(self, terms=dict.fromkeys(NAMES), withheld=DIGITS)
        terms = dict(self.terms)
        for name in names:
            term = terms[name]
            if term is not None:
                terms[name] = Estimate(term.value, math.hypot(term.sd, 0.5 * error * term.value))
        return replace(self, terms=terms)

    def with_missing(self, share: float) -> Fit:
        """Return the terms where this share of the samples is missing: means of fewer have more white noise.

        Corrected on average only: shorter averaging times do not cross gaps.
        """
        fit = self.less_certain(min(0.5 * share, NO_SUM))
        white = fit.terms["angle_random_walk"]
        if white is None or not share:
            return fit
        kept = math.sqrt(1.0 - share)
        return replace(fit, terms={**fit.terms, "angle_random_walk": Estimate(kept * white.value, white.sd)})

    def shares(self, m: FloatArray) -> FloatArray:
        """Return the Allan variance that each of `TERMS` makes at averaging factors, (n, 6)."""
        shapes = [shape(m) for shape in SHAPES.values()]
        shapes.append(markov_shape(m, self.time) if self.coefficients[MARKOV] else np.zeros(len(m)))
        return np.column_stack(shapes) * self.coefficients


def fit_terms(variances: FloatArray, family: Family, interval_s: float, last: int) -> Fit | None:
    """Fit the terms to Allan variances at the averaging factors 0..last of `family`; None if too few."""
    n = last + 1
    if n < 2 or not np.all(variances[:n] > 0.0):
        return None
    whole = Problem(variances[:n], family.at(family.times[0]).part(0, n))
    start, stop, error = usable_range(whole, interval_s)
    described = error == 0.0 and stop == n
    correlated = find_correlated(whole.part(start if described else 0, n), family)
    problem, every, time = whole.part(start, stop, error), EVERY, np.nan
    if correlated is not None:
        time, problem = correlated
        every, start, stop, error = WITH_MARKOV, n - len(problem), n, 0.0
    smallest = _smallest(problem, every)
    fitted = _with_alike(smallest) | ({FILTER} if start else frozenset())
    solution = problem.fit(fitted, ALIKE | {FILTER})
    shown = [column for column in sorted(solution.columns) if _is_shown(problem, smallest, column)]
    if error > NO_SUM:
        shown = []
    elif stop < n:
        shown = [column for column in shown if column == WHITE]
    withheld = ""
    doubtful = described and correlated is None and bool(ALIKE & {*shown})
    if doubtful and may_be_correlated(problem, family, smallest.columns - ALIKE):
        withheld, shown = AMBIGUOUS, [column for column in shown if column not in ALIKE]
    terms = _estimates(problem, solution, shown, time, interval_s)
    return Fit(terms, signed(solution.coefficients), time, start, stop - 1, error, withheld)


def usable_range(problem: Problem, interval_s: float) -> tuple[int, int, float]:
    """Return the first averaging time to fit, the one after the last, and the model error that is left.

    The shortest averaging times are left out, one by one, while no sum of the terms describes the curve: a
    low-pass filter of the device lowers those that are not longer than itself, by a little longer ones as
    well.  What still does not fit becomes a model error: a part of every variance, so that the many samples
    behind the short averaging times do not outvote the long ones.  When that is large, the averaging times
    before the disturbance are used.
    """
    n, m = len(problem), problem.covariances.m
    tried: list[tuple[float, int]] = []
    for start in range(max(1, n - FEWEST + 1)):
        if start and m[start] * interval_s > LONGEST_START_S:
            break
        error, solution = _model_error(problem.part(start, n))
        if not start or _is_filtered(problem, start, solution):
            tried.append((error, start))
        if tried[-1] == (0.0, start):
            break
    error, start = min(tried)
    if error > NO_SUM and (stop := _good_beginning(problem)):
        return 0, stop, 0.0
    return min(start + BEYOND_FILTER, n - FEWEST) if start else 0, n, error


def _is_filtered(problem: Problem, start: int, solution: Solution) -> bool:
    """Return whether what was left out lies below what the terms say of it, as behind a low-pass filter.

    Quantization is none behind a filter; where it is called for, it stands for the end of a bump.
    """
    coefficients = solution.coefficients[:FILTER]
    expected = problem.design[:start, :FILTER] @ coefficients
    return coefficients[QUANTIZATION] == 0.0 and bool(
        np.all(problem.variances[:start] <= FILTERED * expected)
    )


def _good_beginning(problem: Problem) -> int:
    """Return how many averaging times from the shortest on a sum of the terms describes; 0 if too few.

    What disturbs the longer ones, such as a sine, begins like a ramp.  The last that would do is not taken:
    chi-square does not see a disturbance that has only just begun.
    """
    for stop in range(len(problem) - 1, FEWEST_BEFORE, -1):
        if problem.part(0, stop).fit(EVERY).is_good():
            return stop - 1
    return 0


def _model_error(problem: Problem) -> tuple[float, Solution]:
    """Return the relative error per variance that brings chi-square to its degrees of freedom, or 0."""
    solution = problem.fit(EVERY)
    if solution.is_good():
        return 0.0, solution
    error = 1.0
    for _ in range(ROUNDS):
        solution = problem.part(0, len(problem), error).fit(EVERY)
        change = math.sqrt(solution.chi_square / solution.degrees_of_freedom)
        error = min(error * change, LARGEST_ERROR)
        if abs(change - 1.0) < CLOSE:
            break
    return error, solution


def _smallest(problem: Problem, every: Sequence[int]) -> Solution:
    """Return the fit of the smallest set of these terms that leaves no other called for."""
    for size in range(1, len(every) - 1):
        found: list[Solution] = []
        for columns in combinations(every, size):
            solution = problem.fit(columns)
            if len(solution.columns) < size:
                continue
            if not any(_is_missing(problem, solution, column) for column in {*every} - {*columns}):
                found.append(solution)
        if found:
            return max(found, key=_merit)
    return problem.fit(every)


def _is_missing(problem: Problem, solution: Solution, column: int) -> bool:
    """Return whether the data call for one more term."""
    least = SHORT_FITTED if column in (QUANTIZATION, FILTER) else FITTED
    return problem.called_for(solution, column) > least


def _merit(solution: Solution) -> float:
    """Return the logarithm of the likelihood; one piece of a random walk resembles a ramp, which must be more
    likely by as much as a term that is shown."""
    return solution.log_likelihood - (0.5 * SHOWN**2 if solution.coefficients[RAMP] else 0.0)


def _with_alike(solution: Solution) -> frozenset[int]:
    """Return the columns of a solution, with what is not called for, but could stand in their place."""
    return solution.columns | ALIKE if solution.columns & ALIKE else solution.columns


def _is_shown(problem: Problem, smallest: Solution, column: int) -> bool:
    """Return whether the fit without a term calls for it, whatever may stand for it."""
    if column == FILTER:
        return False
    others = (_with_alike(smallest) if column in ALIKE else smallest.columns) - {column}
    return column == MARKOV or not others or problem.called_for(problem.fit(others), column) > SHOWN


def _estimates(
    problem: Problem, solution: Solution, columns: Sequence[int], time: float, interval_s: float
) -> dict[str, Estimate | None]:
    """Return the terms of these columns, and None for every other; `time` is NaN without correlated noise."""
    terms: dict[str, Estimate | None] = dict.fromkeys(NAMES)
    covariance = solution.covariance
    if not math.isnan(time):
        covariance, of_time = uncertainty(problem, solution, time)
        if MARKOV in columns:
            time_s = time * interval_s
            terms[CORRELATION_TIME] = Estimate(time_s, time_s * math.sqrt(of_time))
    for column in columns:
        coefficient, sd = float(solution.coefficients[column]), math.sqrt(covariance[column, column])
        value = math.sqrt(coefficient * [*TERMS.values()][column](interval_s))
        terms[NAMES[column]] = Estimate(value, 0.5 * value * sd / coefficient)
    return terms
