"""The heading from all poses: mean and standard deviation over what cannot be known.

The hypotheses of `fit` are weighed by their probability, and so is the size of the gyros' bias: what the
vertical gyro shows beyond Ω sin L, and the horizontal ones beyond the length Ω cos L, tell of it.  A turn
about the vertical that has gone on all the time adds to the vertical rate as a bias does, and it has turned
the unit away from where each pose saw north.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.account import ANY_ANGLE_SD
from imumon.estimation.alignment.creep import ALL_ALONG, RATES
from imumon.estimation.alignment.fit import FINEST, PoseFit
from imumon.geodesy import EARTH_RATE

ROUNDS = 4
"""Gauss-Newton steps to the heading."""
LIKELIEST = 24
"""Hypotheses that are looked at; the others have lost by far."""
FLAT = 1e-3
"""1/rad²: what is flatter knows no heading, and rounding may have made it so."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the unit is, and what its gyros may be wrong by.

    Parameters
    ----------
    latitude : float
        rad.
    bias_sds : array, (s, 3)
        Standard deviations of the gyros' biases that are thought of, body axes, rad/s.
    bias_log_prior : array, (s,)
    flicker : float
        Standard deviation by which a bias changes from pose to pose, rad/s.
    level_sd : float
        Standard deviation of an accelerometer's bias, in g.
    """

    latitude: float
    bias_sds: FloatArray
    bias_log_prior: FloatArray
    flicker: float
    level_sd: float


@dataclass(frozen=True, slots=True)
class Heading:
    """The posterior.

    Parameters
    ----------
    north : float
        Direction of north at the end of the last pose, in the frame of the attitudes, rad from its forward to
        its left.
    sd : float
        rad.
    bias_sd : float
        Posterior root mean square of a horizontal gyro's bias that the poses do not cancel, rad/s.
    supposed_sd : float
        Posterior root mean square of the size of the bias, rad/s.
    tilting : float
        Probability that the unit settles, or tilts ever farther.
    noise_sd : float
        What white noise alone leaves, rad.
    """

    north: float
    sd: float
    bias_sd: float
    supposed_sd: float
    tilting: float
    noise_sd: float


def heading(
    fits: Sequence[PoseFit], attitudes: Sequence[FloatArray], turn_variances: FloatArray, place: Place
) -> Heading:
    """Return the direction of north.

    Parameters
    ----------
    fits : sequence of PoseFit, (p,)
    attitudes : sequence of array (3, 3)
        Body axes in the middle of each pose to a level frame, that of the means of the fits.
    turn_variances : array, (p,)
        Of their angles about the vertical, rad².
    """
    poses, level = len(fits), EARTH_RATE * math.cos(place.latitude)
    log_weight, which = _together(fits)
    values = np.stack([fit.mean[k] for fit, k in zip(fits, which, strict=True)], 1)  # (h, p)
    common = FINEST**2 + place.flicker**2
    spread = np.stack([fit.variance[k] for fit, k in zip(fits, which, strict=True)], 1)
    spread += common + level**2 * turn_variances
    settles = np.max([fit.settles[k] for fit, k in zip(fits, which, strict=True)], axis=0)
    seen = np.concatenate(
        [values.real, values.imag, np.tile([fit.creep.rest.rate for fit in fits], (len(values), 1))], 1
    )
    vertical = np.array([fit.vertical_variance for fit in fits]) + common
    noise = np.concatenate([spread, spread, np.tile(vertical, (len(values), 1))], 1)
    by_bias = np.concatenate([np.stack([matrix[axis] for matrix in attitudes]) for axis in range(3)])
    upward = np.r_[np.zeros(2 * poses), np.full(poses, EARTH_RATE * math.sin(place.latitude))]
    by_north = np.zeros((3 * poses, 2))
    by_north[:poses, 0] = by_north[poses : 2 * poses, 1] = level
    offered = np.zeros((*seen.shape, 3))
    offered[..., 0], offered[..., 1:] = seen - upward, -by_north
    start = math.atan2(*(float(x) for x in _first_guess(seen[0], noise[0], poses)))
    by_creep, rates, rate_log_prior = _creeping(fits, level * np.exp(1j * start))
    sizes = [*place.bias_sds.T, rates, np.ones(1)]
    forms, log_determinant = _without_bias(offered, noise, np.hstack([by_bias, by_creep]), sizes)
    angle, misfit, curvature = _closest(forms, start)
    logs = log_weight[:, None, None] + rate_log_prior + place.bias_log_prior - 0.5 * misfit  # (h, r, s)
    logs -= 0.5 * log_determinant + 0.5 * np.log(curvature)
    probability = np.exp(logs - logs.max())
    probability /= probability.sum()
    centre = float(np.angle(np.sum(probability * np.exp(1j * angle))))
    off = np.remainder(angle - centre + math.pi, 2.0 * math.pi) - math.pi
    variance = float(np.sum(probability * (1.0 / curvature + off**2)))
    turned = (place.level_sd * math.tan(place.latitude)) ** 2 if abs(place.latitude) < 1.5 else math.inf
    white = 1.0 / float(np.sum(1.0 / spread[0])) / level**2
    by_size = probability.sum(0)
    supposed = math.sqrt(float(by_size.sum(0) @ np.mean(place.bias_sds**2, axis=1)))
    left_over = max(float(np.vdot(by_size, 1.0 / curvature[0])) - white, 0.0)
    return Heading(
        centre,
        min(math.sqrt(variance + turned), ANY_ANGLE_SD),
        math.sqrt(left_over) * level,
        supposed,
        float(probability.sum((1, 2)) @ settles),
        math.sqrt(white),
    )


def _creeping(fits: Sequence[PoseFit], north: complex) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how what is seen depends on the rate by which each pose turns more than its `creep` says.

    Parameters
    ----------
    north : complex
        About the horizontal earth rate, rad/s.

    Returns
    -------
    array, (3 p, 2)
        On one rate all along, and on what `creep` leaves unknown of all poses, over its standard deviation.
    array, (r, 1)
        Standard deviations of that rate, rad/s, that are thought of: no rate, or turns.
    array, (r, 1)
        Logarithms of their prior probabilities.
    """
    later_s = np.triu(np.tile([fit.creep.before_s + fit.creep.after_s for fit in fits], (len(fits), 1)), 1)
    turned = 1j * north * (later_s + np.diag([fit.creep.after_s for fit in fits]))
    # The noise of the mean is that of the vertical rate already; a turn by it is nothing beside its heading.
    own = np.sqrt([max(fit.creep.rest.variance - fit.vertical_variance, 0.0) for fit in fits])
    prior = np.log(np.r_[1.0 - ALL_ALONG, np.full(len(RATES), ALL_ALONG / len(RATES))])
    each = np.concatenate([turned.real, turned.imag, np.eye(len(fits))])
    return np.column_stack([each.sum(1), each @ own]), np.r_[0.0, RATES][:, None], prior[:, None]


