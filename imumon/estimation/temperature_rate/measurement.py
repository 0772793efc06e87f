"""What the readings of a slot say to each filter of the bank: its states given them, and their probability.

A slot's readings are one of three kinds.

- *one level*: the temperature is inside it, away from the edges by what the noise demands.  Where a
  prediction is sharper than the noise, each such slot is a measurement.  Where it is not, the same interval
  says nothing new every second: it is applied to what is shown (`merged`), and taken into the state only
  when the prediction grows fast, has grown wider than the level, or contradicts it.
- *two levels*: the share of the upper one weighs the boundary between them.  Where a filter moves so fast
  that noise does not matter, the time of the crossing is the measurement.
- *more*: the mean is the measurement.

A single reading, as of a thermometer that is refreshed slowly, is one of these with the reading before it.

That is what the level kinds hear.  The mean and slow kinds take the mean of any slot with its errors.
Probabilities are those of the lattice that the mean of a slot's independent readings can take, whatever the
kind, so that all can be compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.compiled import inner, njit
from imumon.estimation.temperature_rate.bank import (
    LEVELS,
    SMOOTHNESSES,
    WALKED_S,
    WHITE,
    Filter,
    Filters,
    Slow,
    condition,
)
from imumon.estimation.temperature_rate.moments import ROOT_2_PI, truncated, weigh
from imumon.estimation.temperature_rate.sensor import Reading, Sensor

SWEEP = 4.0
"""A crossing is timed where the temperature moves by so many noise deviations within a slot."""
CROWDED = 1.8
"""∫ φ²/(Φ(1 - Φ)): readings d °C apart that pass an edge locate it with a variance of d σ over this."""
SHARPER = 2.0
"""A prediction sharper than so many noise deviations sees the edge of a level as soft."""
WIDER = 1.5
"""A prediction wider than so many steps is replaced by the level."""
GROWN = 0.1
"""So is one that grows wider by so many steps from slot to slot: to stay is news then."""
SURPRISE = math.log(0.02)
"""So is one that has less than this log probability to be inside."""
EDGE = 1.5
"""Readings that do not flicker keep the temperature so many noise deviations from the edge."""
TINY = 1e-6
IMPOSSIBLE = -60.0
"""Least log probability relative to the best filter's: none is lost for ever."""

Moments = tuple[float, float, float]
"""Mean and variance of the reading without steps, and log probability of what was read."""
NO_STEP, MANY, STAY, FLICKER = range(4)


class Said(NamedTuple):
    """What a slot's readings say, as all filters need it; °C, °C², s."""

    case: int
    """NO_STEP of the sensor is known; MANY levels; STAY on one; FLICKER between two, or cross."""
    step: float
    duration_s: float
    gap_s: float
    mean: float
    linear: float
    """Of the readings, and with the quantizer's ripple taken off."""
    independent: float
    """Independent readings, 1 at least."""
    levels: float
    """Levels that were read."""
    white: float
    """Variance of the mean."""
    cell: float
    """Between values that the mean can have."""
    edge: float = 0.0
    """FLICKER: between the two levels."""
    above: float = 0.0
    below: float = 0.0
    """Independent readings on either side of it."""
    lattice: float = 0.0
    """Log of the number of orders in which they can come."""
    readings: float = 0.0
    changes: int = 0
    since_s: float = 0.0
    """Readings, how many of them differ from the one before, and time from a single crossing to the
    middle."""
    upward: bool = False
    """The direction of a single crossing."""


def said(reading: Reading, sensor: Sensor) -> Said:
    """Return what a slot with readings says."""
    step, low, high, independent = sensor.step, reading.low, reading.high, sensor.independent(reading)
    if math.isfinite(reading.before):
        low, high = min(low, reading.before), max(high, reading.before)
    count = max(independent, 1.0)
    # A reading that is repeated over m slots has a variance of m times what its slots show, and counts once.
    repeats = 1.0 / min(independent, 1.0)
    case = NO_STEP
    if step:
        case = MANY if high - low > 1.5 * step else STAY if high - low < 0.5 * step else FLICKER
        # A leap says no more than the level where it ends.
        case = STAY if case == MANY and reading.count == 1 else case
    plain = Said(
        case=case,
        step=step,
        duration_s=reading.duration_s,
        gap_s=reading.gap_s,
        mean=reading.mean,
        linear=sensor.linear(reading),
        independent=count,
        levels=(reading.high - reading.low) / step + 1.0 if step else 1.0,
        white=sensor.roughness * repeats**2,
        cell=step / count,
        changes=reading.changes,
    )
    return _with_shares(plain, reading, low, high) if case == FLICKER else plain


