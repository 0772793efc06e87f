"""How a unit may tilt in a pose, and what each possibility says of the rate it would see if it stood still.

Gyros see the rate of the tilt, dφ/dt, on top of c'; accelerometers see φ itself beside their own drift.  A
hypothesis is a set of courses of which φ is the sum, with coefficients of some standard deviation:

    the unit stands                              φ = 0
    a tripod settles, or tilts ever farther      three neighbours of eight exponentials, or two ramps
    it sways slowly, in a narrow band            sine and cosine at four neighbouring frequencies
    it sways slowly, at no certain frequency     the same over the whole of the band
    it settles and sways                         two of these together

All that is faster is left to the windows.  A sway that takes as long as the record cannot be told from the
earth rate by its shape, only by the accelerometers; these see it truly only if the unit turns rather than
swings to and fro.  So every sway is thought of twice: seen by the accelerometers, and not.  The size of the
noise is not known either.  All coefficients have Gaussian priors, so c' under each hypothesis is Gaussian in
closed form (Bayesian linear regression), and the evidence of each is, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray

TIME_CONSTANTS_S = np.geomspace(5.0, 640.0, 8)
"""Of a tripod that settles.  Three neighbours together follow any time constant between them."""
RAMP_S = 640.0
"""A steady tilt is told by its angle over this time."""
LATER = (0.25, 0.5, 0.75)
"""Shares of the time after which a steady tilt may have begun."""
_STEADY = len(TIME_CONSTANTS_S)
_SWAYS = _STEADY + 1 + len(LATER)
CYCLES = 0.25 * np.arange(1.0, 25.0)
"""Periods in the record of the sways: four neighbours together follow all between them to some percent."""
SIZES = np.array([1e-5, 1e-4, 1e-3])
"""Standard deviations of the tilt, rad: tripods and buildings do from a few µrad to some mrad."""
NOISES = 2.0 ** np.arange(-6.0, 3.0)
"""Variances of the noise that are thought of, over the one its scatter shows."""
SETTLING, SWAYING = 0.1, 0.1
"""Prior probabilities.  With more, a clean warm-up settles later than after a minute; with less, errors
exceed their sigma more often (`scripts/reproduce/alignment`, `alignment_site`)."""
DISTINCT = 1e-9
"""A tilt that looks like the earth rate to this share leaves nothing to tell them apart."""


def _sway_columns(nodes: IntArray) -> IntArray:
    """Return the courses of the sways at nodes, (k, m): sine and cosine, (k, 2 m)."""
    return np.concatenate([_SWAYS + 2 * nodes, _SWAYS + 2 * nodes + 1], axis=1)


_TRIPLES = np.array(
    [(k, k + 1, k + 2) for k in range(_STEADY - 2)]
    + [(_STEADY - 1, _STEADY, _STEADY + 1 + k) for k in range(len(LATER))]
)
_BANDS = _sway_columns(np.arange(0, len(CYCLES) - 3, 2)[:, None] + np.arange(4))
_WHOLE = _sway_columns(np.arange(1, len(CYCLES), 2)[None])
_OF_ONE = SIZES[:, None] ** -2.0


@dataclass(frozen=True, slots=True)
class Family:
    """Hypotheses of the same rank.

    Parameters
    ----------
    columns : array, (k, r)
        Their courses.
    precision : array, (s, r)
        One over the variance of each angle, for each size.
    seen : bool
        Whether the accelerometers see the tilt.
    share : float
        Prior probability of all of them.
    """

    columns: IntArray
    precision: FloatArray
    seen: bool
    share: float

    def beside(self, other: Family, which: int, share: float) -> Family:
        """Return these, each together with one of another family, that has the index `which`."""
        k, size = divmod(which, len(other.precision))
        columns, precision = other.columns[k], other.precision[size]
        return Family(
            np.concatenate([self.columns, np.tile(columns, (len(self.columns), 1))], axis=1),
            np.concatenate([self.precision, np.tile(precision, (len(self.precision), 1))], axis=1),
            self.seen,
            share,
        )


def _sways(columns: IntArray, seen: bool) -> Family:
    """Return sways whose sines share their variance."""
    rank = columns.shape[1]
    return Family(columns, np.tile(0.5 * rank * _OF_ONE, (1, rank)), seen, 0.25 * SWAYING)


SETTLES = Family(_TRIPLES, np.tile(_OF_ONE, (1, 3)), True, SETTLING)
SWAYS = _sways(_BANDS, True)
OTHERS = (_sways(_BANDS, False), _sways(_WHOLE, True), _sways(_WHOLE, False))


def courses(time_s: FloatArray) -> FloatArray:
    """Return the course of each kind of tilt, per its angle, (n, kinds), since the pose began."""
    kinds = [-np.expm1(-time_s / tau) for tau in TIME_CONSTANTS_S]
    kinds.append(time_s / RAMP_S)
    kinds += [np.maximum(time_s - share * time_s[-1], 0.0) / RAMP_S for share in LATER]
    phase = 2.0 * math.pi * np.outer((time_s - time_s[0]) / (time_s[-1] - time_s[0]), CYCLES)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time_s), -1)
    return np.concatenate([np.column_stack(kinds), waves], axis=1)


@dataclass(frozen=True, slots=True)
class Seen:
    """What a pose shows.

    Parameters
    ----------
    gram : array, (kinds + 3, kinds + 3)
        Scalar products of the columns over white noise of one: 1, slope of each course, data forward and left.
    rows : float
        Observations in them.
    noise : float
        Variance of the noise, by its scatter.
    information, level : array, (kinds, kinds), and (kinds,) complex
        What the accelerometers tell of the angles, and that times their means.
    """

    gram: FloatArray
    rows: float
    noise: float
    information: FloatArray
    level: ColumnArray


@dataclass(frozen=True, slots=True)
class Told:
    """What each hypothesis says: its log probability, mean of c', variance of that, and of the noise; (h,)."""

    log_weight: FloatArray
    mean: ColumnArray
    variance: FloatArray
    noise: FloatArray
    settles: FloatArray


