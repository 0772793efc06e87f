"""Parameters of the alignment in a pipeline file."""

import math
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from imumon.blocks import FloatArray
from imumon.config import Retired, StrictModel

ANY_WARM_UP = 1e-4, (100.0, 300.0, 1000.0)
"""Warm-up of accelerometers: sd of its amplitudes, g, and their time constants, s; assumed."""
_Positive = Annotated[float, Field(gt=0.0, le=1e5)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e5)]


class KnownWarmUp(StrictModel):
    """Accelerometer bias after power-on, known from earlier recordings: amplitude (1 - exp(-t / tau)).

    Parameters
    ----------
    amplitude_ug : [x, y, z]
        Final value in body axes, µg.
    time_constant_s : [x, y, z], or a float for all
    amplitude_sd_ug, time_constant_sd_s : float
        Standard deviations, when they are known: what they do not explain is then a tilt of the unit.
    """

    amplitude_ug: Annotated[list[Annotated[float, Field(ge=-1e5, le=1e5)]], Field(min_length=3, max_length=3)]
    time_constant_s: Annotated[
        list[_Positive],
        BeforeValidator(lambda given: [given] * 3 if isinstance(given, int | float) else given),
        Field(min_length=3, max_length=3),
    ]
    amplitude_sd_ug: _Positive | None = None
    time_constant_sd_s: _NotNegative = 0.0

    def bias_g(self, time_s: FloatArray) -> FloatArray:
        """Return the bias at times since the first sample, s, (n,), in body axes, g, (n, 3)."""
        course = -np.expm1(-time_s[:, None] / np.array(self.time_constant_s))
        return np.asarray(1e-6 * course * np.array(self.amplitude_ug))

    @property
    def remaining(self) -> tuple[float, tuple[float, ...]]:
        """What remains of the warm-up when this is subtracted: `ANY_WARM_UP` without `amplitude_sd_ug`."""
        if self.amplitude_sd_ug is None:
            return ANY_WARM_UP
        largest, mean_s = max(map(abs, self.amplitude_ug)), sum(self.time_constant_s) / 3.0
        sd_ug = math.hypot(self.amplitude_sd_ug, self.time_constant_sd_s / mean_s * largest)
        return 1e-6 * sd_ug, tuple(sorted(set(self.time_constant_s)))


class AlignmentParameters(StrictModel):
    """Parameters of the heading estimation; every key has a default.

    Parameters
    ----------
    settled_deg : float
        The heading is settled when its sigma is at most this.
    observable_deg : float
        A heading with a larger sigma is not shown; MEMS gyros whose bias is small by luck reach 7 to 12.
    gyro_bias_sd_deg_per_h : float, optional
        Standard deviation of a gyro's bias, from run to run.  Default: a regression on the noise, with a
        factor of 4.5 either way (one sigma), weighted by how well the earth rate then fits the rates.
    gyro_flicker_deg_per_h : float, optional
        Standard deviation of the part of the bias that is new in each position: the bias instability.
        Default: 0, with which the sigma of several positions is too small where the bias moves: declare it.
    gyro_scale_sd_ppm : float, optional
        Standard deviation of each element of a gyro's scale and misalignment: in turns between positions,
        and, if declared, of the earth rate at rest (else sigma lacks 0.02°).  Default: by the noise, >= 300.
    accel_bias_sd_ug : float, optional
        Standard deviation of the constant bias of an accelerometer; it tilts the horizon.  Default:
        a regression on the noise of the gyros, 750 at least.
    known_warm_up : KnownWarmUp, optional
        Counted from the first sample of the device.
    """

    settled_deg: float = Field(default=0.05, gt=0.0, le=90.0)
    observable_deg: float = Field(default=5.0, gt=0.0, le=60.0)
    gyro_bias_sd_deg_per_h: _NotNegative | None = None
    gyro_flicker_deg_per_h: _NotNegative | None = None
    gyro_scale_sd_ppm: _NotNegative | None = None
    accel_bias_sd_ug: _NotNegative | None = None
    known_warm_up: KnownWarmUp | None = None
    coarse_s: Retired = None
    corner_hz: Retired = None
    damping: Retired = None
