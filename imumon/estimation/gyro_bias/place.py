"""Attitude of a unit against the earth, as far as the bias needs it: up at rest, and turns in between.

At rest the specific force shows where up is.  While the unit moves, the gyros follow the attitude sample by
sample (`imumon.filters.turns`): that keeps north, or bounds how the earth rate in the bias has turned.

Known at a rest          Subtracted           In sigma, beside what the filters have
up, latitude, heading    all earth rate       the error of its level part by that of north
up, latitude             its vertical part    how turns since the rest before moved what is in the bias,
up                       nothing              which is taken for bias, as it is for one pose
latitude, but not up     nothing any more     all of it, as it is in the bias (`pose_unknown`)
"""

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import STILL
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL, STANDARD_GRAVITY, earth_rate_along, north_in_body

from .bank import SENSITIVITY, Prediction

SCALE_SD = 0.01  # error of an element of the matrix of scale and misalignment, of consumer gyros.  Assumed.
LOST_SD = 1.0  # rad, of a heading that is not known: by it the level earth rate is wrong by about itself
ANY_TURN_VARIANCE = 2.0 / 3.0 * EARTH_RATE**2  # (rad/s)², of an axis: mean of |(R - I) e|²/3 over all turns R


class Attitude:
    """Up, north and earth rate at the last rest, body axes, and the turn since then.

    `latitude`, and `heading` of the first rest after each start, are in rad; None where not known.
    """

    def __init__(self, latitude: float | None, heading: float | None) -> None:
        self.latitude, self.heading = latitude, heading
        self.restart()

    def restart(self) -> None:
        """Begin before the first rest."""
        self.up = self.north = np.zeros(3)  # unit vectors; zero where not known
        self.earth = np.zeros(3)  # what is known of the earth rate, rad/s
        self.heading_variance = 0.0  # of north, rad²
        self.turn = STILL  # since the last rest, less the bias
        self.lost = False  # whether readings were missing since the last rest
        self.pose_unknown = False  # whether that of this rest is not known, so that all earth rate is bias

    @property
    def uncertain_earth(self) -> FloatArray:
        """Variance of the error of the earth rate that is subtracted or taken for bias, (rad/s)², (3,)."""
        if self.pose_unknown:
            return np.full(3, EARTH_RATE**2)
        return self._level_variance(self.heading_variance) + self._turned_earth()

    def _level_variance(self, heading_variance: float) -> FloatArray:
        """Return the variance of the level earth rate, (rad/s)², (3,), by that of the heading, rad²."""
        level = EARTH_RATE * math.cos(self.latitude or 0.0)  # without a latitude no heading is known
        return level**2 * heading_variance * (1.0 - self.up**2)  # east² ≤ 1 - up²: the error is eastward

    def _turned_earth(self) -> FloatArray:
        """Return the variance of what the turn does to the earth rate that is taken for bias, (rad/s)², (3,).

        The rate's direction is not known; with the latitude alone the whole earth rate is counted, not its
        level part.  Where readings were missing it may have turned by any angle.
        """
        if self.up.any() and self.latitude is not None and self.heading is not None:
            return np.zeros(3)
        if self.lost:
            return np.full(3, ANY_TURN_VARIANCE)
        if not self.turn.seconds:
            return np.zeros(3)
        change = self.turn.rotation.T - np.eye(3)
        return np.asarray(EARTH_RATE**2 / 3.0 * (change**2).sum(1))

    def come_to_rest(self, force: FloatArray, prediction: Prediction | None) -> FloatArray:
        """Take the attitude of a new rest; return what that adds to the variance of the bias, (rad/s)², (3,).

        The mean specific force, m/s², is NaN or zero where not known; the prediction is None at first.
        """
        size = np.linalg.norm(force)
        turned = self.lost or self.turn.seconds > 0.0
        if size > 0.0:
            added = self._take_pose(force / size, prediction)
        elif turned if self.up.any() else self.latitude is not None:
            # Of this pose, another one or the first, nothing is known.
            self.up = self.north = self.earth = np.zeros(3)
            self.pose_unknown = self.latitude is not None
            added = np.full(3, ANY_TURN_VARIANCE)
        else:
            added = self._turned_earth()
        self.turn, self.lost = STILL, False
        return added

    def _take_pose(self, up: FloatArray, prediction: Prediction | None) -> FloatArray:
        """Take up, (3,), and what follows of north and earth rate; return what that adds to the variance."""
        added = self._turned_earth()
        before, self.up = self.up, up
        if self.latitude is not None:
            if self.heading is not None:
                added = self._take_north(before, self.heading, prediction)
            self.earth = earth_rate_along(up, self.north, self.latitude)
        if self.pose_unknown:
            # The bias loses the earth rate again, or without a heading all but the level part of it.
            self.pose_unknown, added = False, np.full(3, EARTH_RATE**2)
            self.heading_variance = 0.0 if self.heading is None else LOST_SD**2
        return added

    def _take_north(self, before: FloatArray, heading: float, prediction: Prediction | None) -> FloatArray:
        """Carry north on from the last rest, where up was `before`, (3,), zero at first; where the turn since
        then is not known, the heading is taken for the first one, to `LOST_SD`."""
        northward = self.north @ self.turn.rotation  # in the axes of now
        northward -= (northward @ self.up) * self.up
        length, variance = np.linalg.norm(northward), LOST_SD**2
        if prediction is not None and not self.lost and length > LEAST_HORIZONTAL:
            self.north = northward / length
            # Errors of the turn about the old vertical.  A sensitivity is one of the bias: gravity turns.
            _, bias_variance = prediction.bias(STANDARD_GRAVITY * before)
            sensitivity = np.einsum("aii->a", prediction.covariance[:, SENSITIVITY, SENSITIVITY]) / 3.0
            by_bias = (before @ self.turn.by_bias) ** 2 @ (bias_variance + STANDARD_GRAVITY**2 * sensitivity)
            by_scale = SCALE_SD**2 * np.sum(self.turn.scale_about(before) ** 2)
            by_earth = (EARTH_RATE * self.turn.seconds) ** 2  # which turned meanwhile
            variance = min(variance, by_bias + by_scale + by_earth + self.turn.sampling_variance(before))
        else:
            self.north = north_in_body(self.up, heading)
        if not before.any():
            return np.zeros(3)
        self.heading_variance = min(LOST_SD**2, self.heading_variance + variance)
        return self._level_variance(variance)
