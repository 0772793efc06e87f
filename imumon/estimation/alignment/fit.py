"""The heading from the record: a weighted fit of each pose, and the posterior over what cannot be known.

In a pose the gyros see, in level axes that do not turn (complex: forward + i left),

    y = c' + dφ/dt + noise,   c' = c + b       (earth rate c, bias b)
    v = Ω sin L + b_up + noise                 (vertical)

and the accelerometers, as an angle, see φ + d + noise: the true tilt φ of the unit and the drift d of their
own bias while they warm up.  Their sum alone cannot be divided; the gyros see φ and not d.  So the hypotheses
are that the unit stands (φ = 0), or that it settles exponentially with some time constant, or tilts steadily,
from the start or since some time.  The size of the bias is unknown, too: what the vertical gyro shows beyond
Ω sin L, and the horizontal ones beyond the length Ω cos L, tell of it.  Heading and sigma are mean and
standard deviation over all of that, by the probability of each (Bayesian model averaging: Hoeting et al.,
Statistical Science 14(4), 1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.noise import fitted, lines
from imumon.geodesy import EARTH_RATE

TIME_CONSTANTS_S = np.geomspace(5.0, 600.0, 12)
"""Of a tripod that settles: so close that the gyros do not tell neighbours apart at 200 µrad."""
RAMP_S = 600.0
"""A steady tilt is told by its angle over this time."""
LATER = (0.25, 0.5, 0.75)
"""Shares of the time after which a steady tilt may have begun."""
TILTS = np.array([3e-5, 3e-4])
"""Standard deviations of the tilt, rad: of what tripods do, 30 to 300 µrad."""
PROBABILITY = 0.1
"""Prior probability that the unit tilts."""
WARM_UPS_S = np.array([30.0, 100.0, 300.0, 1000.0])
WARM_UP = 1e-4
"""Time constants of accelerometers, and the standard deviation of each part of the drift, in g."""
WALK = 1e-7
"""Random walk of an accelerometer, g/√s: 6 µg in an hour."""
LEVEL = 1e-3
"""Standard deviation of the mean level about its estimate, rad: wide, but not so wide as to cost digits."""
BLOCKS = 48
"""Averages to which the accelerometers' record is reduced."""
FINEST = 1e-10
"""rad/s, 2e-5 °/h: no mean of a gyro is better, whatever a record without noise says."""
BETTER = 2.0
"""A tapered mean is taken when its variance is less by this factor: with 12 degrees of freedom, white noise
lets that happen in 2 % of records."""
DISTINCT = 1e-9
"""A tilt that looks like the earth rate to this share leaves nothing to tell them apart."""
LEAST_CELLS = 12
"""Nothing is told from less."""


@dataclass(frozen=True, slots=True)
class PoseFit:
    """What one pose tells of its horizontal rate c', for each of the hypotheses.

    Parameters
    ----------
    log_evidence : array, (h,)
    mean : array of complex, (h,)
        rad/s, forward + i left.
    variance : array, (h,)
        Of each axis.
    vertical, vertical_variance : float
        Mean of the vertical gyro, rad/s.
    white : float
        Power spectral density of the noise of a horizontal gyro at frequency zero, (rad/s)²/Hz.
    seconds : float
        Time that counts.
    """

    log_evidence: FloatArray
    mean: ColumnArray
    variance: FloatArray
    vertical: float
    vertical_variance: float
    white: float
    seconds: float


def prior() -> FloatArray:
    """Return the logarithm of the prior probability of each hypothesis, (h,); the first: the unit stands."""
    kinds = len(TIME_CONSTANTS_S) + 1 + len(LATER)
    each = PROBABILITY / (kinds * len(TILTS))
    return np.asarray(np.log(np.r_[1.0 - PROBABILITY, np.full(kinds * len(TILTS), each)]))


def tilt_courses(time_s: FloatArray) -> FloatArray:
    """Return the course of each kind of tilt, per its angle, (n, kinds), since the pose began."""
    kinds = [-np.expm1(-time_s / tau) for tau in TIME_CONSTANTS_S]
    kinds.append(time_s / RAMP_S)
    kinds += [np.maximum(time_s - share * time_s[-1], 0.0) / RAMP_S for share in LATER]
    return np.column_stack(kinds)


