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

SCALE_SD = 0.01
"""Error of an element of the matrix of scale and misalignment: consumer data sheets."""
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
    def horizontal(self) -> float:
        """Horizontal earth rate, rad/s; the most it can be where the latitude is not known."""
        return EARTH_RATE * (math.cos(self.latitude) if math.isfinite(self.latitude) else 1.0)


@dataclass(slots=True, eq=False)
class Attitude:
    """Up, north and earth rate at the last rest, body axes."""

    up: FloatArray = field(default_factory=lambda: np.zeros(3))
    north: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Unit vectors, (3,); zero where not known."""
    earth: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What is known of the earth rate, rad/s, (3,)."""
    heading_variance: float = 0.0
    """Of the heading, where the place is known, rad²."""
    placed: bool = False

    def uncertain_earth(self, place: Place) -> FloatArray:
        """Return the variance of the known earth rate by the error of the heading, (rad/s)², (3,)."""
        return np.asarray(place.horizontal**2 * self.heading_variance * (1.0 - self.up**2))

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
            Whether the angle turned is not known, as readings were missing.
        """
        before, placed = self.up, self.placed
        if force is None or not force.any():
            return np.zeros(3)
        self.up, self.placed = force / np.linalg.norm(force), True
        added = np.zeros(3)
        if place.oriented:
            sampled = math.sqrt(turn.sampling_variance(before))
            scaled = SCALE_SD * float(np.linalg.norm(np.tensordot(before, turn.by_scale, 1)))
            heading_sd = min(LOST_SD, scaled + sampled + drift) if math.isfinite(drift) else 0.0
            if placed:
                northward = self.north @ turn.rotation
                northward -= (northward @ self.up) * self.up
                length = float(np.linalg.norm(northward))
                if length > LEAST_HORIZONTAL and not lost:
                    self.north = northward / length
                else:
                    self.north, heading_sd = north_in_body(self.up, place.heading), LOST_SD
                added = (place.horizontal * heading_sd) ** 2 * (1.0 - self.up**2)
                self.heading_variance = min(LOST_SD**2, self.heading_variance + heading_sd**2)
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
