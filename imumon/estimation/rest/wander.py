"""Does it turn slowly about the vertical, or does the bias wander?  A choice between histories, by Bayes.

The history of a rest is the means of bins that grow with age, the latest 2 s, the first an hour long.  A gyro
at rest has white noise and flicker or a random walk, so the covariance of these means is known but for their
strength.  Where there is a thermometer, it has a slope over temperature as well, which is another at another
temperature, and the gyro lags behind: what these explain is in the covariance, too.  Tried are ten strengths
of flicker and four of a walk, with three sizes of the slope about the vertical, and for each of them::

    nothing happened
    a turn began at a time, in some time, and goes on            only about the vertical
    a turn began and has ended                                   only about the vertical
    the bias began to creep, as it does with temperature         all axes, each by its own slope

The last by no more than the temperature moved, where that is known.
Each has the probability of its means (likelihoods of a change in coloured noise, as Willsky and Jones 1976,
but weighed instead of maximised), times that of such a change.  The level axes tell how strong the
flicker is, and whether something creeps: they cannot turn unseen, for gravity would show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, FloatArray
from imumon.estimation.rest.state import ACCEL, EVERY, GYRO, State
from imumon.estimation.rest.thermometer import EFFECTS, SLOPE

EDGES = np.array(
    [0, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072]
)
"""Ages of the bins' edges, in units of `EVERY` slots: a second each; the last edge is the history's own."""
LAST = 0.8
"""An edge older than so much of the history gives way to the last."""
LEAST = 16
"""Units without which there is no history."""
TAUS_S = np.array([10.0, 100.0, 1000.0, 10000.0])
"""Correlation times of flicker, a sum of Gauss-Markov processes of one strength (`filters.noise`)."""
STRENGTHS = np.geomspace(1.0 / 240.0, 16.0, 10)
"""Variance of a process over the density of the white noise, 1/s: flicker overtakes it at 400 s to 0.1 s."""
WALKS = np.geomspace(0.5, 50.0, 4)
"""The same of the slowest process alone, a random walk: by 0.01 to 0.1 of the white noise of a second."""
SHARES = np.vstack([np.outer(STRENGTHS, np.ones(len(TAUS_S))), np.outer(WALKS, np.eye(len(TAUS_S))[-1])])
"""Variance of each process, (s, taus), for each noise that is tried."""
SLOPES = SLOPE * np.array([1.0, 1.0 / 6.0, 1.0 / 36.0])
"""Sizes of the slope that are tried about the vertical: 180 to 5 °/h/K, consumer to tactical, so that a turn
is not hidden by a slope that the history has not.  The level axes may have any: theirs says nothing of it."""
UNKNOWN = 1e6
"""Variance of the bias at first, over that of the white noise in a unit."""
TURN_EVERY_S = 600.0
"""A turn, and a change of temperature, is expected every ten minutes, and to last as long."""
RATES = 20.0
"""2 ln of the ratio of the largest and the smallest rate: 0.01 °/s is as likely as 300 °/s."""
OBLIQUE = 0.3
"""Share of a difference across the vertical that no misalignment or tilt of a turntable explains (17°)."""
CREEP = 2e-5
"""rad/s²: 70 °/h/°C at 2 °C/min is 1.1e-5; more than this, about the vertical alone, is a turn."""
SURPRISE = 12.0
"""Strengths so much less likely (log) than the best are left out."""
FORGET = 0.5
"""Of what a history told of the strength of the flicker so much holds for the next."""
LEAST_LEFT = 1e-9
"""Share of a change, squared, that is not lost in rounding where the temperature explains it."""
SHOWN = 3.0
"""Standard deviations by which gravity has moved where it may tell of a tilt: the priors ask for more."""
MOST = 50.0
"""Logarithm beyond which one probability is all there is."""
TINY = 1e-24
_FIRST, _SECOND = np.triu_indices(EFFECTS)
_TIMES = np.where(_FIRST == _SECOND, 1.0, 2.0)
"""Of a quadratic form: the pairs of components, and how often each is in it."""


class Turning(NamedTuple):
    """That it turns now: the probability, and that it tilts; the turn's rms, rad/s, (3,), 0 for what is
    decided, the age at which it likeliest began, units, and the rms of what may turn since the age of the one
    that is kept; the mean of all axes before it began, (6,), how long ago that was, s, and the temperature
    then, °C."""

    probability: float
    tilts: float
    turn: FloatArray
    age: float
    possible: float
    before: FloatArray
    age_s: float
    degc: float


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """What may have happened in a history, whitened for each of the s strengths.

    Parameters
    ----------
    edges : array of int, (b + 1,)
        Ages, units.
    whiten : array, (s, b, b)
        Inverse Cholesky factors of the covariance of the bins.
    evidence : array, (s,)
        Logarithm of their determinants.
    shapes, size : array, (s, b, h), (s, h)
        The changes as columns, normalised, and what they were.
    creeps, goes_on : int
        So many of them take time and go on, and so many go on: the first.
    began : array of int, (h,)
        Bin in whose oldest part it began.
    start, end : array, (h,)
        Ages between which it grew, units.
    seconds : array, (h,)
        The time in which it may have begun.
    """

    edges: npt.NDArray[np.intp]
    whiten: FloatArray
    evidence: FloatArray
    shapes: FloatArray
    size: FloatArray
    creeps: int
    goes_on: int
    began: npt.NDArray[np.intp]
    start: FloatArray
    end: FloatArray
    seconds: FloatArray


class Seen(NamedTuple):
    """What a history says of each change.

    Parameters
    ----------
    which : array of int, (s,)
        Noises that are not too unlikely, one with each slope.
    likely : array, (s, 1)
        Log-likelihood without any change.
    square, ratio2 : array, (3, s, h)
        The changes over their variances, squared, and one over the variances, of the vertical and the level
        axes.
    clockwise : array of bool, (3, s, h)
        Whether the change is.
    """

    which: npt.NDArray[np.intp]
    likely: FloatArray
    square: FloatArray
    ratio2: FloatArray
    clockwise: BoolArray


def kept_edge(units: int) -> int:
    """Return the last edge of a history: an eighth of an octave or less before its beginning."""
    fine = 1 << max(units.bit_length() - 4, 0)
    return units // fine * fine


@lru_cache(128)
def changes(last: int, unit_s: float) -> Changes:
    """Return what may have happened in `last` units of `unit_s` seconds."""
    edges = np.append(EDGES[LAST * last > EDGES], last)
    width, bins = np.diff(edges).astype(np.float64), len(edges) - 1
    variance = unit_s * np.tensordot(SHARES, _correlation(edges, unit_s), 1)
    covariance = np.diag(1.0 / width) + variance + UNKNOWN
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    made = [*_begun(edges), *_over(edges)]
    start, end, stop, began = (np.array(column) for column in zip(*made, strict=True))
    profile = _ramp(edges, start, end) - _ramp(edges, stop, stop)
    shapes = whiten @ profile
    size = np.sqrt((shapes * shapes).sum(1))
    alike = np.bincount(began * 2 + (stop > 0), minlength=2 * bins)[began * 2 + (stop > 0)]
    return Changes(
        edges,
        whiten,
        np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum(1),
        shapes / size[:, np.newaxis],
        size,
        int((start > end)[stop == 0.0].sum()),
        int((stop == 0.0).sum()),
        began,
        start,
        end,
        unit_s * width[began] / alike,
    )


def _begun(edges: npt.NDArray[np.intp]) -> list[tuple[float, float, float, int]]:
    """Return turns that go on: the ages at which they began and were at full rate, 0, and the bin.

    Those that take time first.
    """
    made: list[tuple[float, float, float, int]] = []
    at_once: list[tuple[float, float, float, int]] = []
    for i in range(1, len(edges) - 1):
        young, old = float(edges[i - 1]), float(edges[i])
        made += [(old, float(end), 0.0, i - 1) for end in edges[: i - 1]]
        for age in (old, (young + 2.0 * old) / 3.0, (2.0 * young + old) / 3.0):
            at_once.append((age, age, 0.0, i - 1))
    return made + at_once


def _over(edges: npt.NDArray[np.intp]) -> list[tuple[float, float, float, int]]:
    """Return turns that have ended: the ages at which they began, twice, and ended, and the bin."""
    pairs = [(i, j) for i in range(2, len(edges) - 1) for j in range(1, i)]
    return [(float(edges[i]), float(edges[i]), float(edges[j]), i - 1) for i, j in pairs]


def _ramp(edges: npt.NDArray[np.intp], start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the means in bins of what is 0 before an age `start`, (h,), and 1 from `end` on, (b, h)."""
    age = edges[:, np.newaxis].astype(np.float64)
    growing = np.maximum(start - end, TINY)
    within = np.clip(age, end, start)
    integral = np.minimum(age, end) + 0.5 * (growing - (start - within) ** 2 / growing)
    return np.asarray(np.diff(integral, axis=0) / np.diff(age, axis=0))


