"""Rate of one position in horizontal axes, given each hypothesis about slow tilts and accelerometer drift.

1. The strongest spectral line of the sway is fitted beside a slow trend, and subtracted.
2. The rest is averaged in Hann windows that overlap by half: an angle that stays bounded falls out of their
   mean, as their sum is flat with smooth ends.  The scatter of the cells about a slow trend is their noise,
   and a cell far beyond that is a knock.
3. One linear regression, complex (forward + i left), on the cells::

       gyros                       y = c + b + Σ A_k d/dt s_k + noise                  c earth rate, b bias
       accelerometers, as angle    α =         Σ A_k s_k + Σ B_j w_j + walk + noise
       unit that settles, accelerometers that warm up: s_k = 1 - exp(-t/τ_k), w_j = 1 - exp(-t/T_j)

The unknowns are the constant rate c + b and the amplitudes A and B, with two real parts each.  A hypothesis
is a prior of the amplitudes: the unit stands, or settles by three neighbours of the τ_k; the accelerometers
have warmed up, or warm up.  Mean, variance and evidence are closed forms; c + b has a flat prior.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment.parameters import RemainingWarmUp

CELLS = (96, 24, 6)
"""Candidate numbers of windows in a record; ablation: 48 alone makes 2.6 times the error."""
MIN_CELLS = 5
"""Fewer used cells give no scatter about a trend."""
OVERLAP = 1.0 / 6.0
"""Correlation of white noise in neighbouring Hann cells: the mean of their product over that of a square."""
TREND_ORDER = 5
"""Coefficients of the polynomial trend that is removed before the scatter is computed; at most a quarter of
the cells."""
KNOCK = 10.0
"""Residual, in medians of the residuals, above which a cell is rejected.  Ablation: without it, a knock that
tilts the unit by 0.005° leaves a heading error of 1.1° after 2 minutes, not 0.01°."""
MIN_VARIANCE = 1e-24
"""Lower bound of a variance, (rad/s)² or rad², for readings that do not change at all."""
CREEP_CELLS, CREEP_YAW, CREEP_NOISE = 12, 3e-4, 4.0
"""A unit creeps about the vertical whose angle by means of 12 cells of the vertical gyro, less their mean,
varies by more than 0.3 mrad and more than 4 times what the white noise turns in this time."""
LEAST_ROWS, MIN_PERIODS = 60, 1.5
"""Rows of the record, and periods in it, that a line needs; a slower sway is left to the trend and the
settling hypotheses."""
FEW_PERIODS, RESIDUAL_SHARE = 5.0, 0.3
"""A line with fewer periods than this must reduce the residual variance to this share: a knock has power at
all frequencies, too."""
LINE_RATIO = 40.0
"""Ratio of the power of a line to the median of the spectrum; white noise exceeds it with probability e^-40
a bin."""
SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod that settles, in octaves."""
TILT_SD, NOTHING = (1e-5, 1e-4, 1e-3), 1e-9
"""rad: sizes of a tilt; rad or g: what is none."""
P_SETTLES = 0.3
"""Prior probability of a settling tripod.  With 0.03 a slow tilt passes for a bias, 9 sigma off."""
WALK = 1e-7
"""Random walk of a warmed-up accelerometer, g/√s.  A drift of 1 µg is read as a tilt of 1 µrad."""
OFFSET_SD = 1e-3
"""Standard deviation of the constant part of α, and of its step in a knock, rad."""
LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""


def tilt_hypotheses(neighbours: int = 3) -> FloatArray:
    """Return the prior sd of the amplitude of each exponential, rad, (19, 8).

    The first hypothesis is that the unit stands; in the others some neighbouring exponentials have one size.
    """
    all_tau = len(SETTLING_TAU_S)
    offset = np.arange(all_tau) - np.arange(all_tau - neighbours + 1)[:, None]
    chosen = (offset >= 0) & (offset < neighbours)
    settles = [np.where(chosen, size, NOTHING) for size in TILT_SD]
    return np.concatenate([np.full((1, all_tau), NOTHING), *settles])


TILTS = tilt_hypotheses()


