"""A bank of Kalman filters for temperature, rate, acceleration and the slow part of the sensor's noise.

The filters differ in how smooth the temperature is (`JERKS`: the density q of the white jerk that drives
T''', with T'' forgetting itself in `FORGETTING_S`) and in what the sensor's errors are like:

- level kinds: the reading is the level that the temperature, with a little white noise, is in;
- mean kinds: the reading is the temperature with white errors, quantization among them.

Some of either have a slow error as well, a Gauss-Markov process, which is the fourth state; and some of these
a random walk beside it, together 1/f noise.  The walk is part of the temperature that they estimate.

They are mixed as an interacting multiple model (Blom and Bar-Shalom 1988).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner, njit, records
from imumon.estimation.temperature_rate.refresh import FASTEST

JERKS = 10.0 ** np.append(np.arange(-27.0, -3.5, 1.5), -2.0)
"""Jerk densities, °C²/s⁵: from a rate that keeps to 0.001 °C/h for a day to a jump of 10 °C/min in 2 s."""
SMOOTHNESSES = len(JERKS)
FORGETTING_S = 1800.0
WHITE_SIGMAS = (0.0003, 0.01, 0.02, 0.035, 0.06, 0.1, 0.13, 0.16, 0.2, 0.25)
"""White noise of the level kinds in steps: beyond the last the steps are no sharper than the noise."""
SLOT_S = 1.0
"""Readings are gathered over this time."""
SLOW_LEVEL_SIGMAS, SLOW_LEVEL_WHITES = (0.12, 0.25, 0.5, 1.0), (0.06, 0.2)
"""Before the quantizer: deviations of slow errors, in units, and of white noise beside them, in steps."""
MEAN_FACTORS = (0.7, 1.4, 2.8)
"""Variance of a slot's mean in the mean kinds, over that seen from slot to slot."""
SLOW_RATIOS, SLOW_TIMES_S = (0.6, 2.0, 6.0, 20.0, 60.0, 200.0), (3.0, 10.0, 30.0, 100.0)
"""Variance of slow errors where the noise hides the steps, over that seen from slot to slot, and correlation
times, s: all pairs that change no faster than what is seen; a slot's mean hides up to half of that."""
FLICKER_TIME_S = 3.0
"""1/f noise in means of a second is as likely under a process with this time and a walk as under two; under
one, -2 log likelihood of half an hour is 60 to 150 more."""
SLOW_LEVEL_TIMES = ((5.0, 0.0), (40.0, 0.0), (FLICKER_TIME_S, 0.01))
"""Of slow errors before the quantizer: correlation time, and variance of the walk per second over theirs."""
FLICKER_RATIOS, FLICKER_WALKS = (0.6, 2.0), (0.01, 0.06)
"""Where the noise hides the steps: the process, as above, and the walk of one reading over what is seen."""
WALKED_S = 900.0
"""A sensor's walk, which stands for 1/f noise, goes no farther than in this time."""


class Kind(NamedTuple):
    """A kind of the sensor's noise: its white noise, slow error and walk."""

    white: float
    """Standard deviation in steps, of a level kind; else variance over that seen from slot to slot."""
    slow: float = 0.0
    """Variance of the process in units² of the sensor; else the part that it has in what is seen."""
    time_s: float = 1.0
    """Its correlation time."""
    walk: float = 0.0
    """Variance that the walk gains, in units² per second, or over that seen from slot to slot."""


def _mean_kind(ratio: float, time_s: float, walk: float = 0.0) -> Kind:
    return Kind(max(1.0 - ratio / time_s, 0.05), ratio / time_s, time_s, walk)


def _level_kind(white: float, sd: float, time_s: float, walk: float) -> Kind:
    """Return a kind whose readings of a slot scatter as the process moves in it, too."""
    return Kind(math.hypot(white, sd * math.sqrt(SLOT_S / (3.0 * time_s))), sd**2, time_s, walk * sd**2)