def _with_shares(plain: Said, reading: Reading, low: float, high: float) -> Said:
    """Add how the readings of two neighbouring levels are shared between them, and when a crossing was."""
    count, total = reading.count, reading.count * reading.mean
    crossed_between = math.isfinite(reading.before) and reading.before != reading.first
    if crossed_between:
        # The level changed between two slots: the last reading of the other belongs to the crossing.
        count, total = count + 1, total + reading.before
    share = min(max((total / count - low) / (high - low), 0.5 / count), 1.0 - 0.5 / count)
    # Independent readings change level this often; a single crossing changes it once.
    own = reading.changes / (2.0 * share * (1.0 - share))
    counted = min(max(own, 1.0), plain.independent)
    above, below = counted * share, counted * (1.0 - share)
    lattice = math.lgamma(counted + 1.0) - math.lgamma(above + 1.0) - math.lgamma(below + 1.0)
    # A clean crossing comes after the readings at the level that is left.
    edge = 0.5 * (low + high)
    upward = reading.last > edge
    left = (1.0 - share if upward else share) * count
    begin = reading.start_s - (reading.gap_s if crossed_between else 0.0)
    return plain._replace(
        duration_s=reading.end_s - begin,
        edge=edge,
        above=above,
        below=below,
        lattice=lattice + math.log(counted / plain.independent),
        readings=float(reading.count),
        since_s=reading.time_s - (begin + (left - 0.5) * reading.gap_s),
        upward=upward,
    )


@njit
def measure(filters: Filters, said: Said) -> None:
    """Give the bank what a slot says."""
    log_evidence = np.empty(len(filters))
    best = -math.inf
    for i in range(len(filters)):
        f, k = filters[i], i // SMOOTHNESSES
        if not f.weight:
            continue
        mean, variance = f.temperature + f.error, f.tt + 2.0 * f.te + f.ee
        if k >= LEVELS:
            mean, variance, log = _as_mean(mean, variance, k, said)
        elif said.case == NO_STEP:
            log = IMPOSSIBLE
        else:
            mean, variance, log = _as_level(f, WHITE[k] * said.step, mean, variance, said)
        condition(f, mean, variance)
        log_evidence[i] = log
        best = max(best, log)
    total = 0.0
    for i in range(len(filters)):
        f = filters[i]
        if f.weight:
            evidence = math.exp(max(log_evidence[i] - best, IMPOSSIBLE))
            f.weight *= evidence
            f.rare *= evidence
            f.cycling *= evidence
            total += f.weight + f.rare
    for i in range(len(filters)):
        filters[i].weight /= total
        filters[i].rare /= total
        filters[i].cycling /= total


@inner
def _gaussian(mean: float, variance: float, measured: float, noise: float) -> Moments:
    """Correct a Gaussian by a measurement with noise; the log density is that over 1/√(2π)."""
    total, residual = variance + noise, measured - mean
    log = -0.5 * math.log(total) - 0.5 * residual * residual / total
    return mean + variance / total * residual, variance * noise / total, log


@inner
def _as_mean(mean: float, variance: float, k: int, said: Said) -> Moments:
    """Take the slot's mean as a measurement: the mean and slow kinds."""
    noise = WHITE[k] * said.white + said.cell**2 / 12.0 + TINY**2
    after, left, _ = _gaussian(mean, variance, said.linear, noise)
    # The cell as a Gaussian of the same height, so that no probability exceeds one.
    cell = max(said.cell, TINY)
    smeared = variance + noise + cell**2 / (2.0 * math.pi)
    log = math.log(cell / ROOT_2_PI) - 0.5 * math.log(smeared) - 0.5 * (said.linear - mean) ** 2 / smeared
    return after, left, log


@inner
def _as_level(f: Filter, noise: float, mean: float, variance: float, said: Said) -> Moments:
    """Take the slot's readings as levels: the level kinds."""
    step, rate = said.step, f.rate
    if said.case == MANY:
        inside = noise**2 / said.independent + (step / said.levels) ** 2 / 12.0
        after, left, log = _gaussian(mean, variance, said.mean, inside)
        return after, left, log + math.log(step / said.independent / ROOT_2_PI)
    sigma = math.hypot(noise, rate * said.duration_s / math.sqrt(12.0))
    # Where every reading counts the one before has been heard: only the last is new.
    if said.case == STAY or (said.readings == 1.0 and math.sqrt(variance) < SHARPER * sigma):
        return _stay(mean, variance, f.growth, sigma, said)
    moved = abs(rate) * said.duration_s
    if (
        said.changes % 2
        and moved > SWEEP * noise
        and said.changes <= 1.0 + SWEEP * noise * said.readings / max(moved, TINY)
        and (rate > 0.0) == said.upward
    ):
        each = max(abs(rate) * said.gap_s, TINY**2)
        width = each * (each / 12.0 + noise / CROWDED) + f.rr * said.since_s**2
        after, left, log = _gaussian(mean, variance, said.edge + rate * said.since_s, width)
        return after, left, log + math.log(each * said.readings / said.independent / ROOT_2_PI)
    after, left, log = weigh(mean, math.sqrt(variance), said.edge, said.edge, said.above, said.below, sigma)
    return after, left, log + said.lattice


