"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Given a hypothesis and a size s of the bias, rates are linear in the direction z = (cos a, sin a) of north and
the bias b, which turns with the body::

    y_p = R z + C_p b + noise,    v_p = R tan L + C_p b + noise,    b ~ N(0, s²),    R = Ω cos L

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

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import PositionFit
from imumon.estimation.alignment.status import ANY_ANGLE_SD
from imumon.geodesy import DEG_PER_H, EARTH_RATE

CLASS_BIAS, CLASS_ARW, CLASS_POWER, CLASS_SCATTER = 2.0 * DEG_PER_H, math.radians(0.1) / 60.0, 1.86, 1.5
"""A gyro with the noise N has a bias of about 2 °/h (N / 0.1 °/√h)^1.86, and 1.5 is the standard deviation of
its logarithm: regression over the data sheets in docs/alignment.md."""
LEAST_ARW, LARGEST_CLASS_BIAS = math.radians(0.002) / 60.0, EARTH_RATE
"""The quietest of these gyros, and a bias that hides the north anyway."""
LOG_SIZES = np.linspace(-4.0, 12.0, 17)
"""Logarithms of the sizes of the bias over that of the class: up to 200 °/h for the best gyros."""
P_WORSE = 0.02
"""Prior probability that all gyros are worse than their class, by any factor; assumed."""
P_SINGLE, SINGLE = 0.003, np.exp([2.0, 4.0, 6.0, 8.0, 10.0])
"""Prior probability that one or two gyros are worse than the others, as seldom as a normal value beyond three
standard deviations, and by which factors."""
SOME_AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0]], dtype=bool)
P_DECLARED = 0.999
"""Prior probability that a declared bias holds."""
LEAST_BIAS = 1e-11
"""rad/s: a bias declared as zero."""
LIKELY = -15.0
"""Log weight below the largest from which on a hypothesis counts."""
DIRECTIONS, NEWTON_STEPS, LONGEST_STEP = 32, 6, 0.2
"""Start values around the circle, and steps of at most 0.2 rad from the two largest: they converge
quadratically."""


@dataclass(frozen=True, slots=True)
class Heading:
    """The posterior of the direction of north.

    Parameters
    ----------
    north : float
        Direction of north in the reference frame at the end of the last position, rad, counter-clockwise.
    sd : float
        rad.
    noise_sd : float
        What noise without a bias leaves, rad.
    bias_sd : float
        What the bias may add to the level rate, root mean square, rad/s.
    size_sd : float
        Root mean square of the size of the bias, rad/s.
    settling : float
        Probability that the unit settles.
    """

    north: float
    sd: float
    noise_sd: float
    bias_sd: float
    size_sd: float
    settling: float


def bias_sizes(arw: float, declared: float | None) -> tuple[FloatArray, FloatArray]:
    """Return sizes of the biases of the three gyros, rad/s, (s, 3), and their log probabilities, (s,).

    Parameters
    ----------
    arw : float
        White noise of the quietest gyro, rad/√s.
    declared : float or None
        Standard deviation of a bias by the pipeline file, rad/s.
    """
    typical = min(CLASS_BIAS * (max(arw, LEAST_ARW) / CLASS_ARW) ** CLASS_POWER, LARGEST_CLASS_BIAS)
    worse = LOG_SIZES > 0.0
    if declared is not None:
        larger = max(typical, declared) * np.exp(LOG_SIZES[worse])
        probability = np.r_[P_DECLARED, np.full(len(larger), (1.0 - P_DECLARED) / len(larger))]
        return np.tile(np.r_[max(declared, LEAST_BIAS), larger][:, None], (1, 3)), np.log(probability)
    density = np.exp(-0.5 * (LOG_SIZES / CLASS_SCATTER) ** 2)
    alike = (1.0 - P_WORSE - P_SINGLE) * density / density.sum() + P_WORSE * worse / worse.sum()
    some = np.where(SOME_AXES, SINGLE[:, None, None], 1.0).reshape(-1, 3)
    sizes = np.concatenate([np.tile(np.exp(LOG_SIZES)[:, None], (1, 3)), some])
    return typical * sizes, np.log(np.r_[alike, np.full(len(some), P_SINGLE / len(some))])