class Information(NamedTuple):
    """A Gaussian in information form, log density η'x - ½ x'Λx + const, of n unknowns x.

    `matrix` Λ is (..., n, n), and `vector` η (..., n, k) for k independent sets of unknowns, such as the real
    parts of complex ones.
    """

    matrix: FloatArray
    vector: FloatArray

    def plus(self, other: Information) -> Information:
        """Return the information of independent data taken together."""
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def without(self, sd: FloatArray) -> tuple[Information, FloatArray]:
        """Eliminate the last m unknowns, N(0, sd²), `sd` (..., m).

        Returns the information on the others, and the log density of what does not depend on them, (...).
        """
        kept, sets = self.matrix.shape[-1] - sd.shape[-1], self.vector.shape[-1]
        precision = self.matrix[..., kept:, kept:] + np.eye(sd.shape[-1]) / sd[..., None, :] ** 2
        covariance = np.linalg.inv(precision)
        gain, vector = self.matrix[..., :kept, kept:] @ covariance, self.vector[..., kept:, :]
        log_density = 0.5 * np.sum(vector * (covariance @ vector), axis=(-2, -1))
        log_density -= sets * (0.5 * np.linalg.slogdet(precision)[1] + np.log(sd).sum(axis=-1))
        rest = Information(
            self.matrix[..., :kept, :kept] - gain @ self.matrix[..., kept:, :kept],
            self.vector[..., :kept, :] - gain @ vector,
        )
        return rest, log_density


class HorizontalRows(NamedTuple):
    """The rows of a position in horizontal axes, complex: forward + i left.

    `rate` (n,) are the horizontal gyros, rad/s, in axes that follow the horizon of the accelerometers,
    `vertical` (n,) is the vertical gyro, and `alpha` (n,) the tilt by the accelerometers, rad, whose
    derivative is a part of the rate; `attitude` (3, 3) is from body axes by the mean specific force.
    """

    row_s: float
    valid: BoolArray
    rate: ColumnArray
    vertical: FloatArray
    alpha: ColumnArray
    attitude: FloatArray


class PositionFit(NamedTuple):
    """Rate of one position given each of h likely hypotheses, in horizontal axes.

    `log_weight` (h,) is that of prior and evidence, the largest 0; `rate` (h,) earth rate and bias, rad/s,
    with the variance of each part; `vertical` is the vertical gyro, rad/s, and `white` the white noise of the
    quietest gyro, (rad/s)²/Hz; `attitude` as in `HorizontalRows`.
    """

    log_weight: FloatArray
    rate: ColumnArray
    variance: FloatArray
    vertical: float
    vertical_variance: float
    white: float
    attitude: FloatArray

    def averaged(self) -> PositionFit:
        """Return the fit with one hypothesis that has the mean and the variance of all."""
        weight = np.exp(self.log_weight)
        weight /= weight.sum()
        mean = weight @ self.rate
        variance = weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2)
        return self._replace(log_weight=np.zeros(1), rate=np.array([mean]), variance=np.array([variance]))


class Cells(NamedTuple):
    """A division of a record of n rows into J cells.

    `windows` (J, n) are the weights of the rows, `used` (J,) the cells of valid rows without a knock, and
    `rate` (J,) their horizontal rates, rad/s, with the variance of each part; `vertical` is the mean of the
    vertical gyro, and `white` the white noise of the quietest axis, (rad/s)²/Hz.
    """

    windows: FloatArray
    used: BoolArray
    rate: ColumnArray
    variance: float
    vertical: float
    vertical_variance: float
    white: float


def fit_position(data: HorizontalRows, warm_up: RemainingWarmUp) -> PositionFit | None:
    """Return the fit of one position given each hypothesis; None if the record is too short."""
    n, dt = len(data.rate), data.row_s
    courses = -np.expm1(-dt * np.arange(n + 1.0)[:, None] / SETTLING_TAU_S)
    slopes, middles = np.diff(courses, axis=0) / dt, 0.5 * (courses[1:] + courses[:-1])
    slow = np.column_stack([_trend(n, TREND_ORDER), slopes])
    (rate, alpha), line = _without_sway(data.rate, data.alpha, data.valid, slow)
    cells = _divide(data, rate)
    if cells is None:
        return None
    windows, used, warm_ups = cells.windows, cells.used, len(warm_up.tau_s)
    mean_rate = complex(cells.rate[used].mean())
    uncertain = windows[used] @ line
    by_gyros = _information(
        np.column_stack([np.ones(n), slopes, np.zeros((n, warm_ups))]),
        cells.rate - mean_rate, windows, used, cells.variance * _correlation(used) + uncertain @ uncertain.T,
    )  # fmt: skip
    levels, time_s = windows @ alpha, dt * (windows @ np.arange(n))
    noise, level, _ = _scatter(levels, used, TREND_ORDER)
    walk = OFFSET_SD**2 + WALK**2 * np.minimum.outer(time_s[level], time_s[level])
    covariance = noise * _correlation(level) + walk + 1e-14 * np.eye(level.sum())
    for knock_s in time_s[~level & np.r_[True, level[:-1]]]:  # the offset is unknown anew behind it
        covariance += OFFSET_SD**2 * np.outer(time_s[level] > knock_s, time_s[level] > knock_s)
    warm = -np.expm1(-dt * (np.arange(n)[:, None] + 0.5) / np.array(warm_up.tau_s))
    by_accelerometers = _information(
        np.column_stack([np.zeros(n), middles, warm]),
        levels - levels[level].mean(), windows, level, covariance,
    )  # fmt: skip
    log_weight, rate, variance = _of_each_hypothesis(by_gyros.plus(by_accelerometers), warm_up)
    likely = log_weight > log_weight.max() + LIKELY
    return PositionFit(
        log_weight=log_weight[likely] - log_weight.max(),
        rate=rate[likely] + mean_rate,
        variance=variance[likely],
        vertical=cells.vertical,
        vertical_variance=cells.vertical_variance,
        white=cells.white,
        attitude=data.attitude,
    )


