"""Standard deviation of VQF's vertical about each level axis, and of the heading; tables in docs/attitude.md.

VQF turns the specific force into axes that only the gyros carry, low-passes it there with the time constant
τ = 3 s, and takes what is left for up, u.  True up stands still in these axes.  So an error of the tilt shows
as a change of u, whether accelerations or gyros cause it.  J, (3, 9), is the integral of C (x) rate over a
slot, with C from body to gyro-carried axes: column 3 i + j is the rotation vector that a unit element (i, j)
of the gyros' matrix of scale and misalignment adds, so 0, 4 and 8 are the turns about the gyros' own axes.

A calibrated magnetometer ties the heading down: VQF follows the field with τ = 9 s.  H and V are the
horizontal and the vertical field, and B its calibrated strength.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_ACC_S, TAU_MAG_S, Rows
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.magnetometer import MagnetometerModel

SLOT_S = 0.5
"""Length of a slot, s: short beside τ."""
LAG_S = 2.0 * TAU_ACC_S
"""Lag of d, s, after which VQF's low-pass has forgotten; m is the mean over three.  Ablation."""
ACCEL_SD = 0.075
"""a0 of accelerometers that are not declared, m/s²: 7.5 mg, between 5 and 10 mg of a calibrated unit.  A
prior that a single pose cannot correct: it does not tell 5 mg from 40."""
SCALE_SD = 0.02
"""s0 of gyros that are not declared: between 1 % of a calibrated unit and 3 % of an MPU-6050."""
SCALE_TURN = 2.0
"""g0, rad²: s0 counts like so much turn.  Ablation."""
CONFIRMING_TURN = 0.1
"""rad² of tilt by turns about the gyros' own axes that confirm them: 18°.  With 0.05 a robot arm whose gyros
x and y are exchanged is off by up to 10 sigma.  Ablation."""
LARGEST_CHANGE = 0.05
"""Share of that tilt by which u may change.  Ablation."""
IRON = 0.025
"""i0, share of the field.  A prior, as `ACCEL_SD`: a single pose shows one of three components."""
IRON_MEMORY_S = 30.0
"""Time in which iron that has shown is forgotten, s: it may have been a magnet in the room, and the next pose
shows it again.  Ablation."""


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """Half a second of motion or rest; vectors in gyro-carried axes unless stated otherwise."""

    rest: bool
    """Whether the unit was at rest for the whole slot."""
    up: FloatArray
    up_body: FloatArray
    """u at its end, in gyro-carried and in body axes, (3,)."""
    force: FloatArray
    """Mean specific force, m/s², (3,); NaN where there is none."""
    low_force: float
    """Magnitude of the low-passed specific force at its end, m/s²; NaN where there is none."""
    sensitivity: FloatArray
    """J, rad, (3, 9)."""
    missed: float
    """Variance of the angle by samples that are missing, rad²."""
    bias_sd: float
    """Standard deviation of the gyro bias about the vertical, rad/s; NaN while it is not known."""


def tilt_squared(sensitivity: FloatArray, up: FloatArray) -> FloatArray:
    """Return tilt²(J) = |J|² - (u J)², rad², of each column of J."""
    return np.asarray((sensitivity * sensitivity).sum(0) - (up @ sensitivity) ** 2)


