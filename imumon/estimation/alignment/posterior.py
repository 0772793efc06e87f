"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Given a hypothesis and a size s of the bias, rates are linear in the direction z = (cos a, sin a) of north and
the bias b, which turns with the body::

    horizontal gyros   y_p = Ω cos L z + C_p b + noise      C_p the attitude in position p
    vertical gyro      v_p - Ω sin L = C_p b + noise        b ~ N(0, s²)

Eliminating b leaves η'z - ½ z'Λz as the log density on the circle: a von Mises distribution where Λ is
isotropic, and a generalised one (Gatto and Jammalamadaka 2007) where one gyro is worse than the others.  An
accelerometer with the bias β g tilts the axes, by which the horizontal gyros see β Ω sin L of the vertical
earth rate.  That turns with the body as well, and is a part of s.

The prior of the errors of gyros and accelerometers is what is declared, or a regression on the gyros' noise
over the data sheets of docs/appendix/alignment-details.md.  Declare the errors of a better unit: of gyros
with 0.001 °/√h, too, 0.0014 °/h, 300 ppm and 750 µg are taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.fit import Information, PositionFit
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.geodesy import DEG_PER_H, EARTH_RATE

GYRO_BIAS = (2.0 * DEG_PER_H, 1.86, 0.0014 * DEG_PER_H, EARTH_RATE)
GYRO_SCALE = (3e-4, 1.4, 3e-4, 0.03)
ACCEL_BIAS = (7.5e-4, 1.4, 7.5e-4, 0.04)
"""Regressions of the bias of a gyro, rad/s, scale factor and misalignment of a gyro, and the bias of an
accelerometer, g: factor (N / 0.1 °/√h)^power, clipped to least and most."""
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
DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
"""Starting points of the search for peaks on the circle, rad."""
QUARTIC = 0.152
"""An exponential of -δ⁴/24 has the integral of a Gaussian of the sharpness √0.152."""


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

    def typical(factor: float, power: float, least: float, most: float) -> float:
        return min(max(factor * math.pow(noise / (math.radians(0.1) / 60.0), power), least), most)

    bias, p_worse = typical(*GYRO_BIAS), P_WORSE
    alike, share = bias * np.exp(LOG_SIZES), np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2)
    if parameters.gyro_bias_sd_deg_per_h is not None:
        declared = max(parameters.gyro_bias_sd_deg_per_h * DEG_PER_H, 1e-11)  # zero has no logarithm
        alike, share = np.array([declared]), np.ones(1)
        bias, p_worse = max(bias, declared), P_WORSE_THAN_DECLARED
    worse = np.full(len(WORSE), p_worse / len(WORSE))
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    return SensorErrors(
        sizes=np.concatenate([np.tile(alike[:, None], (1, 3)), bias * WORSE]),
        log_prior=np.log(np.concatenate([(1.0 - p_worse) * share / share.sum(), worse])),
        flicker=(parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
        scale=typical(*GYRO_SCALE) if ppm is None else ppm * 1e-6,
        accel_bias=typical(*ACCEL_BIAS) if micro_g is None else micro_g * 1e-6,
    )


class HeadingPosterior(NamedTuple):
    """The posterior of the direction of north.

    `north` is counter-clockwise in the reference frame, rad, `sd` its standard deviation, and `bias_size`,
    rad/s, the root mean square size of a gyro's bias.
    """

    north: float
    sd: float
    bias_size: float


def heading_posterior(
    fits: Sequence[PositionFit], azimuth_variances: FloatArray, latitude: float, errors: SensorErrors
) -> HeadingPosterior:
    """Return the heading at a latitude, rad, by the last position and the averaged fits of those before.

    `azimuth_variances` (p,) are of the angle by which the unit was turned since the first position, rad².
    """
    joint, log_density = _linear_model(fits, azimuth_variances, latitude, errors.flicker)
    sizes = np.hypot(errors.sizes, errors.accel_bias * EARTH_RATE * math.sin(latitude))
    of_north, log_factor = Information(joint.matrix[:, None], joint.vector[:, None]).without(sizes)
    log_weight = (log_density[:, None] + log_factor + errors.log_prior).ravel()
    matrix, vector = of_north.matrix.reshape(-1, 2, 2), of_north.vector.reshape(-1, 2)
    part, angle, height, sharpness = peaks(matrix, vector)

    # Each peak is a von Mises distribution with this concentration; moments of their mixture.
    log_mass = log_weight[part] + height + np.log(i0e(sharpness))
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    length = i1e(sharpness) / i0e(sharpness)
    north = float(np.angle(np.sum(mass * length * np.exp(1j * angle))))
    off = np.remainder(angle - north + np.pi, 2.0 * np.pi) - np.pi
    spread = np.minimum(-2.0 * np.log(np.maximum(length, 1e-9)), ANY_ANGLE_SD**2)
    return HeadingPosterior(
        north=north,
        sd=min(math.sqrt(np.sum(mass * (spread + off**2))), ANY_ANGLE_SD),
        bias_size=math.sqrt(mass @ np.mean(errors.sizes**2, axis=1)[part % len(sizes)]),
    )


def _linear_model(
    fits: Sequence[PositionFit], azimuth_variances: FloatArray, latitude: float, flicker: float
) -> tuple[Information, FloatArray]:
    """Return the information on z and b of each hypothesis, (h,), and the log density without them, (h,)."""
    horizontal, vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    model = Information(np.zeros((1, 5, 5)), np.zeros((1, 5, 1)))
    log_density = fits[-1].log_weight
    for fit, azimuth_variance in zip(fits, azimuth_variances[-1] - azimuth_variances, strict=True):
        rate = fit.rate
        observed = np.column_stack([rate.real, rate.imag, np.full(len(rate), fit.vertical - vertical)])
        of_level = fit.variance + horizontal**2 * azimuth_variance
        variance = np.column_stack([of_level, of_level, np.full(len(rate), fit.vertical_variance)])
        weight = 1.0 / (variance + flicker**2)
        design = np.hstack([horizontal * np.eye(3, 2), fit.attitude])
        weighted = design.T * weight[:, None, :]
        model = model.plus(Information(weighted @ design, weighted @ observed[:, :, None]))
        log_density = log_density - 0.5 * np.sum(weight * observed**2 - np.log(weight), axis=1)
    return model, log_density


def peaks(matrix: FloatArray, vector: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return the local maxima on the circle of η'z - ½ z'Λz, Λ (m, 2, 2), η (m, 2), one or two each.

    They are an index of the function, the angle, rad, the value, and the concentration of a von Mises
    distribution with the same integral: minus the second derivative, and a part of the fourth, without which
    two peaks that merge are any angle.
    """
    z = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
    values = vector @ z - 0.5 * np.sum(z * (matrix @ z), axis=1)
    found = (values >= np.roll(values, 1, axis=1)) & (values > np.roll(values, -1, axis=1))
    found[np.arange(len(values)), np.argmax(values, axis=1)] = True
    index, start = np.nonzero(found)
    x, y = vector[index].T
    xx, yy, xy = matrix[index, 0, 0], matrix[index, 1, 1], matrix[index, 0, 1]
    angle = DIRECTIONS[start]
    for step in range(7):
        c, s = np.cos(angle), np.sin(angle)
        # First and second harmonic: η'z and -½ z'Λz + ¼ tr Λ.
        first, second = x * c + y * s, 0.25 * (yy - xx) * (c * c - s * s) - xy * c * s
        slope = y * c - x * s - (yy - xx) * c * s - xy * (c * c - s * s)
        curvature, fourth = first + 4.0 * second, np.maximum(-first - 16.0 * second, 0.0)
        if step < 6:  # Newton's steps converge quadratically
            angle = angle + np.clip(slope / np.maximum(np.abs(curvature), 1e-30), -0.2, 0.2)
    half = 0.5 * np.maximum(curvature, 0.0)
    sharpness = half + np.sqrt(half**2 + QUARTIC * fourth)
    return index, angle, first + second - 0.25 * (xx + yy), sharpness