@inner
def _stay(mean: float, variance: float, growth: float, sigma: float, said: Said) -> Moments:
    """Take a reading that does not change, where it says something new."""
    step, sd = said.step, math.sqrt(variance)
    low, high = said.mean - 0.5 * step, said.mean + 0.5 * step
    if sd < SHARPER * sigma:
        if min(mean - low, high - mean) > 5.0 * sigma + 3.0 * sd:
            return mean, variance, 0.0
        return weigh(mean, sd, low, high, said.independent, said.independent, sigma)
    shift, shrink, log_mass = truncated((low - mean) / sd, (high - mean) / sd)
    if sd < WIDER * step and log_mass > SURPRISE and growth <= (GROWN * step) ** 2:
        return mean, variance, 0.0
    # No edge is sharper than the noise: far outside the variance would vanish, and rounding make it negative.
    return mean + shift * sd, max(shrink * variance, sigma * sigma), log_mass


class Merged(NamedTuple):
    """The mean of all filters, and variances of temperature, rate, the slow error and its walk, °C²."""

    temperature: float
    rate: float
    acceleration: float
    temperature_variance: float
    rate_variance: float
    slow: float
    walked: float


@njit
def merged(filters: Filters, slow_errors: Slow, step: float, level: float) -> Merged:
    """Merge the filters into what is shown; `level` is the one that the readings stay on, NaN where none.

    Then the level kinds are confined to it.
    """
    total, both, frequent, slow, walked = 0.0, 0.0, 0.0, 0.0, 0.0
    x, r, a = 0.0, 0.0, 0.0
    sum_x, sum_r, square_x, square_r = 0.0, 0.0, 0.0, 0.0
    # About the heaviest filter, so that the differences of squares keep their digits.
    main = _heaviest(filters)
    for i in range(len(filters)):
        f, k = filters[i], i // SMOOTHNESSES
        if not f.weight:
            continue
        frequent += f.weight
        slow += slow_errors.variance[k] * f.weight
        walked += slow_errors.walk[k] * WALKED_S * f.weight
        mass, shift, shrink = 1.0, 0.0, 1.0
        if k < LEVELS and not math.isnan(level):
            mass, shift, shrink = _confined(f, WHITE[k] * step, step, level)
        gain_x, gain_r = f.tt + f.te, f.tr + f.re
        spread = gain_x + f.te + f.ee
        off_x = f.temperature + gain_x * shift - main.temperature
        off_r = f.rate + gain_r * shift - main.rate
        weight = (f.weight + f.rare) * mass
        both += weight
        x += weight * off_x
        r += weight * off_r
        a += weight * (f.acceleration + (f.ta + f.ae) * shift)
        weight = f.weight * mass
        total += weight
        sum_x += weight * off_x
        sum_r += weight * off_r
        square_x += weight * (f.tt + gain_x * gain_x / spread * (shrink - 1.0) + off_x * off_x)
        square_r += weight * (f.rr + gain_r * gain_r / spread * (shrink - 1.0) + off_r * off_r)
    if not total > 1e-200 and not math.isnan(level):
        # The level is out of reach of all filters.
        return merged(filters, slow_errors, step, math.nan)
    x, r, a = x / both, r / both, a / both
    return Merged(
        main.temperature + x,
        main.rate + r,
        a,
        (square_x - 2.0 * x * sum_x) / total + x * x,
        (square_r - 2.0 * r * sum_r) / total + r * r,
        slow / frequent,
        walked / frequent,
    )


@inner
def _heaviest(filters: Filters) -> Filter:
    best = 0
    for i in range(len(filters)):
        if filters[i].weight + filters[i].rare > filters[best].weight + filters[best].rare:
            best = i
    return filters[best]


@inner
def _confined(f: Filter, noise: float, step: float, level: float) -> tuple[float, float, float]:
    """Return probability, shift over sd and shrinking of variance by a level that is sharp for a filter."""
    spread = f.tt + 2.0 * f.te + f.ee
    sd = math.sqrt(spread)
    if sd < SHARPER * noise:
        return 1.0, 0.0, 1.0
    half = 0.5 * step - min(EDGE * noise, 0.3 * step)
    offset = f.temperature + f.error - level
    shift, shrink, log_mass = truncated((-half - offset) / sd, (half - offset) / sd)
    return math.exp(log_mass), shift / sd, shrink