def heading_posterior(
    fits: Sequence[PositionFit],
    turn_variances: FloatArray,
    latitude: float,
    sizes: FloatArray,
    log_prior: FloatArray,
    flicker: float,
    level_sd: float,
    north: float | None = None,
) -> Heading:
    """Return the heading at the end of the last position.

    Parameters
    ----------
    fits : sequence of PositionFit
        Earlier ones count by mean and variance over their hypotheses.
    turn_variances : array, (p,)
        Of the angle by which the unit was turned since the first position, rad².
    latitude : float
        rad.
    sizes, log_prior : array, (s, 3) and (s,)
        Of `bias_sizes`.
    flicker : float
        Standard deviation by which a bias changes from position to position, rad/s.
    level_sd : float
        Of an accelerometer's bias, g.
    north : float, optional
        About where north is, rad, for a unit that creeps about the vertical: found in a first pass.
    """
    if north is None:
        north = float(np.angle(fits[-1].together()[0]))
        if any(one.crept for one in fits):
            given = fits, turn_variances, latitude, sizes, log_prior, flicker, level_sd
            north = heading_posterior(*given, north).north
    last = fits[-1]
    keep = last.log_weight > LIKELY
    log_weight, settles = last.log_weight[keep], last.settles[keep]
    level_rate, earth_vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    information, vector = np.zeros((5, 5)), np.zeros(5)
    crept, creep_s = last.crept, last.seconds if last.crept else 0.0
    for one, turned in zip(fits[-2::-1], (turn_variances[-1] - turn_variances)[-2::-1].tolist(), strict=True):
        rate, variance = one.together()
        rate *= cmath.exp(-1j * crept)
        design = _design(one, north, level_rate, crept, creep_s)
        weight = _weights(one, variance, turned, level_rate, flicker)
        crept, creep_s = crept + one.crept, creep_s + (one.seconds if one.crept else 0.0)
        information += design.T @ (weight[:, None] * design)
        vector += design.T @ (weight * [rate.real, rate.imag, one.vertical - earth_vertical])
    design = _design(last, north, level_rate, 0.0, 0.0)
    weights = np.array([_weights(last, v, 0.0, level_rate, flicker) for v in last.variance[keep].tolist()])
    rates = last.rate[keep]
    observed = np.column_stack([rates.real, rates.imag, np.full(len(rates), last.vertical - earth_vertical)])
    informations = information + np.einsum("ri,hr,rj->hij", design, weights, design)
    vectors = vector + (weights * observed) @ design
    misfit = 0.5 * np.sum(weights * observed**2, axis=1) - 0.5 * np.log(weights).sum(axis=1)
    form = _without_bias(informations, vectors, sizes)
    log_density = form.log_factor - misfit[:, None] + log_weight[:, None] + log_prior
    return _mixture(form, log_density, settles, sizes, level_rate, level_sd * math.tan(latitude))


def _design(one: PositionFit, north: float, level_rate: float, crept: float, creep_s: float) -> FloatArray:
    """Return the derivatives of level rates and vertical rate by z and b, (3, 5).

    Where the unit creeps about the vertical, its rates were turned by the angle that the vertical gyro shows.
    Its bias turned them as well: those of the position by half of what it adds up to, and by all of it in
    later positions, which took `creep_s` and turned the unit by `crept`, rad.
    """
    design = np.zeros((3, 5))
    design[0, 0] = design[1, 1] = level_rate
    level = one.turned_bias * cmath.exp(-1j * crept) * (one.attitude[0] + 1j * one.attitude[1])
    design[:, 2:] = level.real, level.imag, one.attitude[2]
    late_s = creep_s + (0.5 * one.seconds if one.crept else 0.0)
    earth = level_rate * cmath.exp(1j * north)
    design[:2, 2:] += late_s * np.outer([earth.imag, -earth.real], one.attitude[2])
    return design


def _weights(
    one: PositionFit, variance: float, turned: float, level_rate: float, flicker: float
) -> FloatArray:
    """Return the inverse variances of level rates and vertical rate, (3,)."""
    level = variance + level_rate**2 * turned + flicker**2
    return 1.0 / np.array([level, level, one.vertical_variance + flicker**2])


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """r.z - ½ z' Λ z of each hypothesis and size: `vector` (h, s, 2), `matrix` (h, s, 2, 2).

    `log_factor` (h, s) is the density of what does not depend on z; `unbiased` (h, 2, 2) is Λ without bias.
    """

    vector: FloatArray
    matrix: FloatArray
    log_factor: FloatArray
    unbiased: FloatArray


