"""What a pose tells of the horizontal rate: lines and fast sway off, the rest by hypotheses.

In a pose the gyros see, in level axes that do not turn (complex: forward + i left),

    y = c' + dφ/dt + noise,   c' = c + b       (earth rate c, bias b)
    v = Ω sin L + b_up + noise                 (vertical)

and the accelerometers, as an angle, see φ + d + noise: the true tilt φ of the unit and the drift d of their
own bias while they warm up.  Their sum alone cannot be divided; the gyros see φ and not d.  `hypotheses` says
how the unit may tilt, and what c' is then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.hypotheses import Seen, courses, told
from imumon.estimation.alignment.lines import without_lines
from imumon.estimation.alignment.windows import ROWS, Windows, bank, in_cells, layout, slowly

WARM_UPS_S = np.array([30.0, 100.0, 300.0, 1000.0])
WARM_UP = 1e-4
"""Time constants of accelerometers, and the standard deviation of each part of the drift, in g."""
WALK = 1e-7
"""Random walk of an accelerometer, g/√s: 6 µg in an hour."""
LEVEL = 1e-3
"""Standard deviation of the mean level about its estimate, rad: wide, but not so wide as to cost digits."""
FINEST = 1e-10
"""rad/s, 2e-5 °/h: no mean of a gyro is better, whatever a record without noise says."""
LUCKY = 1.0 / 64.0
"""The noise may be less than its scatter by this factor, when a slow sway is in that."""
ALIKE = 0.5
"""The noise of horizontal gyros is not less than that of the vertical one by more than this factor."""
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
    log_weight : array, (h,)
        Logarithm of prior probability times evidence.
    mean : array of complex, (h,)
        rad/s, forward + i left.
    variance : array, (h,)
        Of each axis.
    settles : array, (h,)
        One where the unit settles.
    vertical, vertical_variance : float
        Mean of the vertical gyro, rad/s.
    white, quietest : float
        Power spectral density of the noise at frequency zero, (rad/s)²/Hz: of a horizontal gyro, and of the
        quietest, as that of the unit at rest.
    seconds : float
        Time that counts.
    """

    log_weight: FloatArray
    mean: ColumnArray
    variance: FloatArray
    settles: FloatArray
    vertical: float
    vertical_variance: float
    white: float
    quietest: float
    seconds: float


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
    angles = courses(cells.edges_s)
    slopes = np.diff(angles, axis=0) / length_s
    middle, above = cells.rate[:, :2].mean(0), float(cells.rate[:, 2].mean())
    data = cells.rate - [*middle, above]
    sets = bank(len(data), cells.hop)
    windows, scatter = _sharpest(data[:, :2], sets)
    # Of several sets, that with the least scatter may have it by luck; the vertical gyro sees no tilt.
    least = max(scatter * LUCKY, ALIKE * sets[0].scatter(data[:, 2:])[0])
    products = windows.products(np.column_stack([np.ones(len(data)), slopes, data]))
    gram = products[:-1, :-1] * cells.share
    level = _accelerometers(cells.level, length_s, 0.5 * (angles[1:] + angles[:-1]), drift_sd)
    found = told(Seen(gram, len(windows.weights) * cells.share, least, *level))
    best = int(np.argmax(found.log_weight))
    white = found.noise[best] / float(gram[0, 0])
    upright = windows.scatter(data[:, 2:])[0]
    vertical_variance = upright / float(gram[0, 0]) + FINEST**2
    counted = length_s * len(data) * cells.share
    return PoseFit(
        found.log_weight,
        complex(*middle) + found.mean,
        found.variance,
        found.settles,
        above + float(products[0, -1] / products[0, 0]),
        vertical_variance,
        white * counted,
        min(white, vertical_variance) * counted,
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
    horizontal = without_lines(columns[:, 0] + 1j * columns[:, 1], slowly(len(rows)))
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
    # Whitened one by one: the products of such columns have no negative eigenvalue, whatever the rounding.
    columns = np.column_stack([shape, values.real - values.real.mean(), values.imag - values.imag.mean()])
    white = np.linalg.solve(np.linalg.cholesky(covariance), columns)
    products = white[:, :-2].T @ white
    return products[:, :-2], products[:, -2] + 1j * products[:, -1]
