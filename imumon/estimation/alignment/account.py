"""How far off the azimuth may be by the turns between poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import Turn
from imumon.geodesy import EARTH_RATE

ANY_ANGLE_SD = math.pi / math.sqrt(3.0)
"""Standard deviation, rad, of an angle of which nothing is known."""
DRIFT_WHILE_TURNED = 1.0
"""While the unit turns by a radian or more, the rate that is taken off may be wrong by the earth's."""
TYPICAL_ARW, TYPICAL_SCALE, SCALE_POWER, LARGEST_SCALE = math.radians(0.1) / 60.0, 3e-4, 1.4, 0.03
"""A gyro of the noise N has a scale error of about 300 ppm (N / 0.1 °/√h)^1.4, and no less than that.  Data
sheets, noise in °/√h and scale in ppm: iMAR FSAS 0.1 and 300, Honeywell HG1700 0.125 and 150, Sensonor
STIM300 0.15 and 500, Bosch BMI088 0.84 and, not calibrated, 1 % at the most; an MPU-6050 has 3 %."""


def typical_scale(arw: float) -> float:
    """Return the standard deviation of the scale factor of a gyro with this angular random walk, rad/√s."""
    return float(np.clip(TYPICAL_SCALE * (arw / TYPICAL_ARW) ** SCALE_POWER, TYPICAL_SCALE, LARGEST_SCALE))


TYPICAL_FORCE, LARGEST_FORCE = 7.5e-4, 0.04
"""g: accelerometers beside a gyro of the noise N are off by about 0.75 mg (N / 0.1 °/√h)^1.4, as its scale,
and no less than that, the geometric mean of those up to 0.15 °/√h, where it does not follow N.  Data sheets,
noise in °/√h and bias in mg: KVH 1750 0.012 and 2, 1775 0.012 and 0.5, Northrop LN-200 0.07 and 0.3, FSAS 0.1
and 1, HG1700 0.125 and 1, STIM300 0.15 and 0.75, BMI088 0.84 and 20.
Those of navigation, 25 µg, look the same: they must be declared."""


def typical_force(arw: float) -> float:
    """Return the standard deviation, g, of accelerometers' bias beside a gyro with this noise, rad/√s."""
    return float(np.clip(TYPICAL_FORCE * (arw / TYPICAL_ARW) ** SCALE_POWER, TYPICAL_FORCE, LARGEST_FORCE))


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A turn from one pose to the next.

    Parameters
    ----------
    turn : Turn
        As the gyros followed it.
    before : array (3, 3)
        Attitude at its beginning.
    seconds : float
        How long it took.
    noise : float
        Of the gyros' angle meanwhile, rad.
    """

    turn: Turn
    before: FloatArray
    seconds: float
    noise: float

    def variance(self) -> float:
        """Return the variance of its azimuth without that by scale and misalignment, rad²."""
        drift = DRIFT_WHILE_TURNED * EARTH_RATE * self.seconds * min(self.turn.path, 1.0)
        return self.turn.sampling_variance(self.before[2]) + self.noise**2 + drift**2

    def unexplained(self, up: FloatArray, scale_sd: float, level_sd: float) -> float:
        """Return what gravity shows to be wrong with it beyond what was to be expected, rad².

        What is wrong about the level axes may be so about the vertical.

        Parameters
        ----------
        up : array (3,)
            Vertical after it, body axes.
        scale_sd : float
        level_sd : float
            Of the vertical by the accelerometers, rad.
        """
        off = (self.before @ (self.turn.rotation @ up))[:2]
        expected = level_sd**2
        for axis in self.before[:2]:
            scale = scale_sd**2 * float(np.sum(self.turn.scale_about(axis) ** 2))
            expected += 0.5 * (scale + self.turn.sampling_variance(axis))
        return max(0.5 * float(off @ off) - expected, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Account:
    """The errors of all turns so far.

    Parameters
    ----------
    by_scale : array (3, 3)
        Azimuth by each element of the matrix of scale and misalignment, rad: a turn back takes it back.
    variance : float
        Of the azimuth by all else, rad².
    """

    by_scale: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    variance: float = 0.0

    def after(self, passage: Passage, unexplained: float = 0.0) -> Account:
        """Return the account after one more turn."""
        by_scale = self.by_scale + passage.turn.scale_about(passage.before[2])
        return Account(by_scale, self.variance + passage.variance() + unexplained)

    def azimuth_variance(self, scale_sd: float) -> float:
        """Return the variance of the azimuth, rad²."""
        return scale_sd**2 * float(np.sum(self.by_scale**2)) + self.variance