def _correlation(edges: npt.NDArray[np.intp] | npt.NDArray[np.floating], unit_s: float) -> FloatArray:
    """Return the covariance of the bins' means of each process if it has unit variance, (taus, b, b)."""
    age = edges * unit_s
    lag = np.abs(age[:, np.newaxis] - age)[..., np.newaxis] / TAUS_S
    twice = np.moveaxis(TAUS_S**2 * (lag + np.expm1(-lag)), -1, 0)
    double = twice[:, 1:, :-1] + twice[:, :-1, 1:] - twice[:, :-1, :-1] - twice[:, 1:, 1:]
    width = np.diff(age)
    return np.asarray(double / np.outer(width, width))


def look_for_turn(state: State, drift: float) -> Turning | None:
    """Tell whether it turns since the history began; None before there is one.

    Accelerometers may drift by `drift`, m/s³.
    """
    past = state.past
    if past.units < LEAST or not state.windows.known[GYRO].all():
        return None
    unit_s = float(f"{past.unit_s:.2g}")
    known = changes(kept_edge(past.units), unit_s)
    means = past.means(known.edges)
    white = np.maximum(state.windows.variance[3, GYRO], state.windows.resolution[GYRO] ** 2 / 12.0) + TINY
    frame = _frame(state, means[:, GYRO])
    white = (frame * frame).T @ white
    columns = means[:, GYRO] @ frame / np.sqrt(white)
    seen = _seen(state, known, columns, np.sqrt(white))
    return _weigh(state, known, seen, frame, _Tilt(means[:, ACCEL], drift))


