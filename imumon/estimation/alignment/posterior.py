"""The heading from all poses: mean and standard deviation over what cannot be known.

The hypotheses of `fit` are weighed by their probability, and so is the size of the gyros' bias: what the
vertical gyro shows beyond Ω sin L, and the horizontal ones beyond the length Ω cos L, tell of it.  A turn
about the vertical that has gone on all the time adds to the vertical rate as a bias does, and it has turned
the unit away from where each pose saw north.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.account import ANY_ANGLE_SD
from imumon.estimation.alignment.creep import ALL_ALONG, RATES, Rest
from imumon.estimation.alignment.fit import FINEST, PoseFit
from imumon.geodesy import EARTH_RATE

PASSES = 2
"""The first tells about where north is, which the second needs where a pose has turned."""
STARTS, ROUNDS = np.arange(16) * math.pi / 8.0, 4
"""Directions tried, rad, and Gauss-Newton steps from the best to the heading."""
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
    rest : Rest
        What the vertical gyro reads at rest in the last pose.
    """

    north: float
    sd: float
    bias_sd: float
    supposed_sd: float
    tilting: float
    noise_sd: float
    rest: Rest


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
    log_weight, which, rests = _together(fits)
    values = np.stack([fit.mean[k] for fit, k in zip(fits, which, strict=True)], 1)  # (h, p)
    common = FINEST**2 + place.flicker**2
    spread = np.stack([fit.variance[k] for fit, k in zip(fits, which, strict=True)], 1)
    spread += common + level**2 * turn_variances
    settles = np.max([fit.settles[k] for fit, k in zip(fits, which, strict=True)], axis=0)
    at_rest = np.array([fit.creep.rest.rate for fit in fits])
    rate = np.stack([fit.creep.rests.rate[k] for fit, k in zip(fits, rests, strict=True)], 1)
    vertical = np.stack([
        np.maximum(fit.creep.rests.variance[k], fit.vertical_variance)
        for fit, k in zip(fits, rests, strict=True)
    ], 1)  # fmt: skip
    seen = np.concatenate([values.real, values.imag, rate], 1)
    noise = np.concatenate([spread, spread, vertical + common], 1)
    by_bias = np.concatenate([np.stack([matrix[axis] for matrix in attitudes]) for axis in range(3)])
    upward = np.r_[np.zeros(2 * poses), np.full(poses, EARTH_RATE * math.sin(place.latitude))]
    by_north = np.zeros((3 * poses, 2))
    by_north[:poses, 0] = by_north[poses : 2 * poses, 1] = level
    of_bias = np.array([fit.creep.of_bias for fit in fits])[:, None]
    of_bias = of_bias * (by_bias[:poses] + 1j * by_bias[poses : 2 * poses])
    by_bias[: 2 * poses] = np.concatenate([of_bias.real, of_bias.imag])
    all_along = np.r_[np.zeros(2 * poses), np.ones(poses)]
    sizes, size_log_prior = _sizes(place)
    north = 0j
    for _ in range(PASSES):
        # What a pose turned beyond its `creep` is what it takes for rest there less what rest is.
        beyond = _beyond(fits, north)
        offered = np.zeros((*seen.shape, 3))
        offered[..., 0], offered[..., 1:] = seen - upward, -by_north
        offered[..., : 2 * poses, 0] -= beyond @ (at_rest - upward[2 * poses :])
        by_error = np.column_stack([by_bias, all_along])
        by_error[: 2 * poses, :3] -= beyond @ by_bias[2 * poses :]
        forms, log_determinant = _without_bias(offered, noise, by_error, sizes)
        logs = log_weight[:, None] + size_log_prior - 0.5 * log_determinant
        angle, misfit, curvature = _closest(forms, cmath.phase(north) if north else _likeliest(forms, logs))
        logs -= 0.5 * misfit + 0.5 * np.log(curvature)
        probability = np.exp(logs - logs.max())
        probability /= probability.sum()
        centre = float(np.angle(np.sum(probability * np.exp(1j * angle))))
        north = level * cmath.exp(1j * centre)
    off = np.remainder(angle - centre + math.pi, 2.0 * math.pi) - math.pi
    variance = float(np.sum(probability * (1.0 / curvature + off**2)))
    turned = (place.level_sd * math.tan(place.latitude)) ** 2 if abs(place.latitude) < 1.5 else math.inf
    white = 1.0 / float(np.sum(1.0 / spread[0])) / level**2
    by_size = probability.sum(0)
    # Of the last pose alone: large sizes leave no digits in a bias by all of them.
    own, other = sizes[:, :3] ** 2 @ by_bias[-1] ** 2, noise[:, -1:] + sizes[:, 3] ** 2
    means = (seen[:, -1:] - upward[-1]) * own / (own + other)
    upright = float(np.sum(probability * means))
    uncertain = float(np.sum(probability * (own * other / (own + other) + (means - upright) ** 2)))
    supposed = math.sqrt(float(by_size @ np.mean(sizes[:, :3] ** 2, axis=1)))
    left_over = max(float(by_size @ (1.0 / curvature[0])) - white, 0.0)
    return Heading(
        centre,
        min(math.sqrt(variance + turned), ANY_ANGLE_SD),
        math.sqrt(left_over) * level,
        supposed,
        float(probability.sum(1) @ settles),
        math.sqrt(white),
        Rest(upward[-1] + upright, uncertain),
    )