def _together(fits: Sequence[PoseFit]) -> tuple[FloatArray, IntArray]:
    """Return the likeliest hypotheses of all poses: log weight (h,), and which of each pose (p, h)."""
    log_weight, which = np.zeros(1), np.zeros((0, 1), np.int64)
    for fit in fits:
        own = np.argsort(-fit.log_weight)[:LIKELIEST]
        log_weight = (log_weight[:, None] + fit.log_weight[own]).ravel()
        which = np.vstack([np.repeat(which, len(own), axis=1), np.tile(own, which.shape[1])])
        best = np.argsort(-log_weight)[:LIKELIEST]
        log_weight, which = log_weight[best], which[:, best]
    return log_weight, which


def _without_bias(
    columns: FloatArray, noise: FloatArray, by_bias: FloatArray, sizes: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return products of columns, weighted by noise and biases of each size, and that log determinant.

    The covariance is D + Σ sⱼ² aⱼ aⱼᵀ.  Each term is of rank one and changes the products by one, too
    (Sherman and Morrison): those with the a that are still to come among them, as in Gauss elimination.

    Parameters
    ----------
    columns : array, (h, n, 3)
    noise : array, (h, n)
        Diagonal of D.
    by_bias : array, (n, k)
        The a, of which the last is taken first.
    sizes : sequence of array, (k,)
        The s, that broadcast to (r, s).

    Returns
    -------
    array, (h, r, s, 3, 3), and array, (h, r, s)
    """
    every = np.concatenate([columns, np.broadcast_to(by_bias, (*noise.shape, len(sizes)))], axis=2)
    products = ((every / noise[..., None]).swapaxes(1, 2) @ every)[:, None, None]
    log_determinant = np.log(noise).sum(1)[:, None, None]
    for size in reversed(sizes):
        of_bias, pivot = products[..., :-1, -1], 1.0 + size**2 * products[..., -1, -1]
        share = (size**2 / pivot)[..., None] * of_bias
        products = products[..., :-1, :-1] - share[..., :, None] * of_bias[..., None, :]
        log_determinant = log_determinant + np.log(pivot)
    return products, log_determinant


def _closest(forms: FloatArray, start: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where (1, cos a, sin a) makes each form least, (h, s): a, the form, and its curvature."""
    constant, by_cos, by_sin = forms[..., 0, 0], forms[..., 0, 1], forms[..., 0, 2]
    cos_cos, cos_sin, sin_sin = forms[..., 1, 1], forms[..., 1, 2], forms[..., 2, 2]
    angle = np.full(constant.shape, start)
    for _ in range(ROUNDS):
        c, s = np.cos(angle), np.sin(angle)
        along, across = by_cos + cos_cos * c + cos_sin * s, by_sin + cos_sin * c + sin_sin * s
        curvature = np.maximum(cos_cos * s**2 - 2.0 * cos_sin * s * c + sin_sin * c**2, FLAT)
        angle = angle + np.clip((s * along - c * across) / curvature, -0.5, 0.5)
    return angle, constant + (by_cos + along) * c + (by_sin + across) * s, curvature


def _first_guess(seen: FloatArray, noise: FloatArray, poses: int) -> tuple[float, float]:
    """Return left and forward part of the mean of the poses."""
    weight = 1.0 / noise[:poses]
    return float(weight @ seen[poses : 2 * poses]), float(weight @ seen[:poses])