def _seen(state: State, known: Changes, columns: FloatArray, white_sd: FloatArray) -> Seen:
    """Return what means, (b, 3) in units of the white noise, say of each change.

    What the temperature explains adds a product to the covariance, which is inverted by Woodbury's formula.
    """
    warm = (known.whiten @ state.past.warmed(known.edges)).swapaxes(1, 2)  # (s, EFFECTS, b)
    slopes = SLOPES if warm.any() else SLOPES[:1]
    # The vertical once with each slope, and the level axes.
    level = len(slopes)
    axis = np.append(np.zeros(level, np.intp), [1, 2])
    noise2 = np.square(white_sd)[axis]
    free = np.eye(EFFECTS) * (noise2 / np.square([*slopes, SLOPE, SLOPE]))[:, np.newaxis, np.newaxis]
    inverse = np.linalg.inv((warm @ warm.swapaxes(1, 2))[:, np.newaxis] + free)  # (s, axes, EFFECTS, EFFECTS)
    seen = (known.whiten @ columns).swapaxes(1, 2)  # (s, 3, b)
    along = (seen @ warm.swapaxes(1, 2))[:, axis]
    fitted = (inverse @ along[..., np.newaxis])[..., 0]
    left = (seen * seen).sum(2)[:, axis] - (along * fitted).sum(2)
    alone = 0.5 * (np.linalg.slogdet(free @ inverse)[1] - left)
    likely = state.strengths + 3.0 * known.evidence + alone[:, level:].sum(1)
    likely = likely[:, np.newaxis] + alone[:, :level]
    # No change of the vertical explains more than all that is seen there.
    each, slope = np.nonzero(likely + 0.5 * left[:, :level] > likely.max() - SURPRISE)
    shared, products = warm @ known.shapes, seen @ known.shapes
    # What is left of a change where the temperature explains a part: 1 - shared' inverse shared.
    pairs = shared[:, _FIRST] * shared[:, _SECOND]
    left2 = np.maximum(1.0 - (inverse[..., _FIRST, _SECOND] * _TIMES) @ pairs, LEAST_LEFT)  # (s, axes, h)
    change = products[:, axis] - fitted @ shared
    ratio2 = left2 * (np.square(known.size)[:, np.newaxis] / noise2[:, np.newaxis])
    axes = each, np.stack([slope, np.full_like(slope, level), np.full_like(slope, level + 1)])
    return Seen(
        each,
        likely[each, slope, np.newaxis],
        (change * change / left2)[axes],
        ratio2[axes],
        (change < 0.0)[axes],
    )


