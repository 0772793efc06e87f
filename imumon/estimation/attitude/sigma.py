"""Standard deviation of VQF's vertical about each level axis, and of the heading.

The equations (T1) to (H5) are in docs/appendix/attitude-details.md, under the same letters.

VQF turns the specific force into axes that only the gyros carry, low-passes it there with the time constant
τ = 3 s, and takes what is left for up, u.  True up stands still in these axes.  So an error of the tilt shows
as a change of u, but not if it stays for over 6 s.  The element i, j of the gyros' matrix of scale and
misalignment turns the attitude wrong by that element times q_ij, the integral of c_i rate_j over a slot, with
c_i the axis of gyro i in gyro-carried axes; q_ii is the turn about the gyro's own axis.

A calibrated magnetometer ties the heading down: VQF follows the field with τ = 9 s.  B_h and B_v are the
horizontal and the vertical field, and B_cal its calibrated strength.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.model import MagnetometerModel

from .fusion import TAU_ACC_S, TAU_MAG_S

SLOT_S = 0.5  # length of a slot, s: short beside τ
LAG_S = 2.0 * TAU_ACC_S
"""Lag of d, s, after which VQF's low-pass has forgotten; m within three lags.  Ablation: "lag 12 s"."""
ACCEL_SD = 0.075
"""a0 of accelerometers that are not declared, m/s²: 7.6 mg, between 5 and 10 mg of a calibrated unit."""
SCALE_SD = 0.02  # s0 of gyros that are not declared: between 1 % of a calibrated unit and 3 % of an MPU-6050
SCALE_TURN = 2.0  # w0, rad²: s0 counts like so much turn.  Ablation: "w0 8 rad²".
CONFIRMING_TURN = 0.1
"""rad² of tilt by turns about the gyros' own axes that confirm all, as mixed-up axes show in any.  It counts
half: a tilt of 18°, held 3 s and taken back, is enough, or 26° alone.  Ablation: "confirmed at 1 rad²"."""
LARGEST_CHANGE = 0.05  # share of these rad² that the sum of d may have.  Ablation: "largest change 1 %".
IRON = 0.025
"""k_iron, share of the field.  A prior, as `ACCEL_SD`: a single pose shows one of three components."""
IRON_MEMORY_S = 30.0
"""Time in which iron is forgotten, s: it may have been in the room.  Ablation: "iron forgotten in 300 s"."""


class Slot(NamedTuple):
    """Half a second of motion or rest."""

    end: Any  # `fusion.ROW` of the first sample behind it
    rest: bool  # whether the unit was at rest for the whole slot, with a known bias
    up: FloatArray  # u at its end, in gyro-carried axes, (3,)
    up_body: FloatArray  # and in body axes
    wrong_turns: FloatArray  # q_ij, rad, in gyro-carried axes, in column 3 i + j, (3, 9); zero at rest
    missed: float  # variance of the angle by samples that are missing, rad²
    bias_sd: float  # standard deviation of the gyro bias about the vertical, rad/s; NaN while it is not known
    field: FloatArray  # in body axes, in the unit of the calibration, (3,); NaN where none came


def tilt_squared(wrong_turns: FloatArray, up: FloatArray) -> FloatArray:
    """Return tilt²_ij = |q_ij|² - (u q_ij)², rad², of each column (T4)."""
    return np.asarray((wrong_turns * wrong_turns).sum(0) - (up @ wrong_turns) ** 2)


class Accelerometers:
    """Size of the accelerometers' error (T7): e is the mean of |low-passed force| - g of each face of the
    body that was up, in motion too, where accelerations widen it; a declared a is taken as it is."""

    def __init__(self, declared: float | None) -> None:
        # The margin is 2, as e shows one of three components.
        self.prior, self.margin = (ACCEL_SD**2, 2.0) if declared is None else (declared**2, 0.0)
        self.slots, self.excess = np.zeros((2, 6))
        """Of each face: slots in which it was up, and the sum of |low-passed force| - g over them, m/s²."""

    def learn(self, up_body: FloatArray, low_force: float) -> None:
        """Take a slot."""
        axis = int(np.argmax(np.abs(up_body)))
        face = 2 * axis + int(up_body[axis] > 0.0)
        self.slots[face] += 1.0
        self.excess[face] += low_force - STANDARD_GRAVITY

    @property
    def variance(self) -> float:
        """a² = a0² + 2 mean e², (m/s²)²."""
        squares = (self.excess / np.maximum(self.slots, 1.0)) ** 2
        return self.prior + self.margin * float(squares.sum()) / max(int(np.count_nonzero(self.slots)), 1)