def fit_pose(
    time_s: FloatArray, weight: FloatArray, rate: FloatArray, level: ColumnArray, drift_sd: float = WARM_UP
) -> PoseFit | None:
    """Fit a pose, or return None when there is too little.

    Parameters
    ----------
    time_s : array, (n,)
        Middles of the cells since the pose began.
    weight : array, (n,)
        Samples in each; zero where it does not count.
    rate : array, (n, 3)
        rad/s, forward, left, up.
    level : array of complex, (n,)
        Angle of the unit as the accelerometers see it, rad about forward + i left.
    drift_sd : float
        Standard deviation of each part of the drift of an accelerometer, in g.
    """
    valid = weight > 0.0
    if valid.sum() < LEAST_CELLS:
        return None
    root = np.sqrt(weight / np.median(weight[valid]))
    step = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    courses = tilt_courses(time_s)
    slopes = np.gradient(courses, time_s, axis=0)
    trend = np.column_stack([np.ones(len(time_s)), np.exp(-np.outer(time_s, 8.0 / time_s[-1] / [1.0, 4.0]))])
    horizontal = rate[:, 0] + 1j * rate[:, 1]
    waves = lines(_residual(trend, horizontal, root) * valid, time_s)
    removed = np.hstack([trend, waves])
    noise = fitted(_residual(removed, horizontal, root), valid, removed.shape[1])
    middle = np.average(horizontal, weights=weight)
    data = np.where(valid, horizontal - middle, 0.0)
    if not valid.all():
        part = waves @ np.linalg.lstsq(root[:, None] * waves, root * data, rcond=None)[0]
        data = part + noise.filled(data - part, valid)
    columns = np.column_stack([waves, np.ones(len(time_s)), slopes, data.real, data.imag])
    white = (root * valid)[:, None] * noise.white(columns)
    gram = _eliminated(white.T @ white, waves.shape[1])
    tapered = _tapered(np.column_stack([np.ones(len(time_s)), slopes, data.real, data.imag]))
    if tapered[0, 0] > BETTER * gram[0, 0]:
        gram = tapered
    evidence, mean, variance = _hypotheses(gram, *_accelerometers(level, weight, courses, drift_sd))
    above = np.average(rate[:, 2], weights=weight)
    upright = fitted(_residual(trend[:, :1], rate[:, 2], root), valid, 1)
    columns = np.column_stack([np.ones(len(time_s)), upright.filled(rate[:, 2] - above, valid)])
    seen = (root * valid)[:, None] * upright.white(columns)
    information, right = (seen.T @ seen)[0].tolist()
    counted = float(step * valid.sum())
    return PoseFit(
        evidence,
        middle + mean,
        variance,
        above + right / information,
        1.0 / information,
        float(variance[0]) * counted,
        counted,
    )


def _tapered(columns: FloatArray) -> FloatArray:
    """Return the products of columns under a Hann taper: one observation, as good as its neighbours say.

    What a resonance shaken by wind leaves at frequency zero is measured at the frequencies next to it, 2 to 4
    periods in the record.
    """
    n = len(columns)
    taper = np.hanning(n + 2)[1:-1]
    angle = 2.0 * math.pi * np.outer(np.arange(2, 5), np.arange(n)) / n
    data = (columns[:, -2] + 1j * columns[:, -1]) * taper
    beside = np.abs(np.stack([np.exp(1j * angle), np.exp(-1j * angle)]) @ data) ** 2
    degrees = 2 * beside.size
    variance = float(beside.sum()) / (degrees - 2) / taper.sum() ** 2
    observed = taper @ columns / taper.sum()
    return np.asarray(np.outer(observed, observed) / max(variance, FINEST**2))


def _eliminated(gram: FloatArray, count: int) -> FloatArray:
    """Return the products of columns that are left when the first ones are fitted to them (Schur)."""
    if not count:
        return gram
    rest = gram[count:, count:] - gram[count:, :count] @ np.linalg.solve(
        gram[:count, :count], gram[:count, count:]
    )
    return np.asarray(rest)


