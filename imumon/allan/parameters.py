"""What a user may state of noise, in the noise section of a pipeline, and its units."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from imumon.config import StrictModel
from imumon.estimation.rest.parameters import Retired
from imumon.geodesy import MICRO_G

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


NAMES = (
    "angle_random_walk", "bias_instability", "rate_random_walk", "quantization", "rate_ramp",
    "correlated_noise", "correlation_time",
)  # fmt: skip
"""The terms of a fit, in the order of the fields of a sensor's noise."""
_DEG = math.degrees(1.0)


class TermOfSensor(NamedTuple):
    """How a term of one sensor is reported: field of the noise section and SI unit, and for people its name,
    its unit, and how many of that are one SI unit."""

    key: str
    unit: str
    title: str
    shown: str
    factor: float


def _terms(section: type[StrictModel], *rows: tuple[str, str, str, float]) -> dict[str, TermOfSensor]:
    fields = zip(NAMES, section.model_fields, rows, strict=True)
    return {name: TermOfSensor(key, *row) for name, key, row in fields}


TERMS_OF = {
    "gyro": _terms(
        GyroNoise,
        ("rad/sqrt(s)", "angle random walk", "°/√h", 60.0 * _DEG),
        ("rad/s", "bias instability", "°/h", 3600.0 * _DEG),
        ("rad/s/sqrt(s)", "rate random walk", "°/h/√h", 60.0 * 3600.0 * _DEG),
        ("rad", "quantization", "arcsec", 3600.0 * _DEG),
        ("rad/s^2", "rate ramp", "°/h/h", 3600.0**2 * _DEG),
        ("rad/s", "correlated noise", "°/h", 3600.0 * _DEG),
        ("s", "  correlated for", "s", 1.0),
    ),
    "accel": _terms(
        AccelNoise,
        ("m/s/sqrt(s)", "velocity random walk", "m/s/√h", 60.0),
        ("m/s^2", "bias instability", "µg", 1.0 / MICRO_G),
        ("m/s^2/sqrt(s)", "accel. random walk", "µg/√h", 60.0 / MICRO_G),
        ("m/s", "quantization", "mm/s", 1e3),
        ("m/s^3", "accel. ramp", "µg/h", 3600.0 / MICRO_G),
        ("m/s^2", "correlated noise", "µg", 1.0 / MICRO_G),
        ("s", "  correlated for", "s", 1.0),
    ),
}
"""Every term of each sensor, by `NAMES`."""


class Noise(StrictModel):
    """The noise section of a pipeline YAML."""

    gyro: GyroNoise | None = None
    accel: AccelNoise | None = None


class AllanParameters(StrictModel):
    """The live Allan curves have nothing to set; the lines of data sheets of before are read and named."""

    gyro_sheet: Retired = None
    accel_sheet: Retired = None