@dataclass
class Gyros:
    """Size of the gyros' scale errors, and whether u has followed their turns: else axes may be mixed up."""

    declared: float | None
    change: float = 0.0  # sum of d = |u(t) - u(t - 6 s)|² (T1) over all lags, rad²
    turned: float = 0.0  # sum of tilt²_ij, rad²
    followed: float = 0.0
    """Half the sum of tilt²_ii that u has had the time to follow, rad²: of turns in 3 of the 6 s of a lag."""

    def learn(self, change: float, wrong_turns: FloatArray, up: FloatArray) -> None:
        """Take d, rad², and q_ij, (n, 3, 9), of the slots of the last lag."""
        share = SLOT_S / LAG_S  # successive lags overlap
        followed = wrong_turns[: -round(TAU_ACC_S / SLOT_S)].sum(0)
        self.change += share * change
        self.turned += share * float(tilt_squared(wrong_turns.sum(0), up).sum())
        self.followed += share * float(tilt_squared(followed, up)[::4].sum())

    @property
    def confirmed(self) -> bool:
        """Whether the gyros have turned the vertical as they should."""
        return self.followed > CONFIRMING_TURN and not self.contradicted

    @property
    def contradicted(self) -> bool:
        """Whether they have turned it enough and not as they should."""
        return self.followed > CONFIRMING_TURN and self.change >= LARGEST_CHANGE * self.followed

    @property
    def variance(self) -> float:
        """s² = (w0 s0² + Σ d) / (w0 + Σ tilt²_ij) (T5), at most as declared: accelerations change u, too."""
        prior = (SCALE_SD if self.declared is None else self.declared) ** 2
        learned = (SCALE_TURN * prior + self.change) / (SCALE_TURN + self.turned)
        return learned if self.declared is None else min(learned, prior)

    def error_variance(self, squares: FloatArray) -> float:
        """Return s² times the sum of squares of q_ij, rad², (9,), and until confirmed all of q_ii."""
        return self.variance * float(squares.sum()) + (not self.confirmed) * float(squares[::4].sum())


class TiltSigma:
    """Estimate of the tilt's standard deviation since the attitude, or its accelerometers, began."""

    def __init__(self, accelerometers: Accelerometers, gyros: Gyros) -> None:
        self.accelerometers, self.gyros = accelerometers, gyros
        self.lag: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=round(LAG_S / SLOT_S) + 1)
        """u and q_ij of the slots of the last lag, and those before it."""
        self.mean = 0.0
        """m (T2), the mean of d/4 over 18 s, rad²: d is of two axes, and u is off at both moments."""
        self.late = np.zeros((3, 9))  # q_ij that are forgotten within τ, rad

    def step(self, slot: Slot) -> float:
        """Take a slot; return the variance at its end, max(m, d/2, l) + a²/g², rad².

        Each shows the same error; d/2, as u was right where a motion begins.  NaN in the first 6 s.
        """
        self.lag.append((slot.up, slot.wrong_turns))
        change = float(((slot.up - self.lag[0][0]) ** 2).sum())
        self.accelerometers.learn(slot.up_body, float(slot.end["low_force"]))
        latest = list(self.lag)[-round(LAG_S / SLOT_S) :]
        self.gyros.learn(change, np.array([wrong_turns for _, wrong_turns in latest]), slot.up)
        self.mean += SLOT_S / (3.0 * LAG_S) * (0.25 * change - self.mean)
        self.late = math.exp(-SLOT_S / TAU_ACC_S) * self.late + slot.wrong_turns
        if SLOT_S * len(self.lag) < LAG_S:
            return math.nan
        changed = max(self.mean, 0.5 * change, self.not_followed(slot.up))
        return changed + self.accelerometers.variance / STANDARD_GRAVITY**2

    def not_followed(self, up: FloatArray) -> float:
        """Return l (T6), rad², by turns of the last τ, which u has not followed yet."""
        return 0.5 * self.gyros.error_variance(tilt_squared(self.late, up))


