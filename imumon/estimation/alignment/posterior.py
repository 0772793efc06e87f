"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Given a hypothesis and a size s of the bias, rates are linear in the direction z = (cos a, sin a) of north and
the bias b, which turns with the body::

    level gyros      y_p = R z + C_p b + noise          R = Ω cos L, C_p the attitude in position p
    vertical gyro    v_p - Ω sin L = C_p b + noise      b ~ N(0, s²)

Eliminating b leaves r.z - ½ z' Λ z as the log density on the circle: a von Mises distribution where Λ is
isotropic, and a generalised one (Gatto and Jammalamadaka 2007) where one gyro is worse than the others.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.hypotheses import LIKELY, PositionFit
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.estimation.alignment.sensor_errors import SensorErrors
from imumon.geodesy import EARTH_RATE


class HeadingPosterior(NamedTuple):
    """The posterior of the direction of north.

    `north` is counter-clockwise in the reference frame at the end of the last position, rad, `sd` its
    standard deviation, and `noise_sd` that without any bias; `level_bias_sd` is that of the bias in the
    level axes that is left in the heading, and `bias_size` the root mean square of its prior size, rad/s;
    `settling` the probability that the unit settles.
    """

    north: float
    sd: float
    noise_sd: float
    level_bias_sd: float
    bias_size: float
    settling: float


def heading_posterior(
    fits: Sequence[PositionFit],
    turn_variances: FloatArray,
    latitude: float,
    errors: SensorErrors,
    north: float,
) -> HeadingPosterior:
    """Return the heading at the end of the last position, at a latitude, rad.

    `turn_variances` (p,) are of the angle by which the unit was turned since the first position, rad².
    Earlier positions count by mean and variance over their hypotheses.  `north` is about where north is, as a
    bias turns the rates of a unit that creeps across it.
    """
    information, vector, log_density = _linear_model(fits, turn_variances, latitude, errors.flicker, north)
    vector, matrix, log_factor = _without_bias(information, vector, errors.sizes)
    log_density = log_density[:, None] + log_factor + errors.log_prior
    of, size = _likely(vector, matrix, log_density)
    matrix = matrix[of, size]
    angle, height, sharpness = _peaks(vector[of, size], matrix)

    # Each peak is a von Mises distribution with this concentration; moments of their mixture.
    log_mass = log_density[of, size] + height + np.log(i0e(sharpness))
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    length = i1e(sharpness) / i0e(sharpness)
    north = float(np.angle(np.sum(mass * length * np.exp(1j * angle))))
    off = np.remainder(angle - north + np.pi, 2.0 * np.pi) - np.pi
    spread = np.minimum(-2.0 * np.log(np.maximum(length, 1e-9)), ANY_ANGLE_SD**2)
    sd = math.hypot(math.sqrt(np.sum(mass * (spread + off**2))), errors.level * math.tan(latitude))

    weight, east = mass.sum(axis=0), np.array([-math.sin(north), math.cos(north)])
    noise, whole = (
        float(weight @ (1.0 / np.maximum(east @ form @ east, 1e-30)))
        for form in (information[of, :2, :2], matrix)
    )
    return HeadingPosterior(
        north=north,
        sd=min(sd, ANY_ANGLE_SD),
        noise_sd=min(math.sqrt(noise), ANY_ANGLE_SD),
        level_bias_sd=EARTH_RATE * math.cos(latitude) * math.sqrt(max(whole - noise, 0.0)),
        bias_size=math.sqrt(weight @ np.mean(errors.sizes**2, axis=1)[size]),
        settling=float(weight @ fits[-1].settles[of]),
    )


