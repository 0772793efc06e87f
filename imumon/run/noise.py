"""The noise section of a pipeline file: what is known of the noise of a unit's sensors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from imumon.config import StrictModel
from imumon.estimation.rest.parameters import Retired

Size = Annotated[float, Field(ge=0.0)]
Axes = Annotated[list[Size | None], Field(min_length=3, max_length=3)]
"""x, y, z; None where the data show none."""
NONE: Axes = [None, None, None]


class GyroNoise(StrictModel):
    """Noise of the gyros, as ``imumon allan --noise-out`` writes it."""

    angle_random_walk_rad_per_sqrt_s: Axes = NONE
    bias_instability_rad_per_s: Axes = NONE
    rate_random_walk_rad_per_s_sqrt_s: Axes = NONE
    quantization_rad: Axes = NONE
    rate_ramp_rad_per_s2: Axes = NONE
    correlated_noise_rad_per_s: Axes = NONE
    correlation_time_s: Axes = NONE


class AccelNoise(StrictModel):
    """Noise of the accelerometers, as ``imumon allan --noise-out`` writes it."""

    velocity_random_walk_m_per_s_sqrt_s: Axes = NONE
    bias_instability_m_per_s2: Axes = NONE
    acceleration_random_walk_m_per_s2_sqrt_s: Axes = NONE
    quantization_m_per_s: Axes = NONE
    acceleration_ramp_m_per_s3: Axes = NONE
    correlated_noise_m_per_s2: Axes = NONE
    correlation_time_s: Axes = NONE


class Noise(StrictModel):
    """The noise section of a pipeline YAML."""

    gyro: GyroNoise | None = None
    accel: AccelNoise | None = None


class AllanParameters(StrictModel):
    """The live Allan curves have nothing to set; the lines of data sheets of before are read and named."""

    gyro_sheet: Retired = None
    accel_sheet: Retired = None