def _residual(trend: FloatArray, values: ColumnArray, root: FloatArray) -> ColumnArray:
    """Return what a slow trend leaves of values."""
    used = trend[:, :1] if len(values) < 4 * LEAST_CELLS else trend
    solution = np.linalg.lstsq(used * root[:, None], values * root, rcond=None)[0]
    return values - used @ solution


def _hypotheses(
    gram: FloatArray, information: FloatArray, seen: ColumnArray
) -> tuple[FloatArray, ColumnArray, FloatArray]:
    """Return log evidence, mean and variance of c' under each hypothesis, with the tilt's angle eliminated.

    Parameters
    ----------
    gram : array, (kinds + 3, kinds + 3)
        Scalar products of the whitened columns: 1, slope of each kind of tilt, data forward and left.
    information, seen : array, (kinds,)
        What the accelerometers tell of the tilt's angle, and that times its mean.
    """
    total, crossed = float(gram[0, 0]), gram[0, 1:-2]
    products = gram[:-2, -2] + 1j * gram[:-2, -1]
    right, right_tilt = products[0], products[1:] + seen
    own = np.maximum(np.diagonal(gram)[1:-2], 0.0) + information
    curvature = (own[:, None] + TILTS**-2.0).ravel()
    crossed, right_tilt = np.repeat(crossed, len(TILTS)), np.repeat(right_tilt, len(TILTS))
    left = np.maximum(total - crossed**2 / curvature, DISTINCT * total)
    mean = (right - crossed * right_tilt / curvature) / left
    # Two axes: every half of a logarithm counts twice.
    evidence = -np.log(curvature * np.tile(TILTS**2, len(own))) + 0.5 * np.abs(right_tilt) ** 2 / curvature
    standing = right / total
    return (
        np.r_[
            0.5 * np.abs(right) ** 2 / total - math.log(total),
            evidence + 0.5 * np.abs(mean) ** 2 * left - np.log(left),
        ],
        np.r_[standing, mean],
        np.r_[1.0 / total, 1.0 / left],
    )