LEVEL_KINDS = [
    *(Kind(white) for white in WHITE_SIGMAS),
    *(
        _level_kind(white, sd, time_s, walk)
        for white, sd, (time_s, walk) in product(SLOW_LEVEL_WHITES, SLOW_LEVEL_SIGMAS, SLOW_LEVEL_TIMES)
    ),
]
MEAN_KINDS = [
    *(Kind(factor) for factor in MEAN_FACTORS),
    *(_mean_kind(r, time_s) for r, time_s in product(SLOW_RATIOS, SLOW_TIMES_S) if r <= 2.0 * time_s),
    *(_mean_kind(r, FLICKER_TIME_S, walk) for r, walk in product(FLICKER_RATIOS, FLICKER_WALKS)),
]
KINDS, LEVELS = len(LEVEL_KINDS) + len(MEAN_KINDS), len(LEVEL_KINDS)
WHITE, SLOW, SLOW_TIME_S, WALK = np.array(LEVEL_KINDS + MEAN_KINDS).T.copy()
"""Of all kinds, those of levels first."""
PRIOR = np.where(SLOW > 0.0, 0.03, 1.0)
"""Most converters have white noise: of a slow error so many times less is believed before it shows."""


class Slow(NamedTuple):
    """The slow errors of every kind: variance, and that which the walk gains, (k,), °C² and °C²/s."""

    variance: FloatArray
    walk: FloatArray


def slow_errors(unit: float, roughness: float, interval_s: float) -> Slow:
    """Return the slow errors of every kind.

    Parameters
    ----------
    unit : float
        °C.
    roughness : float
        Variance that a reading seems to have from the second differences of readings, °C².
    interval_s : float
        Between these.  Of an error with the variance v that keeps φ until the next reading they show
        v (1 - φ)(3 - φ)/3.
    """
    variance, walk = SLOW * unit**2, WALK * unit**2
    variance[LEVELS:] = SLOW[LEVELS:] * roughness / _shown(interval_s)
    walk[LEVELS:] = WALK[LEVELS:] * roughness / interval_s
    return Slow(variance, walk)


@lru_cache(maxsize=8)
def _shown(interval_s: float) -> FloatArray:
    keep = np.exp(-interval_s / SLOW_TIME_S[LEVELS:])
    return np.asarray((1.0 - keep) * (3.0 - keep) / 3.0)


CHANGE_PER_S = 1.0 / 3600.0
"""Probability per second that the smoothness changes to a neighbour's."""
RARE_JUMP_PER_S, JUMP_PER_S, CYCLING_JUMP_PER_S = 1e-7, 1e-4, 3e-3
"""The same to any: a jump in months as where nobody touches the unit, one every three hours as where a
chamber goes through its program, one every five minutes as where a thermostat switches."""
FREQUENT, CYCLING, FORGOTTEN_S = 0.01, 0.01, 3600.0
"""Probability that jumps are not rare, and of these that they come every few minutes, before any is seen, and
the time after which one is forgotten.  The estimate weighs all; its standard deviation is that of jumps which
are not rare about it, as the next may have come."""
MIX_S = 3.9
"""Filters are mixed so often; a fraction of the time in which any could take over."""
NATURE_PER_S = 1e-10
"""The same for the kind of the sensor's noise, to any."""
LEAST_WEIGHT = 3e-11
"""A kind with less probability rests until its turn comes to get what `NATURE_PER_S` grants it."""
NEGLIGIBLE = 1e-4
"""A filter takes up no rougher one that would be less of it than this: it would lose what it knows."""
UNSEEN_RATE = 200.0 / 3600.0
START_ACCELERATION = UNSEEN_RATE / 300.0
"""Standard deviations of a rate that nobody has seen change, and of the acceleration, °C/s and °C/s²: a board
that warms by 20 °C with a time constant of 6 min begins with 200 °C/h.  At the start it may be any rate."""


LEAST_LEFT = 1e-10
"""A slot leaves so much of a variance, or rounding would leave none: the next makes up for it."""


class Filter:
    """One filter: its probability, means and covariances, these by the first letters of the two."""

    weight: float
    rare: float
    """The probability that it is right and jumps of the smoothness are frequent, or rare: of all filters
    1."""
    cycling: float
    """The part of the weight with which jumps come every few minutes."""
    temperature: float
    rate: float
    acceleration: float
    error: float
    """Means; the error is the slow one of the reading: °C, °C/s, °C/s², °C."""
    tt: float
    tr: float
    ta: float
    te: float
    rr: float
    ra: float
    re: float
    aa: float
    ae: float
    ee: float
    growth: float
    """By which the variance of the reading grew since the last slot, °C²."""