@dataclass(slots=True)
class Accelerometers:
    """Size of the accelerometers' error: a² = a0² + 2 mean z², z the mean of |low-passed force| - g of each
    face of the body that was up; a declared a is taken as it is."""

    declared: float | None
    face_s: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Time for which each face was up, s."""
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
        """a², (m/s²)²; the 2 in it is a margin, as z shows one of three components."""
        if self.declared is not None:
            return self.declared**2
        z = self.face_sum / np.maximum(self.face_s, SLOT_S)
        return ACCEL_SD**2 + 2.0 * float(z @ z) / max(int(np.count_nonzero(self.face_s)), 1)


@dataclass(slots=True)
class Gyros:
    """Size of the gyros' scale errors, and whether u has followed their turns: else axes may be mixed up."""

    declared: float | None
    change: float = 0.0
    """Sum of d = |u(t) - u(t - 6 s)|², the change of u, over all lags, rad²."""
    turned: float = 0.0
    """Sum of tilt²(J), rad²."""
    followed: float = 0.0
    """Sum of tilt² by turns about the gyros' own axes that u has had the time to follow, rad²."""

    def learn(self, change: float, sensitivities: FloatArray, up: FloatArray) -> None:
        """Take d, rad², and J, (n, 3, 9), of the slots of the last lag."""
        share = SLOT_S / LAG_S  # successive lags overlap
        own = sensitivities[: -round(TAU_ACC_S / SLOT_S)].sum(0)[:, ::4]
        # A turn counts as a quarter of a circle at most: by half a circle each way the vertical is the same.
        circle = np.maximum((own**2).sum(0) / (0.5 * math.pi) ** 2, 1.0)
        self.change += share * change
        self.turned += share * float(tilt_squared(sensitivities.sum(0), up).sum())
        self.followed += share * float((tilt_squared(own, up) / circle).sum())

    @property
    def confirmed(self) -> bool:
        """Whether the gyros have turned the vertical as they should."""
        return self.followed > CONFIRMING_TURN and self.change < LARGEST_CHANGE * self.followed

    @property
    def contradicted(self) -> bool:
        """Whether they have turned it enough and not as they should."""
        return self.followed > CONFIRMING_TURN and not self.confirmed

    @property
    def variance(self) -> float:
        """s² = (g0 s0² + Σ d) / (g0 + Σ tilt²(J)); no more than is declared: accelerations change u, too."""
        prior = (SCALE_SD if self.declared is None else self.declared) ** 2
        learned = (SCALE_TURN * prior + self.change) / (SCALE_TURN + self.turned)
        return learned if self.declared is None else min(learned, prior)

    @property
    def turn_variance(self) -> float:
        """Variance of a turn over its square: s², and 1 more until the gyros are confirmed."""
        return self.variance + (not self.confirmed)

    def error_variance(self, squares: FloatArray) -> float:
        """Return s² times the sum of squared turns, rad², (9,), and until confirmed all of the own ones."""
        return self.variance * float(squares.sum()) + (not self.confirmed) * float(squares[::4].sum())


@dataclass(slots=True)
class TiltSigma:
    """State of the estimate of the tilt's standard deviation, since the attitude began."""

    accelerometers: Accelerometers
    gyros: Gyros
    ups: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=round(LAG_S / SLOT_S) + 1))
    sensitivities: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=round(LAG_S / SLOT_S)))
    """u and J of the last lag."""
    mean: float = 0.0
    """m, the mean of d/4 over 18 s of motion, rad²: d is of two axes, and u is off at both moments."""
    late: FloatArray = field(default_factory=lambda: np.zeros((3, 9)))
    """J that is forgotten within τ, rad."""
    rested: bool = False
    """Whether the unit has been at rest since the attitude began."""

    def step(self, slot: Slot) -> float:
        """Take a slot; return the variance at its end, rad²; NaN while nothing is known.

        At rest it is |u - f/|f||² / 2 + a²/g², with the mean specific force f.
        """
        self.ups.append(slot.up)
        self.sensitivities.append(np.zeros((3, 9)) if slot.rest else slot.sensitivity)
        change = float(((slot.up - self.ups[0]) ** 2).sum())
        if math.isfinite(slot.low_force):
            self.accelerometers.learn(slot.up_body, slot.low_force)
        self.gyros.learn(change, np.array(self.sensitivities), slot.up)
        if slot.rest:
            self.rested = True
            self.late[:] = 0.0
            variance = 0.5 * float(((slot.up - slot.force / np.linalg.norm(slot.force)) ** 2).sum())
        else:
            variance = self._in_motion(slot, change)
        return variance + self.accelerometers.variance / STANDARD_GRAVITY**2

    def _in_motion(self, slot: Slot, change: float) -> float:
        """Return max(m, d/2, l), rad²; d/2 as u was right where a motion begins: all its change is error."""
        self.mean += SLOT_S / (3.0 * LAG_S) * (0.25 * change - self.mean)
        self.late = math.exp(-SLOT_S / TAU_ACC_S) * self.late + slot.sensitivity
        if not self.rested and SLOT_S * len(self.sensitivities) < LAG_S:
            return math.nan  # begun in motion: there is no earlier vertical to compare with
        return max(self.mean, 0.5 * change, self._not_followed(slot.up))

    def _not_followed(self, up: FloatArray) -> float:
        """Return l, rad², by turns of the last τ, which u has not followed yet."""
        return 0.5 * self.gyros.error_variance(tilt_squared(self.late, up))


