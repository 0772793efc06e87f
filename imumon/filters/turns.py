"""How a unit has turned over a slot, integrated sample by sample: the one place where rates become attitude.

Rotations do not add up where the axis of rotation moves (coning), so a mean rate over a slot has lost a part
of the turn.  Here each sample turns the unit (Bortz 1971; Savage 1998).  From one to the next it turns by the
rotation vector::

    phi_k = alpha_k + c alpha_(k-1) x alpha_k,    alpha_k = rate_k dt

with c = 1/12 where a sample is the mean rate since the one before (Savage 1998, eq. 47), c = 0 where the
device has taken coning into account itself, and 1/24 where it samples the rate at a moment (the same
expansion, of a tangent instead of a chord).  Which one holds is not known: 1/24 is taken, with an error of
as much.  Of motion nearly as fast as the samples, the squared second differences of alpha bound the rest.
What is faster than half the sample rate is lost, unless the device has integrated it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner

MIDDLE = 1.0 / 24.0
"""Of the products of successive angles: what is added, and the error of that."""
FAST = 1.0 / 40.0
"""Of the squared second differences of the angles.  A cone of half angle a at half the sample rate has
64 a² of these a sample, and of its turn, pi a² / 2, nothing is measured."""
PAUSE_S, PAUSE_INTERVALS = 0.25, 3.0
"""A longer pause, in s and in usual intervals, hides how the unit turned in it."""
LATE = 1.5
"""Intervals after which a sample is missing."""
SMALL = 1e-2
"""rad: of rotation vectors up to this the term of third order is below 1e-5 of the next angle."""
HALF_CIRCLE = 3.0
"""rad: near half a circle a matrix does not tell which way round."""


@dataclass(slots=True, eq=False)
class Turn:
    """A turn, from body axes at its beginning to those at its end, and what may be wrong with it."""

    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    """C: vectors in the axes of its end to those of its beginning, (3, 3)."""
    by_bias: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    """Integral of C dt, s, (3, 3): times a bias it is the angle that this adds, in the axes of the
    beginning."""
    by_scale: FloatArray = field(default_factory=lambda: np.zeros((3, 3, 3)))
    """Integral of C[a, i] rate[j] dt, rad, (3, 3, 3): the angle about a by the element i, j of the matrix
    of scale and misalignment."""
    coning: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What may be missing or too much between samples, rad, with one sign, (3,)."""
    fast: float = 0.0
    """The same of motion that is nearly too fast for the samples, rad, in any direction."""
    missed: float = 0.0
    """Variance by samples that are missing, rad²."""
    seconds: float = 0.0
    """Time of all samples, each since the one before; without pauses."""
    path: float = 0.0
    """Sum of the angles of the parts that it is made of, rad."""

    def less(self, bias: FloatArray) -> Turn:
        """Return the turn by rates without a constant bias, rad/s, (3,), to first order of its angle."""
        angle = self.by_bias @ bias
        rotation = rotation_by(-angle) @ self.rotation
        return Turn(
            rotation, self.by_bias, self.by_scale - self.by_bias[:, :, np.newaxis] * bias, self.coning,
            self.fast, self.missed, self.seconds, angle_of(rotation),
        )  # fmt: skip

    def then(self, other: Turn) -> Turn:
        """Return this turn and another after it."""
        c = self.rotation
        return Turn(
            c @ other.rotation,
            self.by_bias + c @ other.by_bias,
            self.by_scale + (c @ other.by_scale.reshape(3, 9)).reshape(3, 3, 3),
            self.coning + c @ other.coning,
            self.fast + other.fast,
            self.missed + other.missed,
            self.seconds + other.seconds,
            self.path + other.path,
        )

    def scale_about(self, axis: FloatArray) -> FloatArray:
        """Return the angle about an axis, (3,), by each element of the matrix of scale and misalignment."""
        return np.asarray((axis @ self.by_scale.reshape(3, 9)).reshape(3, 3))

    def sampling_variance(self, axis: FloatArray) -> float:
        """Return the variance of the angle about an axis, (3,), for want of more samples, rad²."""
        coning = float(axis @ self.coning)
        return coning * coning + self.fast**2 + self.missed


STILL = Turn()
"""No turn, in no time."""


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """The turns of m slots, each since the last sample before: fields of `Turn`, (m, ...)."""

    rotation: FloatArray
    by_bias: FloatArray
    by_scale: FloatArray
    coning: FloatArray
    fast: FloatArray
    missed: FloatArray
    seconds: FloatArray

    def at(self, k: int) -> Turn:
        """Return one."""
        rotation = self.rotation[k]
        return Turn(
            rotation, self.by_bias[k], self.by_scale[k], self.coning[k], float(self.fast[k]),
            float(self.missed[k]), float(self.seconds[k]), angle_of(rotation),
        )  # fmt: skip


