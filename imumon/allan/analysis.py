"""From the samples of a channel to its deviations, their confidence, and the noise terms."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from imumon.allan.confidence import TRUSTED_FREEDOM, intervals
from imumon.allan.correlated import Family, times_to_try
from imumon.allan.covariance import (
    COEFFICIENTS,
    NORMS,
    Freedom,
    Kind,
    Runs,
    covariances_of,
    freedom,
)
from imumon.allan.fit import LONGEST_START_S, Fit, fit_terms
from imumon.allan.kernels import all_sums, integrate
from imumon.allan.parameters import NAMES
from imumon.allan.series import EvenSeries
from imumon.blocks import FloatArray, IntArray
from imumon.filters.rounding import Digits, digits

_WALK = np.array([0.0, 0.0, 1.0, 0.0])
_WHITE = np.array([1.0, 0.0, 0.0, 0.0])
MISSING = 2.0
"""Part of the variance by which the terms are less certain, over the square of the share of samples that are
missing: without it N and B err by up to 2.9 sigma (rms) where three tenths are missing."""


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """One kind of deviation at the averaging times, (n,) each; NaN where the runs are too short for it."""

    values: FloatArray
    low: FloatArray
    high: FloatArray
    freedom: FloatArray


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
    """All overlapping, with intervals of `imumon.allan.confidence.CONFIDENCE`."""
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
    x = integrate(series.values, float(series.values.mean()))
    found = np.full((len(factors), len(COEFFICIENTS)), np.nan)
    for row, m in enumerate(factors.tolist()):
        sums, numbers = all_sums(x, *series.runs(m), m)
        scale = np.array(
            [NORMS[kind] * m**2 * (m**2 if kind == "modified" else 1.0) for kind in COEFFICIENTS]
        )
        some = numbers > 0
        found[row, some] = sums[some] / numbers[some] / scale[some]
    return dict(zip(COEFFICIENTS, found.T, strict=True))


def _white_gain(series: EvenSeries, factors: IntArray) -> FloatArray:
    """Return by what missing samples multiply the variance of white noise, (n,): of m samples as many fewer
    are in a mean as are missing within the runs."""
    count = np.concatenate([[0], np.cumsum(series.there)])
    found = []
    for m in factors.tolist():
        starts, stops = series.runs(m)
        found.append(float((stops - starts).sum()) / float((count[stops] - count[starts]).sum()))
    return np.array(found)


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
    at = cache(partial(covariances_of, factors, runs, _white_gain(series, factors)))
    times = times_to_try(series.interval_s, LONGEST_START_S, int(factors[:trusted].max(initial=1)))
    for time in times:
        at(time)  # now, and not once in each thread
    return Uncertainty(factors, Family(times, at), trusted, freedoms)


def analyse(series: Mapping[str, EvenSeries]) -> dict[str, Result]:
    """Return deviations and noise terms of channels; what follows from the gaps is worked out once."""
    shared: dict[tuple[bytes, ...], Uncertainty] = {}
    for channel in series.values():
        key = _key(channel)
        if key not in shared:
            shared[key] = uncertainty(channel)
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
        fit = fit.less_certain(MISSING * (1.0 - series.there.mean()) ** 2)
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
    return Deviations(np.sqrt(values), *intervals(values, edf), edf)
