"""The terms of a fit: their names, and how each is reported of a gyro and of an accelerometer."""

from __future__ import annotations

import math
from typing import NamedTuple

from imumon.config import StrictModel
from imumon.geodesy import MICRO_G
from imumon.run.noise import AccelNoise, GyroNoise

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