Filters = Sequence[Filter]


@dataclass(slots=True)
class Bank:
    """The filters: for each of the `KINDS` of noise those of the `JERKS`, one after the other."""

    filters: Filters
    unmixed_s: float = 0.0
    """Since they were last mixed."""
    turn: int = 0
    """The kind of noise that may wake at the next mixing."""

    @property
    def kinds(self) -> FloatArray:
        """Probability of each kind of noise, (k,)."""
        weights: FloatArray = np.asarray(self.filters)["weight"].reshape(KINDS, SMOOTHNESSES)
        return np.asarray(weights.sum(1) / weights.sum())


def started(
    temperature: tuple[float, float],
    rate: tuple[float, float],
    slow: Slow,
    kinds: FloatArray | None = None,
) -> Bank:
    """Return a bank that begins at a temperature and a rough rate.

    Parameters
    ----------
    temperature, rate : (float, float)
        And their standard deviations, to which what any rate has is added: °C, °C/s.
    kinds : array (k,), optional
        Weights of the kinds of noise, where they are known.
    """
    filters = records(Filter, KINDS * SMOOTHNESSES)
    share = PRIOR / PRIOR.sum() if kinds is None else kinds
    values = {
        "weight": np.repeat(share / SMOOTHNESSES, SMOOTHNESSES) * FREQUENT,
        "cycling": np.repeat(share / SMOOTHNESSES, SMOOTHNESSES) * FREQUENT * CYCLING,
        "rare": np.repeat(share / SMOOTHNESSES, SMOOTHNESSES) * (1.0 - FREQUENT),
        "temperature": temperature[0],
        "rate": rate[0],
        "tt": temperature[1] ** 2,
        "rr": (FASTEST + rate[1]) ** 2,
        "aa": np.tile(np.minimum(START_ACCELERATION**2, JERKS * FORGETTING_S / 2.0), KINDS),
        "ee": np.repeat(slow.variance, SMOOTHNESSES),
    }
    table = np.asarray(filters)
    for name, value in values.items():
        table[name] = value
    return Bank(filters)


def advance(bank: Bank, dt: float, slow: Slow, least_jerk: float = 0.0) -> tuple[float, float]:
    """Mix the filters and move them on by dt seconds; return mean and variance of the reading to come.

    Without steps, that is, and without white noise.
    """
    bank.unmixed_s += dt
    if bank.unmixed_s >= MIX_S:
        mix(bank.filters, np.zeros((2, len(bank.filters), MOMENTS)), bank.unmixed_s, slow.variance, bank.turn)
        bank.unmixed_s, bank.turn = 0.0, (bank.turn + 1) % KINDS
    return predict(bank.filters, dt, slow, least_jerk)


@njit
def predict(filters: Filters, dt: float, slow: Slow, least_jerk: float) -> tuple[float, float]:
    """Move the filters on by dt seconds: x = F x and P = F P Fᵀ + Q, written out; return as `advance`.

    F = [[1, dt, c, 0], [0, 1, g, 0], [0, 0, keep, 0], [0, 0, 0, fade]].
    """
    keep = math.exp(-dt / FORGETTING_S)
    g = FORGETTING_S * (1.0 - keep)
    c = FORGETTING_S * (dt - g)
    reference, total, mean, square = filters[0].temperature, 0.0, 0.0, 0.0
    for k in range(KINDS):
        fade = math.exp(-dt / SLOW_TIME_S[k])
        wander, walked = slow.variance[k] * (1.0 - fade * fade), slow.walk[k] * dt
        for q in range(SMOOTHNESSES):
            f = filters[k * SMOOTHNESSES + q]
            if not f.weight:
                continue
            before = f.tt + 2.0 * f.te + f.ee
            jerk = max(JERKS[q], least_jerk) * dt
            _move(f, dt, c, g, keep, fade)
            f.tt += jerk * dt**4 / 20.0 + walked
            f.tr += jerk * dt**3 / 8.0
            f.ta += jerk * dt * dt / 6.0
            f.rr += jerk * dt * dt / 3.0
            f.ra += jerk * dt / 2.0
            f.aa += jerk
            f.ee += wander
            after = f.tt + 2.0 * f.te + f.ee
            f.growth = after - before
            off = f.temperature + f.error - reference
            total += f.weight
            mean += f.weight * off
            square += f.weight * (after + off * off)
    mean /= total
    return reference + mean, square / total - mean * mean


