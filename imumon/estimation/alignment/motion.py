"""Disturbances of a unit that should stand still, slot by slot: knocks, steps on the floor, and turns.

A slot is disturbed when its mean leaves those of the last half minute by more than they scatter, or its
samples scatter far more.  So sway that has been there is no disturbance.  A turn is followed by the gyros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray

RECENT = 120
"""Slots of which the usual level and scatter are taken: half a minute holds two periods of slow sway."""
RENEWED = 8
"""Slots after which they are taken anew."""
LEAST = 8
"""Slots, 2 s, after which a unit is taken to rest, at the start and after a disturbance."""
LIMIT = 7.0
"""Standard deviations: less than once a year for Gaussian means of six channels in slots of 1/4 s."""
FINEST = np.array([2e-8, 2e-8, 2e-8, 2e-4, 2e-4, 2e-4])
"""The scatter of means is never taken for less, rad/s and m/s²: 20 µg, 0.004 °/h."""
TURNING = 1e-3
"""rad/s: a unit whose rate differs by more from that at rest is still being turned; a hand is not slower."""
NORMAL = 1.4826
"""Standard deviation of normal values over the median of their sizes."""


@dataclass(frozen=True, slots=True)
class Slot:
    """One slot: middle and length in s, samples, mean and variance of the six channels, whether at rest."""

    time_s: float
    length_s: float
    samples: int
    mean: FloatArray
    variance: FloatArray
    at_rest: bool


@dataclass
class Motion:
    """What is known of the unit's rest.

    Parameters
    ----------
    recent : array (m, 6), scatter : array (m, 6)
        Means and variances of the last undisturbed slots.
    calm : list of Slot
        Slots that may be a new rest.
    base : array (3,)
        Rate at the last rest, rad/s.
    turned : array (3, 3)
        Body axes of now to those when the disturbance began.
    last : array (3,)
        Angle of the last slot, rad, for the coning correction.
    """

    recent: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    scatter: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    calm: list[Slot] = field(default_factory=list)
    base: FloatArray | None = None
    turned: FloatArray = field(default_factory=lambda: np.eye(3))
    last: FloatArray = field(default_factory=lambda: np.zeros(3))
    known: tuple[FloatArray, FloatArray, FloatArray] | None = None
    age: int = 0
    disturbed: bool = True
    cause: str = ""
    begun_s: float = math.nan
    angle: float = 0.0
    """Sum of the angles of the disturbance, rad."""

    def judge(self, slot: Slot) -> str:
        """Return what disturbs the slot, or nothing."""
        if not slot.at_rest:
            return "the unit moved"
        if len(self.recent) < LEAST:
            return ""
        middle, spread, scatter = self.usual()
        middle = middle.copy()
        middle[3:] = np.median(self.recent[-LEAST:, 3:], axis=0)  # an accelerometer may warm up
        limit = LIMIT + 3.0 * LIMIT / math.sqrt(len(self.recent))
        off = np.abs(slot.mean - middle) > limit * spread
        if off[:3].any():
            return "the unit turned"
        if off[3:].any():
            return "the specific force jumped"
        noisy = np.sqrt(slot.variance) > scatter[0] + limit * scatter[1]
        if slot.samples >= LEAST and noisy.any():
            return "a shock or vibration"
        return ""

    def usual(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return median and scatter of the means of recent slots, (6,), and both of their noise, (2, 6)."""
        if self.known is None:
            middle = np.median(self.recent, axis=0)
            spread = NORMAL * np.median(np.abs(self.recent - middle), axis=0) + FINEST
            noise = np.sqrt(self.scatter)
            usual = np.median(noise, axis=0)
            varied = NORMAL * np.median(np.abs(noise - usual), axis=0) + FINEST
            self.known = middle, spread, np.stack([usual, varied])
        return self.known

    def go_on(self, slot: Slot) -> None:
        """Add an undisturbed slot."""
        self.age += 1
        if len(self.recent) < RECENT or self.age % RENEWED == 0:
            self.known = None
        self.recent = np.vstack([self.recent[-RECENT + 1 :], slot.mean])
        self.scatter = np.vstack([self.scatter[-RECENT + 1 :], slot.variance])

    def begin(self, slot: Slot, cause: str) -> None:
        """Begin a disturbance."""
        self.base = np.median(self.recent[:, :3], axis=0) if len(self.recent) else None
        self.disturbed, self.cause, self.begun_s = True, cause, slot.time_s - 0.5 * slot.length_s
        self.turned, self.last, self.angle, self.calm = np.eye(3), np.zeros(3), 0.0, []

    def follow(self, slot: Slot) -> bool:
        """Follow the unit through a disturbed slot; return whether it may rest in it."""
        if self.base is not None:
            angle = slot.length_s * (slot.mean[:3] - self.base)
            # First-order coning correction of successive slots: Savage 1998, J. Guidance 21(1), eq. 41.
            turn = angle + np.cross(self.last, angle) / 12.0
            self.turned = self.turned @ Rotation.from_rotvec(turn).as_matrix()
            self.last = angle
            self.angle += float(np.sqrt(angle @ angle))
        if self.base is not None and np.abs(slot.mean[:3] - self.base).max() > TURNING:
            return False
        if not self.calm or len(self.recent) < LEAST:
            return True
        off = slot.mean - np.median([other.mean for other in self.calm], axis=0)
        return bool((np.abs(off) < 2.0 * LIMIT * self.usual()[1]).all())

    @property
    def rested(self) -> bool:
        """Whether the calm has lasted."""
        if len(self.calm) < LEAST or not self.calm[-1].at_rest:
            return False
        return float(np.std([slot.mean[:3] for slot in self.calm], axis=0).max()) < TURNING

    def rest(self, same: bool) -> None:
        """End the disturbance; the unit stands as before, or in a new pose."""
        means = np.array([slot.mean for slot in self.calm])
        scatter = np.array([slot.variance for slot in self.calm])
        if same and len(self.recent) >= LEAST:
            means = np.vstack([self.recent, means])
            scatter = np.vstack([self.scatter, scatter])
        self.recent, self.scatter, self.known = means[-RECENT:], scatter[-RECENT:], None
        self.disturbed, self.calm = False, []
