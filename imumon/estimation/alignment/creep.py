"""A turn about the vertical within a pose, too slow to be a disturbance: as a head creeps on its tripod.

The vertical gyro sees its rate beside what it reads at rest, the earth's and its bias.  So a pose is cut into
pieces, and the hypotheses are: it stands; or it turns from one of the pieces to another, at a mean rate and
one of its own in each about that, and stands in the others, and in the pose before.  What it reads at rest
is then Gaussian under each, and so is the evidence; where it turns in all pieces, nothing but the earth's
rate and the usual bias tell.  A turn at a constant rate all the time looks like a bias: that is for
`posterior`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray

PIECES = 12
LEAST_ROWS = 4
"""Of a piece: fewer say nothing of the noise."""
RATES = np.geomspace(1e-6, 1e-2, 5)
"""Standard deviations of the rates that are thought of, rad/s, 0.2 °/h to 0.6 °/s: from a degree in an hour
to what begins a disturbance.  A rate between them costs at most a factor of three in evidence."""
CREEPING = 0.1
"""Prior probability of a turn, as of a tripod that settles (`hypotheses.SETTLING`)."""
ALL_ALONG = CREEPING / (PIECES * (PIECES + 1) // 2)
"""That of one at a constant rate in the whole record, which is one of so many intervals."""
LIKELIEST = 8
"""Hypotheses that are handed on; neighbours of the true interval, the others have lost by far."""
SMOOTH_ROWS = 16
"""4 s of slots: what is slower is the turn, what is faster is noise."""
ROUNDING = 1e-12
"""rad/s: of a mean over a piece."""


class Rest(NamedTuple):
    """What a vertical gyro reads at rest, rad/s, and the variance of that."""

    rate: float
    variance: float


@dataclass(frozen=True, slots=True, eq=False)
class Usual:
    """What a vertical gyro should read at rest: the rate of the earth, and a bias of one of some sizes.

    Parameters
    ----------
    rate : float
        rad/s.
    variance : array, (s,)
        Of the bias, (rad/s)².
    log_prior : array, (s,)
    """

    rate: float
    variance: FloatArray
    log_prior: FloatArray

    def given(self, rests: Rests) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how likely hypotheses and sizes are together, a logarithm, and the rest: mean and variance.

        All (h, s).
        """
        variance = rests.variance[:, None]
        both = variance + self.variance
        off = self.rate - rests.rate[:, None]
        logs = self.log_prior - 0.5 * (off**2 / both + np.log(both))
        return logs, rests.rate[:, None] + off * variance / both, variance * self.variance / both


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """What a vertical gyro reads at rest by each hypothesis, for all that the gyro shows alone, all (h,).

    Parameters
    ----------
    rate, variance : array
        rad/s and its square.
    log_weight : array
        Logarithm of prior probability times evidence.
    """

    rate: FloatArray
    variance: FloatArray
    log_weight: FloatArray

    def together(self) -> Rest:
        """Return mean and variance, whatever is usual."""
        return mixture(probabilities(self.log_weight), self.rate, self.variance)


@dataclass(frozen=True, slots=True, eq=False)
class Creep:
    """How a unit turns about the vertical within a pose.

    Parameters
    ----------
    angle : array, (n,)
        Counter-clockwise since the middle of what counts, rad.
    noise : array, (n,)
        What the vertical gyro shows without the turn, rad/s.
    rest : Rest
        The likeliest, by which the angle is counted, and how far it may be off.
    rests : Rests
        The likeliest hypotheses of it.
    log_usual : array, (h,)
        How well each agrees with what is usual, a logarithm.
    before_s, after_s : float
        From the beginning to that middle, and from there to the end.
    of_bias : complex
        What is left of a level bias, which turns with the unit, in the mean of rates that are turned back.
    """

    angle: FloatArray
    noise: FloatArray
    rest: Rest
    rests: Rests
    log_usual: FloatArray
    before_s: float
    after_s: float
    of_bias: complex

    @property
    def before(self) -> float:
        """Angle from the beginning to the middle, rad."""
        return -float(self.angle[0])

    @property
    def after(self) -> float:
        """Angle from the middle to the end, rad."""
        return float(self.angle[-1])

    def turned(self, rest: Rest) -> float:
        """Return the angle in all of the pose, rad, if the gyro reads something else at rest."""
        return self.before + self.after + (self.rest.rate - rest.rate) * (self.before_s + self.after_s)


