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
from dataclasses import dataclass

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.hypotheses import PositionFit
from imumon.estimation.alignment.prior import SensorErrors
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.geodesy import EARTH_RATE

LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""
DIRECTIONS = 32
"""Directions around the circle from which the search for the likeliest begins."""


@dataclass(frozen=True, slots=True)
class HeadingPosterior:
    """The posterior of the direction of north.

    Parameters
    ----------
    north : float
        Direction of north in the reference frame at the end of the last position, rad, counter-clockwise.
    sd, noise_sd : float
        Its standard deviation, and that without any bias, rad.
    level_bias_sd, bias_size : float
        Standard deviation of the bias in the level axes that is left in the heading, and root mean square of
        its prior size, rad/s.
    settling : float
        Probability that the unit settles.
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
    north: float | None = None,
) -> HeadingPosterior:
    """Return the heading at the end of the last position.

    Parameters
    ----------
    fits : sequence of PositionFit
        Earlier ones count by mean and variance over their hypotheses.
    turn_variances : array, (p,)
        Of the angle by which the unit was turned since the first position, rad².
    latitude : float
        rad.
    errors : SensorErrors
    north : float, optional
        About where north is, rad, for a unit that creeps about the vertical: found in a first pass.
    """
    last = fits[-1]
    if north is None:
        north = cmath.phase(last.moments()[0])
        if any(one.yaw for one in fits):
            north = heading_posterior(fits, turn_variances, latitude, errors, north).north
    rate, earth_vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    information, vector = np.zeros((5, 5)), np.zeros(5)
    yaw, creep_s = last.yaw, last.creep_s
    for one, variance in zip(fits[-2::-1], (turn_variances[-1] - turn_variances)[-2::-1], strict=True):
        mean, level_variance = one.moments()
        mean *= cmath.exp(-1j * yaw)
        design = _design(one, rate, north, yaw, creep_s)
        weight = _weights(one, level_variance + rate**2 * variance, errors.flicker)
        information += design.T @ (weight[:, None] * design)
        vector += design.T @ (weight * [mean.real, mean.imag, one.vertical - earth_vertical])
        yaw, creep_s = yaw + one.yaw, creep_s + one.creep_s
    keep = last.log_weight > LIKELY
    design, means = _design(last, rate, north, 0.0, 0.0), last.rate[keep]
    weights = np.array([_weights(last, variance, errors.flicker) for variance in last.variance[keep]])
    observed = np.column_stack([means.real, means.imag, np.full(len(means), last.vertical - earth_vertical)])
    information = information + np.einsum("ri,hr,rj->hij", design, weights, design)
    vector, matrix, log_factor = _without_bias(
        information, vector + (weights * observed) @ design, errors.sizes
    )
    misfit = 0.5 * np.sum(weights * observed**2 - np.log(weights), axis=1)
    log_density = log_factor + (last.log_weight[keep] - misfit)[:, None] + errors.log_prior
    of, size = _likely(vector, matrix, log_density)
    vector, matrix, log_density = vector[of, size], matrix[of, size], log_density[of, size]
    angle, height, sharpness = _peaks(vector, matrix)
    log_mass = log_density + height + np.log(i0e(sharpness))
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    # Mean and variance of the mixture of von Mises distributions.
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
        level_bias_sd=rate * math.sqrt(max(whole - noise, 0.0)),
        bias_size=math.sqrt(weight @ np.mean(errors.sizes**2, axis=1)[size]),
        settling=float(weight @ last.settles[keep][of]),
    )


def _likely(vector: FloatArray, matrix: FloatArray, log_density: FloatArray) -> tuple[IntArray, IntArray]:
    """Return indices of the likely hypotheses and bias sizes, by bounds of their log density."""
    xx, yy, xy = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 0, 1]
    middle = log_density + np.hypot(vector[..., 0], vector[..., 1]) - 0.25 * (xx + yy)
    off = 0.5 * np.hypot(0.5 * (xx - yy), xy)
    of, size = np.nonzero(middle + off > (middle - off).max() + 2.0 * LIKELY)
    return of, size


def _design(one: PositionFit, level_rate: float, north: float, yaw: float, creep_s: float) -> FloatArray:
    """Return the derivatives of level rates and vertical rate by z and b, (3, 5).

    Where the unit creeps about the vertical, its rates were turned by the angle that the vertical gyro shows.
    Its bias turned them as well: those of the position by half of what it adds up to, and by all of it in
    later positions, which took `creep_s` and turned the unit by `yaw`, rad.
    """
    design = np.zeros((3, 5))
    design[0, 0] = design[1, 1] = level_rate
    level = one.bias_rotation * cmath.exp(-1j * yaw) * (one.attitude[0] + 1j * one.attitude[1])
    late = (creep_s + 0.5 * one.creep_s) * level_rate * np.array([math.sin(north), -math.cos(north)])
    design[:2, 2:] = np.stack([level.real, level.imag]) + np.outer(late, one.attitude[2])
    design[2, 2:] = one.attitude[2]
    return design


def _weights(one: PositionFit, level_variance: float, flicker: float) -> FloatArray:
    """Return the inverse variances of level rates and vertical rate, (3,)."""
    return 1.0 / (np.array([level_variance, level_variance, one.vertical_variance]) + flicker**2)


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


def _peaks(vector: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return place, height and sharpness (minus the second derivative) of two peaks, (2, ...).

    r.z - ½ z' Λ z is a constant and waves, w0 cos a + w1 sin a + w2 cos 2a + w3 sin 2a, with one or two
    peaks; a second one that is not there has the height -inf.
    """
    xx, yy, xy = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 0, 1]
    waves = np.stack([vector[..., 0], vector[..., 1], 0.25 * (yy - xx), -0.5 * xy])
    order = np.array([1.0, 1.0, 2.0, 2.0]).reshape(4, *[1] * (waves.ndim - 1))

    def basis(angle: FloatArray) -> FloatArray:
        return np.stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)])

    around = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    values = np.moveaxis(waves, 0, -1) @ basis(around)
    peak = (values >= np.roll(values, 1, axis=-1)) & (values > np.roll(values, -1, axis=-1))
    first = np.argmax(values, axis=-1)
    np.put_along_axis(peak, first[..., None], False, axis=-1)
    second = np.argmax(np.where(peak, values, -np.inf), axis=-1)
    angle = around[np.stack([first, second])]
    for _ in range(6):  # Newton's steps converge quadratically
        c, s, c2, s2 = basis(angle)
        slope = np.sum(order * waves * np.stack([-s, c, -s2, c2]).swapaxes(0, 1), axis=1)
        sharp = np.sum(order**2 * waves * np.stack([c, s, c2, s2]).swapaxes(0, 1), axis=1)
        angle = angle + np.clip(slope / np.maximum(np.abs(sharp), 1e-30), -0.2, 0.2)
    at = basis(angle).swapaxes(0, 1)
    height, sharp = np.sum(waves * at, axis=1), np.sum(order**2 * waves * at, axis=1)
    height[1][~peak.any(axis=-1)] = -np.inf
    return angle, height - 0.25 * (xx + yy), np.maximum(sharp, 0.0)