@inner
def _move(f: Filter, dt: float, c: float, g: float, keep: float, fade: float) -> None:
    """Apply F; the order is such that nothing is needed after it has been written."""
    f.temperature += dt * f.rate + c * f.acceleration
    f.rate += g * f.acceleration
    f.acceleration *= keep
    f.error *= fade
    tr, ta = f.tr + dt * f.rr + c * f.ra, f.ta + dt * f.ra + c * f.aa
    ra = f.ra + g * f.aa
    f.tt += dt * (f.tr + tr) + c * (f.ta + ta)
    f.tr = tr + g * ta
    f.ta = keep * ta
    f.te = fade * (f.te + dt * f.re + c * f.ae)
    f.rr += g * (f.ra + ra)
    f.ra = keep * ra
    f.re = fade * (f.re + g * f.ae)
    f.aa *= keep * keep
    f.ae *= keep * fade
    f.ee *= fade * fade


@inner
def condition(f: Filter, mean: float, variance: float) -> None:
    """Give what a sensor without steps would read these moments, and the states what follows from them."""
    t, r, a, e = f.tt + f.te, f.tr + f.re, f.ta + f.ae, f.te + f.ee
    spread = t + e
    shift = (mean - f.temperature - f.error) / spread
    change = (max(variance, LEAST_LEFT * spread) - spread) / (spread * spread)
    f.temperature += t * shift
    f.rate += r * shift
    f.acceleration += a * shift
    f.error += e * shift
    _add_square(f, t, r, a, e, change)


@inner
def _add_square(f: Filter, t: float, r: float, a: float, e: float, factor: float) -> None:
    """Add a vector's outer product with itself to the covariance."""
    f.tt += factor * t * t
    f.tr += factor * t * r
    f.ta += factor * t * a
    f.te += factor * t * e
    f.rr += factor * r * r
    f.ra += factor * r * a
    f.re += factor * r * e
    f.aa += factor * a * a
    f.ae += factor * a * e
    f.ee += factor * e * e


@njit
def mix(filters: Filters, sums: FloatArray, dt: float, slow: FloatArray, turn: int) -> None:
    """Pass weight, and with it states, between the filters, as over dt seconds.

    In between they are `sums`, room for (2, filters, moments): moments about the mean of all, times weight,
    so that merging costs no digits.  Kinds with next to no weight rest, with none; the one whose turn it is
    gets what it is due since the last.
    """
    change = min(dt * NATURE_PER_S, 0.4)
    x0, r0, a0 = _mean(filters)
    for i in range(len(filters)):
        f = filters[i]
        if f.weight:
            x, r, a = f.temperature - x0, f.rate - r0, f.acceleration - a0
            _add_square(f, x, r, a, f.error, 1.0)
            _write(f, x, r, a, sums[0, i])
    for k in range(KINDS):
        _pass_on(sums, k * SMOOTHNESSES, dt)
    # From one kind of noise to another the slow error begins anew.
    for q in range(SMOOTHNESSES):
        to = sums[1, turn * SMOOTHNESSES + q]
        for k in range(KINDS):
            if k != turn:
                others = sums[1, k * SMOOTHNESSES + q]
                for m in range(KNOWN):
                    to[m] += change * others[m]
                to[SLOW_VARIANCE] += change * others[0] * slow[turn]
                to[RARE] += change * others[RARE]
                to[CYCLES] += change * others[CYCLES]
    frequent, rare = 0.0, 0.0
    for i in range(len(filters)):
        frequent += sums[1, i, 0]
        rare += sums[1, i, RARE]
    forgotten = min(dt / FORGOTTEN_S, 1.0)
    returns = (FREQUENT * (frequent + rare) - frequent) * forgotten
    for i in range(len(filters)):
        f = filters[i]
        f.weight = sums[1, i, 0] * (1.0 + returns / frequent)
        f.rare = sums[1, i, RARE] * (1.0 - returns / rare)
        cycling = sums[1, i, CYCLES] * (1.0 + returns / frequent)
        f.cycling = cycling + (CYCLING * f.weight - cycling) * forgotten
        if f.weight:
            _read(f, sums[1, i])
            _add_square(f, f.temperature, f.rate, f.acceleration, f.error, -1.0)
            f.temperature += x0
            f.rate += r0
            f.acceleration += a0