class HeadingSigma:
    """Estimate of the heading's standard deviation since the attitude began.

    The change of a relative heading since the bias is known has the variance v = s² Σ h_ij² + variance by
    missing samples + that by the bias + (∫ earth_rate dt)² (H1), and Σ h_ii² more until the gyros are
    confirmed; white noise, and motion nearly as fast as the samples, are not in it.  An uncalibrated
    `magnetometer` is None; `earth_rate` is the vertical one left in the corrected rate, rad/s.
    """

    def __init__(self, gyros: Gyros, magnetometer: MagnetometerModel | None, earth_rate: float) -> None:
        self.gyros, self.magnetometer, self.earth_rate = gyros, magnetometer, earth_rate
        self.about_up = np.zeros(9)  # h_ij = u q_ij, summed over all slots, rad
        self.earlier = 0.0  # variance by what the bias was before, and by missing samples, rad²
        self.drift, self.by_earth = 0.0, 0.0  # sd by the bias as it is now, and by the earth rate, rad
        self.field_correction = 0.0
        """p, the angle by which the field has turned the heading against the gyros, forgotten with τ, rad."""
        self.bias_sd, self.delta = math.nan, math.nan  # of the last slot, rad/s and rad
        self.by_field = math.nan  # variance by the field that the heading has followed last, rad²
        self.iron = 0.0  # largest along² + across² lately, in the square of the field's unit

    def step(self, slot: Slot, tilt_variance: float) -> float:
        """Take a slot; return the variance of the heading, or of its change where it is relative, rad²."""
        known = not math.isnan(slot.bias_sd)
        if not known:
            self.about_up, self.earlier, self.drift, self.by_earth = np.zeros(9), 0.0, 0.0, 0.0
        elif slot.rest:  # the bias has a part of its past error still; the other part is independent of it
            same = min(slot.bias_sd / self.bias_sd, 1.0) if self.bias_sd > 0.0 else 1.0
            self.earlier += (1.0 - same**2) * self.drift**2
            self.drift *= same
        else:
            self.drift += SLOT_S * slot.bias_sd
            self.by_earth += SLOT_S * self.earth_rate
            self.about_up += slot.up @ slot.wrong_turns
            self.earlier += slot.missed
        self.bias_sd = slot.bias_sd
        follows = slot.end["north"] and slot.end["follows"] and not math.isnan(slot.field[0])
        if follows:  # the field corrects what is older than τ
            keep = math.exp(-SLOT_S / TAU_MAG_S)
            self.about_up *= keep
            self.drift *= keep
            self.by_earth *= keep
            self.earlier *= keep**2
            self.field_correction *= keep
        turned = self.gyros.error_variance(self.about_up**2)
        relative = turned + self.earlier + self.drift**2 + self.by_earth**2 if known else math.nan
        if follows:
            self.by_field = self._magnetic(slot, tilt_variance, relative)
        return self.by_field + relative if slot.end["north"] else relative

    def _magnetic(self, slot: Slot, tilt_variance: float, relative: float) -> float:
        """Return (H2) less v: (e_cal² + e_iron² + B_v² θ²) / B_h²; NaN without a calibration.

        θ² is the variance of the tilt, and `relative` is v.  e_cal is the error of the calibration, and
        e_iron the iron that came after it (H5), with a margin of 2 for what a pose does not show.
        """
        if not math.isnan(self.delta):  # at first the field shows where north is: that is no change
            self.field_correction += math.remainder(slot.end["delta"] - self.delta, 2.0 * math.pi)
        self.delta, magnetometer = float(slot.end["delta"]), self.magnetometer
        strength, vertical = float(np.linalg.norm(slot.field)), float(slot.field @ slot.up_body)
        horizontal2 = strength**2 - vertical**2
        if magnetometer is None or not horizontal2 > 0.0:
            return math.nan
        prior = magnetometer.error_sd**2 + (IRON * magnetometer.field) ** 2 + vertical**2 * tilt_variance
        along2 = (strength - magnetometer.field) ** 2  # (H3)
        across2 = horizontal2 * (self.field_correction**2 - relative) - prior  # (H4): beyond what is expected
        self.iron *= math.exp(-SLOT_S / IRON_MEMORY_S)
        if math.isfinite(across2):
            self.iron = max(self.iron, along2 + max(across2, 0.0))
        return (prior + 2.0 * self.iron) / horizontal2
