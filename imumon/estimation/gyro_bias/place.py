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
from imumon.estimation.gyro_bias.modes import SENSITIVITY
from imumon.estimation.gyro_bias.prediction import Prediction
from imumon.filters.turns import Turn
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL, STANDARD_GRAVITY, earth_rate_along, north_in_body

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

    def uncertain_earth(self, place: Place) -> FloatArray:
        """Return the variance of the known earth rate by the error of the heading, (rad/s)², (3,)."""
        return np.asarray(place.horizontal**2 * self.heading_variance * (1.0 - self.up**2))

    def come_to_rest(
        self, force: FloatArray, place: Place, turn: Turn, prediction: Prediction | None
    ) -> FloatArray:
        """Take the attitude of a new rest; return what that adds to the variance of the bias, (3,).

        Parameters
        ----------
        force : array (3,)
            Mean specific force, m/s²; NaN or zero without one.
        turn : Turn
            Since the last rest.
        prediction : Prediction or None
            Of the bias meanwhile; None where the angle turned is not known, as readings were missing.
        """
        size = float(np.linalg.norm(force))
        if not size > 0.0:
            return turned_earth(self.up, place, turn)
        before, self.up = self.up, force / size
        placed, added = before.any(), np.zeros(3)
        if placed and not place.oriented:
            added = turned_earth(before, place, turn)
        elif placed:
            northward = self.north @ turn.rotation
            northward -= (northward @ self.up) * self.up
            length = float(np.linalg.norm(northward))
            variance = LOST_SD**2
            if prediction is not None and length > LEAST_HORIZONTAL:
                self.north, variance = (
                    northward / length,
                    min(heading_variance(before, turn, prediction), variance),
                )
            else:
                self.north = north_in_body(self.up, place.heading)
            added = place.horizontal**2 * variance * (1.0 - self.up**2)
            self.heading_variance = min(LOST_SD**2, self.heading_variance + variance)
        elif place.oriented:
            self.north = north_in_body(self.up, place.heading)
        if math.isfinite(place.latitude):
            self.earth = earth_rate_along(self.up, self.north, place.latitude)
        return added


def heading_variance(up: FloatArray, turn: Turn, prediction: Prediction) -> float:
    """Return the variance of the angle by which the gyros estimate to have turned about the vertical, rad².

    By the bias at f0, by the sensitivity to a gravity that turns in body axes, by scale and misalignment, and
    for want of more samples; `up` (3,) is that before the turn.
    """
    upright_s = up @ turn.by_bias
    turned2 = max(turn.seconds**2 - float(upright_s @ upright_s), 0.0)
    sensitivity = float(np.einsum("aii->", prediction.covariance[:, SENSITIVITY, SENSITIVITY])) / 9.0
    by_bias = (
        float(upright_s**2 @ prediction.bias(prediction.force)[1])
        + turned2 * STANDARD_GRAVITY**2 * sensitivity
    )
    return by_bias + SCALE_SD**2 * float(np.sum(turn.scale_about(up) ** 2)) + turn.sampling_variance(up)


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
