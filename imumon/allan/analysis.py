"""From the samples of a channel to its deviations, their confidence, and the noise terms.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.  The sums are compiled: in NumPy they take
three times as long (an hour of six channels at 400 Hz: 2 s), and a hundred times with a gap every 20 samples.
"""

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.filters.rounding import Digits, digits

from .covariance import DIFFERENCES, NAMES, Kind, freedom, intervals
from .fit import DIGITS, NO_SUM, Estimate, Fit, fit_terms
from .series import Division, EvenSeries


class Deviations(NamedTuple):
    """One kind of deviation at the averaging times, (n,) each; NaN where the runs are too short for it."""

    values: FloatArray
    low: FloatArray
    high: FloatArray


class Result(NamedTuple):
    """What is known of the noise of one channel."""

    series: EvenSeries
    """What it was computed from."""
    tau_s: FloatArray
    """Averaging times, in octaves, (n,)."""
    allan: Deviations
    modified: Deviations
    hadamard: Deviations
    """Overlapping, with intervals of `imumon.allan.covariance.CONFIDENCE`."""
    noise: list[str]
    """The term that the fit has most of at each averaging time."""
    fit: Fit | None
    """None when there are too few averaging times."""
    trusted: int
    """How many of the averaging times can be trusted, from the shortest on: those that had
    `TRUSTED_FREEDOM` degrees of freedom if they were a random walk of the rate, and more for every other
    noise."""
    digits: Digits | None
    """Steps of the readings, where they are not far finer than the noise."""

    def term(self, name: str) -> Estimate | None:
        """Return a term, by `NAMES`; None where the data do not show it."""
        return None if self.fit is None else self.fit.terms[name]

    @property
    def longest_tau_s(self) -> float:
        """The longest averaging time that can be trusted; NaN when there is none."""
        return float(self.tau_s[self.trusted - 1]) if self.trusted else float("nan")

    @property
    def lowest(self) -> int:
        """Index of the lowest trusted Allan deviation."""
        return int(np.argmin(self.allan.values[: max(1, self.trusted)]))


def variances(series: EvenSeries, factors: IntArray) -> dict[Kind, FloatArray]:
    """Return overlapping variances at averaging factors, (n,) each; NaN where no run is long enough."""
    x = np.zeros(len(series.values) + 1)
    np.cumsum(series.values - series.values.mean(), out=x[1:])
    found = np.full((len(factors), len(DIFFERENCES)), np.nan)
    for row, m in enumerate(factors.tolist()):
        sums, numbers = sums_of_squares(x, *series.runs(m), m)
        scale = np.array([each.norm * float(m) ** (2 * each.integrals) for each in DIFFERENCES.values()])
        some = numbers > 0
        found[row, some] = sums[some] / numbers[some] / scale[some]
    return dict(zip(DIFFERENCES, found.T, strict=True))


@partial(njit, fastmath={"reassoc"})
def sums_of_squares(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[FloatArray, IntArray]:
    """Return sums of squares and their numbers for Allan, modified Allan and Hadamard, (3,) each.

    The modified one takes sums of m second differences; from one such sum to the next the step is the third
    difference.  Their rounding stays below 1e-9 of the result for 1e8 samples.

    `x` (n + 1,): running sum of the samples without their mean.
    `starts`, `stops` (k,): runs: samples start..stop, so that x[start] ... x[stop] belong to the run.
    """
    sums, numbers = np.zeros(3), np.zeros(3, np.int64)
    for run in range(len(starts)):
        start = starts[run]
        seconds = max(0, stops[run] - start - 2 * m + 1)
        thirds = max(0, seconds - m)
        allan, modified, hadamard, window = 0.0, 0.0, 0.0, 0.0
        for t in range(start, start + m if seconds >= m else start):
            window += x[t + 2 * m] - 2.0 * x[t + m] + x[t]
        for t in range(start, start + thirds):
            second = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            third = x[t + 3 * m] - 2.0 * x[t + 2 * m] + x[t + m] - second
            allan += second * second
            modified += window * window
            hadamard += third * third
            window += third
        for t in range(start + thirds, start + seconds):
            second = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            allan += second * second
        sums += np.array([allan, modified + window * window, hadamard])
        numbers += np.array([seconds, thirds + (seconds >= m), thirds])
    return sums, numbers


def analyse(series: Mapping[str, EvenSeries]) -> dict[str, Result]:
    """Return deviations and noise terms of channels; what follows from the gaps is worked out once."""
    # Channels whose samples are missing at the same places share these arrays (`even_channels`).
    kinds = {id(channel.islands): channel for channel in series.values()}
    divisions = {key: Division(channel) for key, channel in kinds.items()}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the kernels release the interpreter
        results = threads.map(lambda one: _analyse(one, divisions[id(one.islands)]), series.values())
        return dict(zip(series, results, strict=True))


def _analyse(series: EvenSeries, division: Division) -> Result:
    factors = division.factors
    found = variances(series, factors)
    fit = fit_terms(found["allan"], division, series.interval_s)
    samples = series.values[series.there]
    steps = digits(samples)
    noise, names = np.array([1.0, 0.0, 0.0, 0.0]), list[str]()  # white alone where nothing is fitted
    if fit is not None:
        fit = _less_certain(fit, samples, steps, 1.0 - series.there.mean())
        found_noise = np.maximum(fit.coefficients[:4], 0.0)
        noise = found_noise if found_noise.any() else noise
        names = [NAMES[row] for row in fit.shares(factors.astype(np.float64)).argmax(axis=1)]
    deviations = {}
    for kind, values in found.items():
        edf = [freedom(kind, m, runs, noise) for m, runs in zip(factors.tolist(), division.runs, strict=True)]
        known = np.where(np.isfinite(values) & (np.array(edf) > 0.0), edf, np.nan)
        deviations[kind] = Deviations(np.sqrt(values), *intervals(values, known))
    tau_s = factors.astype(np.float64) * series.interval_s
    return Result(series, tau_s, **deviations, noise=names, fit=fit, trusted=division.trusted, digits=steps)


def _less_certain(fit: Fit, samples: FloatArray, steps: Digits | None, missing: float) -> Fit:
    """Return a fit with what the covariance of normal noise does not know of in its standard deviations.

    That are tails of the samples, (n,), their steps, and missing ones, a share: means of fewer have more
    white noise.  That is corrected on average only: shorter averaging times do not cross gaps.
    """
    if steps is not None and steps.error > NO_SUM:
        return fit._replace(terms=dict.fromkeys(NAMES), withheld=DIGITS)
    error = math.hypot(0.0 if steps is None else steps.error, min(0.5 * missing, NO_SUM))
    terms = {
        name: None if term is None else Estimate(term.value, math.hypot(term.sd, 0.5 * error * term.value))
        for name, term in fit.terms.items()
    }
    if (white := terms[NAMES[0]]) is not None:
        square = np.square(np.diff(samples))
        # The excess kurtosis of white noise is twice that of the differences of neighbours.
        kurtosis = max(2.0 * (np.square(square).mean() / square.mean() ** 2 - 3.0), 0.0)
        tails = 0.5 * math.sqrt(kurtosis / len(samples)) * white.value
        terms[NAMES[0]] = Estimate(math.sqrt(1.0 - missing) * white.value, math.hypot(white.sd, tails))
    return fit._replace(terms=terms)
