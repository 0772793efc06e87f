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
from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.lines import without_lines
from imumon.estimation.alignment.windows import ROWS, Windows, bank, in_cells, layout, trend

TIME_CONSTANTS_S = np.geomspace(5.0, 640.0, 8)
"""Of a tripod that settles.  Two neighbours together follow any time constant between them."""
RAMP_S = 640.0
"""A steady tilt is told by its angle over this time."""
LATER = (0.25, 0.5, 0.75)
"""Shares of the time after which a steady tilt may have begun."""
_STEADY = len(TIME_CONSTANTS_S)
PAIRS = np.array(
    [(k, k + 1) for k in range(_STEADY)] + [(_STEADY, _STEADY + 1 + k) for k in range(len(LATER))]
).T
"""Courses of which a tilt is the sum: exponentials, or a steady tilt that changes once; (2, pairs)."""
TILTS = np.array([3e-5, 3e-4])
"""Standard deviations of the tilt, rad: of what tripods do, 30 to 300 µrad."""
PROBABILITY = 1.0 / 3.0
"""Prior probability that the unit tilts: of standing, warming up and settling, one."""
WARM_UPS_S = np.array([30.0, 100.0, 300.0, 1000.0])
WARM_UP = 1e-4
"""Time constants of accelerometers, and the standard deviation of each part of the drift, in g."""
WALK = 1e-7
"""Random walk of an accelerometer, g/√s: 6 µg in an hour."""
LEVEL = 1e-3
"""Standard deviation of the mean level about its estimate, rad: wide, but not so wide as to cost digits."""
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
class PoseRecord:
    """What is kept of a pose.

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
    """

    time_s: FloatArray
    weight: FloatArray
    rate: FloatArray
    level: ColumnArray


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
    white, quietest : float
        Power spectral density of the noise at frequency zero, (rad/s)²/Hz: of a horizontal gyro, and of the
        quietest, as that of the unit at rest.
    seconds : float
        Time that counts.
    """

    log_evidence: FloatArray
    mean: ColumnArray
    variance: FloatArray
    vertical: float
    vertical_variance: float
    white: float
    quietest: float
    seconds: float


def prior() -> FloatArray:
    """Return the logarithm of the prior probability of each hypothesis, (h,); the first: the unit stands."""
    count = PAIRS.shape[1] * len(TILTS)
    return np.asarray(np.log(np.r_[1.0 - PROBABILITY, np.full(count, PROBABILITY / count)]))


def tilt_courses(time_s: FloatArray) -> FloatArray:
    """Return the course of each kind of tilt, per its angle, (n, kinds), since the pose began."""
    kinds = [-np.expm1(-time_s / tau) for tau in TIME_CONSTANTS_S]
    kinds.append(time_s / RAMP_S)
    kinds += [np.maximum(time_s - share * time_s[-1], 0.0) / RAMP_S for share in LATER]
    return np.column_stack(kinds)


def fit_pose(record: PoseRecord, drift_sd: float = WARM_UP) -> PoseFit | None:
    """Fit a pose, or return None when there is too little.

    Parameters
    ----------
    record : PoseRecord
    drift_sd : float
        Standard deviation of each part of the drift of an accelerometer, in g.
    """
    valid = record.weight > 0.0
    if valid.sum() < LEAST_CELLS:
        return None
    cells = _in_cells(record, valid)
    length_s = float(cells.edges_s[1] - cells.edges_s[0])
    courses = tilt_courses(cells.edges_s)
    slopes = np.diff(courses, axis=0) / length_s
    middle, above = cells.rate[:, :2].mean(0), float(cells.rate[:, 2].mean())
    data = cells.rate - [*middle, above]
    windows, scatter = _sharpest(data[:, :2], bank(len(data), cells.hop))
    columns = np.column_stack([np.ones(len(data)), slopes, data])
    products = windows.products(columns)
    gram = products[:-1, :-1] * (cells.share / scatter)
    tapered = _tapered(columns[:, :-1]) * cells.share
    if tapered[0, 0] > BETTER * gram[0, 0]:
        gram = tapered
    told = _accelerometers(cells.level, length_s, 0.5 * (courses[1:] + courses[:-1]), drift_sd)
    found = _hypotheses(gram, *told)
    wider = _misfit(gram, found, len(windows.weights))
    if wider > 1.0 and gram is not tapered:
        found = _hypotheses(gram / wider, *told)
    mean, variance = found.mean, found.variance
    upright = windows.scatter(data[:, 2:])[0]
    vertical_variance = upright / (float(products[0, 0]) * cells.share) + FINEST**2
    counted = length_s * len(data) * cells.share
    return PoseFit(
        found.log_evidence,
        complex(*middle) + mean,
        variance,
        above + float(products[0, -1] / products[0, 0]),
        vertical_variance,
        float(variance[0]) * counted,
        min(float(variance[0]), vertical_variance) * counted,
        counted,
    )


@dataclass(frozen=True, slots=True)
class _Cells:
    """A record in cells: rate (n, 3), level (n,) complex, and the share of it that counts.

    The edges, s, (n + 1,), are those of the cells if these did not overlap; a cell is `hop` rows long.
    """

    edges_s: FloatArray
    hop: int
    rate: FloatArray
    level: ColumnArray
    share: float


def _in_cells(record: PoseRecord, valid: ColumnArray) -> _Cells:
    """Return the cells of a record, without its lines; where nothing counts, between their neighbours."""
    columns = np.column_stack([record.rate, record.level.real, record.level.imag])
    rows = np.arange(len(columns))
    if not valid.all():
        kept = np.flatnonzero(valid)
        columns = np.column_stack([np.interp(rows, kept, column[kept]) for column in columns.T])
    horizontal = without_lines(columns[:, 0] + 1j * columns[:, 1], trend(len(rows)))
    columns[:, 0], columns[:, 1] = horizontal.real, horizontal.imag
    count, weights = layout(len(rows))
    means = in_cells(columns, count, weights)
    hop = max(len(weights) // 2, 1)
    step = float(record.time_s[-1] - record.time_s[0]) / (len(rows) - 1)
    edges = hop * step * (np.arange(count + 1.0) + (0.5 if hop > 1 else 0.0))
    return _Cells(edges, hop, means[:, :3], means[:, 3] + 1j * means[:, 4], float(valid.mean()))


def _sharpest(data: FloatArray, sets: tuple[Windows, ...]) -> tuple[Windows, float]:
    """Return the set of windows with the least variance of the mean of data, (n, axes), and that of a cell.

    Wider edges are taken when they are better by more than their scatter may be wrong.
    """
    found: list[tuple[float, Windows, float]] = []
    for windows in sets:
        variance, uncertainty = windows.scatter(data)
        of_mean = variance * windows.variance
        if not found or (1.0 + uncertainty) * of_mean < found[-1][0]:
            found.append((of_mean, windows, variance))
    return found[-1][1:]


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


@dataclass(frozen=True, slots=True)
class _Hypotheses:
    """Log evidence, mean and variance of c' (h,), and the angles of the courses (h, kinds)."""

    log_evidence: FloatArray
    mean: ColumnArray
    variance: FloatArray
    angles: ColumnArray