def _frame(state: State, means: FloatArray) -> FloatArray:
    """Return axes as columns, (3, 3), the vertical first: that of gravity, or of the largest change."""
    force, gravity = state.windows.rest_mean[ACCEL], state.windows.known[ACCEL].all()
    up = force if gravity else means[0] - means[-1]
    up = up / max(float(np.sqrt(up @ up)), TINY)
    # A Householder reflection takes the first axis to the vertical, and keeps the angles.
    mirror = up + np.array([np.copysign(1.0, up[0]), 0.0, 0.0])
    axes = np.eye(3) - np.outer(mirror, mirror) * (2.0 / (mirror @ mirror))
    axes[:, 0] = up
    return np.asarray(axes)


class _Tilt(NamedTuple):
    """Specific force of the bins, m/s², (b, 3), and by how much accelerometers may drift, m/s³."""

    force: FloatArray
    drift: float


def _weigh(state: State, known: Changes, seen: Seen, frame: FloatArray, tilt: _Tilt) -> Turning:
    """Return what changes make likely; the frame's first column is the vertical."""
    likely, up = seen.likely, frame[:, 0]
    square, ratio2 = seen.square, seen.ratio2
    steps2 = np.square(np.abs(frame).T @ state.windows.resolution[GYRO]) / 6.0
    if steps2.any():
        # Any change may be what the steps of a gyro hide, whatever made it: of two means a twelfth of a step
        # squared each, as anywhere in a step is as likely.
        hidden2 = 1.0 + steps2[:, np.newaxis, np.newaxis] * ratio2
        square, ratio2 = square / hidden2, ratio2 / hidden2
    off2, change2 = square[0], square[0] / ratio2[0]
    prior = np.log(known.seconds / TURN_EVERY_S)
    # Rates are as likely on a logarithmic scale: exp(x²/2) times their density at x.
    turn = likely + (prior - np.log(RATES / 2.5066)) + 0.5 * off2
    density2 = np.maximum(off2, 1.0)
    if state.windows.known[ACCEL].all():
        gained, more = _explained(square[1:], np.square(0.5 * OBLIQUE) * change2 * ratio2[1:])
        turn += 0.5 * (gained - np.log(density2 * more))
    else:
        turn -= 1.5 * np.log(density2)  # any direction would have done
    # A bias creeps on, and takes time to: of a step nobody says so.
    creeps = slice(known.creeps)
    crept2 = np.square(_crept(state, known)[creeps])
    gained, more = _explained(square[..., creeps], crept2 * ratio2[..., creeps])
    creep = likely + prior[creeps] + 0.5 * (gained - np.log(more))
    most = max(float(likely.max()), float(turn.max()), float(creep.max(initial=-np.inf)))
    turned = np.exp(turn - most)
    each = np.exp(likely[:, 0] - most) + turned.sum(1) + np.exp(creep - most).sum(1)
    tilting = _tilting(state, known, seen._replace(square=square, ratio2=ratio2), prior, (frame, tilt)) - most
    tilts = np.exp(np.minimum(tilting, MOST))
    share = np.bincount(seen.which, each / each.sum(), len(SHARES))
    state.strengths_seen = np.log(share + np.exp(-SURPRISE))
    goes_on = slice(known.goes_on)
    tilted = float(tilts.sum()) / float(tilts.sum() + each.sum())
    now, rates2 = turned[:, goes_on] / each.sum(), change2[:, goes_on]
    rms = np.sqrt((now * rates2).sum())
    likeliest = tilts if tilted > 0.5 else now.max(0)
    began = int(known.began[np.argmax(likeliest)]) + 1
    ages = known.edges[began:]
    oldest = int(np.searchsorted(ages, min(ages[0] + LEAST, ages[-1])))
    past = state.past
    before, degc = past.means(ages[[0, oldest]])[0], past.first_degc + past.warmed(ages[[0, oldest]])[0, 0]
    rates = np.sqrt(rates2)
    clockwise = (now * np.where(seen.clockwise[0, :, goes_on], rates, -rates)).sum() > 0.0
    unseen = (-rms if clockwise else rms) * up
    possible, age = _possible(known, turn, change2, ratio2[0], state.unseen_age), float(ages[0])
    return Turning(float(now.sum()), tilted, unseen, age, possible, before, age * past.unit_s, degc)


