"""The heading from all positions: a mixture over hypotheses and sizes of the gyros' bias.

Rates are in the reference frame (forward, left and up of the first position).  There the earth rate ω is
Ω (cos L z, sin L), with z, the level unit vector to north.  In attitude C_p a fit has the rates w_p::

    w_p = ω + C_p (b + E C_pᵀ ω) + ω × (u × C_p β) + flicker + noise    u up                     (6)
    z'  = z + (Σ ψ_ij E_ij + N(0, q)) J z                               a turn; J turns by 90°   (7)

b is the bias of the gyros, E their scale and misalignment, and β the bias of the accelerometers, g, which
tilts the axes.  All three are constant in body axes.  ψ is the angle about the vertical by each element of E,
and q the variance of a turn by all else, and of a creep; it is added to both parts of z, so that a large one,
which is not linear, stays harmless.  Where z multiplies an error, it is that of the fit before.  In (6) E
counts only if its size is declared: without that sigma lacks it (`AlignmentParameters`).

So w_p is linear in x = (z, b, E, β), by `_design`, and Gaussian.  The log density of x is η'x - ½ x'Λx: each
position adds to Λ and η, and each turn changes them (`_behind_turn`).  E and β have one size, and are
eliminated for each hypothesis about tilts and warm-up.  Then b ~ N(0, s²) is, too, for each hypothesis and
size s.  What is left, η'z - ½ z'Λz, is the log density on the circle: a von Mises distribution where Λ is
isotropic, and a generalised one (Gatto and Jammalamadaka 2007) where one gyro is worse than the others.
`peaks` finds its maxima, and the heading is the mean of all by weight.

The sizes of errors are declared, or by a regression on the gyros' noise.  That of the bias is through four
gyros, °/√h and °/h: Honeywell HG9900 (0.002, 0.0035) and HG1700 (0.125, 1) by is4s.github.io/NavToolkit, iMAR
FSAS (0.1, 0.75) and Xsens MTi-G (3, 3600) by Mathematical Problems in Engineering 2013, 435286, table 6.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import i0e, i1e

from imumon.blocks import FloatArray, IntArray
from imumon.geodesy import DEG_PER_H, EARTH_RATE

from .fit import eliminate
from .parameters import AlignmentParameters
from .position import AzimuthError, PositionFit
from .report import ANY_ANGLE_SD

GYRO_BIAS, BIAS_POWER, LEAST_ARW = 2.0 * DEG_PER_H, 1.86, 0.02
"""Regression of the bias of a gyro: this, rad/s, times the ratio of its noise to 0.1 °/√h, 0.02 at least
(0.002 °/√h), to this power; at most the earth rate."""
GYRO_SCALE, ACCEL_BIAS, ERROR_POWER, MOST_ERROR = 3e-4, 7.5e-4, 1.4, 100.0
"""Scale factor and misalignment of a gyro, and bias of an accelerometer, g, of gyros with 0.1 °/√h at most;
of others they grow with this power of the ratio, up to 100 times."""
LOG_SIZES, LOG_SIZE_SD = np.linspace(-4.0, 4.0, 9), 1.5
"""Logarithms of the sizes of a bias over that of the regression, and their standard deviation; assumed."""
AXES = np.array(list(product([0.0, 1.0], repeat=3)))[1:]  # which gyros are worse, (7, 3)
WORSE = np.exp(np.concatenate([log_factor * AXES for log_factor in (2.0, 4.0, 6.0, 8.0, 10.0)]))
"""Factors by which one, two or all gyros are worse than that, (35, 3): up to 31 °/h for the best of them."""
P_WORSE, P_WORSE_THAN_DECLARED = 0.003, 0.001
"""Prior probabilities of any of these factors (assumed): over the regression, as rare as a normal value
beyond three sigmas, and over a declared bias.  Ablation: without them, errors are up to 40 sigma."""
DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
"""Where the search for peaks on the circle begins, rad: every half degree, as two may be close together."""
WAVES = np.stack([f(k * DIRECTIONS) for k in (1.0, 2.0) for f in (np.cos, np.sin)])
QUARTIC = 0.152  # an exponential of -δ⁴/24 has the integral of a Gaussian of the sharpness √0.152


class SensorErrors(NamedTuple):
    """Standard deviations of the errors of gyros and accelerometers."""

    sizes: FloatArray  # of the gyros' biases, rad/s, (s, 3)
    log_prior: FloatArray  # log probabilities of these, (s,)
    flicker: float  # of the part of the bias that is new in each position, rad/s
    scale: float  # of each element of E
    scale_declared: bool  # whether E changes the earth rate at rest
    accel_bias: float  # of β, g


def sensor_errors(arw: float, parameters: AlignmentParameters) -> SensorErrors:
    """Return the declared errors, and the regression on an angular random walk, rad/√s, for the others."""
    ratio = arw / (math.radians(0.1) / 60.0)
    bias = min(GYRO_BIAS * max(ratio, LEAST_ARW) ** BIAS_POWER, EARTH_RATE)
    alike, p_worse = bias * np.exp(LOG_SIZES), P_WORSE
    share = np.exp(-0.5 * (LOG_SIZES / LOG_SIZE_SD) ** 2)
    if parameters.gyro_bias_sd_deg_per_h is not None:
        declared = parameters.gyro_bias_sd_deg_per_h * DEG_PER_H
        alike, share = np.array([declared]), np.ones(1)
        bias, p_worse = max(bias, declared), P_WORSE_THAN_DECLARED
    poorer = min(max(ratio, 1.0) ** ERROR_POWER, MOST_ERROR)
    ppm, micro_g = parameters.gyro_scale_sd_ppm, parameters.accel_bias_sd_ug
    worse = np.full(len(WORSE), p_worse / len(WORSE))
    return SensorErrors(
        sizes=np.concatenate([np.tile(alike[:, None], (1, 3)), bias * WORSE]),
        log_prior=np.log(np.concatenate([(1.0 - p_worse) * share / share.sum(), worse])),
        flicker=(parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
        scale=GYRO_SCALE * poorer if ppm is None else ppm * 1e-6,
        scale_declared=ppm is not None,
        accel_bias=ACCEL_BIAS * poorer if micro_g is None else micro_g * 1e-6,
    )


class HeadingPosterior(NamedTuple):
    """Direction of north, counter-clockwise in the reference frame, rad, and its standard deviation."""

    north: float
    sd: float
    rate_sd: float  # what b, E and β may make in a horizontal gyro, sizes of b by their posterior, rad/s
    worse: float  # probability that gyros are `WORSE` than declared, or than the regression


def heading_posterior(
    fits: Sequence[PositionFit], about: float, latitude: float, errors: SensorErrors
) -> HeadingPosterior:
    """Return the heading at a latitude, rad, by the last position and the averaged fits of those before.

    `about` is the direction of north, rad, that multiplies E and β.
    """
    matrix, vector, log_density = _linear_model(fits, about, latitude, errors)
    of_e_and_beta = np.repeat([errors.scale, errors.accel_bias], [9, 3])
    matrix, vector, log_factor = eliminate(matrix, vector, of_e_and_beta)
    log_density = (log_density + log_factor)[:, None]
    matrix, vector, log_factor = eliminate(matrix[:, None], vector[:, None], errors.sizes)
    log_weight = (log_density + log_factor + errors.log_prior).ravel()
    index, angle, height, sharpness = peaks(matrix.reshape(-1, 2, 2), vector.reshape(-1, 2))
    # Each peak is a von Mises distribution with this concentration; mean direction of their mixture.
    log_mass = log_weight[index] + height + np.log(i0e(sharpness))
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    resultant = i1e(sharpness) / i0e(sharpness)
    north = float(np.angle(np.sum(mass * resultant * np.exp(1j * angle))))
    # Variance of the mixture: within a peak -2 ln R, as of a wrapped normal distribution with the same mean
    # resultant length R (Mardia and Jupp 2000, eq 2.3.11), and that of the peaks about the mean.
    within = np.minimum(-2.0 * np.log(np.maximum(resultant, 1e-9)), ANY_ANGLE_SD**2)
    off = np.remainder(angle - north + np.pi, 2.0 * np.pi) - np.pi
    size = index % len(errors.sizes)
    by_bias = math.sqrt(mass @ np.mean(errors.sizes**2, axis=1)[size])
    by_scale, by_lean = errors.scale * errors.scale_declared, errors.accel_bias * math.sin(latitude)
    return HeadingPosterior(
        north=north,
        sd=math.sqrt(mass @ (within + off**2)),
        rate_sd=math.hypot(by_bias, EARTH_RATE * math.hypot(by_scale, by_lean)),
        worse=float(mass @ (size >= len(errors.sizes) - len(WORSE))),
    )


def _linear_model(
    fits: Sequence[PositionFit], about: float, latitude: float, errors: SensorErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Λ and η of x given each hypothesis, (h, 17, 17) and (h, 17, 1), and its log weight."""
    north, vertical = np.array([math.cos(about), math.sin(about)]), EARTH_RATE * math.sin(latitude)
    matrix, vector = np.zeros((1, 17, 17)), np.zeros((1, 17, 1))
    # Fits before the last have one hypothesis, and so no weight.
    log_density, before = fits[-1].log_weight, fits[0].azimuth_error
    for fit in fits:
        matrix, vector = _behind_turn(matrix, vector, before, fit.azimuth_error, north)
        before, one = fit.azimuth_error, np.ones(len(fit.rate))
        # Less the vertical earth rate, which is known.
        observed = np.column_stack([fit.rate.real, fit.rate.imag, (fit.vertical - vertical) * one])
        variances = np.column_stack([fit.variance, fit.variance, fit.vertical_variance * one])
        weight = 1.0 / (variances + errors.flicker**2)
        design = _design(fit.attitude, north, latitude, errors.scale_declared)
        weighted = design.T * weight[:, None, :]
        matrix, vector = matrix + weighted @ design, vector + weighted @ observed[:, :, None]
        log_density = log_density - 0.5 * np.sum(weight * observed**2 - np.log(weight), axis=1)
    return matrix, vector, log_density


