"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Given a hypothesis and a size s of the bias, rates are linear in the direction z = (cos a, sin a) of north and
the bias b, which turns with the body::

    horizontal gyros   y_p = Ω cos L z + C_p b + noise      C_p the attitude in position p
    vertical gyro      v_p - Ω sin L = C_p b + noise        b ~ N(0, s²)

Eliminating b leaves η'z - ½ z'Λz as the log density on the circle: a von Mises distribution where Λ is
isotropic, and a generalised one (Gatto and Jammalamadaka 2007) where one gyro is worse than the others.  An
accelerometer with the bias β g tilts the axes, by which the horizontal gyros see β Ω sin L of the vertical
earth rate.  That turns with the body as well, and is a part of s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.hypotheses import Information, PositionFit
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.estimation.alignment.sensor_errors import SensorErrors
from imumon.geodesy import EARTH_RATE

DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
"""Starting points of the search for peaks on the circle, rad."""
QUARTIC = 0.152
"""An exponential of -δ⁴/24 has the integral of a Gaussian of the sharpness √0.152."""


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
