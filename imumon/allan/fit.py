"""The noise terms behind a curve of Allan variances, with their uncertainties.

The variances are a sum of known shapes with coefficients that are not negative.  They are fitted by
generalised least squares whose covariance matrix, over all averaging times together, is that of the fitted
noise itself, until both agree: the quasi-likelihood of variances.  No slope is picked by eye.

A variance is distributed about as chi-square, and so its cube root about normally (Wilson and Hilferty 1931):
whether a sum of terms describes the curve, and which one does so better, is tested by that.  By the variance
itself no curve could be too low for a large random walk, which makes the variance of its variances large.

1. `usable_range`: the shortest averaging times are left out where a filter of the device has shaped them, the
   longest where something else than noise has, such as a vibration; or the curve gets a model error.
2. `with_correlated`: a first-order Gauss-Markov process is a term where the curve is far less likely without:
   with a correlation time that is short or long enough it can stand for any other term.
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

import math
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.special import gammaincc

from imumon.blocks import FloatArray

from .covariance import FLOOR_PER_INSTABILITY, NAMES, Covariances, shapes_at
from .series import LONGEST_START_S, Division

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
FITTED, SHORT_FITTED = 2.0, 3.0
"""A term is in the fit when the data call for it by this many standard deviations; the second number is that
of quantization and filter, at the short averaging times: with 2 the error of N in white noise is a quarter
larger."""
SHOWN = 3.5
"""A term is in the result when the data call for it by so many standard deviations; noise alone does that
once in some hundred curves."""
BEYOND_FILTER = 1
"""Octaves that are left out besides: chi-square does not see the end of a filter, and the error of N would be
up to 4.8 of its standard deviations (rms); with one octave it is up to 1.1."""
FILTERED = 1.02
"""A filter takes noise away: what is left out for it may not lie higher above what the terms predict."""
NO_SUM = 0.4
"""With a larger model error nothing is known of the terms from the whole curve: a sine of any size puts
angle random walk or quantization in the place of its own bump."""
ROUNDS, CLOSE, LARGEST_ERROR = 8, 0.05, 3.0
"""The model error is found to 5 %: chi-square falls with its square where it counts."""
FEWEST, FEWEST_BEFORE = 5, 4
"""Averaging times that a fit must keep; and that one before a disturbance must have."""
WITHIN = 0.25
"""A process whose correlation time is a longer part of the longest trusted averaging time is, as far as the
curve goes, a random walk: its highest point, at 1.89 times the correlation time, would have to be passed."""
WITH_MARKOV = (*EVERY, MARKOV)
ALIKE = frozenset((FLICKER, WALK))
"""Each of these can stand in the place of the other at the longest averaging times."""

AMBIGUOUS, DIGITS = "ambiguous", "digits"


class Solution(NamedTuple):
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
        return float(wanted @ self.residual / np.linalg.norm(beyond))


class Problem(NamedTuple):
    """Variances from one averaging time to another, with the covariance of each set of coefficients."""

    variances: FloatArray  # at all trusted averaging times, (n,)
    covariances: Covariances  # at these and maybe further ones
    start: int
    stop: int  # the averaging times that are to be described: start..stop, without the last
    model_error: float = 0.0  # part of each variance that no sum of the terms describes

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
        spread = 2.0 * np.log(np.diag(root)).sum() + 4.0 / 3.0 * np.log(ratio).sum()
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


class Estimate(NamedTuple):
    """A number and its standard deviation."""

    value: float
    sd: float


class Fit(NamedTuple):
    """The terms of one channel."""

    terms: dict[str, Estimate | None]
    """By `NAMES`; None for what the data do not show."""
    coefficients: FloatArray
    """Allan variance at one sample of all that was fitted, and the variance of the correlated noise, (6,);
    that of quantization is negative where a filter in the device takes away more than quantization adds."""
    time: float
    """Correlation time of the correlated noise, samples, where there is any."""
    first: int
    last: int
    """The averaging times that were fitted: first..last.  Where `last` is not the longest trusted one, no
    sum of the terms describes the longer ones, and only the angle random walk is reported."""
    model_error: float
    """Part of each variance by which the curve differs from any sum of the terms beyond its noise, as far
    as the fit can determine; it is in the standard deviations.  0 when chi-square is in order; above `NO_SUM`
    no term is reported."""
    withheld: str = ""
    """`AMBIGUOUS`: bias instability and random walk are not reported, because noise that is correlated for a
    while would be as likely.  `DIGITS`: nothing is, because the steps of the readings hide the noise."""

    def shares(self, m: FloatArray) -> FloatArray:
        """Return the Allan variance that each of the first six terms makes at averaging factors, (n, 6)."""
        return shapes_at(m, self.time) * self.coefficients


def fit_terms(variances: FloatArray, division: Division, interval_s: float) -> Fit | None:
    """Fit the terms to Allan variances at the trusted averaging factors; None if too few."""
    n = division.trusted
    if n < 2 or not np.all(variances[:n] > 0.0):
        return None
    whole = Problem(variances[:n], division.at(division.times[0]), 0, n)
    usable = usable_range(whole, interval_s)
    described = usable.model_error == 0.0 and usable.stop == n
    correlated = with_correlated(usable if described else whole, division)
    problem = correlated or usable
    smallest = smallest_set(problem, EVERY if correlated is None else WITH_MARKOV)
    alike = ALIKE if smallest.columns & ALIKE else frozenset()
    fitted = smallest.columns | alike | ({FILTER} if problem.start else frozenset())
    solution = problem.fit(fitted)
    shown = [column for column in sorted(solution.columns) if _is_shown(problem, smallest, column)]
    withheld = ""
    if problem.model_error > NO_SUM:
        shown = []
    elif problem.stop < n:
        shown = [column for column in shown if column == WHITE]
    elif described and not correlated and ALIKE & {*shown} and may_be_correlated(problem, division, smallest):
        withheld, shown = AMBIGUOUS, [column for column in shown if column not in ALIKE]
    sd = solution.sd({*fitted, TIME} if correlated else fitted)
    terms: dict[str, Estimate | None] = dict.fromkeys(NAMES)
    # Squares of the terms per unit of their coefficients, the Allan variances at one sample.
    dt, flat = interval_s, FLOOR_PER_INSTABILITY**-2
    squares = (dt, flat, 3.0 / dt, dt**2 / 3.0, 2.0 / dt**2, 1.0)
    for column in shown:
        coefficient = float(solution.coefficients[column])
        value = math.sqrt(coefficient * squares[column])
        terms[NAMES[column]] = Estimate(value, 0.5 * value * sd[column] / coefficient)
        if column == MARKOV:
            time_s = problem.covariances.time * interval_s
            terms[NAMES[-1]] = Estimate(time_s, time_s * sd[TIME] / coefficient)
    return Fit(
        terms,
        signed(solution.coefficients),
        problem.covariances.time,
        problem.start,
        problem.stop - 1,
        problem.model_error,
        withheld,
    )


def usable_range(whole: Problem, interval_s: float) -> Problem:
    """Return the averaging times to fit, with the model error that is left.

    The shortest averaging times are left out, one by one, while no sum of the terms describes the curve: a
    low-pass filter of the device lowers those that are not longer than itself, by a little longer ones as
    well.  What still does not fit becomes a model error: a part of every variance, so that the many samples
    behind the short averaging times do not outvote the long ones.  When that is large, the averaging times
    before the disturbance are used.
    """
    n, tried = whole.stop, [_with_model_error(whole)]
    for start in range(1, n - FEWEST + 1):
        if tried[-1].model_error == 0.0 or whole.covariances.m[start] * interval_s > LONGEST_START_S:
            break
        part = _with_model_error(whole._replace(start=start))
        if _is_filtered(part):
            tried.append(part)
    best = min(tried, key=lambda part: part.model_error)
    if best.model_error > NO_SUM:
        # What disturbs the longer averaging times, such as a sine, begins like a ramp.  The last that would
        # do is not taken: chi-square does not see a disturbance that has only just begun.
        for stop in range(n - 1, FEWEST_BEFORE, -1):
            if whole._replace(stop=stop).fit(EVERY).is_good():
                return whole._replace(stop=stop - 1)
    return best._replace(start=min(best.start + BEYOND_FILTER, n - FEWEST)) if best.start else best


def _with_model_error(problem: Problem) -> Problem:
    """Return a problem with the error, if any, that brings chi-square to its degrees of freedom."""
    if problem.fit(EVERY).is_good():
        return problem
    problem = problem._replace(model_error=1.0)
    for _ in range(ROUNDS):
        solution = problem.fit(EVERY)
        change = math.sqrt(solution.chi_square / solution.degrees_of_freedom)
        problem = problem._replace(model_error=min(problem.model_error * change, LARGEST_ERROR))
        if abs(change - 1.0) < CLOSE:
            break
    return problem


def _is_filtered(part: Problem) -> bool:
    """Return whether what was left out lies below what the terms predict of it, as behind a low-pass filter.

    Quantization is none behind a filter; where it is called for, it stands for the end of a bump.
    """
    coefficients = part.fit(EVERY).coefficients
    expected = part.design[: part.start, :FILTER] @ coefficients[:FILTER]
    below = np.all(part.variances[: part.start] <= FILTERED * expected)
    return coefficients[QUANTIZATION] == 0.0 and bool(below)


def with_correlated(plain: Problem, division: Division) -> Problem | None:
    """Return a problem with the covariances of the likeliest correlation time.

    None where the other terms alone make the variances about as likely.
    """
    likelihood = partial(_likelihood, plain, division, WITH_MARKOV)
    longest = plain.covariances.m[plain.stop - 1]
    tried = {time: likelihood(time) for time in division.times if time <= longest}
    # As much as of any term; and of so many correlation times one does well by chance.
    needed = plain.fit(EVERY).log_likelihood + 0.5 * SHOWN**2 + math.log(len(division.times))
    best = max(tried, key=tried.__getitem__, default=0.0)
    if not tried or tried[best] < needed:
        return None
    half = math.sqrt(2.0)
    left, right = likelihood(best / half), likelihood(best * half)
    bend, slope, _ = np.polyfit((-1.0, 0.0, 1.0), (left, tried[best], right), 2)
    peak = np.clip(-0.5 * slope / bend, -1.0, 1.0) if bend < 0.0 else np.sign(slope)
    found = plain._replace(covariances=division.at(best * half ** float(peak)))
    solution = found.fit(WITH_MARKOV)
    is_likely = solution.log_likelihood >= needed and solution.is_good()
    return found if is_likely and solution.columns >= {WHITE, MARKOV} else None


def may_be_correlated(plain: Problem, division: Division, smallest: Solution) -> bool:
    """Return whether a process short enough to show, in place of flicker and random walk, is as likely."""
    needed, longest = plain.fit(EVERY).log_likelihood, plain.covariances.m[plain.stop - 1]
    columns = smallest.columns - ALIKE | {MARKOV}
    times = [time for time in division.times if time <= WITHIN * longest]
    return any(_likelihood(plain, division, columns, time) > needed for time in times)


def _likelihood(plain: Problem, division: Division, columns: Iterable[int], time: float) -> float:
    """Return the log likelihood of these terms with a correlation time, samples."""
    return plain._replace(covariances=division.at(time)).fit(columns).log_likelihood


def smallest_set(problem: Problem, every: Sequence[int]) -> Solution:
    """Return the fit of the smallest set of these terms that leaves no other called for.

    Of several the likeliest.  One piece of a random walk resembles a ramp, which must be more likely by as
    much as a term that is shown.
    """

    def is_complete(solution: Solution) -> bool:
        return not any(
            solution.called_for(column) > (SHORT_FITTED if column in (QUANTIZATION, FILTER) else FITTED)
            for column in {*every} - solution.columns
        )

    for size in range(1, len(every) - 1):
        solutions = map(problem.fit, combinations(every, size))
        if found := [each for each in solutions if len(each.columns) == size and is_complete(each)]:
            return max(found, key=lambda one: one.log_likelihood - 0.5 * SHOWN**2 * (RAMP in one.columns))
    return problem.fit(every)


def _is_shown(problem: Problem, smallest: Solution, column: int) -> bool:
    """Return whether the fit without a term calls for it, whatever may stand for it."""
    if column in (FILTER, MARKOV):
        return column == MARKOV
    others = (smallest.columns | (ALIKE if column in ALIKE else frozenset())) - {column}
    return not others or problem.fit(others).called_for(column) > SHOWN