def _design(attitude: FloatArray, north: FloatArray, latitude: float, with_scale: bool) -> FloatArray:
    """Return the design matrix of (6), (3, 17), by C_p and the z that multiplies E and β, (2,)."""
    horizontal, vertical = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)
    earth = np.array([*(horizontal * north), vertical])
    by_scale = with_scale * np.kron(attitude, attitude.T @ earth)
    by_lean = np.outer([0.0, 0.0, 1.0], earth) - vertical * np.eye(3)  # ω × (u × v) = u (ω v) - v (ω u)
    return np.hstack([horizontal * np.eye(3, 2), attitude, by_scale, by_lean @ attitude])


def _behind_turn(
    matrix: FloatArray, vector: FloatArray, before: AzimuthError, behind: AzimuthError, north: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return Λ and η of x behind the turn (7) from those before it, in information form."""
    back = np.eye(17)  # x before the turn, by x after it; E is x[5:14]
    back[:2, 5:14] = np.outer([north[1], -north[0]], behind.by_scale - before.by_scale)
    matrix, vector = back.T @ matrix @ back, back.T @ vector
    gain = behind.variance_from(before) * matrix[..., :2]
    gain = gain @ np.linalg.inv(np.eye(2) + gain[..., :2, :])
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
    values = np.column_stack([p.real, p.imag, q.real, q.imag]) @ WAVES
    rises = values >= np.roll(values, 1, axis=1)
    found = rises & ~np.roll(rises, -1, axis=1)
    found[np.arange(len(values)), np.argmax(values, axis=1)] = True
    index, start = np.nonzero(found)
    angle = DIRECTIONS[start]
    for _ in range(4):  # Newton's steps converge quadratically
        first, second = p[index] * np.exp(-1j * angle), q[index] * np.exp(-2j * angle)
        slope, curvature = first.imag + 2.0 * second.imag, np.abs(first.real + 4.0 * second.real)
        angle = angle + np.clip(slope / np.maximum(curvature, 1e-30), -0.2, 0.2)
    first, second = (p[index] * np.exp(-1j * angle)).real, (q[index] * np.exp(-2j * angle)).real
    half = 0.5 * np.maximum(first + 4.0 * second, 0.0)
    sharpness = half + np.sqrt(half**2 + QUARTIC * np.maximum(-first - 16.0 * second, 0.0))
    return index, angle, first + second - 0.25 * (xx + yy)[index], sharpness