def _tilting(
    state: State, known: Changes, seen: Seen, prior: FloatArray, given: tuple[FloatArray, _Tilt]
) -> FloatArray:
    """Return log-likelihoods of turns about any axis that go on, (h,), or (1,) while gravity stays.

    Gravity would follow: by how much the specific force has changed since before is as likely as that change
    is, against that of accelerometers that drift, and what their steps hide.
    """
    (frame, tilt), windows, unit_s = given, state.windows, state.past.unit_s
    now = tilt.force[0]
    moved = now - tilt.force[1:]
    noise = 2.0 * windows.variance[4, ACCEL].max() + windows.resolution[ACCEL].max() ** 2 / 6.0
    known_noise = state.windows.known[ACCEL].all()
    if not (known_noise and (moved * moved).sum(1).max() > SHOWN**2 * noise):
        return np.full(1, -np.inf)
    best, goes_on = int(np.argmax(seen.likely)), slice(known.goes_on)
    square, ratio2 = seen.square[:, best, goes_on], seen.ratio2[:, best, goes_on]
    off2 = square.sum(0)
    turn = prior[goes_on] + 0.5 * off2 - 1.5 * np.log(np.maximum(off2, 1.0)) - np.log(RATES / 2.5066)
    rate = np.sqrt(square / ratio2) * np.where(seen.clockwise[:, best, goes_on], -1.0, 1.0)
    start, end = known.start[goes_on], known.end[goes_on]
    turned_s = unit_s * np.maximum(0.5 * (start + end) - 1.0, 0.0)
    expected, changed = np.cross(now, (frame @ (rate * turned_s)).T), moved[known.began[goes_on]]
    drifts = noise + np.square(tilt.drift * unit_s * start) / 3.0
    follows = drifts + (now @ now) * np.square(turned_s) / ratio2[1:].min(0)
    off, size2 = changed - expected, (expected * expected).sum(1)
    told = (changed * changed).sum(1) / drifts - (off * off).sum(1) / follows
    # As long as gravity does not show it, level axes only wander.
    shown = ((changed * expected).sum(1) > 0.5 * size2) & (size2 > drifts)
    likely = float(seen.likely[best, 0]) + turn + 0.5 * told - np.log(follows / drifts)
    return np.where(shown, likely, -np.inf)


