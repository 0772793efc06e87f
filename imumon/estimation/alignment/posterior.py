"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Given a hypothesis and a size s of the bias, rates are linear in the direction z = (cos a, sin a) of north, in
the bias b, which turns with the body, and in the error e of scale, which is the same in all turns::

    horizontal gyros   y_p = Ω cos L z + C_p b + noise      C_p the attitude in position p
    vertical gyro      v_p - Ω sin L = C_p b + noise        b ~ N(0, s²), e ~ N(0, s_e²)
    a turn             z' = z + (e t + N(0, v)) J z         t its angle, v its variance by all but e

J turns by 90°; J z is that of the fit before.  Eliminating b and e leaves η'z - ½ z'Λz as the log density on
the circle: a von Mises distribution where Λ is isotropic, and a generalised one (Gatto and Jammalamadaka
2007) where one gyro is worse than the others.  An accelerometer with the bias β g tilts the axes, by which
the horizontal gyros see β Ω sin L of the vertical earth rate.  That turns with the body as well, and is a
part of s.

The prior of the errors of gyros and accelerometers is what is declared, or a regression on the gyros' noise
over the data sheets of docs/appendix/alignment-details.md.  Declare the errors of a better unit: for
gyros with 0.001 °/√h, 0.0014 °/h, 300 ppm and 750 µg are taken, of which the 750 µg count most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.fit import eliminate
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.position import AzimuthError, PositionFit
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.geodesy import DEG_PER_H, EARTH_RATE

GYRO_BIAS, BIAS_POWER, LEAST_NOISE = 2.0 * DEG_PER_H, 1.86, 0.02
"""Regression of the bias of a gyro, rad/s, on the ratio of its noise to 0.1 °/√h, of which 0.02 counts at
least; at most the earth rate."""
GYRO_SCALE, ACCEL_BIAS, ERROR_POWER, MOST_ERROR = 3e-4, 7.5e-4, 1.4, 100.0
"""Scale factor and misalignment of a gyro, and bias of an accelerometer, g, of gyros with 0.1 °/√h at most;
of others they grow with this power of the ratio, up to 100 times."""
LEAST_SCALE = 1e-9
"""A declared scale error of zero has no logarithm."""
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
P_WORSE, P_WORSE_THAN_DECLARED = 0.003, 0.001
"""Prior probabilities of any of these factors (assumed): over the regression, as rare as a normal value
beyond three sigmas, and over a declared bias.  Ablation: without them, errors are up to 40 sigma."""
DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
"""Starting points of the search for peaks on the circle, rad."""
QUARTIC = 0.152
"""An exponential of -δ⁴/24 has the integral of a Gaussian of the sharpness √0.152."""


class SensorErrors(NamedTuple):
    """Standard deviations of the errors of gyros and accelerometers.

    `sizes` (s, 3) of the gyros' biases, rad/s, have the log probabilities `log_prior` (s,); `flicker` is what
    changes from position to position, rad/s; `scale` is a ratio; `accel_bias` is in g.
    """

    sizes: FloatArray
    log_prior: FloatArray
    flicker: float
    scale: float
    accel_bias: float


def sensor_errors(noise: float, parameters: AlignmentParameters) -> SensorErrors:
    """Return the declared errors, and the regression on an angular random walk, rad/√s, for the others."""
    ratio = noise / (math.radians(0.1) / 60.0)
    bias = min(GYRO_BIAS * max(ratio, LEAST_NOISE) ** BIAS_POWER, EARTH_RATE)
    alike, share, p_worse = bias * np.exp(LOG_SIZES), np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2), P_WORSE
    if parameters.gyro_bias_sd_deg_per_h is not None:
        declared = max(parameters.gyro_bias_sd_deg_per_h * DEG_PER_H, 1e-11)  # zero has no logarithm
        bias, p_worse = max(bias, declared), P_WORSE_THAN_DECLARED
        alike, share = np.array([declared]), np.ones(1)
    poorer = min(max(ratio, 1.0) ** ERROR_POWER, MOST_ERROR)
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    flicker = parameters.gyro_flicker_deg_per_h
    worse = np.full(len(WORSE), p_worse / len(WORSE))
    return SensorErrors(
        sizes=np.concatenate([np.tile(alike[:, None], (1, 3)), bias * WORSE]),
        log_prior=np.log(np.concatenate([(1.0 - p_worse) * share / share.sum(), worse])),
        # A declared error of scale and misalignment changes the earth rate as a bias of that position would.
        flicker=math.hypot((flicker or 0.0) * DEG_PER_H, (ppm or 0.0) * 1e-6 * EARTH_RATE),
        scale=GYRO_SCALE * poorer if ppm is None else ppm * 1e-6,
        accel_bias=ACCEL_BIAS * poorer if micro_g is None else micro_g * 1e-6,
    )


class HeadingPosterior(NamedTuple):
    """Direction of north, counter-clockwise in the reference frame, rad, and its standard deviation.

    `bias_size`, rad/s, is the root mean square size of a gyro's bias, with the part by the level, and `worse`
    the probability that gyros are `WORSE` than declared or, if nothing is declared, than the regression.
    """

    north: float
    sd: float
    bias_size: float
    worse: float


