"""From the samples of a channel to its deviations, their confidence, and the noise terms.

With x the running sum of the samples (x[0] = 0), m the averaging factor and d the order of the difference,
every deviation is a mean of squares of sum over a of c_a x[t + a m], c = (1, -2, 1) or (1, -3, 3, -1).  Only
differences whose whole span lies in one run of samples are taken.  The sums are compiled: in NumPy they take
three times as long (an hour of six channels at 400 Hz: 2 s), and a hundred times with a gap every 20 samples.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imumon.allan.correlated import Family, times_to_try
from imumon.allan.covariance import (
    COEFFICIENTS,
    NORMS,
    TRUSTED_FREEDOM,
    Freedom,
    Kind,
    Runs,
    covariances_of,
    freedom,
    intervals,
)
from imumon.allan.fit import LONGEST_START_S, Fit, fit_terms
from imumon.allan.parameters import NAMES
from imumon.allan.series import EvenSeries
from imumon.blocks import FloatArray, IntArray
from imumon.compiled import inner, njit
from imumon.filters.rounding import Digits, digits

_WALK = np.array([0.0, 0.0, 1.0, 0.0])
_WHITE = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """One kind of deviation at the averaging times, (n,) each; NaN where the runs are too short for it."""

    values: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What is known of the noise of one channel."""

    series: EvenSeries
    """What it was computed from."""
    tau_s: FloatArray
    """Averaging times, in octaves, (n,)."""
    allan: Deviations
    modified: Deviations
    hadamard: Deviations
    """All overlapping, with intervals of `imumon.allan.covariance.CONFIDENCE`."""
    noise: tuple[str, ...]
    """The term that the fit has most of at each averaging time."""
    fit: Fit | None
    """None when there are too few averaging times."""
    trusted: int
    """How many of the averaging times can be trusted, from the shortest on: those that had
    `TRUSTED_FREEDOM` degrees of freedom if they were a random walk of the rate, and more for every other
    noise."""
    digits: Digits | None
    """Steps of the readings, where they are not far finer than the noise."""

    @property
    def longest_tau_s(self) -> float:
        """The longest averaging time that can be trusted; NaN when there is none."""
        return float(self.tau_s[self.trusted - 1]) if self.trusted else float("nan")

    @property
    def lowest(self) -> int:
        """Index of the lowest trusted Allan deviation."""
        return int(np.argmin(self.allan.values[: max(1, self.trusted)]))


def octaves(series: EvenSeries) -> IntArray:
    """Return the averaging factors 1, 2, 4, ... for which a run is long enough."""
    factors: list[int] = []
    m = 1
    while True:
        starts, stops = series.runs(m)
        if not len(starts) or int((stops - starts).max()) < 2 * m:
            return np.array(factors, np.int64)
        factors.append(m)
        m *= 2


def variances(series: EvenSeries, factors: IntArray) -> dict[Kind, FloatArray]:
    """Return overlapping variances at averaging factors, (n,) each; NaN where no run is long enough."""
    x = np.zeros(len(series.values) + 1)
    np.cumsum(series.values - series.values.mean(), out=x[1:])
    found = np.full((len(factors), len(COEFFICIENTS)), np.nan)
    for row, m in enumerate(factors.tolist()):
        sums, numbers = all_sums(x, *series.runs(m), m)
        scale = np.array([NORMS[kind] * m ** (4 if kind == "modified" else 2) for kind in COEFFICIENTS])
        some = numbers > 0
        found[row, some] = sums[some] / numbers[some] / scale[some]
    return dict(zip(COEFFICIENTS, found.T, strict=True))


@partial(inner, fastmath={"reassoc"})
def _all_runs(x: FloatArray, start: int, positions: int, m: int, window: float) -> tuple[float, float, float]:
    """Return the sums of squares of second differences, third differences, and windows of m of the second.

    The step from one window to the next is the third difference.  The rounding of the windows stays below
    1e-9 of the result for 1e8 samples.
    """
    allan, hadamard, modified = 0.0, 0.0, window * window
    for k in range(positions):
        t = start + k
        near, far = x[t + m] - x[t], x[t + 2 * m] - x[t + m]
        second = far - near
        third = x[t + 3 * m] - x[t + 2 * m] - far - second
        allan += second * second
        hadamard += third * third
        window += third
        modified += window * window
    return allan, hadamard, modified