def _without_bias(information: FloatArray, vector: FloatArray, sizes: FloatArray) -> _Form:
    """Eliminate the bias from information (h, 5, 5) and its vector (h, 5)."""
    precision = information[:, None, 2:, 2:] + np.eye(3) / sizes[:, None, :] ** 2
    covariance = np.linalg.inv(precision)
    cross = information[:, None, :2, 2:] @ covariance
    bias = vector[:, None, 2:, None]
    reduced = vector[:, None, :2] - (cross @ bias)[..., 0]
    matrix = information[:, None, :2, :2] - cross @ information[:, None, 2:, :2]
    log_factor = 0.5 * (bias.swapaxes(-1, -2) @ covariance @ bias)[..., 0, 0]
    log_factor -= 0.5 * np.linalg.slogdet(precision)[1] + np.log(sizes).sum(axis=1)
    return _Form(reduced, matrix, log_factor, information[:, :2, :2])


def _mixture(
    form: _Form,
    log_density: FloatArray,
    settles: FloatArray,
    sizes: FloatArray,
    level_rate: float,
    level_sd: float,
) -> Heading:
    """Return mean and standard deviation over all hypotheses and sizes."""
    isotropic = 0.5 * (form.matrix[..., 0, 0] + form.matrix[..., 1, 1])
    along = 0.25 * (form.matrix[..., 0, 0] - form.matrix[..., 1, 1])
    across = 0.5 * form.matrix[..., 0, 1]
    waves = np.stack([form.vector[..., 0], form.vector[..., 1], -along, -across], axis=-1)
    angle, height, sharpness = _peaks(waves)
    log_mass = log_density - 0.5 * isotropic + height + np.log(i0e(sharpness))
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    length = i1e(sharpness) / i0e(sharpness)
    north = float(np.angle(np.sum(mass * length * np.exp(1j * angle))))
    off = np.remainder(angle - north + np.pi, 2.0 * np.pi) - np.pi
    spread = np.minimum(-2.0 * np.log(np.maximum(length, 1e-9)), ANY_ANGLE_SD**2)
    variance = float(np.sum(mass * (spread + off**2))) + level_sd**2
    tangent = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)[..., None, :]
    sharp, free = (
        (tangent @ matrix @ tangent.swapaxes(-1, -2))[..., 0, 0]
        for matrix in (form.matrix, form.unbiased[:, None])
    )
    noise_variance = float(np.sum(mass / np.maximum(free, 1.0 / ANY_ANGLE_SD**2)))
    whole_variance = float(np.sum(mass / np.maximum(sharp, 1e-12 * free + 1e-30)))
    return Heading(
        north,
        min(math.sqrt(variance), ANY_ANGLE_SD),
        math.sqrt(noise_variance),
        level_rate * math.sqrt(max(whole_variance - noise_variance, 0.0)),
        math.sqrt(float(mass.sum(axis=(0, 1)) @ np.mean(sizes**2, axis=1))),
        float(np.sum(mass.sum(axis=(0, 2)) * settles)),
    )


def _peaks(waves: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return place, height and sharpness (minus the second derivative) of the two largest peaks, (2, ...).

    The function is w0 cos a + w1 sin a + w2 cos 2a + w3 sin 2a, `waves` (..., 4).  A second peak that is not
    there has the height -inf.
    """
    around = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    values = waves @ np.stack([np.cos(around), np.sin(around), np.cos(2.0 * around), np.sin(2.0 * around)])
    local = (values >= np.roll(values, 1, axis=-1)) & (values > np.roll(values, -1, axis=-1))
    ranked = np.where(local, values, -np.inf)
    first = np.argmax(np.where(local.any(axis=-1, keepdims=True), ranked, values), axis=-1)
    np.put_along_axis(ranked, first[..., None], -np.inf, axis=-1)
    second = np.argmax(ranked, axis=-1)
    missing = ~np.isfinite(np.take_along_axis(ranked, second[..., None], axis=-1)[..., 0])
    angle = around[np.stack([first, second])]
    c, s, c2, s2 = np.moveaxis(waves, -1, 0)
    for _ in range(NEWTON_STEPS):
        one, two = np.exp(1j * angle), np.exp(2j * angle)
        slope = s * one.real - c * one.imag + 2.0 * (s2 * two.real - c2 * two.imag)
        sharp = c * one.real + s * one.imag + 4.0 * (c2 * two.real + s2 * two.imag)
        angle = angle + np.clip(slope / np.maximum(np.abs(sharp), 1e-30), -LONGEST_STEP, LONGEST_STEP)
    one, two = np.exp(1j * angle), np.exp(2j * angle)
    height = c * one.real + s * one.imag + c2 * two.real + s2 * two.imag
    sharp = c * one.real + s * one.imag + 4.0 * (c2 * two.real + s2 * two.imag)
    height[1][missing] = -np.inf
    return angle, height, np.maximum(sharp, 0.0)
