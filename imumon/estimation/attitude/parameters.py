"""What a pipeline file says of the attitude; apart from the stage, so that it loads quickly."""

from __future__ import annotations

from typing import Any

from pydantic import AliasChoices, Field

from imumon.config import StrictModel


def _probability(sensor: str, usual: float) -> Any:
    """Return the field of a probability; sessions of before have it by another name."""
    names = AliasChoices(f"{sensor}_error_probability", f"{sensor}_doubt")
    return Field(default=usual, ge=0.0, le=0.5, validation_alias=names)


class AttitudeParameters(StrictModel):
    """Which sensors are used, and what of their errors rest does not show.

    Parameters
    ----------
    use_magnetometer : bool
        Whether the heading is taken from the magnetometer, where there is one.
    accel_bias_m_per_s2 : float, optional
        Standard deviation of what the accelerometers are off at rest.  When it is not given it may be
        anything that data sheets state, from the 5 mg of calibrated MEMS units to the 80 mg of an MPU-6050.
    gyro_scale : float
        Standard deviation of each element of the matrix of scale and misalignment: 1 % without calibration.
    accel_error_probability, axes_error_probability, magnet_error_probability : float
        How likely it is that the accelerometers are off by more than was given, that a gyro has another scale
        or shows other axes than declared, and that iron has come to the unit since its magnetometer was
        calibrated: in the sigma until rests and turns have spoken.  Judged, not measured; docs/attitude.md
        says what they cost.
    """

    use_magnetometer: bool = True
    accel_bias_m_per_s2: float | None = Field(default=None, ge=0.0, le=10.0)
    gyro_scale: float = Field(default=0.01, ge=0.0, le=0.5)
    accel_error_probability: float = _probability("accel", 0.05)
    axes_error_probability: float = _probability("axes", 0.1)
    magnet_error_probability: float = _probability("magnet", 0.1)
