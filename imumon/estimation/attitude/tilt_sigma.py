"""How far VQF's vertical may be off: one standard deviation about each level axis.

VQF turns the specific force into axes that only the gyros carry, low-passes it there with the time constant
tau, and takes what is left for up, u.  True up stands still in these axes.  So an error of the tilt shows as
a change of u, whether accelerations or gyros cause it.  With J the integral of C (x) rate over a slot, C from
body to gyro-carried axes, and level(J) = |J|² - |u J|² what of it tilts, summed over its nine columns::

    change     d  = |u(t) - u(t - 2 tau)|²                                          (1)
    mean       m  = mean of d / 4 over the last 20 s of motion                      (2)
    delay      l  = s² level(J) / 2 + sum over unconfirmed gyros of level(J_ii) / 2 + lost,
                    J of the last tau: what u has not followed yet                  (3)
    scale      s² = (g0 s0² + sum of d) / (g0 + sum of level(J over 2 tau))         (4)
    accel      a² = a0² + 2 mean of z² over the body faces that were up             (5)
    in motion  : max(m, 2 d / 4, l) + a² / g²                                       (6)
    at rest    : |u - f / |f||² / 2 + a² / g²                                       (7)

(1) has two moments and two axes, so d / 4 is the variance.  The 2 in (6): when a motion begins u was right
before, so all of the change is error.  In (5) z is the mean of |low-passed force| - g with that face up: one
of three components of the error, two of which tilt.  A gyro is confirmed once u has followed turns about its
axis; until then its error is as large as its turn, for its axis or sign may not be as declared.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.estimation.attitude.fusion import TAU_ACC_S
from imumon.geodesy import STANDARD_GRAVITY

SLOT_S = 0.5
"""Length of a slot, s; 1/4 s gives the same sigma to 0.04 of its errors."""
LAG_S = 2.0 * TAU_ACC_S
"""Lag of (1), s: by then VQF's low-pass has forgotten.  Ablation: 3 s is not honest, 12 s is 7 % wider."""
MEMORY_S = 20.0
"""A motion is taken to go on as it was for so long, s; 5 and 60 s make no difference."""
ACCEL_SD = 0.075
"""a0 of accelerometers that are not declared, m/s²: 7.5 mg, between 5 and 10 mg of a calibrated unit.  A bet:
a single pose cannot tell 5 mg from 40.  Ablation: attitude, a0."""
SCALE_SD = 0.02
"""s0 of gyros that are not declared: between 1 % of a calibrated unit and 3 % of an MPU-6050."""
SCALE_TURN = 2.0
"""g0, rad²: s0 counts like so much turn; 0.5 to 8 make no difference."""
CONFIRMING_TURN = 0.1
"""rad² of turn about its own axis, the vertical having moved as it should, that confirm a gyro."""
LARGEST_CHANGE = 0.05
"""Share of that turn by which u may change; 1 to 10 % make no difference."""


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """Half a second of motion or rest; vectors in gyro-carried axes unless stated otherwise."""

    rest: bool
    """Whether the unit was at rest for the whole slot."""
    up: FloatArray
    up_body: FloatArray
    """VQF's up at its end, in gyro-carried and in body axes, (3,)."""
    force: FloatArray
    """Mean specific force, m/s², (3,); NaN where there is none."""
    low_force: float
    """Magnitude of the low-passed specific force at its end, m/s²."""
    turn: FloatArray
    """J, rad, (3, 9)."""
    lost: float
    """Variance of the angle by samples that are missing or too slow, and by turns taken for rest, rad²."""
    bias_sd: float
    """Standard deviation of the gyro bias about the vertical, rad/s; NaN where it is not known."""
    north: bool
    field: FloatArray
    yaw: float
    follow_rate: float
    """At its end, as of `fusion.ROW`; the field in the unit of the calibration."""


@dataclass(slots=True)
class Accelerometers:
    """Size of the accelerometers' error, by the magnitude of gravity in each pose."""

    declared: float | None
    face_s: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Time for which each face of the body was up, s."""
    face_sum: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Integral of |low-passed force| - g over it, m/s."""

    def learn(self, up_body: FloatArray, low_force: float) -> None:
        """Take a slot."""
        axis = int(np.argmax(np.abs(up_body)))
        face = 2 * axis + int(up_body[axis] > 0.0)
        self.face_s[face] += SLOT_S
        self.face_sum[face] += SLOT_S * (low_force - STANDARD_GRAVITY)

    @property
    def variance(self) -> float:
        """a² of (5), (m/s²)²."""
        if self.declared is not None:
            return self.declared**2
        z = self.face_sum / np.maximum(self.face_s, SLOT_S)
        return ACCEL_SD**2 + 2.0 * float(z @ z) / max(int(np.count_nonzero(self.face_s)), 1)