def rotation_by(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of a rotation vector, rad (Rodrigues)."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    first = math.sin(angle) / angle if angle > 0.0 else 1.0
    second = 2.0 * (math.sin(0.5 * angle) / angle) ** 2 if angle > 0.0 else 0.5
    xy, yz, zx = second * x * y, second * y * z, second * z * x
    xx, yy, zz = second * x * x, second * y * y, second * z * z
    x, y, z = first * x, first * y, first * z
    return np.array(
        [
            [1.0 - yy - zz, xy - z, zx + y],
            [xy + z, 1.0 - xx - zz, yz - x],
            [zx - y, yz + x, 1.0 - xx - yy],
        ]
    )


def angle_of(rotation: FloatArray) -> float:
    """Return the angle of a rotation (3, 3), rad; small ones to full precision."""
    (_, b, c), (d, _, f), (g, h, _) = rotation.tolist()
    sine = math.sqrt((h - f) ** 2 + (c - g) ** 2 + (d - b) ** 2)
    return math.atan2(sine, rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)


def mean_rates(turns: Turns) -> FloatArray:
    """Return the constant rates by which the same turns come about, rad/s, (m, 3); NaN without any time."""
    c = turns.rotation
    twice = np.stack([c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], 1)
    sine = 0.5 * np.sqrt((twice**2).sum(1))
    angle = np.arctan2(sine, 0.5 * (np.trace(c, axis1=1, axis2=2) - 1.0))
    longer = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 0.0)
    known = (turns.seconds > 0.0) & (angle < HALF_CIRCLE)
    rate = np.full(len(sine), np.nan)
    np.divide(0.5 * longer, turns.seconds, out=rate, where=known)
    return np.asarray(rate[:, np.newaxis] * twice)


_VECTOR, _MATRIX = (np.float64, (3,)), (np.float64, (3, 3))
_RESULTS = [
    ("rotation", *_MATRIX),
    ("by_bias", *_MATRIX),
    ("by_scale", np.float64, (3, 3, 3)),
    ("coning", *_VECTOR),
    *((name, np.float64, ()) for name in ("fast", "missed", "seconds")),
]
ENDED = np.dtype(_RESULTS)
"""Results of a slot: the fields of `Turns`."""
OPEN = np.dtype(
    [
        *_RESULTS,
        *((name, *_VECTOR) for name in ("rate", "angle", "before", "phi", "angles", "between")),
        *((name, np.float64, ()) for name in ("interval", "span")),
        *((name, np.int64, ()) for name in ("present", "time_ns")),
    ]
)
"""The turn of the slot that is being filled, and the samples before.

Samples are first summed in a small rotation vector: `phi` after `span` seconds, the sum of its `angles`, and
its part by turns `between` samples.  The rotation of the slot is advanced by it.
"""


def turns_of(ended: Any) -> Turns:
    """Return turns that were written, without what they were written into."""
    if not len(ended):
        return NONE
    return Turns(*(np.array(ended[one.name]) for one in fields(Turns)))


NONE = Turns(*(np.empty((0, *shape)) for _, _, shape in _RESULTS))


@inner
def begin_segment(turn: Any) -> None:
    """Begin with the next sample: nothing is known of how the unit turned before it."""
    turn.present = 0
    turn.interval = 0.0
    _begin_small(turn)


@inner
def begin_turn(turn: Any) -> None:
    """Begin the turn of a slot at the last sample."""
    for a in range(3):
        turn.coning[a] = 0.0
        for i in range(3):
            turn.rotation[a, i] = 1.0 if a == i else 0.0
            turn.by_bias[a, i] = 0.0
            for j in range(3):
                turn.by_scale[a, i, j] = 0.0
    turn.fast = turn.missed = turn.seconds = 0.0


@inner
def end_turn(turn: Any, ended: Any) -> None:
    """Write the turn of a slot into a row of the results."""
    _settle(turn)
    for a in range(3):
        ended.coning[a] = turn.coning[a]
        for i in range(3):
            ended.rotation[a, i] = turn.rotation[a, i]
            ended.by_bias[a, i] = turn.by_bias[a, i]
            for j in range(3):
                ended.by_scale[a, i, j] = turn.by_scale[a, i, j]
    ended.fast, ended.missed, ended.seconds = turn.fast, turn.missed, turn.seconds