def creep(
    time_s: FloatArray, weight: FloatArray, rate: FloatArray, usual: Usual, before: Rest | None = None
) -> Creep:
    """Return how a unit turns by the rates of its vertical gyro, rad/s, all (n,).

    Rows without weight stand.  `before` is what the pose before says of this one.
    """
    counts = weight > 0.0
    rows = np.flatnonzero(counts)
    parts = np.array_split(rows, min(PIECES, len(rows) // LEAST_ROWS))
    means = np.array([rate[part].mean() for part in parts])
    steps = np.diff(rate[rows])
    noise = 0.5 * float(steps @ steps) / len(steps) / (len(rows) / len(parts)) + ROUNDING**2
    known = [] if before is None else [before]
    inside = _intervals(len(parts), len(known))
    rests = _at_rest(
        np.array([*means, *(one.rate for one in known)]),
        np.array([*[noise] * len(parts), *(one.variance for one in known)]),
        inside,
    )
    logs, at_rest, variance = usual.given(rests)
    log_usual = np.logaddexp.reduce(logs, axis=1)
    probability = probabilities(rests.log_weight[:, None] + logs)
    rest = float(at_rest.flat[np.argmax(probability)])
    spread = float(np.sum(probability * (variance + (at_rest - rest) ** 2)))
    which = np.searchsorted([part[0] for part in parts[1:]], np.arange(len(rate)), "right")
    turns = (probability.sum(1) @ inside)[which]
    step = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    angle = step * np.cumsum(np.where(counts, rate - rest, 0.0))
    middle_s = float(weight @ time_s / weight.sum())
    angle -= np.interp(middle_s, time_s, angle)
    near = np.ones(min(SMOOTH_ROWS, len(rate)))
    smooth = np.convolve(counts * (rate - rest), near, "same") / np.maximum(
        np.convolve(counts, near, "same"), 1.0
    )
    best = np.argsort(-(rests.log_weight + log_usual))[:LIKELIEST]
    return Creep(
        angle, rate - turns * smooth, Rest(rest, spread),
        Rests(rests.rate[best], rests.variance[best], rests.log_weight[best]), log_usual[best],
        middle_s - float(time_s[0]), float(time_s[-1]) - middle_s,
        complex(weight @ np.exp(1j * angle) / weight.sum()),
    )  # fmt: skip


def _at_rest(mean: FloatArray, noise: FloatArray, inside: FloatArray) -> Rests:
    """Return what a gyro reads at rest by each hypothesis, of which the first is that it stands.

    Those that differ in nothing but the size of the rates are one: mean and variance over these.

    Parameters
    ----------
    mean, noise : array, (k,)
        Of each piece: mean rate, rad/s, and its variance.
    inside : array, (h, k)
        One where it turns.
    """
    middle, turns, common = float(mean.mean()), inside[:, None], RATES**-2.0
    off = mean - middle
    precision = 1.0 / (noise + turns * RATES[:, None] ** 2)  # (h, sizes, k)
    turning, standing = np.sum(precision * turns, -1), np.sum(precision * (1.0 - turns), -1)
    turned, stood = np.sum(precision * turns * off, -1), np.sum(precision * (1.0 - turns) * off, -1)
    # Normal equations of the rate at rest and the mean rate of the turn, without differences that cancel.
    total = standing * (turning + common) + turning * common
    rest = ((turning + common) * stood + common * turned) / total
    turn = (turned - turning * rest) / (turning + common)
    left = off - rest[..., None] - turns * turn[..., None]
    misfit = np.sum(precision * left**2, -1) + common * turn**2
    logs = 0.5 * (np.log(precision).sum(-1) + np.log(common / total) - misfit)
    probability = probabilities(logs, axis=1)
    rates = np.sum(probability * rest, 1)
    variance = np.sum(probability * ((turning + common) / total + (rest - rates[:, None]) ** 2), 1)
    prior = np.r_[1.0 - CREEPING, np.full(len(inside) - 1, CREEPING / max(len(inside) - 1, 1))]
    return Rests(middle + rates, variance, np.logaddexp.reduce(logs, axis=1) + np.log(prior / len(RATES)))


def mixture(probability: FloatArray, rates: FloatArray, variances: FloatArray) -> Rest:
    """Return mean and variance of a mixture; arrays of any shape."""
    rate = float(np.sum(probability * rates))
    return Rest(rate, float(np.sum(probability * (variances + (rates - rate) ** 2))))


def probabilities(logs: FloatArray, axis: int | None = None) -> FloatArray:
    """Return probabilities that add up to one along an axis, or over all."""
    weight = np.exp(logs - logs.max(axis=axis, keepdims=True))
    return np.asarray(weight / weight.sum(axis=axis, keepdims=True))


def _intervals(pieces: int, more: int) -> FloatArray:
    """Return in which pieces in a row it may turn, none first; in the last `more` it stands."""
    at = np.arange(pieces + more)
    first, last = np.triu_indices(pieces)
    some = (at >= first[:, None]) & (at <= last[:, None])
    return np.concatenate([np.zeros((1, len(at))), some])


def upright_turn(angle: float) -> FloatArray:
    """Return the matrix, (3, 3), of a turn about the vertical, rad, counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
