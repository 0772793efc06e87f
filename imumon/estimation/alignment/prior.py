"""Prior of the sensor errors by regression on the gyros' noise N over data sheets; see docs/alignment.md."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.geodesy import DEG_PER_H, EARTH_RATE


class ByNoise(NamedTuple):
    """A regression: factor (N / 0.1 °/√h)^power, clipped to least and most."""

    factor: float
    power: float
    least: float
    most: float

    def at(self, noise: float) -> float:
        """Return the value for gyros with this angular random walk, rad/√s."""
        ratio = noise / (math.radians(0.1) / 60.0)
        return min(max(self.factor * math.pow(ratio, self.power), self.least), self.most)


BIAS = ByNoise(2.0 * DEG_PER_H, 1.86, 0.0014 * DEG_PER_H, EARTH_RATE)
"""Bias of a gyro, rad/s: at least that of the quietest in the table, at most the earth rate."""
SCALE = ByNoise(3e-4, 1.4, 3e-4, 0.03)
"""Scale factor and misalignment of a gyro."""
LEVEL = ByNoise(7.5e-4, 1.4, 7.5e-4, 0.04)
"""Bias of an accelerometer, g."""
LOG_SIZES, LOG_SIZE_SD = np.linspace(-4.0, 12.0, 17), 1.5
"""Logarithms of the sizes of a bias over that of the regression, up to 200 °/h for the best gyros, and their
standard deviation."""
WORSE_FACTORS = np.exp([2.0, 4.0, 6.0, 8.0, 10.0])
"""Factors by which one or two gyros may be worse than the others."""
P_ALL_WORSE, P_SOME_WORSE, P_DECLARED = 0.02, 0.003, 0.999
"""Prior probabilities that all gyros are worse than the regression by any factor (assumed), that one or two
are worse than the others (as rare as a normal value beyond three sigmas), and that a declared bias holds."""


class SensorErrors(NamedTuple):
    """Standard deviations of the errors of gyros and accelerometers.

    `sizes` (s, 3) of the gyros' biases, rad/s, have the log probabilities `log_prior` (s,); `flicker` is the
    change of a bias from position to position, rad/s; `scale` is a ratio; `level` is in g.
    """

    sizes: FloatArray
    log_prior: FloatArray
    flicker: float
    scale: float
    level: float


def sensor_errors(noise: float, parameters: AlignmentParameters) -> SensorErrors:
    """Return the declared errors, and the regression on an angular random walk, rad/√s, for the others."""
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    return SensorErrors(
        *_bias_sizes(BIAS.at(noise), parameters.gyro_bias_sd_deg_per_h),
        flicker=(parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
        scale=SCALE.at(noise) if ppm is None else ppm * 1e-6,
        level=LEVEL.at(noise) if micro_g is None else micro_g * 1e-6,
    )


def _bias_sizes(typical: float, declared: float | None) -> tuple[FloatArray, FloatArray]:
    worse = LOG_SIZES > 0.0
    if declared is not None:
        sd = max(declared * DEG_PER_H, 1e-11)  # a bias of zero has no logarithm
        sizes = np.r_[sd, max(typical, sd) * np.exp(LOG_SIZES[worse])]
        probability = np.r_[P_DECLARED, np.full(len(sizes) - 1, (1.0 - P_DECLARED) / (len(sizes) - 1))]
        return np.tile(sizes[:, None], (1, 3)), np.log(probability)
    density = np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2)
    alike = (1.0 - P_ALL_WORSE - P_SOME_WORSE) * density / density.sum() + P_ALL_WORSE * worse / worse.sum()
    one = np.eye(3, dtype=bool)
    some = np.where(np.concatenate([one, ~one]), WORSE_FACTORS[:, None, None], 1.0).reshape(-1, 3)
    factors = np.concatenate([np.tile(np.exp(LOG_SIZES)[:, None], (1, 3)), some])
    return typical * factors, np.log(np.r_[alike, np.full(len(some), P_SOME_WORSE / len(some))])
