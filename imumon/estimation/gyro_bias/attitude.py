"""Attitude of a unit against the earth, as far as the bias needs it: up at rest, and turns in between.

At rest the specific force shows where up is.  While the unit moves, mean rates of short slots are integrated
with the coning term of two successive ones (Savage 1998, eq. 47): that keeps north, or bounds how much of
the earth rate that is taken for bias has turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL, earth_rate_along, north_in_body

FINE_S = 1.0 / 16.0
"""Slots that are integrated while it moves."""
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
class Turn:
    """Rotation since some moment.

    Parameters
    ----------
    matrix : array (3, 3)
        From body axes then to body axes now.
    path : float
        Angle turned in all, rad.
    lost : bool
        Whether readings were missing meanwhile.
    """

    matrix: FloatArray = field(default_factory=lambda: np.eye(3))
    path: float = 0.0
    lost: bool = False
    last: FloatArray = field(default_factory=lambda: np.zeros(3))

    def add(self, angles: FloatArray) -> None:
        """Turn by the integrated rates of successive slots, rad, (n, 3)."""
        self.path += _turn(self.matrix, self.last, angles)


@njit
def _turn(matrix: FloatArray, last: FloatArray, angles: FloatArray) -> float:
    """Turn a matrix by each angle in turn (Rodrigues), with coning; return the path."""
    path = 0.0
    for k in range(len(angles)):
        a, b, c = angles[k]
        x = a + (last[1] * c - last[2] * b) / 12.0
        y = b + (last[2] * a - last[0] * c) / 12.0
        z = c + (last[0] * b - last[1] * a) / 12.0
        angle = math.sqrt(x * x + y * y + z * z)
        first = math.sin(angle) / angle if angle > 0.0 else 1.0
        second = 2.0 * (math.sin(0.5 * angle) / angle) ** 2 if angle > 0.0 else 0.5
        for j in range(3):
            # A column of the matrix, v - first w x v + second w x (w x v).
            u, v, w = matrix[0, j], matrix[1, j], matrix[2, j]
            p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
            matrix[0, j] = u - first * p + second * (y * r - z * q)
            matrix[1, j] = v - first * q + second * (z * p - x * r)
            matrix[2, j] = w - first * r + second * (x * q - y * p)
        path += math.sqrt(a * a + b * b + c * c)
        last[0], last[1], last[2] = a, b, c
    return path


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product, (3,): `numpy.cross` takes thirty times as long for one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


@dataclass(slots=True, eq=False)
class Attitude:
    """Up, north and earth rate at the last rest, body axes.

    Parameters
    ----------
    gravity : float
        Specific force at rest, m/s²; 0 without accelerometers.
    up, north : array (3,)
        Unit vectors; zero where not known.
    earth : array (3,)
        What is known of the earth rate, rad/s.
    flat : array (3,)
        Share of the rotation about each axis that gravity shows.
    """

    gravity: float = 0.0
    up: FloatArray = field(default_factory=lambda: np.zeros(3))
    north: FloatArray = field(default_factory=lambda: np.zeros(3))
    earth: FloatArray = field(default_factory=lambda: np.zeros(3))
    flat: FloatArray = field(default_factory=lambda: np.zeros(3))
    placed: bool = False

    def tilt(self, force: FloatArray) -> FloatArray:
        """Return the rotation that gravity shows since the rest began, rad, (3,)."""
        return cross(force / self.gravity - self.up, self.up)

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
            self.gravity, self.flat = 0.0, np.zeros(3)
            return np.zeros(3)
        self.up, self.placed = force / self.gravity, True
        self.flat = 1.0 - self.up**2
        added = np.zeros(3)
        if place.oriented:
            heading_sd = min(LOST_SD, TURN_SD * turn.path + drift) if math.isfinite(drift) else 0.0
            if placed:
                northward = turn.matrix @ self.north
                northward -= (northward @ self.up) * self.up
                length = float(np.linalg.norm(northward))
                if length > LEAST_HORIZONTAL and not lost:
                    self.north = northward / length
                else:
                    self.north, heading_sd = north_in_body(self.up, place.heading), LOST_SD
                added = (place.horizontal * heading_sd) ** 2 * self.flat
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
    change = turn.matrix - np.eye(3)
    square = (change * change) @ np.ones(3)
    if math.isfinite(place.latitude):
        return np.asarray(0.5 * place.horizontal**2 * (square - (change @ up) ** 2))
    return np.asarray(place.horizontal**2 / 3.0 * square)
