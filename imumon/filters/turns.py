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

import math
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner

MIDDLE = 1.0 / 24.0  # of the products of successive angles: what is added, and the error of that
FAST = 1.0 / 40.0
"""Of the squared second differences of the angles.  A cone of half angle a at half the sample rate has
64 a² of these a sample, and of its turn, pi a² / 2, nothing is measured."""
PAUSE_S, PAUSE_INTERVALS = 0.25, 3.0
"""A longer pause, in s and in usual intervals, hides how the unit turned in it."""
LATE = 1.5  # intervals after which a sample is missing


class Turn(NamedTuple):
    """A turn, from body axes at its beginning to those at its end, and what may be wrong with it."""

    rotation: FloatArray = np.eye(3)
    """C: vectors in the axes of its end to those of its beginning, (3, 3)."""
    by_bias: FloatArray = np.zeros((3, 3))
    """Integral of C dt, s, (3, 3): times a bias it is the angle that this adds, in the axes of the
    beginning."""
    by_scale: FloatArray = np.zeros((3, 3, 3))
    """Integral of C[a, i] rate[j] dt, rad, (3, 3, 3): the angle about a by the element i, j of the matrix
    of scale and misalignment."""
    coning: FloatArray = np.zeros(3)
    """What may be missing or too much between samples, rad, with one sign, (3,)."""
    fast: float = 0.0  # the same of motion that is nearly too fast for the samples, rad, in any direction
    missed: float = 0.0  # variance by samples that are missing, rad²
    seconds: float = 0.0  # time of all samples, each since the one before; without pauses
    path: float = 0.0  # sum of the angles of the parts that it is made of, rad

    def less(self, bias: FloatArray) -> "Turn":
        """Return the turn of a slot less what a bias, rad/s, (3,), adds, to first order of its angle."""
        angle = self.by_bias @ bias
        rotation = rotation_by(-angle) @ self.rotation
        by_scale = self.by_scale - self.by_bias[:, :, None] * bias
        return self._replace(rotation=rotation, by_scale=by_scale, path=angle_of(rotation))

    def then(self, other: "Turn") -> "Turn":
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
        return (axis @ self.by_scale.reshape(3, 9)).reshape(3, 3)

    def sampling_variance(self, axis: FloatArray) -> float:
        """Return the variance of the angle about an axis, (3,), by missing samples, rad²."""
        coning = float(axis @ self.coning)
        return coning * coning + self.fast**2 + self.missed


STILL = Turn()  # no turn, in no time

Vector = tuple[float, float, float]


