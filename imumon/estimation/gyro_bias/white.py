"""White noise of gyros and accelerometers at rest, from second differences of slots.

Neither an offset nor a ramp is in a second difference, and slow drift hardly is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray

MEMORY_SLOTS = 1200.0
"""Slots over which the noise is averaged."""
NEEDED = 6
"""Second differences before the noise is believed."""
EFFECTIVE = 1.94
"""Second differences that say as much as one independent value (their variance is that of an MA(2))."""
CLIP = 16.0
"""A squared second difference counts as no more than this times its mean."""
LEAST_RATE, LEAST_TILT = 3e-7, 1e-6
"""What no measured noise is believed to be below (rad/sqrt(s), rad sqrt(s)): readings that do not change."""


@dataclass(slots=True, eq=False)
class WhiteNoise:
    """What is known of the noise so far."""

    squares: FloatArray = field(default_factory=lambda: np.zeros(4))
    """Sums of squared second differences over what they are at unit density, (4,): of the three rates, and
    the sum of those of the two tilts."""
    count: float = 0.0
    """Of second differences, faded."""
    last: list[tuple[float, FloatArray]] = field(default_factory=list)
    """The slots in a row, two at the most, (dt, rate and tilt) each."""

    @property
    def known(self) -> bool:
        """Whether there is enough to believe."""
        return self.count >= NEEDED

    def begin(self) -> None:
        """Say that the next slot does not follow the last."""
        self.last = []

    def add(self, dt: float, rate: FloatArray, tilt: FloatArray) -> None:
        """Take the means of a slot at rest, rad/s and rad, (3,) each."""
        values = np.concatenate([rate, tilt])
        if len(self.last) == 2:
            (dt_2, values_2), (dt_1, values_1) = self.last
            squares = (values - 2.0 * values_1 + values_2) ** 2 / (1.0 / dt + 4.0 / dt_1 + 1.0 / dt_2)
            new = squares[:4]
            new[3] = 0.5 * (squares[3] + squares[4] + squares[5])
            if self.known:
                new = np.minimum(new, CLIP * self.squares / self.count)
            keep = 1.0 - 1.0 / MEMORY_SLOTS
            self.squares = keep * self.squares + new
            self.count = keep * self.count + 1.0
        self.last = [*self.last[-1:], (dt, values)]

    @property
    def rate(self) -> FloatArray:
        """Angular random walk of each axis, rad/sqrt(s), (3,), widened as Student's t is of few values."""
        degrees = self.count / EFFECTIVE
        widening = degrees / (degrees - 2.0)
        return np.maximum(LEAST_RATE, np.sqrt(widening * self.squares[:3] / self.count))

    @property
    def tilt(self) -> float:
        """The same of the tilt by the accelerometers, rad sqrt(s)."""
        return max(LEAST_TILT, math.sqrt(self.squares[3] / self.count))