def _information(
    design: FloatArray, data: ColumnArray, windows: FloatArray, used: BoolArray, covariance: FloatArray
) -> Information:
    """Return the information of the used cells: data (J,) = windows design (n, k) x + noise."""
    design, data = windows[used] @ design, data[used]
    weighted = np.linalg.solve(covariance, design).T
    return Information(weighted @ design, weighted @ np.column_stack([data.real, data.imag]))


def _of_each_hypothesis(
    known: Information, warm_up: RemainingWarmUp
) -> tuple[FloatArray, ColumnArray, FloatArray]:
    """Return log weight, mean rate and variance of each part, of standing or settling, warm or not, (38,)."""
    sizes = np.array([[NOTHING], [warm_up.sd]]) * np.ones(len(warm_up.tau_s))
    sd = np.hstack([np.tile(TILTS, (2, 1)), np.repeat(sizes, len(TILTS), axis=0)])
    of_rate, evidence = known.without(sd)
    precision = of_rate.matrix[:, 0, 0]
    mean = of_rate.vector[:, 0, :] / precision[:, None]
    prior = np.r_[1.0 - P_SETTLES, np.full(len(TILTS) - 1, P_SETTLES / (len(TILTS) - 1))]
    evidence += 0.5 * precision * np.sum(mean**2, axis=1) - np.log(precision) + np.log(np.tile(prior, 2))
    return evidence, mean @ np.array([1.0, 1j]), 1.0 / precision


def _divide(data: HorizontalRows, rate: ColumnArray) -> Cells | None:
    """Return the division into cells with the smallest variance of the mean; None if the record is too short.

    Longer cells suppress more sway, but estimate the noise from fewer degrees of freedom: they must be better
    by the standard deviation of that estimate.
    """
    best, smallest, n = None, math.inf, len(rate)
    for count in CELLS:
        if n < 2 * (count + 1):
            continue
        windows = hann_windows(n, count)
        used = windows @ ~data.valid == 0.0
        if used.sum() < MIN_CELLS:
            continue
        cells, vertical = windows @ rate, windows @ data.vertical
        up_variance, up_used, _ = _scatter(vertical, used, 1)
        variance, used, freedom = _scatter(cells, used, TREND_ORDER)
        of_mean = (1.0 + 2.0 * OVERLAP) / float(used.sum())
        if variance * of_mean * (1.0 + math.sqrt(2.0 / max(freedom, 1.0))) < smallest:
            smallest = variance * of_mean
            white = min(variance, up_variance) * data.row_s / float(np.sum(windows[0] ** 2))
            mean = float(vertical[up_used].mean())
            best = Cells(windows, used, cells, variance, mean, up_variance * of_mean, white)
    return best