def told(seen: Seen) -> Told:
    """Return what each hypothesis says of c'.

    A unit may settle and sway: what settles is tried beside the likeliest sway, and what sways beside the
    likeliest way to settle.
    """
    noise = seen.noise * NOISES
    total = float(seen.gram[0, 0]) / noise
    right = complex(seen.gram[0, -2], seen.gram[0, -1]) / noise
    stands = _over_noises(
        seen, math.log(1.0 - SETTLING - SWAYING), np.zeros(1),
        np.broadcast_to(total, (1, len(noise))), right / total, 0.0,
    )  # fmt: skip
    settles, sways = _family(seen, SETTLES, 1.0), _family(seen, SWAYS, 0.0)
    parts = [stands, settles, sways, *[_family(seen, family, 0.0) for family in OTHERS]]
    both = 0.5 * SETTLING * SWAYS.share
    sway, settle = int(np.argmax(sways.log_weight)), int(np.argmax(settles.log_weight))
    parts.append(_family(seen, SETTLES.beside(SWAYS, sway, both), 1.0))
    parts.append(_family(seen, SWAYS.beside(SETTLES, settle, both), 1.0))
    return Told(*(np.concatenate([getattr(part, name) for part in parts]) for name in Told.__slots__))


def _family(seen: Seen, family: Family, settles: float) -> Told:
    """Return what the hypotheses of a family say; sizes vary fastest."""
    gram, noise, columns, own = seen.gram, seen.noise * NOISES[:, None], family.columns, family.precision
    ones, data = gram[0, 1:-2][columns], (gram[1:-2, -2] + 1j * gram[1:-2, -1])[columns]
    slopes = gram[1:-2, 1:-2][columns[:, :, None], columns[:, None, :]]
    known = seen.information[columns[:, :, None], columns[:, None, :]][:, None]
    level = seen.level[columns][:, None, :, None]
    both = known + own[:, :, None] * np.eye(columns.shape[1])
    log_prior = np.log(own).sum(1) + math.log(family.share / (len(columns) * len(own)))
    if family.seen:
        lower = np.linalg.cholesky(both)
        log_prior = log_prior - 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1)
        root = np.linalg.inv(lower)
        values, vectors = np.linalg.eigh(root @ slopes[:, None] @ root.swapaxes(-1, -2))
        turn = vectors.swapaxes(-1, -2) @ root
        w = (turn @ level)[..., None, :, 0]
    else:
        # The sines of a sway share their variance: all sizes have the same axes.
        explained = np.sum(level.conj() * np.linalg.solve(both, level), axis=(-2, -1)).real
        log_prior = log_prior + 0.5 * explained - np.linalg.slogdet(both)[1]
        values, vectors = np.linalg.eigh(slopes)
        values = values[:, None] / own
        turn = vectors.swapaxes(-1, -2)[:, None] / np.sqrt(own)[:, :, None]
        w = np.zeros(1)
    p, q = (turn @ ones[:, None, :, None])[..., None, :, 0], (turn @ data[:, None, :, None])[..., None, :, 0]
    loss = 1.0 / (1.0 + np.maximum(values, 0.0)[..., None, :] / noise)  # (k, s, noises, r)
    pulled = q / noise + w
    total = gram[0, 0] / noise[:, 0]
    left = np.maximum(total - np.sum(p**2 * loss, axis=-1) / noise[:, 0] ** 2, DISTINCT * total)
    right = complex(gram[0, -2], gram[0, -1]) / noise[:, 0]
    mean = (right - np.sum(p * loss * pulled, axis=-1) / noise[:, 0]) / left
    # Two axes: every half of a logarithm counts twice.
    evidence = 0.5 * np.sum(loss * (pulled.real**2 + pulled.imag**2), axis=-1) + np.log(loss.prod(-1))
    count = len(NOISES)
    shaped = (part.reshape(-1, count) for part in (evidence, left, mean))
    return _over_noises(seen, np.broadcast_to(log_prior, evidence.shape[:2]).ravel()[:, None], *shaped, settles)


def _over_noises(
    seen: Seen, log_prior: FloatArray | float, evidence: FloatArray, left: FloatArray, mean: ColumnArray, settles: float
) -> Told:
    """Return what hypotheses say whatever the noise, from what they say for each size of it, (h, noises)."""
    noise = seen.noise * NOISES
    squares = float(seen.gram[-2, -2] + seen.gram[-1, -1])
    logs = log_prior + evidence + 0.5 * np.abs(mean) ** 2 * left - np.log(left)
    logs = logs - 0.5 * squares / noise - seen.rows * np.log(noise)
    most = logs.max(axis=1, keepdims=True)
    weight = np.exp(logs - most)
    sums = weight.sum(axis=1)
    weight /= sums[:, None]
    centre = np.sum(weight * mean, axis=1)
    variance = np.sum(weight * (1.0 / left + 0.5 * np.abs(mean - centre[:, None]) ** 2), axis=1)
    return Told(most[:, 0] + np.log(sums), centre, variance, weight @ noise, np.full(len(sums), settles))