@dataclass(slots=True)
class Gyros:
    """Size of the gyros' scale errors, and which axes the vertical has confirmed, by how u follows turns."""

    declared: float | None
    change: float = 0.0
    """Sum of d over all lags, rad²."""
    turned: float = 0.0
    """Sum of level(J), rad²."""
    own_change: FloatArray = field(default_factory=lambda: np.zeros(3))
    own_turned: FloatArray = field(default_factory=lambda: np.zeros(3))
    """The same of each gyro about its own axis."""
    confirmed: BoolArray = field(default_factory=lambda: np.zeros(3, bool))
    """Which gyros have turned the vertical as they should."""

    def learn(self, change: float, turned: FloatArray) -> None:
        """Take d, and level(J) over the last lag, (9,), rad²."""
        share = SLOT_S / LAG_S  # successive lags overlap
        own = turned[::4]
        self.change += share * change
        self.turned += share * float(turned.sum())
        self.own_turned += share * own
        self.own_change += share * change * own / max(float(own.sum()), 1e-12)
        self.confirmed = (self.own_turned > CONFIRMING_TURN) & (
            self.own_change < LARGEST_CHANGE * self.own_turned
        )

    @property
    def prior(self) -> float:
        """s0²."""
        return (SCALE_SD if self.declared is None else self.declared) ** 2

    @property
    def variance(self) -> float:
        """s² of (4)."""
        return (SCALE_TURN * self.prior + self.change) / (SCALE_TURN + self.turned)

    @property
    def contradicted(self) -> bool:
        """Whether a gyro has turned enough and the vertical does not confirm it."""
        return bool(((self.own_turned > CONFIRMING_TURN) & ~self.confirmed).any())


@dataclass(slots=True)
class TiltSigma:
    """State of the estimate of the tilt's standard deviation, since the attitude began."""

    accelerometers: Accelerometers
    gyros: Gyros
    ups: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=round(LAG_S / SLOT_S) + 1))
    turns: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=round(LAG_S / SLOT_S)))
    """u and J of the last lag."""
    mean: float = 0.0
    """m of (2), rad²."""
    moved_s: float = 0.0
    """Time in motion, s."""
    late: FloatArray = field(default_factory=lambda: np.zeros((3, 9)))
    """J of (3), rad."""
    lost: float = 0.0
    """Variance by lost samples, rad², forgotten within tau as J of (3)."""
    rested: bool = False
    """Whether the unit has been at rest since the attitude began."""

    def step(self, slot: Slot) -> float:
        """Take a slot; return the variance at its end, rad²; NaN while nothing is known."""
        self.ups.append(slot.up)
        self.turns.append(np.zeros((3, 9)) if slot.rest else slot.turn)
        change = float(((slot.up - self.ups[0]) ** 2).sum())
        if math.isfinite(slot.low_force):
            self.accelerometers.learn(slot.up_body, slot.low_force)
        self.gyros.learn(change, level(np.sum(self.turns, axis=0), slot.up))
        variance = self._at_rest(slot) if slot.rest else self._in_motion(slot, change)
        return variance + self.accelerometers.variance / STANDARD_GRAVITY**2

    def _at_rest(self, slot: Slot) -> float:
        """(7): the distance from the vertical that the accelerometers show."""
        self.rested = True
        self.late[:] = self.lost = 0.0
        return 0.5 * float(((slot.up - slot.force / np.linalg.norm(slot.force)) ** 2).sum())

    def _in_motion(self, slot: Slot, change: float) -> float:
        """(6)."""
        self.moved_s += SLOT_S
        self.mean += SLOT_S / min(max(self.moved_s, LAG_S), MEMORY_S) * (0.25 * change - self.mean)
        delay = self._delay(slot)
        if not self.rested and self.moved_s < LAG_S:
            return math.nan  # begun in motion: there is no earlier vertical to compare with
        return max(self.mean, 0.5 * change, delay)

    def _delay(self, slot: Slot) -> float:
        """(3)."""
        forget = math.exp(-SLOT_S / TAU_ACC_S)
        self.late = forget * self.late + slot.turn
        self.lost = forget**2 * self.lost + slot.lost
        tilted = level(self.late, slot.up)
        unconfirmed = float(tilted[::4] @ ~self.gyros.confirmed)
        return 0.5 * (self.gyros.variance * float(tilted.sum()) + unconfirmed) + self.lost


def level(turn: FloatArray, up: FloatArray) -> FloatArray:
    """Return the squares of what each element of scale and misalignment tilts, rad², (9,)."""
    return np.asarray((turn * turn).sum(0) - (up @ turn) ** 2)
