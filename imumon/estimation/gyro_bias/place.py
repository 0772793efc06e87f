"""Attitude of a unit against the earth, as far as the bias needs it: up at rest, and turns in between.

At rest the specific force shows where up is.  While the unit moves, the gyros follow it sample by sample
(`imumon.filters.turns`): that keeps north, or bounds how much of the earth rate that is taken for bias has
turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import Turn
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL, earth_rate_along, north_in_body

TURN_SD = 0.01
"""Error of the heading after a turn, over the angle turned."""
LOST_SD = 1.0
"""Error of a heading that is not known, rad; the sine of larger ones is no larger."""


@dataclass(frozen=True, slots=True)
class Place:
    """Latitude and first heading, rad; NaN when they are not known."""

    latitude: float
    heading: float

    @property
    def oriented(self) -> bool:
        """Whether the earth rate is known in all three axes."""
        return math.isfinite(self.heading) and math.isfinite(self.latitude)

    @property
    def turning(self) -> float:
        """Earth rate that is part of the bias, and turns against the body, rad/s."""
        return 0.0 if self.oriented else self.horizontal

    @property
    def horizontal(self) -> float:
        """Horizontal earth rate, rad/s; the most it can be where the latitude is not known."""
        return EARTH_RATE * (math.cos(self.latitude) if math.isfinite(self.latitude) else 1.0)


@dataclass(slots=True, eq=False)
class Attitude:
    """Up, north and earth rate at the last rest, body axes."""

    gravity: float = 0.0
    """Specific force at rest, m/s²; 0 without accelerometers."""
    up: FloatArray = field(default_factory=lambda: np.zeros(3))
    north: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Unit vectors, (3,); zero where not known."""
    earth: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What is known of the earth rate, rad/s, (3,)."""
    placed: bool = False

    def come_to_rest(
        self, force: FloatArray | None, place: Place, turn: Turn, drift: float, lost: bool
    ) -> FloatArray:
        """Take the attitude of a new rest; return what that adds to the variance of the bias, (3,).

        Parameters
        ----------
        force : array (3,) or None
            Mean specific force, m/s².
        turn : Turn
            Since the last rest.
        drift : float
            Error of the heading that the bias has made meanwhile, rad; NaN when it is not known.
        lost : bool
            Whether nobody knows how far it has turned.
        """
        before, placed = self.up, self.placed
        self.gravity = 0.0 if force is None else float(np.linalg.norm(force))
        if force is None or self.gravity == 0.0:
            self.gravity = 0.0
            return np.zeros(3)
        self.up, self.placed = force / self.gravity, True
        added = np.zeros(3)
        if place.oriented:
            sampled = math.sqrt(turn.sampling_variance(before))
            heading_sd = min(LOST_SD, TURN_SD * turn.path + sampled + drift) if math.isfinite(drift) else 0.0
            if placed:
                northward = self.north @ turn.rotation
                northward -= (northward @ self.up) * self.up
                length = float(np.linalg.norm(northward))
                if length > LEAST_HORIZONTAL and not lost:
                    self.north = northward / length
                else:
                    self.north, heading_sd = north_in_body(self.up, place.heading), LOST_SD
                added = (place.horizontal * heading_sd) ** 2 * (1.0 - self.up**2)
            else:
                self.north = north_in_body(self.up, place.heading)
        elif placed:
            added = turned_earth(before, place, turn)
        if math.isfinite(place.latitude):
            self.earth = earth_rate_along(self.up, self.north, place.latitude)
        return added


def turned_earth(up: FloatArray, place: Place, turn: Turn) -> FloatArray:
    """Return the variance of what a turn does to the earth rate that is taken for bias, (3,).

    Its direction is not known; `up` (3,) is that before the turn.
    """
    if place.oriented:
        return np.zeros(3)
    change = turn.rotation.T - np.eye(3)
    square = (change * change) @ np.ones(3)
    if math.isfinite(place.latitude):
        return np.asarray(0.5 * place.horizontal**2 * (square - (change @ up) ** 2))
    return np.asarray(place.horizontal**2 / 3.0 * square)
