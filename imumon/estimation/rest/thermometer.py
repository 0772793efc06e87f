"""How far a change of temperature may have moved the bias of a gyro."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray, SampleBlock

SLOPE = np.radians(0.05)
"""Standard deviation of the slope of a gyro's bias, rad/s/K: data sheets of consumer gyros say ±0.015 °/s/K
(BMI088), ±0.05 (BMI160), and ±20 °/s from -40 to 85 °C (MPU-6050), which is 0.16 at most."""
CURVATURE_DEGC = 30.0
"""Temperature difference over which a slope changes by as much as itself, as `gyro_bias.steps` says."""
LAG_S = 30.0
"""How far a gyro's temperature may be behind the thermometer's (sd): `effects.thermal_lag.UNTOLD_S`, written
again, for the compiled windows of rest would begin anew with each edit of the effects."""
EFFECTS = 3
"""What moves a bias as temperature does: it, its square, and its lag; all in °C, with a slope of `SLOPE`."""


def temperature(block: SampleBlock) -> FloatArray:
    """Return the temperature of the unit in °C, (n,): the estimate, else the reading, else NaN.

    The mean of the axes where each has a thermometer.
    """
    # The reading is a stopgap where there is no estimate at all; mixed with it, it would jump.
    for name in ("temperature_estimate", "temperature"):
        if name in block:
            return np.asarray(block[name])
        axes = block.vector(name)
        if axes is not None:
            return np.asarray(axes.mean(1))
    return np.full(len(block), np.nan)


def effects(degc: float, lagged: float) -> tuple[float, float, float]:
    """Return what moves a bias, °C: temperature since a time, its square, and how far a gyro is behind it."""
    return degc, 0.5 * degc * degc / CURVATURE_DEGC, lagged - degc


def warmed(degc: FloatArray | float, since_degc: FloatArray | float) -> FloatArray:
    """Return by how much a change of temperature may move a bias (sd), rad/s; 0 without a thermometer."""
    return np.asarray(np.nan_to_num(SLOPE * np.abs(np.subtract(degc, since_degc))))
