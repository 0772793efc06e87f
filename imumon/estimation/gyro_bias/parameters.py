"""Settings of the gyro bias in a pipeline file; apart from the estimator, so that they load quickly."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from imumon.blocks import FloatArray
from imumon.config import StrictModel
from imumon.estimation.rest.parameters import Retired

_Positive = Annotated[float, Field(gt=0.0, le=10.0)]
_NotNegative = Annotated[float, Field(ge=0.0, le=10.0)]
_PerAxis = _Positive | Annotated[list[_Positive], Field(min_length=3, max_length=3)]
_PerAxisFromZero = _NotNegative | Annotated[list[_NotNegative], Field(min_length=3, max_length=3)]


class GyroBiasParameters(StrictModel):
    """Noise of the sensors, and how the bias is followed; every key has a default, which suits any unit.

    Parameters
    ----------
    angle_random_walk_rad_per_sqrt_s : float or [x, y, z], optional
        Square root of the two-sided density of the gyro's white noise (0.28 °/√h is 8.1e-5).  Measured at
        rest when it is not given.
    bias_instability_rad_per_s, rate_random_walk_rad_per_s_per_sqrt_s : float or [x, y, z], optional
        Flicker coefficient B (floor of the Allan deviation 0.664 B) and bias random walk K.  When one is
        given, both hold, the other being zero, in proportion to the white noise of the first rest.  When
        neither is, how much the bias wanders is learned from the innovations.
    assume_at_rest : bool
        Whether data without the column at_rest are taken as at rest throughout.
    velocity_random_walk_m_per_s_per_sqrt_s, zeroing_s, thermal_form
        Not used any more: the first is measured at rest, and nothing is filtered twice.
    """

    angle_random_walk_rad_per_sqrt_s: _PerAxis | None = None
    bias_instability_rad_per_s: _PerAxisFromZero | None = None
    rate_random_walk_rad_per_s_per_sqrt_s: _PerAxisFromZero | None = None
    assume_at_rest: bool = False
    velocity_random_walk_m_per_s_per_sqrt_s: Retired = None
    zeroing_s: Retired = None
    thermal_form: Literal["increments"] = Field(default="increments", exclude=True)

    @property
    def per_axis(self) -> list[FloatArray | None]:
        """White noise, B and K as declared, (3,) each or None; B and K are declared together."""
        white, b, k = (
            self.angle_random_walk_rad_per_sqrt_s,
            self.bias_instability_rad_per_s,
            self.rate_random_walk_rad_per_s_per_sqrt_s,
        )
        if b is not None or k is not None:
            b, k = b or 0.0, k or 0.0
        return [None if value is None else np.full(3, value, np.float64) for value in (white, b, k)]
