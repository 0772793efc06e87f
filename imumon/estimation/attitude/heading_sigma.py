"""Standard deviation of the heading, relative or by the magnetometer; the table is in docs/attitude.md.

A relative heading turns wrong by scale errors of what was turned about the vertical, u J of `tilt_sigma`, by
gyros that are not confirmed, and by the bias, which each rest measures anew::

    h = s² |Σ u J|² + (Σ u J_ii)² of gyros not confirmed + Σ over motions (bias sigma · seconds)² + missed

A calibrated magnetometer ties it down: VQF follows the field with τ = 9 s and forgets older parts of h.  H
and V are the horizontal and the vertical field, B its calibrated strength, c the error of the calibration, i
the iron that came after it, p the angle by which the field has turned the heading against the gyros::

    variance = (c² + i² + V² tilt) / H² + h
    i² = (i0 B)² + 2 · largest (along² + across²) of the last half minute
    along = strength - B;  across² = (H p)² - H² h - (c² + (i0 B)² + V² tilt), if positive

The 2 is a margin for the component of the iron that a pose does not show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_MAG_S, Rows
from imumon.estimation.attitude.tilt_sigma import SLOT_S, Gyros, Slot
from imumon.models.magnetometer import MagnetometerModel

IRON = 0.025
"""i0, share of the field.  A prior, as `ACCEL_SD`: a single pose shows one of three components."""
IRON_MEMORY_S = 30.0
"""Time in which iron that has shown is forgotten, s: it may have been a magnet in the room, and the next pose
shows it again.  Ablation."""


@dataclass(slots=True)
class HeadingSigma:
    """State of the estimate of the heading's standard deviation, since the attitude began."""

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
    """p, forgotten with τ, rad."""
    delta: float = math.nan
    """That of the last slot, rad."""
    iron: float = 0.0
    """Largest along² + across², in the square of the field's unit."""

    def step(self, slot: Slot, end: Rows, tilt_variance: float) -> float:
        """Process a slot; return the variance of the heading, or of its change where it is relative, rad².

        `end` is the last sample of the slot, a `fusion.ROW` with the field in the unit of the calibration.
        """
        about_vertical = float(np.linalg.norm(slot.up_body * end["bias_sd"]))
        if math.isnan(about_vertical):
            self.about_up[:] = self.earlier = self.moving_s = 0.0
        bias_sd = math.hypot(about_vertical, self.earth_rate)
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
        """Return the variance of a heading by the field, NaN where the magnetometer is not calibrated."""
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