@dataclass(slots=True)
class HeadingSigma:
    """State of the estimate of the heading's standard deviation, since the attitude began.

    The change of a relative heading has the variance h: s² |Σ u J|², (Σ u J_ii)² until the gyros are
    confirmed, the bias of each motion, which the next rest measures anew, Σ (bias sigma · seconds)², and
    missed samples.
    """

    gyros: Gyros
    magnetometer: MagnetometerModel | None
    """None: not calibrated, so a heading by it has no sigma."""
    earth_rate: float
    """Vertical part of it that is left in the corrected rate, rad/s."""
    about_up: FloatArray = field(default_factory=lambda: np.zeros(9))
    """Sum of u J: turn about the vertical for each element of scale and misalignment, rad."""
    earlier: float = 0.0
    """Variance by the bias in the motions before, and by missing samples, rad²."""
    moving_s: float = 0.0
    """Duration of this motion, s."""
    field_correction: float = 0.0
    """p, the angle by which the field has turned the heading against the gyros, forgotten with τ, rad."""
    delta: float = math.nan
    """That of the last slot, rad."""
    iron: float = 0.0
    """Largest along² + across² lately, in the square of the field's unit."""

    def step(self, slot: Slot, end: Rows, tilt_variance: float) -> float:
        """Process a slot; return the variance of the heading, or of its change where it is relative, rad².

        `end` is the last sample of the slot, a `fusion.ROW` with the field in the unit of the calibration.
        """
        if math.isnan(slot.bias_sd):
            self.about_up[:] = self.earlier = self.moving_s = 0.0
        bias_sd = math.hypot(slot.bias_sd, self.earth_rate)
        if slot.rest:
            self.earlier += (bias_sd * self.moving_s) ** 2
            self.moving_s = 0.0
        else:
            self.moving_s += SLOT_S
            self.about_up += slot.up @ slot.sensitivity
            self.earlier += slot.missed
        if end["north"] and end["follows"]:  # the field corrects what is older than τ
            keep = math.exp(-SLOT_S / TAU_MAG_S)
            self.about_up *= keep
            self.moving_s *= keep
            self.earlier *= keep**2
            self.field_correction *= keep
        relative = self.gyros.error_variance(self.about_up**2) + self.earlier + (bias_sd * self.moving_s) ** 2
        return self._magnetic(slot.up_body, end, tilt_variance, relative) if end["north"] else relative

    def _magnetic(self, up_body: FloatArray, end: Rows, tilt_variance: float, relative: float) -> float:
        """Return (c² + i² + V² tilt) / H² + h, NaN where the magnetometer is not calibrated.

        c is the error of the calibration, and i the iron that came after it: i² = (i0 B)² + 2 · largest
        (along² + across²) of the last half minute.  The 2 is a margin for the component that a pose does not
        show; along = strength - B; across² = (H p)² - H² h - (c² + (i0 B)² + V² tilt), if positive.
        """
        if not math.isnan(self.delta):  # at first the field shows where north is: that is no change
            self.field_correction += math.remainder(end["delta"] - self.delta, 2.0 * math.pi)
        self.delta, magnetometer = float(end["delta"]), self.magnetometer
        strength, vertical = float(np.linalg.norm(end["field"])), float(end["field"] @ up_body)
        horizontal2 = max(strength**2 - vertical**2, 0.0)
        if magnetometer is None or not horizontal2 > 0.0:
            return math.nan
        prior = magnetometer.error_sd**2 + (IRON * magnetometer.field) ** 2 + vertical**2 * tilt_variance
        across2 = horizontal2 * (self.field_correction**2 - relative) - prior
        self.iron *= math.exp(-SLOT_S / IRON_MEMORY_S)
        if end["follows"] and math.isfinite(across2):
            self.iron = max(self.iron, (strength - magnetometer.field) ** 2 + max(across2, 0.0))
        return (prior + 2.0 * self.iron) / horizontal2 + relative