def _scatter(values: ColumnArray, used: BoolArray, order: int) -> tuple[float, BoolArray, float]:
    """Return the variance of cells about a trend, those used without knocks, and the degrees of freedom.

    `values` (cells,) are real, or complex with the same variance in both parts.
    """
    order = max(1, min(order, len(values) // 4))
    basis, square = _trend(len(values), order), np.zeros(len(values))
    for _ in range(3):  # a knock hides smaller ones
        square = np.abs(values - basis @ np.linalg.lstsq(basis[used], values[used], rcond=None)[0]) ** 2
        used = used & (square <= KNOCK**2 * np.median(square[used]) + MIN_VARIANCE)
    freedom = (2 if np.iscomplexobj(values) else 1) * max(int(used.sum()) - order, 0.5)
    return max(float(square[used].sum()), MIN_VARIANCE) / max(freedom - 2.0, 1.0), used, freedom


def hann_windows(n: int, cells: int) -> FloatArray:
    """Return the weights of n rows in Hann windows that overlap by half, (cells, n); each sums to one."""
    row = (np.arange(n) + 0.5) * ((cells + 1) / n)
    from_middle = np.minimum(np.abs(row - np.arange(1, cells + 1)[:, None]), 1.0)
    windows = 1.0 + np.cos(np.pi * from_middle)
    return np.asarray(windows / windows.sum(axis=1, keepdims=True))


def _correlation(used: BoolArray) -> FloatArray:
    """Return the correlation of white noise in those of the cells that are used, (m, m)."""
    apart = np.abs(np.subtract.outer(np.flatnonzero(used), np.flatnonzero(used)))
    return np.asarray((apart == 0) + OVERLAP * (apart == 1))


def _trend(n: int, order: int) -> FloatArray:
    """Return the first Chebyshev polynomials over n points, (n, order)."""
    return np.asarray(np.polynomial.chebyshev.chebvander((np.arange(n) + 0.5) / n * 2.0 - 1.0, order - 1))


def creeps(data: HorizontalRows) -> bool:
    """Return whether the unit turns slowly about the vertical, at a rate that changes."""
    n = len(data.valid)
    if n < 2 * (CREEP_CELLS + 1):
        return False
    windows = hann_windows(n, CREEP_CELLS)
    means = (windows @ data.vertical)[windows @ ~data.valid == 0.0]
    if len(means) < MIN_CELLS:
        return False
    yaw = np.cumsum(means - means.mean()) * data.row_s * n / (CREEP_CELLS + 1)
    steps = np.diff(data.vertical[data.valid])
    steps = steps[steps != 0.0]  # a sample may fill several rows
    noise = math.sqrt(0.5 * steps @ steps) * data.row_s * n / max(len(steps), 1)
    return float(np.ptp(yaw)) > max(CREEP_YAW, CREEP_NOISE * noise)


def _without_sway(
    rate: ColumnArray, alpha: ColumnArray, valid: BoolArray, slow: FloatArray
) -> tuple[ColumnArray, FloatArray]:
    """Return rates, rad/s, and α, rad, of horizontal axes, (n,) each, without the strongest line, (2, n).

    The line is found in the rate, and fitted beside slow functions of time, (n, m).  Cosine and sine have an
    amplitude that may change along the record, and the frequency by a fraction of a period in the record.
    The second result are these functions times the amplitude, (n, 4) or (n, 0), rad/s: its uncertainty.
    """
    n, given = len(rate), np.column_stack([rate, alpha])
    slow = slow / np.sqrt(np.sum(slow**2, axis=0))
    left = rate - slow @ _amplitudes(slow, rate, valid)
    omega = _strongest(left * valid * np.hanning(n + 2)[1:-1]) if n >= LEAST_ROWS else None
    if omega is None:
        return given.T, np.zeros((n, 0))
    row = (np.arange(n) - 0.5 * (n - 1))[:, None]
    wave = np.hstack([np.cos(omega * row), np.sin(omega * row)])
    line = np.hstack([wave, wave * row / (0.5 * n)])
    columns = np.hstack([slow, line])
    amplitudes = _amplitudes(columns, given, valid)
    remains = rate - columns @ amplitudes[:, 0]
    share = np.sum(np.abs(remains[valid]) ** 2) / np.sum(np.abs(left[valid]) ** 2)
    if omega * n < FEW_PERIODS * math.tau and share > RESIDUAL_SHARE:
        return given.T, np.zeros((n, 0))
    swing = line @ amplitudes[-4:]
    return np.asarray((given - swing).T), line * math.sqrt(2.0 * np.mean(np.abs(swing[:, 0]) ** 2))


def _strongest(left: ColumnArray) -> float | None:
    """Return the frequency of the strongest line, rad a row, or None when there is none."""
    n = len(left)
    bins = 1 << (8 * n - 1).bit_length()  # at least eight to a period in the record
    least = math.ceil(MIN_PERIODS * bins / n)
    axes = np.column_stack([left.real, left.imag])
    power = np.sum(np.abs(np.fft.rfft(axes, bins, axis=0)) ** 2, axis=1)[least : bins // 2]
    peak = int(np.argmax(power))
    return math.tau * (least + peak) / bins if power[peak] > LINE_RATIO * np.median(power) else None


def _amplitudes(columns: FloatArray, data: ColumnArray, valid: BoolArray) -> ColumnArray:
    """Return the least-squares solution over the valid rows."""
    columns = columns[valid]
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.asarray(np.linalg.solve(normal, columns.T @ data[valid]))
