"""How far the heading may be off: a free one by its change, one by the magnetometer by calibration and iron.

A free heading turns wrong by scale errors of what was turned about the vertical (J of `tilt_sigma`), by gyros
that are not confirmed (as there), and by the bias, which each rest measures anew::

    free     = min(s², s0²) |sum of u J|² + sum over unconfirmed gyros of (sum of u J_ii)²
               + sum over motions of (bias sd, seconds)² + lost                                          (1)

A calibrated magnetometer ties the heading down.  VQF follows it with tau_mag and forgets older parts of (1).
With H and V the horizontal and the vertical field, c the error of the calibration, i the iron on the unit
that came after it, and p the angle by which the field turned the heading against the gyros, forgotten alike::

    magnetic = (c² + i² + (V tilt)²) / H² + (1) forgotten                                                (2)
    iron  i² = i0² + 2 largest (along² + across²) of the last half minute                               (3)
    along    = |m| less its calibrated strength                                                          (4)
    across²  = (H p)² beyond H² (2) with i = i0                                                          (5)

The 2 in (3): what is along the field in one pose is across it in another, as in (5) of the tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_MAG_S
from imumon.estimation.attitude.tilt_sigma import SLOT_S, Gyros, Slot
from imumon.models.magnetometer import MagnetometerModel

IRON = 0.025
"""i0, share of the field: iron that came after the calibration and has not shown yet.  A bet, as `ACCEL_SD`:
a single pose shows one of three components.  Ablation: attitude, i0."""
IRON_MEMORY_S = 30.0
"""Time in which iron that has shown is forgotten, s: it may have been a magnet in the room, and the next pose
shows it again."""


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
    iron: float = 0.0
    """Largest (along² + across²) of (3), in the square of the field's unit."""
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
        self.iron *= math.exp(-SLOT_S / IRON_MEMORY_S)
        if slot.follow_rate and math.isfinite(across2):
            self.iron = max(self.iron, (strength - magnetometer.field) ** 2 + across2)
        return (declared + 2.0 * self.iron) / level2 + free
