"""How far the heading may be off: a free one by its change, one by the magnetometer by calibration and iron.

A free heading turns wrong by scale errors of what was turned about the vertical (J of `tilt_sigma`), and by
the bias, which each rest measures anew.  A gyro that the vertical has not confirmed may have another axis::

    free     = min(s², s0²) |sum of u J|² + sum over motions of (bias sd, seconds)² + lost
               + p sum over unconfirmed gyros of (turn about their axis and the vertical)²              (1)

with the probability p = `WRONG_AXES`.

A calibrated magnetometer ties the heading down.  VQF follows it with tau_mag and forgets older parts of (1).
With H and V the horizontal and the vertical field, c the error of the calibration, i the iron on the unit
that came after it, and `pulled` by how much the field turned the heading against the gyros, forgotten alike::

    magnetic = (c² + i² + (V tilt)²) / H² + (1) forgotten                                                (2)
    iron  i² = i0² + 2 mean of (along² + across²) over the body faces that the field pointed out of        (3)
    along    = mean of |m| less its calibrated strength in the latest visit of that face                 (4)
    across²  = largest (H pulled)² beyond H² (2) without what has shown, in that visit                   (5)

The 2 in (3): what is along the field in one pose is across it in another, as in (5) of the tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_MAG_S
from imumon.estimation.attitude.tilt_sigma import SLOT_S, WRONG_AXES, Gyros, Slot, face_of
from imumon.models.magnetometer import MagnetometerModel

IRON = 0.025
"""i0, share of the field: iron that came after the calibration and has not shown yet.  A bet, as `ACCEL_SD`:
a single pose shows one of three components.  Ablation: attitude, i0."""
IRON_SHOWN = 2.0
"""Factor in (3): as `tilt_sigma.ACCEL_SHOWN`."""


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

    def learn(self, mag: FloatArray, too_strong: float, across2: float, seconds: float) -> None:
        """Take a slot that was followed for so many seconds."""
        face = face_of(mag)
        if face != self.face:
            self.face = face
            self.followed_s[face] = self.along[face] = self.across2[face] = 0.0
        self.followed_s[face] += seconds
        self.along[face] += seconds * too_strong
        self.across2[face] = max(self.across2[face], across2)

    @property
    def shown(self) -> float:
        """Mean square of what has shown, in the square of the field's unit."""
        known = self.followed_s > 0.0
        if not known.any():
            return 0.0
        return float(np.mean((self.along[known] / self.followed_s[known]) ** 2 + self.across2[known]))


@dataclass(slots=True)
class HeadingSigma:
    """State of the estimate of the heading's standard deviation.

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
    bias: float = 0.0
    """Variance by the bias in the motions before, and by lost samples, rad²."""
    moving_s: float = 0.0
    """Duration of this motion, s."""
    pulled: float = 0.0
    delta: float = math.nan
    """That of the last slot, rad."""

    def begin_anew(self) -> HeadingSigma:
        """Return the state when the attitude begins anew: what is known of the sensors stays."""
        return HeadingSigma(self.gyros, self.magnetometer, self.earth_rate, self.iron)

    def step(self, slot: Slot, tilt_variance: float) -> float:
        """Take a slot; return the variance of the heading, or of its change where it is free, rad²."""
        free = self._free(slot)
        return self._magnetic(slot, tilt_variance) if slot.north else free

    def _free(self, slot: Slot) -> float:
        """(1)."""
        if math.isnan(slot.bias_sd):
            self.about_up[:] = self.bias = self.moving_s = 0.0
        drift = math.hypot(slot.bias_sd, self.earth_rate)
        if slot.rest:
            self.bias += (drift * self.moving_s) ** 2
            self.moving_s = 0.0
        else:
            self.moving_s += SLOT_S
            self.about_up += slot.up @ slot.turn
            self.bias += slot.lost + slot.ignored
        return self._drifted(drift)

    def _drifted(self, drift: float) -> float:
        scale2 = min(self.gyros.variance, self.gyros.prior)
        turned = scale2 * float(self.about_up @ self.about_up)
        turned += WRONG_AXES * float(np.square(self.about_up[::4]) @ ~self.gyros.confirmed)
        return turned + self.bias + (drift * self.moving_s) ** 2

    def _magnetic(self, slot: Slot, tilt_variance: float) -> float:
        """(2)."""
        keep = math.exp(-slot.follows * SLOT_S / TAU_MAG_S)
        for name in ("about_up", "moving_s", "pulled"):
            setattr(self, name, keep * getattr(self, name))
        self.bias *= keep * keep
        # At first the field shows where north is: that is no change.
        changed = 0.0 if math.isnan(self.delta) else math.remainder(slot.delta - self.delta, math.tau)
        self.pulled, self.delta = self.pulled + changed, slot.delta
        if self.magnetometer is None:
            return math.nan
        strength = float(np.linalg.norm(slot.mag))
        vertical = float(slot.mag @ slot.up_body)
        level2 = max(strength**2 - vertical**2, 0.0)
        if not level2:
            return math.nan
        drifted = self._drifted(math.hypot(slot.bias_sd, self.earth_rate))
        usual = self.magnetometer.error_sd**2 + (IRON * self.magnetometer.field) ** 2
        usual += vertical**2 * tilt_variance
        across2 = max(level2 * self.pulled**2 - usual - level2 * drifted, 0.0)
        if math.isfinite(across2):
            self.iron.learn(slot.mag, strength - self.magnetometer.field, across2, slot.follows * SLOT_S)
        return (usual + IRON_SHOWN * self.iron.shown) / level2 + drifted
