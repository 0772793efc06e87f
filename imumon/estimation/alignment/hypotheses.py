"""How a unit may tilt in a pose, and what each possibility says of the rate it would see if it stood still.

Gyros see the rate of the tilt, dφ/dt, on top of c'; accelerometers see φ itself beside their own drift.  A
hypothesis is a set of courses of which φ is the sum, with coefficients of some standard deviation:

    the unit stands                              φ = 0
    a tripod settles, or tilts ever farther      three neighbours of eight exponentials
    it sways slowly, in a narrow band            sine and cosine at four neighbouring frequencies
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
"""Of a tripod that settles.  Three neighbours together follow any time constant between them, a steady tilt,
and one that begins later."""
_SWAYS = len(TIME_CONSTANTS_S)
CYCLES = 0.25 * np.arange(1.0, 25.0)
"""Periods in the record of the sways: four neighbours together follow all between them to 1 %."""
SIZES = np.array([1e-5, 1e-4, 1e-3])
"""Standard deviations of the tilt, rad: tripods and buildings do from a few µrad to some mrad."""
NOISES = 2.0 ** np.arange(9.0)
"""Variances of the noise that are thought of, over the least."""
SETTLING, SWAYING = 0.1, 0.1
"""Prior probabilities, independent of each other.  With more, a clean warm-up settles later than after a
minute; with less, errors exceed their sigma more often (`scripts/reproduce/alignment`, `alignment_site`)."""
DISTINCT = 1e-9
"""A tilt that looks like the earth rate to this share leaves nothing to tell them apart."""


def _sway_columns(nodes: IntArray) -> IntArray:
    """Return the courses of the sways at nodes, (k, m): sine and cosine, (k, 2 m)."""
    return np.concatenate([_SWAYS + 2 * nodes, _SWAYS + 2 * nodes + 1], axis=1)


_TRIPLES = np.arange(_SWAYS - 2)[:, None] + np.arange(3)
_BANDS = _sway_columns(np.arange(0, len(CYCLES) - 3, 2)[:, None] + np.arange(4))
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

    def beside(self, other: Family, k: int, size: int, share: float) -> Family:
        """Return these, each together with one of another family, the k-th of this size."""
        columns, precision = other.columns[k], other.precision[size]
        return Family(
            np.concatenate([self.columns, np.tile(columns, (len(self.columns), 1))], axis=1),
            np.concatenate([self.precision, np.tile(precision, (len(self.precision), 1))], axis=1),
            self.seen,
            share,
        )


SETTLES = Family(_TRIPLES, np.tile(_OF_ONE, (1, 3)), True, SETTLING * (1.0 - SWAYING))
# The sines of a sway share its variance.
SWAYS, UNSEEN = (
    Family(_BANDS, np.tile(4.0 * _OF_ONE, (1, 8)), seen, 0.5 * SWAYING * (1.0 - SETTLING))
    for seen in (True, False)
)


def courses(time_s: FloatArray) -> FloatArray:
    """Return the course of each kind of tilt, per its angle, (n, kinds), since the pose began."""
    kinds = [-np.expm1(-time_s / tau) for tau in TIME_CONSTANTS_S]
    phase = 2.0 * math.pi * np.outer((time_s - time_s[0]) / (time_s[-1] - time_s[0]), CYCLES)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time_s), -1)
    return np.concatenate([np.column_stack(kinds), waves], axis=1)


@dataclass(frozen=True, slots=True)
class Seen:
    """What a pose shows.

    Parameters
    ----------
    gram : array, (kinds + 3, kinds + 3)
        Scalar products of the columns over white noise of one: 1, slopes of courses, data forward and left.
    rows : float
        Observations in them.
    noise : float
        The least variance of the noise.
    information, level : array, (d, kinds, kinds), and (d, kinds) complex
        What the accelerometers tell of the angles, and that times their means, by each of their drifts.
    drifts : array, (d,)
        Logarithm of prior probability times evidence of these, if the unit stands.
    """

    gram: FloatArray
    rows: float
    noise: float
    information: FloatArray
    level: ColumnArray
    drifts: FloatArray


@dataclass(frozen=True, slots=True)
class Told:
    """What each hypothesis says, all (h,).

    Parameters
    ----------
    log_weight : array
        Logarithm of prior probability times evidence.
    mean, variance : array
        Of c', the variance that of each axis.
    noise : array
        Variance of the noise.
    settles : array
        One where the unit settles, zero elsewhere.
    """

    log_weight: FloatArray
    mean: ColumnArray
    variance: FloatArray
    noise: FloatArray
    settles: FloatArray


def told(seen: Seen) -> Told:
    """Return what each hypothesis says of c'.

    A unit may settle and sway: what settles is tried beside the likeliest sway, and what sways beside the
    likeliest way to settle, each whether the accelerometers drift or not: what settles is what may look like
    their drift.
    """
    settles, sways = _family(seen, SETTLES), _family(seen, SWAYS)
    parts = [_stands(seen), settles, sways, _family(seen, UNSEEN)]
    for own, other, likeliest in ((SETTLES, SWAYS, sways), (SWAYS, SETTLES, settles)):
        shape = len(other.columns), len(seen.drifts), len(other.precision)
        k, _, size = (int(at) for at in np.unravel_index(np.argmax(likeliest.log_weight), shape))
        parts.append(_family(seen, own.beside(other, k, size, 0.5 * SETTLING * SWAYING)))
    parts[1].settles[:] = parts[4].settles[:] = parts[5].settles[:] = 1.0
    return Told(*(np.concatenate([getattr(part, name) for part in parts]) for name in Told.__slots__))


@dataclass(frozen=True, slots=True)
class _Given:
    """What hypotheses say for each size of the noise, (h, noises): evidence, information and mean of c'."""

    evidence: FloatArray
    left: FloatArray
    mean: ColumnArray