def rotation_by(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of a rotation vector, rad (Rodrigues)."""
    crossed = cross_matrix(vector)
    first, second = _rodrigues(_square(vector.tolist()))
    return np.eye(3) + first * crossed + second * (crossed @ crossed)


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that takes a vector to its cross product from the left."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def angle_of(rotation: FloatArray) -> float:
    """Return the angle of a rotation (3, 3), rad; small ones to full precision."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    twice_sine = math.sqrt((h - f) ** 2 + (c - g) ** 2 + (d - b) ** 2)
    return math.atan2(twice_sine, a + e + i - 1.0)


TURN = np.dtype(
    [(name, np.float64, (3, 3)) for name in ("rotation", "by_bias")]
    + [("by_scale", np.float64, (3, 3, 3))]
    + [(name, np.float64, (3,)) for name in ("coning", "rate", "alpha", "before")]
    + [(name, np.float64) for name in ("fast", "missed", "seconds", "interval", "slope")]
    + [("present", np.int64), ("time_ns", np.int64)]
)
"""A turn as compiled code has it: fields of `Turn`; `rate` in rad/s, `alpha` in rad and `time_ns` of the last
sample, the alpha `before` it, the last `interval` in s, which grows `LATE` times at most, the last `slope` of
the rate, rad/s², and how many samples are `present` since a pause."""
FIELDS = "rotation", "by_bias", "by_scale", "coning", "fast", "missed", "seconds"


def turn_of(record: Any) -> Turn:
    """Return the turn of one record of compiled code."""
    parts = {name: record[name] for name in FIELDS}
    return Turn(**parts, path=angle_of(parts["rotation"]))


@inner
def begin_segment(turn: Any) -> None:
    """Begin with the next sample: nothing is known of how the unit turned before it."""
    turn.present = 0
    turn.interval = 0.0


@inner
def begin_turn(turn: Any) -> None:
    """Begin the turn of a slot at the last sample."""
    turn.rotation[:] = 0.0
    turn.by_bias[:] = 0.0
    turn.by_scale[:] = 0.0
    turn.coning[:] = 0.0
    for i in range(3):
        turn.rotation[i, i] = 1.0
    turn.fast = turn.missed = turn.seconds = 0.0


@inner
def add_rate(turn: Any, time_ns: int, rate: Vector) -> None:
    """Turn on by a sample of the rates, rad/s, (3,), which holds since the one before."""
    x, y, z = rate
    if not np.isfinite(x + y + z):
        return
    dt = (time_ns - turn.time_ns) * 1e-9
    turn.time_ns = time_ns
    if turn.present > 0 and dt > 0.0:
        usual = turn.interval if turn.interval > 0.0 else dt
        turn.interval = min(dt, LATE * usual)
        if dt > LATE * usual:
            _miss_samples(turn, dt, usual, rate)
        if turn.present > 0:
            _rotate(turn, (x * dt, y * dt, z * dt), dt)
            turn.slope = math.sqrt(_change(turn, rate)) / dt
    turn.present += 1
    for i in range(3):
        turn.rate[i] = rate[i]


@inner
def _miss_samples(turn: Any, dt: float, usual: float, rate: Vector) -> None:
    change = _change(turn, rate)
    if dt > PAUSE_S and dt > PAUSE_INTERVALS * usual:
        # Of the pause only the rates before and after it are known: it may be all of these.
        turn.missed += ((math.sqrt(_square(rate)) + math.sqrt(change)) * dt) ** 2
        turn.present = 0
        turn.slope = 0.0
    else:
        # At the end of the range of a gyro both are equal, and the rate may have gone on as before.
        change = max(change, min((turn.slope * (dt - usual)) ** 2, 9.0 * _square(rate)))
        turn.missed += change * (0.5 * (dt - usual)) ** 2


@inner
def _change(turn: Any, rate: Vector) -> float:
    """Return the square of the change of the rate since the last sample, (rad/s)²."""
    x, y, z = rate
    return _square((x - turn.rate[0], y - turn.rate[1], z - turn.rate[2]))


@inner
def _rotate(turn: Any, alpha: Vector, dt: float) -> None:
    """Turn on by the angle of a sample, rad: C exp([phi x]), phi with the coning since the sample before."""
    a, b, c = alpha
    p, q, r = _vector(turn.alpha) if turn.present > 1 else (0.0, 0.0, 0.0)
    if turn.present > 2:
        k, m, n = _vector(turn.before)
        turn.fast += FAST * _square((a - 2.0 * p + k, b - 2.0 * q + m, c - 2.0 * r + n))
    x, y, z = _cross((p, q, r), alpha)
    between = (MIDDLE * x, MIDDLE * y, MIDDLE * z)
    phi = (a + between[0], b + between[1], c + between[2])
    first, second = _rodrigues(_square(phi))
    for k in range(3):
        row = _vector(turn.rotation[k])
        once = _cross(row, phi)
        twice = _cross(once, phi)
        for i in range(3):
            half = 0.5 * (first * once[i] + second * twice[i])
            middle = row[i] + half  # for the sums: C in the middle of the interval
            turn.rotation[k, i] = middle + half
            turn.coning[k] += middle * between[i]
            turn.by_bias[k, i] += middle * dt
            turn.by_scale[k, i, 0] += middle * a
            turn.by_scale[k, i, 1] += middle * b
            turn.by_scale[k, i, 2] += middle * c
    turn.before[:] = turn.alpha
    turn.alpha[0], turn.alpha[1], turn.alpha[2] = a, b, c
    turn.seconds += dt


@inner
def _rodrigues(square: float) -> tuple[float, float]:
    """Return sin(x) / x and (1 - cos(x)) / x² of a squared angle, rad², by its half."""
    half = 0.5 * math.sqrt(square)
    ratio = math.sin(half) / half if half > 0.0 else 1.0
    return ratio * math.cos(half), 0.5 * ratio * ratio


@inner
def _vector(a: Any) -> Vector:
    return a[0], a[1], a[2]


@inner
def _square(a: Vector) -> float:
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@inner
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
