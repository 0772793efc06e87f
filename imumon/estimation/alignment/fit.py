"""What a pose tells of the horizontal rate: lines and fast sway off, the rest by hypotheses.

In a pose the gyros see, in level axes that do not turn (complex: forward + i left),

    y = c' + dφ/dt + noise,   c' = c + b       (earth rate c, bias b)
    v = Ω sin L + b_up + dψ/dt + noise         (vertical)

and the accelerometers, as an angle, see φ + d + noise: the true tilt φ of the unit and the drift d of their
own bias while they warm up.  Their sum alone cannot be divided; the gyros see φ and not d.  `hypotheses` says
how the unit may tilt, and what c' is then.  By ψ the unit turns about the vertical meanwhile: `creep` tells
it, and it is turned back to where it stood in the middle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.creep import Creep, Rest, Usual, creep
from imumon.estimation.alignment.hypotheses import SETTLING, Seen, courses, told
from imumon.estimation.alignment.lines import without_lines
from imumon.estimation.alignment.loudness import quietness
from imumon.estimation.alignment.windows import (
    CYCLES,
    FLOOR,
    NOTHING,
    ROWS,
    Windows,
    bank,
    coloured,
    in_cells,
    layout,
    of_white,
    slow_columns,
    slowly,
    spectrum,
    weighted_bank,
)

WARM_UPS_S = np.array([100.0, 300.0, 1000.0])
DRIFTS = {0.0: 1.0 - SETTLING, 1e-4: SETTLING}
"""Time constants of accelerometers that warm up, and standard deviations of each part of the drift, in g,
with their probabilities: they have warmed up, or they do, which is as likely as that the unit settles.  What
accelerometers see change slowly is a drift or a tilt, and nothing but the length of the rate tells which; a
drift is one kind where a tilt is one of many, so were it likelier, a tilt along a parallel, which leaves that
length, would be luck.  With a part of 30 s slow drifts would be unlikely, and a clean warm-up of 300 s a
tilt."""
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
WORSE = 4.0
"""It is not more by more than this, either; and if all that is seen is not, it is white noise."""
UNDISTURBED = 0.25
"""Share of the frequencies in which there is white noise alone: the rest may all sway.  Where more of the
time than this is loud, what shakes comes and goes."""
SAME = 1e-9
"""Weights that differ by less differ by rounding."""
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
    vertical_variance : float
        Of the mean of the vertical gyro, (rad/s)².
    creep : Creep
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
    vertical_variance: float
    creep: Creep
    white: float
    quietest: float
    seconds: float


def fit_pose(
    record: PoseRecord, usual: Usual, drifts: Mapping[float, float] = DRIFTS, before: Rest | None = None
) -> PoseFit | None:
    """Fit a pose, or return None when there is too little.

    Parameters
    ----------
    record : PoseRecord
    usual : Usual
        What the vertical gyro should read at rest.
    drifts : mapping
        Standard deviations of each part of the drift of an accelerometer, in g, and their probabilities.
    before : Rest or None
        What the pose before says of the vertical gyro.
    """
    valid = record.weight > 0.0
    if valid.sum() < LEAST_CELLS:
        return None
    turned = creep(record.time_s, record.weight, record.rate[:, 2], usual, before)
    record = _turned_back(record, turned)
    quiet = quietness(record.rate, valid)
    seen = [_in_cells(record, valid.astype(np.float64))]
    if not seen[0].sets:
        return None
    if (quiet < valid).any():
        weighed = _in_cells(record, quiet)
        if weighed.sets:  # else hardly anything was quiet
            seen.append(weighed)
    # The vertical gyro has no hypotheses: what it shows of a trend is an error of its mean.
    upright, upright_windows, upright_noise = _sharpest(seen, slice(2, 3), trends=False)
    own_noise = upright_windows.scatter(upright.rate[:, 2:])[0]
    cells, windows, scatter = _sharpest(seen, slice(0, 2), trends=True, noise=own_noise)
    length_s = float(cells.edges_s[1] - cells.edges_s[0])
    angles = courses(cells.edges_s)
    slopes = np.diff(angles, axis=0) / length_s
    # Of several sets, that with the least scatter may have it by luck; the vertical gyro sees no tilt.
    least = max(scatter * LUCKY, ALIKE * own_noise)
    gram = windows.products(np.column_stack([np.ones(len(slopes)), slopes, cells.rate[:, :2]]))
    level = _accelerometers(cells, 0.5 * (angles[1:] + angles[:-1]), drifts)
    found = told(Seen(gram, windows.count, least, *level))
    best = int(np.argmax(found.log_weight))
    counted = length_s * float(cells.quiet.sum())
    white = found.noise[best] / float(gram[0, 0]) * counted
    vertical_variance = upright_noise / float(upright_windows.products(np.ones((len(slopes), 1)))[0, 0])
    return PoseFit(
        found.log_weight,
        complex(*cells.middle[:2]) + found.mean,
        found.variance,
        found.settles,
        vertical_variance + FINEST**2,
        turned,
        white,
        min(white, vertical_variance * length_s * float(upright.quiet.sum())),
        counted,
    )


def _turned_back(record: PoseRecord, turned: Creep) -> PoseRecord:
    """Return a record as of a unit that does not turn about the vertical."""
    horizontal = (record.rate[:, 0] + 1j * record.rate[:, 1]) * np.exp(1j * turned.angle)
    rate = np.column_stack([horizontal.real, horizontal.imag, turned.noise])
    return replace(record, rate=rate)


@dataclass(frozen=True, slots=True)
class _Cells:
    """A record in cells, each a mean over rows by how much these count.

    Parameters
    ----------
    edges_s : array, (n + 1,)
        Those of the cells if these did not overlap.
    rate, level : array (n, 3), and complex (n,)
        The rate less its mean.
    middle : array, (3,)
        That mean.
    quiet : array, (n,)
        By how much a cell counts.
    sets : tuple of Windows
    white : array, (n + 1,)
        Spectrum of the cells of white rows, over the variance of a cell; see `windows.spectrum`.
    """

    edges_s: FloatArray
    rate: FloatArray
    level: ColumnArray
    middle: FloatArray
    quiet: FloatArray
    sets: tuple[Windows, ...]
    white: FloatArray


def _in_cells(record: PoseRecord, quiet: FloatArray) -> _Cells:
    """Return the cells of a record, without its lines, when each row counts by so much, (n,)."""
    columns = np.column_stack([record.rate, record.level.real, record.level.imag])
    rows = len(columns)
    horizontal = without_lines(columns[:, 0] + 1j * columns[:, 1], slowly(rows), quiet)
    columns[:, 0], columns[:, 1] = horizontal.real, horizontal.imag
    count, weights = layout(rows)
    hop = max(len(weights) // 2, 1)
    middle = quiet @ columns / quiet.sum()
    means = in_cells(np.column_stack([(columns - middle) * quiet[:, None], quiet]), count, weights)
    whole = bool((means[:, -1] > 1.0 - SAME).all())
    means[:, :-1] /= np.maximum(means[:, -1:], FLOOR)
    step = float(record.time_s[-1] - record.time_s[0]) / (rows - 1)
    edges = hop * step * (np.arange(count + 1.0) + (0.5 if hop > 1 else 0.0))
    sets = bank(count, hop) if whole else weighted_bank(means[:, -1], hop)
    level = means[:, 3] + 1j * means[:, 4]
    return _Cells(edges, means[:, :3], level, middle[:3], means[:, -1], sets, of_white(count, hop))


def _sharpest(
    seen: list[_Cells], axes: slice, trends: bool, noise: float = 0.0
) -> tuple[_Cells, Windows, float]:
    """Return the cells and windows with the least variance of the mean of some axes, and that of a cell.

    Wider edges, less weight for what is loud, and, where the gyros' own noise is known, weights by the
    spectrum are taken when they are better by more than their scatter may be wrong.  No mean is better than
    that noise lets it be.
    """
    least, found = math.inf, None
    for cells, windows in _tried(seen, axes, noise):
        variance, uncertainty = windows.scatter(cells.rate[:, axes], trends)
        of_mean = max(variance, noise) * windows.variance
        if found is None or (1.0 + uncertainty) * of_mean < least:
            least, found = of_mean, (cells, windows, variance)
    assert found is not None
    return found


def _tried(seen: list[_Cells], axes: slice, noise: float) -> Iterator[tuple[_Cells, Windows]]:
    """Yield all sets of windows; last the cells weighed by the spectrum of some axes beside white noise.

    All cells count alike then: weights that vary would let the rate of a bounded angle into the mean.  It
    comes last, as it takes for sure that what shakes is an angle, which samples of a slammed door do not add
    up to; and a spectrum is that of what goes on all the time, so none is looked at where much is loud.
    White noise is that of the vertical gyro, or more, if a quarter of the spectrum is.
    """
    for cells in seen:
        for windows in cells.sets:
            yield cells, windows
    cells = seen[0]
    data = cells.rate[:, axes]
    if not noise or seen[-1].quiet.sum() < (1.0 - UNDISTURBED) * cells.quiet.sum():
        return
    if np.mean(cells.quiet[:, None] * data**2) < WORSE * noise:
        return  # there is no more in any spectrum
    power = spectrum(data, cells.quiet)
    usual = float(np.quantile((power / cells.white)[2 * CYCLES :], UNDISTURBED))
    white = cells.white * min(max(noise, usual), WORSE * noise)
    if power.mean() > WORSE * white.mean():
        yield cells, coloured(cells.quiet, np.maximum(power, white) / noise)


def _accelerometers(
    cells: _Cells, courses: FloatArray, drifts: Mapping[float, float]
) -> tuple[FloatArray, ColumnArray, FloatArray]:
    """Return what the accelerometers tell of the angles for each drift: as of `hypotheses.Seen`.

    Their drift is a sum of exponentials with unknown parts and a random walk; the level itself is unknown.
    """
    together = -(-len(cells.level) // ROWS)
    count = len(cells.level) // together
    blocks = np.column_stack([courses, cells.level.real, cells.level.imag, cells.edges_s[1:]])
    weight = cells.quiet[: count * together].reshape(count, together)
    blocks = blocks[: count * together].reshape(count, together, -1)
    total = weight.sum(1)
    some = total > NOTHING * total.max()
    means = np.einsum("bt,bti->bi", weight[some], blocks[some]) / total[some, None]
    weight = total[some] / total.max()
    values, time = means[:, -3] + 1j * means[:, -2], means[:, -1]
    known = float(weight.sum() ** 2 / (weight @ weight))
    root = np.sqrt(weight)
    slow = np.linalg.qr(slow_columns(slowly(count), known)[some] * root[:, None])[0]
    left = root * values
    left = left - slow @ (slow.T @ left)
    noise = float(np.vdot(left, left).real) / (2.0 * (known - slow.shape[1]))
    warm_ups = -np.expm1(-time[:, None] / WARM_UPS_S)
    values = values - weight @ values / weight.sum()
    columns = np.column_stack([means[:, :-3], values.real, values.imag])
    covariance = LEVEL**2 + WALK**2 * np.minimum.outer(time, time)
    covariance[np.diag_indices(len(time))] += noise / weight + 1e-14
    variances = np.square(list(drifts))[:, None, None]
    lower = np.linalg.cholesky(covariance + variances * (warm_ups @ warm_ups.T))
    # Whitened one by one: the products of such columns have no negative eigenvalue, whatever the rounding.
    white = np.linalg.solve(lower, columns)
    products = white.swapaxes(-1, -2) @ white
    misfit = products[:, -2, -2] + products[:, -1, -1]
    evidence = -2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1) - 0.5 * misfit
    information, level = products[:, :-2, :-2], products[:, :-2, -2] + 1j * products[:, :-2, -1]
    return information, level, evidence + np.log(list(drifts.values()))