def heading_posterior(
    positions: Sequence[tuple[PositionFit, AzimuthError]], about: float, latitude: float, errors: SensorErrors
) -> HeadingPosterior:
    """Return the heading at a latitude, rad, by the last position and the averaged fits of those before.

    `about` is the direction of north, rad, near which an error of scale is linear.
    """
    matrix, vector, log_density = _linear_model(positions, about, latitude, errors)
    sizes = np.hypot(errors.sizes, errors.accel_bias * EARTH_RATE * math.sin(latitude))
    prior = np.column_stack([sizes, np.full(len(sizes), max(errors.scale, LEAST_SCALE))])
    matrix, vector, log_factor = eliminate(matrix[:, None], vector[:, None], prior)
    log_weight = (log_density[:, None] + log_factor + errors.log_prior).ravel()
    part, angle, height, sharpness = peaks(matrix.reshape(-1, 2, 2), vector.reshape(-1, 2))
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
        bias_size=math.sqrt(mass @ np.mean(sizes**2, axis=1)[part % len(sizes)]),
        worse=float(mass @ (part % len(sizes) >= len(sizes) - len(WORSE))),
    )


def _linear_model(
    positions: Sequence[tuple[PositionFit, AzimuthError]], about: float, latitude: float, errors: SensorErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Λ and η of z, b and e given each hypothesis, (h, 6, 6) and (h, 6, 1), and its log weight."""
    horizontal, vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    matrix, vector = np.zeros((1, 6, 6)), np.zeros((1, 6, 1))
    log_density = positions[-1][0].log_weight
    longest = max((error.by_scale for _, error in positions), key=lambda path: float(np.sum(path**2)))
    before = positions[0][1]
    for fit, error in positions:
        by_scale = error.by_scale - before.by_scale
        angle = float(np.sum(by_scale * longest)) / max(float(np.linalg.norm(longest)), 1e-12)
        variance = error.variance_from(before, errors.scale) - (errors.scale * angle) ** 2
        matrix, vector = _turn(matrix, vector, about, angle, variance)
        before, one = error, np.ones(len(fit.rate))
        observed = np.column_stack([fit.rate.real, fit.rate.imag, (fit.vertical - vertical) * one])
        variances = np.column_stack([fit.variance, fit.variance, fit.vertical_variance * one])
        weight = 1.0 / (variances + errors.flicker**2)
        design = np.column_stack([horizontal * np.eye(3, 2), fit.attitude, np.zeros(3)])
        weighted = design.T * weight[:, None, :]
        matrix, vector = matrix + weighted @ design, vector + weighted @ observed[:, :, None]
        log_density = log_density - 0.5 * np.sum(weight * observed**2 - np.log(weight), axis=1)
    return matrix, vector, log_density


def _turn(
    matrix: FloatArray, vector: FloatArray, about: float, angle: float, variance: float
) -> tuple[FloatArray, FloatArray]:
    """Predict Λ and η over a turn by an `angle` t, rad, that has the `variance` v, rad², beside e t.

    In information form: x' = F x + N(0, v G Gᵀ), with z at the angle `about`, rad, in F, and G that selects
    z: a turn of which little is known is not linear, so N(0, v) is taken in both directions.
    """
    back = np.eye(6)  # F⁻¹
    back[:2, -1] = angle * math.sin(about), -angle * math.cos(about)
    matrix, vector = back.T @ matrix @ back, back.T @ vector
    gain = variance * matrix[..., :2] @ np.linalg.inv(np.eye(2) + variance * matrix[..., :2, :2])
    return matrix - gain @ matrix[..., :2, :], vector - gain @ vector[..., :2, :]


def peaks(matrix: FloatArray, vector: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return the local maxima on the circle of η'z - ½ z'Λz, Λ (m, 2, 2), η (m, 2), one or two each.

    They are an index of the function, the angle, rad, the value, and the concentration of a von Mises
    distribution with the same integral: minus the second derivative, and a part of the fourth, without which
    two peaks that merge are any angle.
    """
    xx, yy, xy = matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 0, 1]
    # At the angle a this is a constant and Re(p e^-ia + q e^-2ia): a first and a second harmonic.
    p, q = vector[:, 0] + 1j * vector[:, 1], 0.25 * (yy - xx) - 0.5j * xy
    values = (np.outer(p, np.exp(-1j * DIRECTIONS)) + np.outer(q, np.exp(-2j * DIRECTIONS))).real
    found = (values >= np.roll(values, 1, axis=1)) & (values > np.roll(values, -1, axis=1))
    found[np.arange(len(values)), np.argmax(values, axis=1)] = True
    index, start = np.nonzero(found)
    angle = DIRECTIONS[start]
    for _ in range(6):  # Newton's steps converge quadratically
        first, second = p[index] * np.exp(-1j * angle), q[index] * np.exp(-2j * angle)
        slope, curvature = first.imag + 2.0 * second.imag, np.abs(first.real + 4.0 * second.real)
        angle = angle + np.clip(slope / np.maximum(curvature, 1e-30), -0.2, 0.2)
    first, second = (p[index] * np.exp(-1j * angle)).real, (q[index] * np.exp(-2j * angle)).real
    half = 0.5 * np.maximum(first + 4.0 * second, 0.0)
    sharpness = half + np.sqrt(half**2 + QUARTIC * np.maximum(-first - 16.0 * second, 0.0))
    return index, angle, first + second - 0.25 * (xx + yy)[index], sharpness