def _possible(known: Changes, turn: FloatArray, change2: FloatArray, ratio2: FloatArray, age: float) -> float:
    """Return the rms of the turns that may have begun in the bin of an age, units, and go on, rad/s.

    They have log-likelihoods, squared rates, and variances of these whose inverses are `ratio2`, (s, h).
    """
    then = min(int(np.searchsorted(known.edges, age)) - 1, int(known.began.max()))
    begun = np.flatnonzero(known.began[: known.goes_on] == max(then, int(known.began.min())))
    likely = turn[:, begun]
    likely = np.exp(likely - likely.max())
    rate2 = change2[:, begun] + 1.0 / ratio2[:, begun]
    return float(np.sqrt((likely * rate2).sum() / likely.sum()))


def _crept(state: State, known: Changes) -> FloatArray:
    """Return by how much a bias may have crept, rad/s, (h,): as temperature moved, where it is known."""
    past = state.past
    if np.isnan(past.first_degc):
        return np.asarray(CREEP * past.unit_s * (known.start - known.end))
    # There and back counts twice: a bias with hysteresis comes back by another way.
    middle, degc = 0.5 * (known.edges[1:] + known.edges[:-1]), past.warmed(known.edges)[:, 0]
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(degc)))])
    return np.asarray(SLOPE * (np.interp(known.start, middle, way) - np.interp(known.end, middle, way)))


def _explained(square: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much chi-square falls, (s, h), if the variances, which are one, are larger by a prior.

    And the product by which they are larger.  The squares of what is seen, and the prior, are (axes, s, h).
    """
    more = 1.0 + prior
    return np.asarray((square * (prior / more)).sum(0)), np.asarray(more.prod(0))


def forget(state: State, share: float = FORGET) -> None:
    """Begin a history; of what the last told of the strength of the flicker, a share holds."""
    state.past.forget()
    state.strengths = state.strengths_seen = share * (state.strengths_seen - state.strengths_seen.max())
    state.unseen = np.zeros(3)


@lru_cache(16)
def _slopes(count: int, width: float, unit_s: float) -> tuple[FloatArray, FloatArray]:
    """Return weights of means of `width` units, the latest first, that tell how they grow, and the variance.

    They tell the change from the middle of the oldest of `count` to that of the latest best (Gauss-Markov)
    for each noise that is tried: (s, count), and (s,) over the variance of the white noise in a unit.
    """
    age = width * np.arange(count + 1)
    variance = unit_s * np.tensordot(SHARES, _correlation(age, unit_s), 1)
    inverse = np.linalg.inv(np.eye(count) / width + variance + UNKNOWN)
    profile = np.linspace(0.5, -0.5, count)
    weights = inverse @ profile
    information = weights @ profile
    return weights / information[:, np.newaxis], 1.0 / information


def grown(state: State, means: FloatArray, slots: int) -> tuple[FloatArray, FloatArray]:
    """Return by how much gyros' means, (n, 3), of so many slots each, the latest first, have grown evenly.

    And the variance of that by white noise and wander, (3,) each.
    """
    unit_s = float(f"{EVERY * state.slot_s:.2g}")
    weights, variance = _slopes(len(means), slots / EVERY, unit_s)
    share = np.exp(state.strengths_seen - state.strengths_seen.max())
    share /= share.sum()
    white = np.maximum(state.windows.variance[3, GYRO], state.windows.resolution[GYRO] ** 2 / 12.0) + TINY
    return share @ weights @ means, white * np.exp(share @ np.log(variance))


def wander_after(state: State, seconds: float) -> FloatArray:
    """Return the mean square by which each gyro's mean of 8 s may differ after a time, (3,)."""
    weight = np.exp(state.strengths_seen - state.strengths_seen.max())
    moved = weight @ (SHARES @ (-2.0 * np.expm1(-seconds / TAUS_S))) / weight.sum()
    white = state.windows.variance[3, GYRO] * EVERY * state.slot_s
    return np.asarray(white * (2.0 / 8.0 + moved))
