"""Noise that is correlated for a while: a first-order Gauss-Markov process beside the other terms.

Its correlation time is found by likelihood, on a grid of octaves and then by a parabola.  Every other sum of
terms can also be a sum with such a process, which then has no part in it: it is one only where the curve is
so much less likely without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.allan.covariance import Covariances, Family, markov_shape
from imumon.allan.problem import (
    EVERY,
    MARKOV,
    WHITE,
    WITH_MARKOV,
    Problem,
    Solution,
    inverse_information,
)
from imumon.blocks import FloatArray

SHOWN = 3.5
"""A term is in the result when the data call for it by so many standard deviations; noise alone does that
once in some hundred curves."""
LEAST_TIME = 4.0
"""Samples: a shorter correlation cannot be told from white noise behind a filter."""
WITHIN = 0.25
"""A process whose correlation time is a longer part of the longest trusted averaging time is, as far as the
curve goes, a random walk: its highest point, at 1.89 times the correlation time, would have to be passed."""


def times_to_try(interval_s: float, shortest_s: float, longest: int) -> FloatArray:
    """Return correlation times in octaves, samples, (g,): beyond a filter, to the longest averaging time."""
    first = math.log2(max(shortest_s / interval_s, LEAST_TIME))
    return np.asarray(2.0 ** np.arange(first, math.log2(max(longest, 1)) + 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class Correlated:
    """The correlation time, samples, and the covariances that go with it."""

    time: float
    covariances: Covariances

    def uncertainty(self, problem: Problem, solution: Solution) -> tuple[FloatArray, float]:
        """Return the covariance of the coefficients, and the variance of the logarithm of the time."""
        active = np.flatnonzero(np.diag(solution.covariance)).tolist()
        m = problem.covariances.m.astype(np.float64)
        near = 1.01
        longer, shorter = markov_shape(m, self.time * near), markov_shape(m, self.time / near)
        slope = solution.coefficients[MARKOV] * (longer - shorter) / (2.0 * math.log(near))
        inverse = inverse_information(np.column_stack([problem.design[:, active], slope]), solution.factor)
        covariance = np.zeros_like(solution.covariance)
        covariance[np.ix_(active, active)] = inverse[:-1, :-1]
        return covariance, float(inverse[-1, -1])


class Search:
    """Looks for a correlation time by which the variances of a curve are far more likely than without.

    Parameters
    ----------
    variances : array, (k,)
        At the averaging factors start..n of the family, n = start + k.
    """

    def __init__(self, variances: FloatArray, family: Family, start: int) -> None:
        self._variances, self._family, self._start = variances, family, start
        self._without = self._problem(family.of(None)).fit(EVERY)
        longest = float(family.m[start + len(variances) - 1])
        # As of a term; and of so many correlation times one does well by chance.
        self._needed = 0.5 * SHOWN**2 + math.log(max(len(family.times), 1))
        self._grid = [row for row, time in enumerate(family.times.tolist()) if time <= longest]
        self._short = [row for row in self._grid if family.times[row] <= WITHIN * longest]

    def _problem(self, covariances: Covariances) -> Problem:
        stop = self._start + len(self._variances)
        return Problem(self._variances, covariances.part(self._start, stop))

    def found(self) -> Correlated | None:
        """Return the process, where there is one and the terms with it describe the curve."""
        likely = np.array([self._likelihood(self._family.of(row)) for row in self._grid])
        if not len(likely) or self._gain(likely.max()) < self._needed:
            return None
        best = int(np.argmax(likely))
        exponent = math.log2(float(self._family.times[self._grid[best]]))
        left, right = (self._likelihood(self._family.at(2.0 ** (exponent + off))) for off in (-0.5, 0.5))
        exponent += 0.5 * _top(left, float(likely[best]), right)
        covariances = self._family.at(2.0**exponent)
        solution = self._problem(covariances).fit(WITH_MARKOV)
        beside_white = solution.coefficients[WHITE] > 0.0 and solution.coefficients[MARKOV] > 0.0
        is_likely = self._gain(solution.log_likelihood) >= self._needed
        if not (is_likely and beside_white and solution.is_good(others=1)):
            return None
        return Correlated(2.0**exponent, covariances)

    def stands_for(self, others: tuple[int, ...]) -> bool:
        """Return whether all is as likely with these terms and a process too short to show."""
        columns = (*others, MARKOV)
        return any(
            self._gain(self._problem(self._family.of(row)).fit(columns).log_likelihood) > 0.0
            for row in self._short
        )

    def _likelihood(self, covariances: Covariances) -> float:
        return self._problem(covariances).fit(WITH_MARKOV).log_likelihood

    def _gain(self, log_likelihood: float) -> float:
        return log_likelihood - self._without.log_likelihood


def _top(left: float, middle: float, right: float) -> float:
    """Return where a parabola through three values is highest, in steps from the middle; one at the most."""
    bend = left - 2.0 * middle + right
    if bend >= 0.0:
        return 1.0 if right > left else -1.0
    return min(max(0.5 * (left - right) / bend, -1.0), 1.0)
