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
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.account import ANY_ANGLE_SD
from imumon.estimation.alignment.creep import ALL_ALONG, RATES, Rest, mixture, probabilities
from imumon.estimation.alignment.fit import FINEST, PoseFit
from imumon.geodesy import EARTH_RATE

ROUNDS = 16
"""Newton's steps to a heading; after 8 tenths of a sigma may be left, where two are nearly as likely."""
CLOSE = 1e-6
"""The next step to a heading is the square of this."""
LIKELIEST = 24
"""Hypotheses that are looked at; the others have lost by far."""
FLAT = 1e-3
"""1/rad²: where two directions opposite each other are as likely, so much decides, which knows no heading."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What is seen of all poses, which is linear in the direction of north and in rates.

    Parameters
    ----------
    columns : array, (h, 3 p, 3)
        Their products with (1, cos a, sin a) are the residuals of a direction a of north, by each hypothesis.
    noise : array, (h, 3 p)
        Variances.
    by_rates : array, (3 p, k)
        What the biases change, and last one rate all along; this is the one that is taken first.
    sizes : sequence of array, (k,)
        Standard deviations of these rates that are thought of, which broadcast to (r, s).
    rate_log_prior : array, (r, 1)
        Of the sizes of the last.
    log_weight, settles : array, (h,)
        Of each hypothesis, and whether the unit settles by it, or tilts ever farther.
    """

    columns: FloatArray
    noise: FloatArray
    by_rates: FloatArray
    sizes: Sequence[FloatArray]
    rate_log_prior: FloatArray
    log_weight: FloatArray
    settles: FloatArray


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
    standing = _seen(fits, attitudes, turn_variances, place)
    # What turns do to the rates depends on where north is, of which the likeliest hypothesis tells enough.
    likeliest = replace(
        standing, columns=standing.columns[:1], noise=standing.noise[:1], log_weight=standing.log_weight[:1]
    )
    about = _weighed(likeliest, place).centre
    level = EARTH_RATE * math.cos(place.latitude)
    seen = _with_turns(standing, fits, level * cmath.exp(1j * about), place)
    found = _weighed(seen, place)
    angle, curvature, probability, centre = found.angle, found.curvature, found.probability, found.centre
    off = np.remainder(angle - centre + math.pi, 2.0 * math.pi) - math.pi
    variance = float(np.sum(probability * (1.0 / curvature + off**2)))
    turned = (place.level_sd * math.tan(place.latitude)) ** 2 if abs(place.latitude) < 1.5 else math.inf
    white = 1.0 / float(np.sum(1.0 / seen.noise[0, : len(fits)])) / level**2
    by_size = probability.sum(0)
    supposed = math.sqrt(float(by_size.sum(0) @ np.mean(place.bias_sds**2, axis=1)))
    left_over = max(float(np.vdot(by_size, 1.0 / curvature[0])) - white, 0.0)
    upright = _upward_bias(seen, probability)
    return Heading(
        centre,
        min(math.sqrt(variance + turned), ANY_ANGLE_SD),
        math.sqrt(left_over) * level,
        supposed,
        float(probability.sum((1, 2)) @ seen.settles),
        math.sqrt(white),
        Rest(EARTH_RATE * math.sin(place.latitude) + upright.rate, upright.variance),
    )


def _seen(
    fits: Sequence[PoseFit], attitudes: Sequence[FloatArray], turn_variances: FloatArray, place: Place
) -> Seen:
    """Return what is seen of poses that stand; parameters as those of `heading`."""
    poses, level = len(fits), EARTH_RATE * math.cos(place.latitude)
    log_weight, which, rests = _together(fits)
    values = np.stack([fit.mean[k] for fit, k in zip(fits, which, strict=True)], 1)  # (h, p)
    common = FINEST**2 + place.flicker**2
    spread = np.stack([fit.variance[k] for fit, k in zip(fits, which, strict=True)], 1)
    spread += common + level**2 * turn_variances
    settles = np.max([fit.settles[k] for fit, k in zip(fits, which, strict=True)], axis=0)
    rate = np.stack([fit.creep.rests.rate[k] for fit, k in zip(fits, rests, strict=True)], 1)
    vertical = np.stack([
        np.maximum(fit.creep.rests.variance[k], fit.vertical_variance)
        for fit, k in zip(fits, rests, strict=True)
    ], 1)  # fmt: skip
    by_bias = np.concatenate([np.stack([matrix[axis] for matrix in attitudes]) for axis in range(3)])
    of_bias = np.array([fit.creep.of_bias for fit in fits])[:, None]
    of_bias = of_bias * (by_bias[:poses] + 1j * by_bias[poses : 2 * poses])
    by_bias[: 2 * poses] = np.concatenate([of_bias.real, of_bias.imag])
    columns = np.zeros((len(values), 3 * poses, 3))
    upward = EARTH_RATE * math.sin(place.latitude)
    columns[..., 0] = np.concatenate([values.real, values.imag, rate - upward], 1)
    columns[:, :poses, 1] = columns[:, poses : 2 * poses, 2] = -level
    all_along = np.r_[np.zeros(2 * poses), np.ones(poses)]
    share = np.log(np.r_[1.0 - ALL_ALONG, np.full(len(RATES), ALL_ALONG / len(RATES))])
    return Seen(
        columns,
        np.concatenate([spread, spread, vertical + common], 1),
        np.column_stack([by_bias, all_along]),
        [*place.bias_sds.T, np.r_[0.0, RATES][:, None]],
        share[:, None],
        log_weight,
        settles,
    )