def _linear_model(
    fits: Sequence[PositionFit], turn_variances: FloatArray, latitude: float, flicker: float, north: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return information, (h, 5, 5), and its vector, (h, 5), of z and b, and the log density without them."""
    rate, earth_vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    information: FloatArray = np.zeros((1, 5, 5))
    vector, log_density = np.zeros((1, 5)), fits[-1].log_weight
    yaw, creep_s = 0.0, 0.0
    for fit, turned in zip(fits[::-1], (turn_variances[-1] - turn_variances)[::-1], strict=True):
        mean, variance = (fit.rate, fit.variance) if fit is fits[-1] else fit.moments()
        to_now = cmath.exp(-1j * yaw)
        level_rate, up_rate = mean * to_now, np.full(len(mean), fit.vertical - earth_vertical)
        observed = np.column_stack([level_rate.real, level_rate.imag, up_rate])
        level_variance = variance + rate**2 * turned
        vertical_variance = np.full(len(mean), fit.vertical_variance)
        weight = 1.0 / (np.column_stack([level_variance, level_variance, vertical_variance]) + flicker**2)
        # A creep is followed by the vertical gyro, whose bias turns the rates across north: those of the
        # position by half of what it adds up to, and those of earlier positions by all of it.
        by_vertical = -1j * cmath.exp(1j * north) * rate * (creep_s + 0.5 * fit.creep_s)
        level = fit.bias_rotation * to_now * (fit.attitude[0] + 1j * fit.attitude[1])
        level = level + by_vertical * fit.attitude[2]
        design = np.zeros((3, 5))
        design[0, 0] = design[1, 1] = rate
        design[:, 2:] = level.real, level.imag, fit.attitude[2]
        information = information + np.einsum("ri,hr,rj->hij", design, weight, design)
        vector = vector + (weight * observed) @ design
        log_density = log_density - 0.5 * np.sum(weight * observed**2 - np.log(weight), axis=1)
        yaw, creep_s = yaw + fit.yaw, creep_s + fit.creep_s
    return information, vector, log_density


def _without_bias(
    information: FloatArray, vector: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eliminate the bias from information, (h, 5, 5), and its vector, (h, 5).

    Returns
    -------
    r : array, (h, s, 2)
    Λ : array, (h, s, 2, 2)
    log_factor : array, (h, s)
        Log density of what does not depend on z.
    """
    precision = information[:, None, 2:, 2:] + np.eye(3) / sizes[:, None, :] ** 2
    covariance = np.linalg.inv(precision)
    gain, bias = information[:, None, :2, 2:] @ covariance, vector[:, None, 2:, None]
    log_factor = 0.5 * (bias.swapaxes(-1, -2) @ covariance @ bias)[..., 0, 0]
    log_factor -= 0.5 * np.linalg.slogdet(precision)[1] + np.log(sizes).sum(axis=1)
    matrix = information[:, None, :2, :2] - gain @ information[:, None, 2:, :2]
    return vector[:, None, :2] - (gain @ bias)[..., 0], matrix, log_factor


def _likely(vector: FloatArray, matrix: FloatArray, log_density: FloatArray) -> tuple[IntArray, IntArray]:
    """Return indices of the likely hypotheses and bias sizes, by bounds of their log density.

    The quadratic form ½ z' Λ z is between half the eigenvalues of Λ.
    """
    xx, yy, xy = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 0, 1]
    middle = log_density + np.hypot(vector[..., 0], vector[..., 1]) - 0.25 * (xx + yy)
    off = 0.5 * np.hypot(0.5 * (xx - yy), xy)
    of, size = np.nonzero(middle + off > (middle - off).max() + 2.0 * LIKELY)
    return of, size


def _peaks(vector: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return place, height and sharpness (minus the second derivative) of two peaks of r.z - ½ z' Λ z.

    r (n, 2) and Λ (n, 2, 2) give arrays (2, n); a second peak that is not there has the height -inf.
    """
    x, y = vector.T
    xx, yy, xy = matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 0, 1]

    def derivatives(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        c, s = np.cos(angle), np.sin(angle)
        along, across = x * c + y * s, y * c - x * s
        form = xx * c * c + 2.0 * xy * c * s + yy * s * s
        slope = across - (yy - xx) * c * s - xy * (c * c - s * s)
        return along - 0.5 * form, slope, along + xx + yy - 2.0 * form

    around = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    values = derivatives(around[:, None])[0]
    peak = (values >= np.roll(values, 1, axis=0)) & (values > np.roll(values, -1, axis=0))
    first = np.argmax(values, axis=0)
    peak[first, np.arange(len(x))] = False
    second = np.argmax(np.where(peak, values, -np.inf), axis=0)
    angle = around[np.stack([first, second])]
    for _ in range(6):  # Newton's steps converge quadratically
        _, slope, sharpness = derivatives(angle)
        angle = angle + np.clip(slope / np.maximum(np.abs(sharpness), 1e-30), -0.2, 0.2)
    height, _, sharpness = derivatives(angle)
    height[1][~peak.any(axis=0)] = -np.inf
    return angle, height, np.maximum(sharpness, 0.0)
