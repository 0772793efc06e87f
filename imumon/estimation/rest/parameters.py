"""Settings of rest and gyro bias in a pipeline file; apart from the estimator, so that they load quickly."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from imumon.blocks import FloatArray
from imumon.config import Retired, StrictModel

_Positive = Annotated[float, Field(gt=0.0, le=10.0)]  # more than 10 of any unit is a slip of the unit
_NotNegative = Annotated[float, Field(ge=0.0, le=10.0)]
_PerAxis = _Positive | Annotated[list[_Positive], Field(min_length=3, max_length=3)]
_PerAxisFromZero = _NotNegative | Annotated[list[_NotNegative], Field(min_length=3, max_length=3)]


class RestParameters(StrictModel):
    """What a resting unit may do; the noise is learnt from the data.

    Parameters
    ----------
    gyro_drift : float
        Fastest change of a gyro's bias that is still rest, rad/s²: 1e-4 is 21 deg/h each second.
    accel_drift : float
        Fastest change of an accelerometer's bias that is still rest, m/s³; a slower tilt than accel_drift / g
        (32 deg/h by default) cannot be distinguished from it.
    undecided_s : float
        A rate that P(turn) takes for a turn becomes bias when it has lasted so long, if gravity and heading
        together do not show a turn, and it differs from the last bias by no more than largest_jump.
    largest_jump : float
        Largest change of a gyro's bias within one run of the unit, rad/s: 0.017 is 1 deg/s.
    """

    gyro_drift: float = Field(default=1e-4, ge=0.0, le=1.0)
    accel_drift: _NotNegative = 1.5e-3
    undecided_s: float = Field(default=14400.0, ge=0.0, le=86400.0)
    largest_jump: _NotNegative = 0.017
    begins_turning: Retired = None  # as all of this type: a key of earlier versions, read and not used
    gyro_g_sensitivity: Retired = None
    gyro_walk: Retired = None


class GyroBiasParameters(StrictModel):
    """Noise of the sensors, and how the bias is followed; every key has a default, which suits MEMS gyros.

    Parameters
    ----------
    angle_random_walk_rad_per_sqrt_s : float or [x, y, z], optional
        Square root of the two-sided density of the gyro's white noise (0.28 °/√h is 8.1e-5).  Learned at
        rest, from this value on if it is given.
    bias_instability_rad_per_s, rate_random_walk_rad_per_s_per_sqrt_s : float or [x, y, z], optional
        Flicker coefficient B (floor of the Allan deviation 0.664 B) and bias random walk K, rad/s/√s.  When
        one is given, both hold, the other being zero.  When neither is, the wander of the bias is learned.
    assume_at_rest : bool
        Whether motion is not detected: rest is that of the column at_rest of the samples, and without one the
        unit rests throughout.  A rate that contradicts the bias is bias at once; for 60 s both are in sigma.
    """

    angle_random_walk_rad_per_sqrt_s: _PerAxis | None = None
    bias_instability_rad_per_s: _PerAxisFromZero | None = None
    rate_random_walk_rad_per_s_per_sqrt_s: _PerAxisFromZero | None = None
    assume_at_rest: bool = False
    velocity_random_walk_m_per_s_per_sqrt_s: Retired = None
    zeroing_s: Retired = None
    thermal_form: Literal["increments"] = Field(default="increments", exclude=True)  # retired, but checked

    @property
    def declared_noise(self) -> list[FloatArray | None]:
        """White noise, B and K as declared, in the units of the keys, (3,) each or None; B and K together."""
        b, k = self.bias_instability_rad_per_s, self.rate_random_walk_rad_per_s_per_sqrt_s
        if b is not None or k is not None:
            b, k = b or 0.0, k or 0.0
        declared = self.angle_random_walk_rad_per_sqrt_s, b, k
        return [None if value is None else np.full(3, value, np.float64) for value in declared]