def _beyond(fits: Sequence[PoseFit], north: complex) -> FloatArray:
    """Return how horizontal rates depend on those by which the poses turn beyond their `creep`, (2 p, p).

    `north` is about the horizontal earth rate, rad/s.
    """
    later_s = np.triu(np.tile([fit.creep.before_s + fit.creep.after_s for fit in fits], (len(fits), 1)), 1)
    turned = 1j * north * (later_s + np.diag([fit.creep.after_s for fit in fits]))
    return np.concatenate([turned.real, turned.imag])


def _sizes(place: Place) -> tuple[FloatArray, FloatArray]:
    """Return standard deviations that are thought of, (s, 4), and logarithms of their probabilities, (s,).

    They are those of the biases, and of a rate all along that looks like one of the vertical gyro, rad/s.
    """
    share = np.log(np.r_[1.0 - ALL_ALONG, np.full(len(RATES), ALL_ALONG / len(RATES))])
    rates = np.repeat(np.r_[0.0, RATES], len(place.bias_sds))
    sizes = np.column_stack([np.tile(place.bias_sds, (len(share), 1)), rates])
    return sizes, (share[:, None] + place.bias_log_prior).ravel()


def _together(fits: Sequence[PoseFit]) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the likeliest hypotheses of all poses: log weight (h,), and which of tilt and creep, (p, h)."""
    weight, log_weight = np.zeros(1), np.zeros(1)  # the first with what is usual, which is not known twice
    which = np.zeros((2, 0, 1), np.int64)
    for fit in fits:
        rests = fit.creep.rests
        own = np.argsort(-fit.log_weight)[:LIKELIEST]
        pairs = np.stack(np.meshgrid(own, np.arange(len(rests.rate)), indexing="ij")).reshape(2, 1, -1)
        more = (fit.log_weight[pairs[0]] + rests.log_weight[pairs[1]]).ravel()
        log_weight = (log_weight[:, None] + more).ravel()
        weight = (weight[:, None] + more + fit.creep.log_usual[pairs[1]]).ravel()
        which = np.concatenate(
            [np.repeat(which, pairs.shape[2], axis=2), np.tile(pairs, which.shape[2])], axis=1
        )
        best = np.argsort(-weight)[:LIKELIEST]
        weight, log_weight, which = weight[best], log_weight[best], which[..., best]
    return log_weight, which[0], which[1]


def _without_bias(
    columns: FloatArray, noise: FloatArray, by_bias: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return products of columns, weighted by noise and biases of each size, and that log determinant.

    The covariance is D + A S² Aᵀ; its inverse is of rank k beside that of D (Woodbury).

    Parameters
    ----------
    columns : array, (h, n, 3)
    noise : array, (h, n)
        Diagonal of D.
    by_bias : array, (n, k)
        A.
    sizes : array, (s, k)
        Diagonals of S.

    Returns
    -------
    array, (h, s, 3, 3), and array, (h, s)
    """
    weighted = columns / noise[..., None]
    own = weighted.transpose(0, 2, 1) @ columns
    known = (by_bias.T[None] / noise[:, None]) @ by_bias
    shared = sizes[:, :, None] * (by_bias.T @ weighted)[:, None]  # (h, s, k, 3)
    grown = np.eye(sizes.shape[1]) + sizes[:, :, None] * known[:, None] * sizes[:, None, :]
    forms = own[:, None] - shared.swapaxes(-1, -2) @ np.linalg.solve(grown, shared)
    return forms, np.log(np.linalg.det(grown)) + np.log(noise).sum(1)[:, None]


def _likeliest(forms: FloatArray, logs: FloatArray) -> float:
    """Return the likeliest of the directions tried, rad; forms as of `_closest`, their weights (h, s)."""
    around = np.stack([np.ones(len(STARTS)), np.cos(STARTS), np.sin(STARTS)])
    misfit = np.einsum("ik,hsij,jk->hsk", around, forms, around, optimize=True)
    return float(STARTS[np.argmax(np.max(logs[..., None] - 0.5 * misfit, axis=(0, 1)))])


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