def _accelerometers(
    level: ColumnArray, weight: FloatArray, courses: FloatArray, drift_sd: float
) -> tuple[FloatArray, ColumnArray]:
    """Return what the accelerometers tell of each tilt: information (kinds,), and that times the angle.

    Their drift is a sum of exponentials with unknown parts and a random walk; the level itself is unknown.
    """
    cells = max(len(level) // BLOCKS, 4)
    count = len(level) // cells
    if count < 4:
        return np.zeros(courses.shape[1]), np.zeros(courses.shape[1], complex)
    parts = (slice(0, count * cells),)
    w = weight[parts].reshape(count, cells)
    total = w.sum(1)
    kept = total > 0.0
    share = w[kept] / total[kept, None]
    values = (share * level[parts].reshape(count, cells)[kept]).sum(1)
    shape = np.einsum("bc,bck->bk", share, courses[parts].reshape(count, cells, -1)[kept])
    time = RAMP_S * shape[:, len(TIME_CONSTANTS_S)]
    steps = np.abs(np.diff(values)) ** 2
    noise = 0.5 * 0.5 * (float(np.median(steps)) / math.log(2.0) if len(steps) else 0.0)
    drifts = drift_sd * -np.expm1(-time[:, None] / WARM_UPS_S)
    covariance = LEVEL**2 + drifts @ drifts.T + WALK**2 * np.minimum.outer(time, time)
    covariance[np.diag_indices(len(time))] += noise + 1e-14
    weighted = np.linalg.solve(covariance, shape)
    return np.einsum("bk,bk->k", shape, weighted), weighted.T @ (values - values.mean())


@dataclass(frozen=True, slots=True)
class Place:
    """Where the unit is, and what its gyros may be wrong by.

    Parameters
    ----------
    latitude : float
        rad.
    bias_sds : array, (s,)
        Standard deviations of a gyro's bias that are thought of, rad/s.
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
        Direction of north in the frame of the first pose, rad from its forward to its left.
    sd : float
        rad.
    bias_sd : float
        Posterior root mean square of a horizontal gyro's bias that the poses do not cancel, rad/s.
    supposed_sd : float
        Posterior root mean square of the size of the bias, rad/s.
    tilting : float
        Probability that the unit tilts.
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
        Body axes to the frame of the first pose, level as in that pose.
    turn_variances : array, (p,)
        Of their angles about the vertical, rad².
    """
    poses, level = len(fits), EARTH_RATE * math.cos(place.latitude)
    values = np.stack([fit.mean for fit in fits], 1)  # (h, p)
    common = FINEST**2 + place.flicker**2
    spread = np.stack([fit.variance for fit in fits], 1) + common + level**2 * turn_variances
    seen = np.concatenate(
        [values.real, values.imag, np.tile([fit.vertical for fit in fits], (len(values), 1))], 1
    )
    vertical = np.array([fit.vertical_variance for fit in fits]) + common
    noise = np.concatenate([spread, spread, np.tile(vertical, (len(values), 1))], 1)
    by_bias = np.concatenate([np.stack([matrix[axis] for matrix in attitudes]) for axis in range(3)])
    upward = np.r_[np.zeros(2 * poses), np.full(poses, EARTH_RATE * math.sin(place.latitude))]
    by_north = np.zeros((3 * poses, 2))
    by_north[:poses, 0] = by_north[poses : 2 * poses, 1] = level
    covariance = place.bias_sds[:, None, None] ** 2 * (by_bias @ by_bias.T)
    whole = covariance[None] + noise[:, None, :, None] * np.eye(3 * poses)  # (h, s, 3p, 3p)
    inverse = np.linalg.inv(whole)
    log_weight = np.sum([fit.log_evidence for fit in fits], 0) + prior()
    start = math.atan2(*(float(x) for x in _first_guess(seen[0], noise[0], poses)))
    angle = np.full(whole.shape[:2], start)
    for _ in range(4):
        unit = np.stack([np.cos(angle), np.sin(angle)], -1)
        across = np.stack([-np.sin(angle), np.cos(angle)], -1)
        left = (seen - upward)[:, None] - unit @ by_north.T
        slope = across @ by_north.T
        weighted = np.einsum("hsij,hsj->hsi", inverse, slope)
        curvature = np.einsum("hsi,hsi->hs", weighted, slope)
        angle = angle + np.clip(np.einsum("hsi,hsi->hs", weighted, left) / curvature, -0.5, 0.5)
    misfit = np.einsum("hsi,hsij,hsj->hs", left, inverse, left)
    logs = log_weight[:, None] + place.bias_log_prior - 0.5 * misfit
    logs -= 0.5 * np.linalg.slogdet(whole)[1] + 0.5 * np.log(curvature)
    probability = np.exp(logs - logs.max())
    probability /= probability.sum()
    centre = float(np.angle(np.sum(probability * np.exp(1j * angle))))
    off = np.remainder(angle - centre + math.pi, 2.0 * math.pi) - math.pi
    variance = float(np.sum(probability * (1.0 / curvature + off**2)))
    turned = (place.level_sd * math.tan(place.latitude)) ** 2 if abs(place.latitude) < 1.5 else math.inf
    white = 1.0 / float(np.sum(1.0 / spread[0])) / level**2
    by_size = probability.sum(0)
    supposed = math.sqrt(float(by_size @ place.bias_sds**2))
    left_over = max(float(by_size @ (1.0 / curvature[0])) - white, 0.0)
    return Heading(
        centre,
        min(math.sqrt(variance + turned), math.pi / math.sqrt(3.0)),
        math.sqrt(left_over) * level,
        supposed,
        1.0 - float(probability[0].sum()),
        math.sqrt(white),
    )


def _first_guess(seen: FloatArray, noise: FloatArray, poses: int) -> tuple[float, float]:
    """Return left and forward part of the mean of the poses."""
    weight = 1.0 / noise[:poses]
    return float(weight @ seen[poses : 2 * poses]), float(weight @ seen[:poses])
