"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

The prior of the sensor errors is a regression on the gyros' noise N over data sheets; see docs/alignment.md.

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
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.hypotheses import PositionFit
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.report import ANY_ANGLE_SD
from imumon.geodesy import DEG_PER_H, EARTH_RATE

LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""
DIRECTIONS = 32
"""Directions around the circle from which the search for the likeliest begins."""


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
LOG_SIZES, LOG_SIZE_SD = np.linspace(-4.0, 4.0, 9), 1.5
"""Logarithms of the sizes of a bias over that of the regression, and their standard deviation."""
_FACTORS = (1.0, *np.exp([2.0, 4.0, 6.0, 8.0, 10.0]))
WORSE = np.array([three for three in product(_FACTORS, repeat=3) if len({*three, 1.0}) == 2])
"""Factors by which some gyros or all are worse than that, (35, 3): up to 200 °/h for the best of them."""
P_WORSE, P_WORSE_CREEPING, P_NOT_DECLARED = 0.003, 0.15, 0.001
"""Prior probabilities that they are: as rare as a normal value beyond three sigmas; where the unit creeps, so
that the vertical gyro is no witness; and against a declared bias (assumed).  Ablation: without the first,
errors are up to 39 sigma."""


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


def sensor_errors(noise: float, parameters: AlignmentParameters, creeps: bool) -> SensorErrors:
    """Return the declared errors, and the regression on an angular random walk, rad/√s, for the others."""
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    return SensorErrors(
        *_bias_sizes(BIAS.at(noise), parameters.gyro_bias_sd_deg_per_h, creeps),
        flicker=(parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
        scale=SCALE.at(noise) if ppm is None else ppm * 1e-6,
        level=LEVEL.at(noise) if micro_g is None else micro_g * 1e-6,
    )


def _bias_sizes(typical: float, declared: float | None, creeps: bool) -> tuple[FloatArray, FloatArray]:
    alike, share = typical * np.exp(LOG_SIZES), np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2)
    worse = P_WORSE_CREEPING if creeps else P_WORSE
    if declared is not None:
        alike = np.array([max(declared * DEG_PER_H, 1e-11)])  # a bias of zero has no logarithm
        share, worse, typical = np.ones(1), P_NOT_DECLARED, max(typical, float(alike[0]))
    sizes = np.concatenate([np.tile(alike[:, None], (1, 3)), typical * WORSE])
    return sizes, np.log(np.r_[(1.0 - worse) * share / share.sum(), np.full(len(WORSE), worse / len(WORSE))])


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
    fits: Sequence[PositionFit], turn_variances: FloatArray, latitude: float, errors: SensorErrors
) -> HeadingPosterior:
    """Return the heading at the end of the last position, at a latitude, rad.

    `turn_variances` (p,) are of the angle by which the unit was turned since the first position, rad².
    Earlier positions count by mean and variance over their hypotheses.
    """
    last, north = fits[-1], cmath.phase(fits[-1].moments()[0])
    for _ in range(2 if any(one.yaw for one in fits) else 1):  # the rotation of a creep acts across north
        information, vector, log_density = _linear(fits, turn_variances, latitude, errors, north)
        vector, matrix, log_factor = _without_bias(information, vector, errors.sizes)
        log_density = log_density[:, None] + log_factor + errors.log_prior
        of, size = _likely(vector, matrix, log_density)
        matrix = matrix[of, size]
        angle, height, sharpness = _peaks(vector[of, size], matrix)
        log_mass = log_density[of, size] + height + np.log(i0e(sharpness))
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
        level_bias_sd=EARTH_RATE * math.cos(latitude) * math.sqrt(max(whole - noise, 0.0)),
        bias_size=math.sqrt(weight @ np.mean(errors.sizes**2, axis=1)[size]),
        settling=float(weight @ last.settles[last.log_weight > LIKELY][of]),
    )


def _linear(
    fits: Sequence[PositionFit],
    turn_variances: FloatArray,
    latitude: float,
    errors: SensorErrors,
    north: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return information, (h, 5, 5), and its vector, (h, 5), of z and b, and the log density without them.

    Where the unit creeps about the vertical, its rates were turned by the angle that the vertical gyro shows.
    Its bias turned them as well: those of the position by half of what it adds up to, and by all of it in
    later positions.  `north` is about where north is, rad.
    """
    rate, earth_vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    information: FloatArray = np.zeros((1, 5, 5))
    vector, log_density = np.zeros((1, 5)), np.zeros(1)
    yaw, creep_s = 0.0, 0.0
    for one, turned in zip(fits[::-1], (turn_variances[-1] - turn_variances)[::-1], strict=True):
        mean, variance = (np.array([value]) for value in one.moments())
        if one is fits[-1]:
            likely = one.log_weight > LIKELY
            mean, variance, log_density = one.rate[likely], one.variance[likely], one.log_weight[likely]
        mean = mean * cmath.exp(-1j * yaw)
        design = np.zeros((3, 5))
        design[0, 0] = design[1, 1] = rate
        level = one.bias_rotation * cmath.exp(-1j * yaw) * (one.attitude[0] + 1j * one.attitude[1])
        late = (creep_s + 0.5 * one.creep_s) * rate * np.array([math.sin(north), -math.cos(north)])
        design[:2, 2:] = np.stack([level.real, level.imag]) + np.outer(late, one.attitude[2])
        design[2, 2:] = one.attitude[2]
        level_variance = variance + rate**2 * turned
        vertical = np.array([one.vertical_variance, one.vertical - earth_vertical]) + np.zeros((len(mean), 1))
        weight = 1.0 / (np.column_stack([level_variance, level_variance, vertical[:, 0]]) + errors.flicker**2)
        observed = np.column_stack([mean.real, mean.imag, vertical[:, 1]])
        information = information + np.einsum("ri,hr,rj->hij", design, weight, design)
        vector = vector + (weight * observed) @ design
        log_density = log_density - 0.5 * np.sum(weight * observed**2 - np.log(weight), axis=1)
        yaw, creep_s = yaw + one.yaw, creep_s + one.creep_s
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
    """Return indices of the likely hypotheses and bias sizes, by bounds of their log density."""
    xx, yy, xy = matrix[..., 0, 0], matrix[..., 1, 1], matrix[..., 0, 1]
    middle = log_density + np.hypot(vector[..., 0], vector[..., 1]) - 0.25 * (xx + yy)
    off = 0.5 * np.hypot(0.5 * (xx - yy), xy)
    of, size = np.nonzero(middle + off > (middle - off).max() + 2.0 * LIKELY)
    return of, size


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
