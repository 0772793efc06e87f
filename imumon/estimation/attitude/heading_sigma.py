"""How far the heading may be off: a free one by its change, one by the magnetometer by calibration and iron.

A free heading turns wrong by scale errors of what was turned about the vertical (J of `tilt_sigma`), by gyros
that are not confirmed (as there), and by the bias, which each rest measures anew::

    free     = min(s², s0²) |sum of u J|² + sum over unconfirmed gyros of (sum of u J_ii)²
               + sum over motions of (bias sd, seconds)² + lost                                          (1)

A calibrated magnetometer ties the heading down.  VQF follows it with tau_mag and forgets older parts of (1).
With H and V the horizontal and the vertical field, c the error of the calibration, i the iron on the unit
that came after it, and p the angle by which the field turned the heading against the gyros, forgotten alike::

    magnetic = (c² + i² + (V tilt)²) / H² + (1) forgotten                                                (2)
    iron  i² = i0² + 2 mean of (along² + across²) over the body faces that the field pointed out of        (3)
    along    = mean of |m| less its calibrated strength in the latest visit of that face                 (4)
    across²  = largest (H p)² beyond H² (2) with i = i0, in that visit                                   (5)

The 2 in (3): what is along the field in one pose is across it in another, as in (5) of the tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_MAG_S
from imumon.estimation.attitude.tilt_sigma import SLOT_S, Gyros, Slot, face_of
from imumon.models.magnetometer import MagnetometerModel

IRON = 0.025
"""i0, share of the field: iron that came after the calibration and has not shown yet.  A bet, as `ACCEL_SD`:
a single pose shows one of three components.  Ablation: attitude, i0."""


@dataclass(slots=True)
class Iron:
    """Size of the iron on the unit, by the strength and the direction of the field in each pose."""

    followed_s: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Time for which the field pointed out of each face and was followed, s, in the latest visit."""
    along: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Integral of |m| less the calibrated strength over that time."""
    across2: FloatArray = field(default_factory=lambda: np.zeros(6))
    """(5) of that visit."""
    face: int = -1

    def learn(self, magnetic: FloatArray, excess: float, across2: float, seconds: float) -> None:
        """Take a slot's field, its strength less the calibrated one, (5), and how long it was followed, s."""
        face = face_of(magnetic)
        if face != self.face:
            self.face = face
            self.followed_s[face] = self.along[face] = self.across2[face] = 0.0
        self.followed_s[face] += seconds
        self.along[face] += seconds * excess
        self.across2[face] = max(self.across2[face], across2)

    @property
    def variance(self) -> float:
        """i² - i0² of (3), in the square of the field's unit."""
        known = self.followed_s > 0.0
        if not known.any():
            return 0.0
        return 2.0 * float(np.mean((self.along[known] / self.followed_s[known]) ** 2 + self.across2[known]))


@dataclass(slots=True)
class HeadingSigma:
    """State of the estimate of the heading's standard deviation, from one beginning of it to the next.

    Parameters
    ----------
    gyros : Gyros
        As of the tilt.
    magnetometer : MagnetometerModel or None
        None: not calibrated, so a heading by it has no sigma.
    earth_rate : float
        What the bias does not hold of it, rad/s.
    """

    gyros: Gyros
    magnetometer: MagnetometerModel | None
    earth_rate: float
    iron: Iron = field(default_factory=Iron)
    about_up: FloatArray = field(default_factory=lambda: np.zeros(9))
    """Sum of u J: turn about the vertical for each element of scale and misalignment, rad."""
    earlier: float = 0.0
    """Variance by the bias in the motions before, and by lost samples, rad²."""
    moving_s: float = 0.0
    """Duration of this motion, s."""
    pull: float = 0.0
    """p, rad."""
    yaw: float = math.nan
    """That of the last slot, rad."""

    def step(self, slot: Slot, tilt_variance: float) -> float:
        """Take a slot; return the variance of the heading, or of its change where it is free, rad²."""
        if math.isnan(slot.bias_sd):
            self.about_up[:] = self.earlier = self.moving_s = 0.0
        bias_sd = math.hypot(slot.bias_sd, self.earth_rate)
        if slot.rest:
            self.earlier += (bias_sd * self.moving_s) ** 2
            self.moving_s = 0.0
        else:
            self.moving_s += SLOT_S
            self.about_up += slot.up @ slot.turn
            self.earlier += slot.lost
        if not slot.north:
            return self._free(bias_sd)
        self._forget(slot)
        return self._magnetic(slot, tilt_variance, self._free(bias_sd), self.magnetometer)

    def _free(self, bias_sd: float) -> float:
        """(1)."""
        squares = self.about_up**2
        scale = min(self.gyros.variance, self.gyros.prior) * float(squares.sum())
        unconfirmed = float(squares[::4] @ ~self.gyros.confirmed)
        return scale + unconfirmed + self.earlier + (bias_sd * self.moving_s) ** 2

    def _forget(self, slot: Slot) -> None:
        """Forget what VQF has corrected by the field, and take by how much that was."""
        keep = math.exp(-slot.follow_rate * SLOT_S / TAU_MAG_S)
        self.about_up *= keep
        self.moving_s *= keep
        self.earlier *= keep * keep
        # At first the field shows where north is: that is no change.
        change = 0.0 if math.isnan(self.yaw) else math.remainder(slot.yaw - self.yaw, math.tau)
        self.pull, self.yaw = keep * self.pull + change, slot.yaw

    def _magnetic(
        self, slot: Slot, tilt_variance: float, free: float, magnetometer: MagnetometerModel | None
    ) -> float:
        """(2)."""
        strength, vertical = float(np.linalg.norm(slot.field)), float(slot.field @ slot.up_body)
        level2 = max(strength**2 - vertical**2, 0.0)
        if magnetometer is None or not level2:
            return math.nan
        declared = magnetometer.error_sd**2 + (IRON * magnetometer.field) ** 2 + vertical**2 * tilt_variance
        across2 = max(level2 * (self.pull**2 - free) - declared, 0.0)
        if math.isfinite(across2):
            seconds = slot.follow_rate * SLOT_S
            self.iron.learn(slot.field, strength - magnetometer.field, across2, seconds)
        return (declared + self.iron.variance) / level2 + free
