"""A turn about the vertical within a pose, too slow to be a disturbance: as a head creeps on its tripod.

The vertical gyro sees its rate beside what it reads at rest, the earth's and its bias.  So a pose is cut into
pieces, and the hypotheses are: it stands; or it turns from one of the pieces to another, at a rate of its own
in each, and stands in the others, and in the pose before.  What it reads at rest is then Gaussian under each,
and so is the evidence.  A turn that has gone on all the time looks like a bias: that is for `posterior`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray

PIECES = 12
LEAST_ROWS = 4
"""Of a piece: fewer say nothing of the noise."""
RATES = np.geomspace(1e-6, 1e-3, 3)
"""Standard deviations of the rates that are thought of, rad/s, 0.2 to 200 °/h: a degree in an hour, to what a
hand does.  A rate between them costs at most a factor of six in evidence."""
CREEPING = 0.1
"""Prior probability of a turn, as of a tripod that settles (`hypotheses.SETTLING`)."""
ALL_ALONG = CREEPING / (PIECES * (PIECES + 1) // 2)
"""That of one that lasts the whole record, which is one of so many intervals."""
SMOOTH_ROWS = 16
"""4 s of slots: what is slower is the turn, what is faster is noise."""
ROUNDING = 1e-12
"""rad/s: of a mean over a piece."""


class Rest(NamedTuple):
    """What a vertical gyro reads at rest, rad/s, and the variance of that."""

    rate: float
    variance: float


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
    before_s, after_s : float
        From the beginning to that middle, and from there to the end.
    """

    angle: FloatArray
    noise: FloatArray
    rest: Rest
    before_s: float
    after_s: float

    @property
    def before(self) -> float:
        """Angle from the beginning to the middle, rad."""
        return -float(self.angle[0])

    @property
    def after(self) -> float:
        """Angle from the middle to the end, rad."""
        return float(self.angle[-1])


def creep(time_s: FloatArray, weight: FloatArray, rate: FloatArray, before: Rest | None = None) -> Creep:
    """Return how a unit turns by the rates of its vertical gyro, rad/s, all (n,).

    Rows without weight stand.  `before` is what the pose before says of this one.
    """
    counts = weight > 0.0
    rest, turns = _at_rest(rate, counts, before)
    step = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    angle = step * np.cumsum(np.where(counts, rate - rest.rate, 0.0))
    middle_s = float(weight @ time_s / weight.sum())
    angle -= np.interp(middle_s, time_s, angle)
    near = np.ones(min(SMOOTH_ROWS, len(rate)))
    smooth = np.convolve(counts * (rate - rest.rate), near, "same") / np.maximum(
        np.convolve(counts, near, "same"), 1.0
    )
    return Creep(
        angle, rate - turns * smooth, rest, middle_s - float(time_s[0]), float(time_s[-1]) - middle_s
    )


def _at_rest(rate: FloatArray, counts: BoolArray, before: Rest | None) -> tuple[Rest, FloatArray]:
    """Return what a gyro reads at rest, and how likely it is that each row turns, (n,)."""
    rows = np.flatnonzero(counts)
    pieces = min(PIECES, len(rows) // LEAST_ROWS)
    parts = np.array_split(rows, pieces)
    steps = np.diff(rate[rows])
    noise = 0.5 * float(steps @ steps) / len(steps) / (len(rows) / pieces) + ROUNDING**2
    known = [] if before is None else [before]
    mean = np.array([*(rate[part].mean() for part in parts), *(one.rate for one in known)])
    own = np.array([*[noise] * pieces, *(one.variance for one in known)])
    inside = _intervals(pieces, len(known))
    variance = own + np.concatenate([np.zeros((1, len(own))), *(inside * size**2 for size in RATES)])
    precision = 1.0 / variance
    total = precision.sum(1)
    middle = precision @ mean / total
    misfit = (precision * (mean - middle[:, None]) ** 2).sum(1)
    logs = 0.5 * (np.log(precision).sum(1) - np.log(total) - misfit)
    logs += np.log(np.r_[1.0 - CREEPING, np.full(len(logs) - 1, CREEPING / max(len(logs) - 1, 1))])
    probability = np.exp(logs - logs.max())
    probability /= probability.sum()
    rest = float(probability @ middle)
    spread = float(probability @ (1.0 / total + (middle - rest) ** 2))
    turns = probability[1:] @ np.tile(inside, (len(RATES), 1))
    which = np.searchsorted([part[0] for part in parts[1:]], np.arange(len(rate)), "right")
    return Rest(rest, spread), turns[which]


def _intervals(pieces: int, more: int) -> FloatArray:
    """Return the pieces in a row in which it may turn, not all; in the last `more` it stands."""
    at = np.arange(pieces + more)
    first, last = np.triu_indices(pieces)
    inside = (at >= first[:, None]) & (at <= last[:, None])
    return np.asarray(inside[~inside.all(1)], np.float64)


def upright_turn(angle: float) -> FloatArray:
    """Return the matrix, (3, 3), of a turn about the vertical, rad, counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