def _misfit(gram: FloatArray, found: _Hypotheses, rows: int) -> float:
    """Return how much more than their noise the data are off what the most probable hypothesis says.

    The noise was judged by what no trend explains; a sway of one period may look like a trend, and like no
    hypothesis.
    """
    best = int(np.argmax(found.log_evidence + prior()))
    off = np.r_[-found.mean[best], -found.angles[best], 1.0, 1.0j]
    return float((off.conj() @ gram @ off).real) / (2.0 * max(rows - 3, 1))


def _hypotheses(gram: FloatArray, information: FloatArray, seen: ColumnArray) -> _Hypotheses:
    """Return what each hypothesis says of c', with the tilt's angles eliminated.

    Parameters
    ----------
    gram : array, (kinds + 3, kinds + 3)
        Scalar products of the columns over the noise: 1, slope of each course, data forward and left.
    information, seen : array, (kinds, kinds) and (kinds,)
        What the accelerometers tell of the angles, and that times their means.
    """
    total, right = float(gram[0, 0]), complex(gram[0, -2], gram[0, -1])
    tilt = gram[1:-2, 1:-2] + information
    first, second = np.repeat(PAIRS, len(TILTS), axis=1)
    known = np.tile(TILTS**-2.0, PAIRS.shape[1])
    a, b, c = tilt[first, first] + known, tilt[first, second], tilt[second, second] + known
    determinant = np.maximum(a * c - b**2, known**2)
    slopes, data = gram[0, 1:-2], gram[1:-2, -2] + 1j * gram[1:-2, -1] + seen
    x, y, p, q = slopes[first], slopes[second], data[first], data[second]
    left = np.maximum(total - (c * x**2 - 2.0 * b * x * y + a * y**2) / determinant, DISTINCT * total)
    mean = (right - (x * (c * p - b * q) + y * (a * q - b * p)) / determinant) / left
    explained = (c * np.abs(p) ** 2 - 2.0 * b * (p * q.conj()).real + a * np.abs(q) ** 2) / determinant
    # Two axes: every half of a logarithm counts twice.
    evidence = 0.5 * (explained + np.abs(mean) ** 2 * left) - np.log(determinant / known**2) - np.log(left)
    angles = np.zeros((len(mean) + 1, len(slopes)), complex)
    row = np.arange(1, len(angles))
    angles[row, first] = (c * (p - x * mean) - b * (q - y * mean)) / determinant
    angles[row, second] = (a * (q - y * mean) - b * (p - x * mean)) / determinant
    return _Hypotheses(
        np.r_[0.5 * abs(right) ** 2 / total - math.log(total), evidence],
        np.r_[right / total, mean],
        np.r_[1.0 / total, 1.0 / left],
        angles,
    )


def _accelerometers(
    level: ColumnArray, length_s: float, courses: FloatArray, drift_sd: float
) -> tuple[FloatArray, ColumnArray]:
    """Return the accelerometers' information of the angles, (kinds, kinds), and that times their means.

    Their drift is a sum of exponentials with unknown parts and a random walk; the level itself is unknown.
    """
    together = -(-len(level) // ROWS)
    count = len(level) // together
    values = level[: count * together].reshape(count, together).mean(1)
    shape = courses[: count * together].reshape(count, together, -1).mean(1)
    time = length_s * together * (np.arange(count) + 0.5)
    slow = bank(count, 1)[0].slow
    left = values - slow @ (slow.T @ values)
    noise = float(np.vdot(left, left).real) / (2.0 * (count - slow.shape[1]))
    drifts = drift_sd * -np.expm1(-time[:, None] / WARM_UPS_S)
    covariance = LEVEL**2 + drifts @ drifts.T + WALK**2 * np.minimum.outer(time, time)
    covariance[np.diag_indices(count)] += noise + 1e-14
    weighted = np.linalg.solve(covariance, shape)
    return shape.T @ weighted, weighted.T @ (values - values.mean())