def _with_turns(seen: Seen, fits: Sequence[PoseFit], north: complex, place: Place) -> Seen:
    """Return what is seen of poses that turn beyond their `creep`.

    What each turns is what it takes for rest there less what rest is.  `north` is about the horizontal earth
    rate, rad/s.
    """
    level = slice(0, 2 * len(fits))
    later_s = np.triu(np.tile([fit.creep.before_s + fit.creep.after_s for fit in fits], (len(fits), 1)), 1)
    turned = 1j * north * (later_s + np.diag([fit.creep.after_s for fit in fits]))
    beyond = np.concatenate([turned.real, turned.imag])
    columns, by_rates = seen.columns.copy(), seen.by_rates.copy()
    at_rest = np.array([fit.creep.rest.rate for fit in fits]) - EARTH_RATE * math.sin(place.latitude)
    columns[:, level, 0] -= beyond @ at_rest
    by_rates[level, :-1] -= beyond @ by_rates[level.stop :, :-1]
    return replace(seen, columns=columns, by_rates=by_rates)


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Directions of north by each hypothesis and sizes of the rates, all (h, r, s), and their mean.

    Parameters
    ----------
    angle, curvature, probability : array
        rad; 1/rad²; a sum of 1.
    centre : float
        rad.
    """

    angle: FloatArray
    curvature: FloatArray
    probability: FloatArray
    centre: float


def _weighed(seen: Seen, place: Place) -> Weighed:
    """Return the direction by each hypothesis, and its probability."""
    forms, log_determinant = _without_bias(seen)
    prior = seen.log_weight[:, None, None] + seen.rate_log_prior + place.bias_log_prior
    angle, misfit, curvature = _closest(forms)
    logs = prior - 0.5 * (log_determinant + misfit + np.log(curvature))
    probability = probabilities(logs)
    return Weighed(angle, curvature, probability, float(np.angle(np.sum(probability * np.exp(1j * angle)))))


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


def _without_bias(seen: Seen) -> tuple[FloatArray, FloatArray]:
    """Return products of columns, weighted by noise and rates, (h, r, s, 3, 3), and the log determinant.

    The covariance is D + Σ sⱼ² aⱼ aⱼᵀ.  Each term is of rank one and changes the products by one, too
    (Sherman and Morrison): those with the a that are still to come among them, as in Gauss elimination.
    """
    noise = seen.noise
    every = np.concatenate(
        [seen.columns, np.broadcast_to(seen.by_rates, (*noise.shape, len(seen.sizes)))], axis=2
    )
    products = ((every / noise[..., None]).swapaxes(1, 2) @ every)[:, None, None]
    log_determinant = np.log(noise).sum(1)[:, None, None]
    for size in reversed(seen.sizes):
        of_rate, pivot = products[..., :-1, -1], 1.0 + size**2 * products[..., -1, -1]
        share = (size**2 / pivot)[..., None] * of_rate
        products = products[..., :-1, :-1] - share[..., :, None] * of_rate[..., None, :]
        log_determinant = log_determinant + np.log(pivot)
    return products, log_determinant


def _upward_bias(seen: Seen, probability: FloatArray) -> Rest:
    """Return the bias of the vertical gyro in the last pose: what it reads there, and the sizes, tell of it.

    The other poses do not: large sizes leave no digits in what all of them tell together.
    """
    own = sum(size**2 * share**2 for size, share in zip(seen.sizes[:-1], seen.by_rates[-1], strict=False))
    other = seen.noise[:, -1, None, None] + seen.sizes[-1] ** 2  # (h, r, 1)
    means = seen.columns[:, -1, 0, None, None] * own / (own + other)
    return mixture(probability, means, own * other / (own + other))


def _closest(forms: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where (1, cos a, sin a) makes each form least, (h, r, s): a, the form, and its curvature.

    Of all a: the least of a quadratic form on the circle, a trust region's (Moré and Sorensen 1983).  In the
    axes in which its quadratic part is diagonal, gap and zero, it is at -b / (gap + m, m), with the m > 0 for
    which this has length one; Newton's steps to it, of one over the length, come from below and only grow.
    """
    constant, by_cos, by_sin = forms[..., 0, 0], forms[..., 0, 1], forms[..., 0, 2]
    cos_cos, cos_sin, sin_sin = forms[..., 1, 1], forms[..., 1, 2], forms[..., 2, 2]
    half = 0.5 * (cos_cos - sin_sin)
    gap, axis = 2.0 * np.hypot(half, cos_sin), 0.5 * np.arctan2(cos_sin, half)
    c, s = np.cos(axis), np.sin(axis)
    b, d = by_cos * c + by_sin * s, by_sin * c - by_cos * s
    d = np.where(np.abs(d) > FLAT, d, np.copysign(FLAT, d))
    multiplier = _multiplier(gap.ravel(), b.ravel(), d.ravel()).reshape(b.shape)
    x, y = -b / (gap + multiplier), -d / multiplier
    angle = axis + np.arctan2(y, x)
    c, s = np.cos(angle), np.sin(angle)
    along, across = by_cos + cos_cos * c + cos_sin * s, by_sin + cos_sin * c + sin_sin * s
    curvature = gap * y * y + multiplier
    return angle, constant + (by_cos + along) * c + (by_sin + across) * s, curvature


def _multiplier(gap: FloatArray, b: FloatArray, d: FloatArray) -> FloatArray:
    """Return the m of each form in `_closest`, (n,)."""
    found = np.maximum(np.abs(d), np.abs(b) - gap)
    some = np.arange(len(found))
    for _ in range(ROUNDS):
        m = found[some]
        x, y = b / (gap + m), d / m
        square = x * x + y * y
        step = square * (np.sqrt(square) - 1.0) / (x * x / (gap + m) + y * y / m)
        found[some] = m + step
        left = step > CLOSE * m
        some, gap, b, d = some[left], gap[left], b[left], d[left]
    return found
