"""Noise that is correlated for a while: a first-order Gauss-Markov process beside the other terms.

Its correlation time is the likeliest of a grid of octaves, refined by a parabola.  The process is reported
only where the curve is far less likely without it: with a correlation time that is short or long enough it
can stand for any other term.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from imumon.allan.covariance import Covariances, markov_shape
from imumon.allan.problem import EVERY, MARKOV, WHITE, WITH_MARKOV, Problem, Solution, inverse_information
from imumon.blocks import FloatArray

SHOWN = 3.5
"""A term is in the result when the data call for it by so many standard deviations; noise alone does that
once in some hundred curves."""
LEAST_TIME = 4.0
"""Samples: a shorter correlation cannot be distinguished from white noise behind a filter."""
WITHIN = 0.25
"""A process whose correlation time is a longer part of the longest trusted averaging time is, as far as the
curve goes, a random walk: its highest point, at 1.89 times the correlation time, would have to be passed."""
STEP = 1.01
"""Ratio of the correlation times between which the derivative by the time is taken."""


def times_to_try(interval_s: float, shortest_s: float, longest: int) -> list[float]:
    """Return correlation times in octaves, samples: beyond a filter, to the longest averaging time."""
    first = math.log2(max(shortest_s / interval_s, LEAST_TIME))
    last = max(math.log2(longest), first)
    return [float(time) for time in 2.0 ** np.arange(first, last + 1e-9)]


class Family(NamedTuple):
    """The covariances of a curve by correlation time, samples, and the times that are tried, upwards."""

    times: list[float]
    at: Callable[[float], Covariances]


def find_correlated(plain: Problem, family: Family) -> tuple[float, Problem] | None:
    """Return a correlation time, samples, and the problem with its covariances.

    None where the other terms alone make the variances about as likely.

    Parameters
    ----------
    plain : Problem
        The variances that are to be described, at some of the averaging times of the family.
    """

    def likelihood(time: float) -> float:
        return plain.with_covariances(family.at(time)).fit(WITH_MARKOV).log_likelihood

    longest = float(plain.covariances.m[-1])
    tried = {time: likelihood(time) for time in family.times if time <= longest}
    # As much as of any term; and of so many correlation times one does well by chance.
    needed = plain.fit(EVERY).log_likelihood + 0.5 * SHOWN**2 + math.log(len(family.times))
    best = max(tried, key=lambda time: tried[time], default=0.0)
    if not tried or tried[best] < needed:
        return None
    half = math.sqrt(2.0)
    time = best * half ** _peak(likelihood(best / half), tried[best], likelihood(best * half))
    problem = plain.with_covariances(family.at(time))
    solution = problem.fit(WITH_MARKOV)
    beside_white = solution.coefficients[WHITE] > 0.0 and solution.coefficients[MARKOV] > 0.0
    is_likely = solution.log_likelihood >= needed and solution.is_good()
    return (time, problem) if is_likely and beside_white else None


def uncertainty(problem: Problem, solution: Solution, time: float) -> tuple[FloatArray, float]:
    """Return the covariance of the coefficients, (7, 7), and the variance of the logarithm of the time."""
    active = np.flatnonzero(np.diag(solution.covariance)).tolist()
    m = problem.covariances.m.astype(np.float64)
    longer, shorter = markov_shape(m, time * STEP), markov_shape(m, time / STEP)
    slope = solution.coefficients[MARKOV] * (longer - shorter) / (2.0 * math.log(STEP))
    design = np.column_stack([problem.design[:, active], slope])
    inverse = inverse_information(design, solution.factor)
    covariance = np.zeros_like(solution.covariance)
    covariance[np.ix_(active, active)] = inverse[:-1, :-1]
    return covariance, float(inverse[-1, -1])


def may_be_correlated(plain: Problem, family: Family, columns: Iterable[int]) -> bool:
    """Return whether these terms and a process short enough to show are as likely as all terms alone."""
    needed, longest = plain.fit(EVERY).log_likelihood, float(plain.covariances.m[-1])
    problems = [plain.with_covariances(family.at(t)) for t in family.times if t <= WITHIN * longest]
    return any(problem.fit({*columns, MARKOV}).log_likelihood > needed for problem in problems)


def _peak(left: float, middle: float, right: float) -> float:
    """Return where a parabola through three values is highest, in steps from the middle; one at the most."""
    bend = left - 2.0 * middle + right
    if bend >= 0.0:
        return 1.0 if right > left else -1.0
    return min(max(0.5 * (left - right) / bend, -1.0), 1.0)
