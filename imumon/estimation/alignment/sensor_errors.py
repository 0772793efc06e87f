"""Prior of the errors of gyros and accelerometers: declared, or a regression on the gyros' noise.

The regression is over the data sheets of docs/appendix/alignment-details.md, in powers of the angular
random walk N.  Declare the errors of a unit better than those: of gyros with 0.001 °/√h, too, 0.0014 °/h,
300 ppm and 750 µg are taken.
"""

from __future__ import annotations

import math
from itertools import product
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


GYRO_BIAS = ByNoise(2.0 * DEG_PER_H, 1.86, 0.0014 * DEG_PER_H, EARTH_RATE)
"""Bias of a gyro, rad/s: at least that of the quietest in the table, at most the earth rate."""
GYRO_SCALE = ByNoise(3e-4, 1.4, 3e-4, 0.03)
"""Scale factor and misalignment of a gyro."""
ACCEL_BIAS = ByNoise(7.5e-4, 1.4, 7.5e-4, 0.04)
"""Bias of an accelerometer, g."""
LOG_SIZES, LOG_SIZE_SD = np.linspace(-4.0, 4.0, 9), 1.5
"""Logarithms of the sizes of a bias over that of the regression, and their standard deviation."""
WORSE = np.array(
    [
        np.where(axes, factor, 1.0)
        for factor in np.exp([2.0, 4.0, 6.0, 8.0, 10.0])
        for axes in product([False, True], repeat=3)
        if any(axes)
    ]
)
"""Factors by which some gyros or all are worse than that, (35, 3): up to 31 °/h for the best of them."""
P_WORSE = 0.003
"""Prior probability of any of these factors (assumed), as rare as a normal value beyond three sigmas.
Ablation: without it, errors are up to 39 sigma."""
P_WORSE_THAN_DECLARED = 0.001
"""Prior probability that a declared bias is exceeded by any of these factors (assumed)."""


class SensorErrors(NamedTuple):
    """Standard deviations of the errors of gyros and accelerometers.

    `sizes` (s, 3) of the gyros' biases, rad/s, have the log probabilities `log_prior` (s,); `flicker` is the
    change of a bias from position to position, rad/s; `scale` is a ratio; `accel_bias` is in g.
    """

    sizes: FloatArray
    log_prior: FloatArray
    flicker: float
    scale: float
    accel_bias: float


def sensor_errors(noise: float, parameters: AlignmentParameters) -> SensorErrors:
    """Return the declared errors, and the regression on an angular random walk, rad/√s, for the others."""
    typical, p_worse = GYRO_BIAS.at(noise), P_WORSE
    alike, share = typical * np.exp(LOG_SIZES), np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2)
    if parameters.gyro_bias_sd_deg_per_h is not None:
        declared = max(parameters.gyro_bias_sd_deg_per_h * DEG_PER_H, 1e-11)  # zero has no logarithm
        alike, share = np.array([declared]), np.ones(1)
        typical, p_worse = max(typical, declared), P_WORSE_THAN_DECLARED
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    return SensorErrors(
        sizes=np.concatenate([np.tile(alike[:, None], (1, 3)), typical * WORSE]),
        log_prior=np.log(
            np.r_[(1.0 - p_worse) * share / share.sum(), np.full(len(WORSE), p_worse / len(WORSE))]
        ),
        flicker=(parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
        scale=GYRO_SCALE.at(noise) if ppm is None else ppm * 1e-6,
        accel_bias=ACCEL_BIAS.at(noise) if micro_g is None else micro_g * 1e-6,
    )