KNOWN, SLOW_VARIANCE, RARE, CYCLES, MOMENTS = 10, 14, 15, 16, 17
"""The first moments of a filter are not those of the slow error; its last one; the other weights; all."""


@inner
def _mean(filters: Filters) -> tuple[float, float, float]:
    total, x, r, a = 0.0, 0.0, 0.0, 0.0
    for i in range(len(filters)):
        f = filters[i]
        total += f.weight
        x += f.weight * f.temperature
        r += f.weight * f.rate
        a += f.weight * f.acceleration
    return x / total, r / total, a / total


@inner
def _write(f: Filter, x: float, r: float, a: float, to: FloatArray) -> None:
    """Write the moments of a filter times its weight, those of the slow error last."""
    w = f.weight
    to[0], to[1], to[2], to[3] = w, w * x, w * r, w * a
    to[4], to[5], to[6] = w * f.tt, w * f.tr, w * f.ta
    to[7], to[8], to[9] = w * f.rr, w * f.ra, w * f.aa
    to[10], to[11], to[12], to[13], to[14] = w * f.error, w * f.te, w * f.re, w * f.ae, w * f.ee
    to[RARE], to[CYCLES] = f.rare, f.cycling


@inner
def _read(f: Filter, sums: FloatArray) -> None:
    """Undo `_write`."""
    each = 1.0 / sums[0]
    f.temperature, f.rate, f.acceleration = each * sums[1], each * sums[2], each * sums[3]
    f.tt, f.tr, f.ta = each * sums[4], each * sums[5], each * sums[6]
    f.rr, f.ra, f.aa = each * sums[7], each * sums[8], each * sums[9]
    f.error, f.te, f.re = each * sums[10], each * sums[11], each * sums[12]
    f.ae, f.ee = each * sums[13], each * sums[14]


@inner
def _pass_on(sums: FloatArray, first: int, dt: float) -> None:
    """Pass the sums of one kind of noise, whose filters begin with the first, between its smoothnesses."""
    before, after = sums[0], sums[1]
    whole = 0.0
    for q in range(SMOOTHNESSES):
        whole += before[first + q, 0] + before[first + q, RARE]
        for m in range(MOMENTS):
            after[first + q, m] = 0.0
    if whole < LEAST_WEIGHT:
        return
    for j in range(SMOOTHNESSES):
        total = 0.0
        for i in range(SMOOTHNESSES):
            total += _flow(i, j, dt, RARE_JUMP_PER_S) * before[first + i, RARE]
        for i in range(SMOOTHNESSES):
            rare = _flow(i, j, dt, RARE_JUMP_PER_S) * before[first + i, RARE]
            if before[first + i, 0] and (i <= j or rare > NEGLIGIBLE * total):
                cycling = before[first + i, CYCLES] / before[first + i, 0]
                other = _flow(i, j, dt, CYCLING_JUMP_PER_S)
                share = (1.0 - cycling) * _flow(i, j, dt, JUMP_PER_S) + cycling * other
                for m in range(RARE):
                    after[first + j, m] += share * before[first + i, m]
                after[first + j, RARE] += rare
                after[first + j, CYCLES] += other * before[first + i, CYCLES]


@inner
def _flow(i: int, j: int, dt: float, jump_per_s: float) -> float:
    """Return which part of a filter's weight goes to another within dt seconds."""
    near, far = min(dt * CHANGE_PER_S, 0.4), min(dt * jump_per_s, 0.4)
    if i == j:
        neighbours = (i > 0) + (i < SMOOTHNESSES - 1)
        return 1.0 - 0.5 * near * neighbours - far * (1.0 - 1.0 / SMOOTHNESSES)
    return 0.5 * near * (abs(i - j) == 1) + far / SMOOTHNESSES