def _stands(seen: Seen) -> Told:
    """Return what is said if the unit stands."""
    total = seen.gram[0, 0] / (seen.noise * NOISES)
    mean = np.full((1, len(NOISES)), complex(seen.gram[0, -2], seen.gram[0, -1]) / seen.gram[0, 0])
    given = _Given(np.zeros((1, len(NOISES))), total[None], mean)
    log_prior = math.log((1.0 - SETTLING) * (1.0 - SWAYING)) + np.logaddexp.reduce(seen.drifts)
    return _over_noises(seen, given, np.full(1, log_prior))


def _family(seen: Seen, family: Family) -> Told:
    """Return what the hypotheses of a family say; sizes vary fastest, then drifts.

    In the axes in which the gyros' information of the angles is diagonal and what is known without them is
    one, all sizes of the noise cost one decomposition.
    """
    gram, noise, columns = seen.gram, seen.noise * NOISES[:, None], family.columns
    values, turn, level, log_prior = _axes(seen, family)
    slopes, data = gram[0, 1:-2][columns], (gram[1:-2, -2] + 1j * gram[1:-2, -1])[columns]
    p = (turn @ slopes[:, None, :, None])[..., None, :, 0]
    q = (turn @ data[:, None, :, None])[..., None, :, 0]
    loss = 1.0 / (1.0 + np.maximum(values, 0.0)[..., None, :] / noise)  # (k, s, noises, r)
    pulled = q / noise + level
    total = gram[0, 0] / noise[:, 0]
    left = np.maximum(total - np.sum(p**2 * loss, axis=-1) / noise[:, 0] ** 2, DISTINCT * total)
    right = complex(gram[0, -2], gram[0, -1]) / noise[:, 0]
    mean = (right - np.sum(p * loss * pulled, axis=-1) / noise[:, 0]) / left
    # Two axes: every half of a logarithm counts twice.
    evidence = 0.5 * np.sum(loss * (pulled.real**2 + pulled.imag**2), axis=-1) + np.log(loss.prod(-1))
    count = len(NOISES)
    given = _Given(evidence.reshape(-1, count), left.reshape(-1, count), mean.reshape(-1, count))
    log_prior = log_prior + math.log(family.share / (len(columns) * len(family.precision)))
    return _over_noises(seen, given, np.broadcast_to(log_prior, evidence.shape[:2]).ravel())


def _axes(seen: Seen, family: Family) -> tuple[FloatArray, FloatArray, ColumnArray, FloatArray]:
    """Return what is known along axes in which all is diagonal.

    These are the gyros' information (k, d s, r), the axes (k, d s, r, r), what the accelerometers say there,
    and how well they agree with the sizes of the angles, a logarithm (k, d s).
    """
    columns, own = family.columns, family.precision
    slopes = seen.gram[1:-2, 1:-2][columns[:, :, None], columns[:, None, :]]
    known = seen.information[:, columns[:, :, None], columns[:, None, :]].swapaxes(0, 1)[:, :, None]
    level = seen.level[:, columns].swapaxes(0, 1)[:, :, None, :, None]
    both = known + own[:, :, None] * np.eye(columns.shape[1])
    lower = np.linalg.cholesky(both)
    log_prior = np.log(own).sum(1) - 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1)
    log_prior = log_prior + seen.drifts[:, None]  # (k, d, s)
    root = np.linalg.inv(lower)
    if not family.seen:
        # The accelerometers sway by angles of their own, of the same size; the axes are those of all sizes.
        explained = (np.abs(root @ level) ** 2).sum((-2, -1))
        values, vectors = np.linalg.eigh(slopes)
        turn = vectors.swapaxes(-1, -2)[:, None] / np.sqrt(own)[:, :, None]
        log_prior = np.logaddexp.reduce(log_prior + 0.5 * explained, axis=1)
        return values[:, None] / own, turn, np.zeros(1, np.complex128), log_prior
    values, vectors = np.linalg.eigh(root @ slopes[:, None, None] @ root.swapaxes(-1, -2))
    turn = vectors.swapaxes(-1, -2) @ root
    level = turn @ level
    count, rank = columns.shape
    return (
        values.reshape(count, -1, rank), turn.reshape(count, -1, rank, rank),
        level.reshape(count, -1, 1, rank), log_prior.reshape(count, -1),
    )  # fmt: skip


def _over_noises(seen: Seen, given: _Given, log_prior: FloatArray) -> Told:
    """Return what hypotheses say whatever the noise; their log prior is (h,)."""
    noise = seen.noise * NOISES
    squares = float(seen.gram[-2, -2] + seen.gram[-1, -1])
    logs = log_prior[:, None] + given.evidence + 0.5 * np.abs(given.mean) ** 2 * given.left
    logs -= np.log(given.left) + 0.5 * squares / noise + seen.rows * np.log(noise)
    most = logs.max(axis=1, keepdims=True)
    weight = np.exp(logs - most)
    sums = weight.sum(axis=1)
    weight /= sums[:, None]
    centre = np.sum(weight * given.mean, axis=1)
    variance = np.sum(weight * (1.0 / given.left + 0.5 * np.abs(given.mean - centre[:, None]) ** 2), axis=1)
    return Told(most[:, 0] + np.log(sums), centre, variance, weight @ noise, np.zeros(len(sums)))
