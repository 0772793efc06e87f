"""By what the gyros have turned the vertical, and the heading, wrong; and what the filter has followed of it.

Errors that stay add up with the turn: each is a column of `Turned.parts`.  The filter's vertical follows what
the accelerometers show in axes that the gyros carry along, by VQF's low pass: so of an error of the gyros it
has followed what that lets through.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.fusion import TAU_ACC_S
from imumon.filters.turns import Turn

BIASES, ELEMENTS, EARTH = slice(0, 3), slice(3, 12), 12
"""Columns of `Turned.parts`: each gyro's bias, nine elements of M row by row, and the earth rate."""


@dataclass(slots=True, eq=False)
class Turned:
    """Error of the angles since some moment, east, north, up, for each error of the gyros that stays.

    Parameters
    ----------
    parts : array (3, 13)
        ∫ C sd dt, by the bias of each gyro; ∫ C ω dt, by each element of the matrix M of scale and
        misalignment, where what turns back takes it back; and by the earth rate that the bias does not hold:
        rad.
    coning : array (3,)
    fast, missed : float
        For want of samples: as of `Turn`.
    """

    parts: FloatArray = field(default_factory=lambda: np.zeros((3, EARTH + 1)))
    coning: FloatArray = field(default_factory=lambda: np.zeros(3))
    fast: float = 0.0
    missed: float = 0.0

    def add(self, turn: Turn, attitude: FloatArray, bias_sd: FloatArray, earth: float, missed: float) -> None:
        """Add a turn.

        Parameters
        ----------
        turn : Turn
        attitude : array (3, 3)
            At its end.
        bias_sd : array (3,)
            rad/s.
        earth : float
            By the earth rate, rad.
        missed : float
            Variance of what is not in the turn, rad².
        """
        begun = attitude @ turn.rotation.T
        self.parts[:, BIASES] += begun @ turn.by_bias * bias_sd
        self.parts[:, ELEMENTS] += begun @ turn.by_scale.reshape(3, 9)
        self.parts[:, EARTH] += earth
        self.coning += begun @ turn.coning
        self.fast += turn.fast
        self.missed += turn.missed + missed

    def forget(self, keep: float) -> None:
        """Keep a share."""
        self.parts *= keep
        self.coning *= keep
        self.fast *= keep
        self.missed *= keep * keep

    def variance(self, scale2: FloatArray) -> FloatArray:
        """Return the variance of the angles about east, north and up, rad², (3,).

        `scale2` (6,) is that of elements of M: as of `covariance`.
        """
        without, by_gyro = covariance(self.parts, self.parts)
        return np.asarray(without + by_gyro @ scale2 + self.sampled)

    @property
    def sampled(self) -> FloatArray:
        """Return the variance of the angles by what is lost between samples, rad², (3,)."""
        return np.asarray(self.coning**2 + self.fast**2 + self.missed)


def covariance(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances of angles by the same errors, parts of both (3, 13): but for M, rad², (3,).

    And what M adds for each variance of an element, (3, 6): of each gyro the one on the diagonal, then the
    others.
    """
    product = one * other
    of_elements = product[:, ELEMENTS].reshape(3, 3, 3)
    scales = of_elements.diagonal(axis1=1, axis2=2)
    without = product[:, BIASES].sum(1) + product[:, EARTH]
    return np.asarray(without), np.hstack([scales, of_elements.sum(1) - scales])


def of_vertical(one: FloatArray, other: FloatArray, squares: FloatArray) -> tuple[float, FloatArray]:
    """Return the covariance of a component of what errors turn the vertical by, rad²: but for M.

    And what M adds, (6, k), for variances of its elements, (6, k).  A large angle φ moves the vertical by its
    chord: of (2 sin φ/2)², 2 on average, φ²/(1 + φ²/2) is taken.

    Parameters
    ----------
    one, other : array (3, 13)
        Parts of two turns by the same errors.
    squares : array (6, k)
    """
    without, by_gyro = covariance(one, other)
    chords = [1.0 + 0.5 * squares * covariance(of, of)[1].sum(0)[:, np.newaxis] for of in (one, other)]
    added = squares * by_gyro[:2].mean(0)[:, np.newaxis] / np.sqrt(chords[0] * chords[1])
    return float(without[:2].mean()), np.asarray(added)


def _none() -> FloatArray:
    return np.zeros((3, EARTH + 1))


@dataclass(slots=True, eq=False)
class Followed:
    """What a low pass of second order (Butterworth, as VQF's) has followed of what a `Turned` has come to.

    Parameters
    ----------
    parts, slope : array (3, 13)
        As of `Turned`, and their change in the time constant.
    last : array (3, 13)
        What the parts were that it followed last.
    """

    parts: FloatArray = field(default_factory=_none)
    slope: FloatArray = field(default_factory=_none)
    last: FloatArray = field(default_factory=_none)

    def follow(self, turned: Turned, seconds: float) -> None:
        """Follow what has come to this in some seconds: y'' = 2 (u - y)/τ² - 2 y'/τ, u half way between."""
        x = seconds / TAU_ACC_S
        keep, cosine, sine = math.exp(-x), math.cos(x), math.sin(x)
        aim = 0.5 * (self.last + turned.parts)
        off = self.parts - aim
        self.parts = aim + keep * ((cosine + sine) * off + sine * self.slope)
        self.slope = keep * ((cosine - sine) * self.slope - 2.0 * sine * off)
        self.last = turned.parts.copy()