@njit
def all_sums(x: FloatArray, starts: IntArray, stops: IntArray, m: int) -> tuple[FloatArray, IntArray]:
    """Return sums of squares and their numbers for Allan, modified Allan and Hadamard, (3,) each.

    Parameters
    ----------
    x : array, (n + 1,)
        Running sum of the samples without their mean.
    starts, stops : arrays of int64
        Runs: samples start..stop, so that x[start] ... x[stop] belong to the run.
    """
    sums, numbers = np.zeros(3), np.zeros(3, np.int64)
    for run in range(len(starts)):
        start, length = starts[run], stops[run] - starts[run]
        second = length - 2 * m + 1
        third = max(0, second - m)
        if second >= m:
            window = 0.0
            for t in range(start, start + m):
                window += x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            allan, hadamard, modified = _all_runs(x, start, third, m, window)
            sums += np.array([allan, modified, hadamard])
            numbers[1] += third + 1
            numbers[2] += third
        for t in range(start + third, start + second):
            difference = x[t + 2 * m] - 2.0 * x[t + m] + x[t]
            sums[0] += difference * difference
        numbers[0] += max(0, second)
    return sums, numbers


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What the division of a record into runs says of the uncertainty; the same for all its channels."""

    factors: IntArray
    family: Family
    trusted: int
    freedoms: Mapping[Kind, list[Freedom | None]]


def uncertainty(series: EvenSeries) -> Uncertainty:
    """Work out the covariances of the averaging times, and what the degrees of freedom follow from."""
    factors = octaves(series)
    runs = [Runs.of(*series.runs(m), 2 * m) for m in factors.tolist()]
    freedoms: dict[Kind, list[Freedom | None]] = {}
    for kind, coefficients in COEFFICIENTS.items():
        span = len(coefficients) - (kind != "modified")
        freedoms[kind] = [
            freedom(kind, m, part) if part.lengths[-1] >= span * m else None
            for m, part in zip(factors.tolist(), runs, strict=True)
        ]
    walk = [0.0 if part is None else part.of(_WALK) for part in freedoms["allan"]]
    trusted = next((row for row, value in enumerate(walk) if value < TRUSTED_FREEDOM), len(walk))
    at = cache(partial(covariances_of, factors, runs))
    times = times_to_try(series.interval_s, LONGEST_START_S, int(factors[:trusted].max(initial=1)))
    for time in times:
        at(time)  # now, and not once in each thread
    return Uncertainty(factors, Family(times, at), trusted, freedoms)


def analyse(series: Mapping[str, EvenSeries]) -> dict[str, Result]:
    """Return deviations and noise terms of channels; what follows from the gaps is worked out once."""
    kinds = {_key(channel): channel for channel in series.values()}
    shared = {key: uncertainty(channel) for key, channel in kinds.items()}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the kernels release the interpreter
        results = threads.map(lambda channel: _analyse(channel, shared[_key(channel)]), series.values())
        return dict(zip(series, results, strict=True))


def _key(series: EvenSeries) -> tuple[bytes, ...]:
    """Return what two channels have in common whose samples are missing at the same places."""
    return tuple(part.tobytes() for part in (series.islands, series.gap_starts, series.gap_lengths))


def _kurtosis(samples: FloatArray) -> float:
    """Return the excess kurtosis of white noise, by differences of neighbours: theirs is half of it."""
    square = np.square(np.diff(samples))
    mean = float(square.mean())
    return max(2.0 * (float(np.square(square).mean()) / mean**2 - 3.0), 0.0) if mean else 0.0


def _analyse(series: EvenSeries, known: Uncertainty) -> Result:
    factors = known.factors
    found = variances(series, factors)
    fit = fit_terms(found["allan"], known.family, series.interval_s, known.trusted - 1)
    samples = series.values[series.there]
    found_digits = digits(samples)
    if fit is not None:
        fit = fit.less_certain(math.sqrt(_kurtosis(samples) / len(samples)), [NAMES[0]])
        fit = fit if found_digits is None else fit.less_certain(found_digits.error)
        fit = fit.with_missing(float(1.0 - series.there.mean()))
    noise = _WHITE if fit is None or not fit.coefficients[:4].any() else fit.coefficients[:4]
    found_intervals = {
        kind: _intervals(values, [part.of(noise) if part else 0.0 for part in known.freedoms[kind]])
        for kind, values in found.items()
    }
    names: tuple[str, ...] = ()
    if fit is not None:
        m = factors.astype(np.float64)
        names = tuple(NAMES[row] for row in fit.shares(m).argmax(axis=1))
    tau_s = factors.astype(np.float64) * series.interval_s
    return Result(
        series, tau_s, **found_intervals, noise=names, fit=fit, trusted=known.trusted, digits=found_digits
    )


def _intervals(values: FloatArray, freedoms: list[float]) -> Deviations:
    edf = np.where(np.isfinite(values), np.array(freedoms), np.nan)
    edf[edf <= 0.0] = np.nan
    return Deviations(np.sqrt(values), *intervals(values, edf))