@inner
def add_rate(turn: Any, time_ns: int, x: float, y: float, z: float) -> None:
    """Turn on by a sample of the rates, rad/s, which holds since the one before."""
    if not np.isfinite(x + y + z):
        return
    dt = (time_ns - turn.time_ns) * 1e-9
    turn.time_ns = time_ns
    if turn.present > 0 and dt > 0.0:
        usual = turn.interval if turn.interval > 0.0 else dt
        turn.interval = dt
        if dt > LATE * usual:
            turn.interval = LATE * usual
            _miss(turn, dt, usual, x, y, z)
        if turn.present > 0:
            _turn_on(turn, x * dt, y * dt, z * dt, dt)
    turn.present += 1
    turn.rate[0], turn.rate[1], turn.rate[2] = x, y, z


@inner
def _miss(turn: Any, dt: float, usual: float, x: float, y: float, z: float) -> None:
    """Take account of missing samples before this one."""
    change = math.sqrt((x - turn.rate[0]) ** 2 + (y - turn.rate[1]) ** 2 + (z - turn.rate[2]) ** 2)
    if dt > PAUSE_S and dt > PAUSE_INTERVALS * usual:
        # Nothing is known in between but rates before and behind: it may be all of these.
        turn.missed += ((math.sqrt(x * x + y * y + z * z) + change) * dt) ** 2
        turn.present = 0
    else:
        turn.missed += (0.5 * change * (dt - usual)) ** 2


@inner
def _turn_on(turn: Any, a: float, b: float, c: float, dt: float) -> None:
    """Add the angles of a sample, rad, to a small rotation vector phi (Bortz 1971, to second order)."""
    p, q, r = turn.angle[0], turn.angle[1], turn.angle[2]
    if turn.present == 1:
        p = q = r = 0.0
    if turn.present > 2:
        e = a - 2.0 * p + turn.before[0]
        f = b - 2.0 * q + turn.before[1]
        g = c - 2.0 * r + turn.before[2]
        turn.fast += FAST * (e * e + f * f + g * g)
    turn.before[0], turn.before[1], turn.before[2] = p, q, r
    turn.angle[0], turn.angle[1], turn.angle[2] = a, b, c
    # The turn between samples.
    u, v, w = MIDDLE * (q * c - r * b), MIDDLE * (r * a - p * c), MIDDLE * (p * b - q * a)
    turn.between[0] += u
    turn.between[1] += v
    turn.between[2] += w
    turn.angles[0] += a
    turn.angles[1] += b
    turn.angles[2] += c
    x, y, z = turn.phi[0], turn.phi[1], turn.phi[2]
    turn.phi[0] = x + a + u + 0.5 * (y * c - z * b)
    turn.phi[1] = y + b + v + 0.5 * (z * a - x * c)
    turn.phi[2] = z + c + w + 0.5 * (x * b - y * a)
    turn.span += dt
    if abs(turn.phi[0]) + abs(turn.phi[1]) + abs(turn.phi[2]) > SMALL:
        _settle(turn)


@inner
def _settle(turn: Any) -> None:
    """Turn by the small rotation vector, and begin it anew."""
    x, y, z = turn.phi[0], turn.phi[1], turn.phi[2]
    angle = math.sqrt(x * x + y * y + z * z)
    first = math.sin(angle) / angle if angle > 0.0 else 1.0
    second = 2.0 * (math.sin(0.5 * angle) / angle) ** 2 if angle > 0.0 else 0.5
    for k in range(3):
        # A row of C exp([phi x]), s + first s x phi + second (s x phi) x phi.
        s, t, m = turn.rotation[k, 0], turn.rotation[k, 1], turn.rotation[k, 2]
        e, f, g = t * z - m * y, m * x - s * z, s * y - t * x
        e, f, g = (
            first * e + second * (f * z - g * y),
            first * f + second * (g * x - e * z),
            first * g + second * (e * y - f * x),
        )
        turn.rotation[k, 0], turn.rotation[k, 1], turn.rotation[k, 2] = s + e, t + f, m + g
        middle = s + 0.5 * e, t + 0.5 * f, m + 0.5 * g
        for i in range(3):
            turn.coning[k] += middle[i] * turn.between[i]
            turn.by_bias[k, i] += middle[i] * turn.span
            for j in range(3):
                turn.by_scale[k, i, j] += middle[i] * turn.angles[j]
    _begin_small(turn)


@inner
def _begin_small(turn: Any) -> None:
    for i in range(3):
        turn.phi[i] = turn.angles[i] = turn.between[i] = 0.0
    turn.seconds += turn.span
    turn.span = 0.0
