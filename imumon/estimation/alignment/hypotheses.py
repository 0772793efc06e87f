"""Level rate of one position given each hypothesis about slow tilts and accelerometer drift.

In level axes, complex, per cell::

    gyros            y = c + b + dphi/dt + n          c = earth rate, b = bias
    accelerometers   alpha = phi + d + m

phi stands, or settles: three neighbours of sum A_k (1 - exp(-t/tau_k)).  d is a random walk, with or without
a warm-up, sum B_j (1 - exp(-t/T_j)).  All are linear and Gaussian, so that mean, variance and evidence of
each are closed forms; c has a flat prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment import cells
from imumon.estimation.alignment.record import Levelled
from imumon.estimation.alignment.sway import find_sway

SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod, in octaves."""
NEIGHBOURS = 3
"""Exponentials side by side; ablation: with one, a sway of 0.05 Hz is not shown after a minute."""
TILT_SD = np.array([1e-5, 1e-4, 1e-3])
"""rad: sizes of a tilt."""
WARM_UP_TAU_S = np.array([100.0, 300.0, 1000.0])
P_SETTLES = 0.03
"""Prior probability of a settling tripod; ablation: 0.3 makes 1.01 times the error, 0 up to 14 times."""
LEVEL_SD = 1e-3
"""Constant of an accelerometer's level, rad."""
TEMPER = 0.7
"""Exponent of prior times evidence (tempered posterior): below 1 because real tilts are no exact exponentials
and the noise is estimated.
Assumed; ablation: with 1 the rms of error/sigma is 0.74 instead of 0.72."""
LEVEL_TREND_ORDER = 8
"""Coefficients of the course of the level that is no noise."""
LARGEST_BIAS = 1e-3
"""rad/s: 200 °/h."""


class Drift(NamedTuple):
    """Accelerometer drift: prior probability, random walk, g/√s, and sd of the warm-up amplitudes, g."""

    probability: float
    walk: float
    warm_up_sd: float


DRIFTS = (Drift(0.495, 1e-7, 0.0), Drift(0.495, 1e-7, 1e-4), Drift(0.01, 3e-6, 0.0))
"""Warmed up, warming up, or with a sudden step.  Ablation: without a warm-up errors are up to 10 sigma;
without a step, one of 30 µg hides the north."""


@dataclass(frozen=True, slots=True, eq=False)
class PositionFit:
    """Level rate of one position given each of h hypotheses.

    Parameters
    ----------
    log_weight : array, (h,)
        Of prior and evidence, the largest 0.
    rate : array of complex, (h,)
        Earth rate and bias in level axes at the end of the position, rad/s.
    variance : array, (h,)
        Of each part of it.
    settles : array of bool, (h,)
    vertical, vertical_variance : float
        Mean of the vertical gyro, rad/s, and its variance.
    white : float
        White noise of the quietest gyro, (rad/s)²/Hz.
    attitude : array, (3, 3)
        Body axes to level axes.
    seconds : float
        Length of the record.
    yaw : float
        Slow rotation about the vertical during the record by the vertical gyro, rad, counter-clockwise; 0 if
        none was detected.  `rate` is in the axes at the end of the record.
    bias_rotation : complex
        Mean of e^{i yaw} over the record: the factor that the rotation of the rates gives to a constant bias.
    """

    log_weight: FloatArray
    rate: ColumnArray
    variance: FloatArray
    settles: BoolArray
    vertical: float
    vertical_variance: float
    white: float
    attitude: FloatArray
    seconds: float
    yaw: float
    bias_rotation: complex

    @property
    def creep_s(self) -> float:
        """Duration of the slow rotation, s; 0 if none was detected."""
        return self.seconds if self.yaw else 0.0

    def moments(self) -> tuple[complex, float]:
        """Return mean and variance of each part of the rate over all hypotheses."""
        weight = np.exp(self.log_weight)
        weight /= weight.sum()
        mean = complex(weight @ self.rate)
        return mean, float(weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2))


def fit_position(data: Levelled, earth_vertical: float, drifts: Sequence[Drift]) -> PositionFit | None:
    """Return the fit of one position given each hypothesis; None if the record is too short.

    Parameters
    ----------
    data : Levelled
    earth_vertical : float
        Ω sin L, rad/s.
    drifts : sequence of Drift
        Models of the accelerometer drift.
    """
    n = len(data.rate)
    creeps = cells.rotates_slowly(data)
    turned = np.cumsum(creeps * data.valid * (data.vertical - earth_vertical)) * data.row_s
    factor = np.exp(1j * (turned - turned[-1]))
    rate = data.rate * factor
    edge_s = data.row_s * np.arange(n + 1.0)
    basis = -np.expm1(-edge_s[:, None] / SETTLING_TAU_S)
    slopes = np.diff(basis, axis=0) / data.row_s
    slow = np.column_stack([cells.trend(n, cells.TREND_ORDER), slopes])
    sways = find_sway(rate, data.level, data.valid, slow)
    found = cells.divide(data, rate - sways.rate, creeps)
    if found is None:
        return None
    columns = np.column_stack([slopes, sways.columns, factor.real, factor.imag])
    gyros = _gyros(found, cells.hann_means(columns, len(found.used)))
    middles = cells.hann_means(0.5 * (basis[1:] + basis[:-1]), len(found.used))[found.used]
    parts = [
        _stands_or_settles(gyros, one)
        for one in _accelerometers(data, data.level - sways.level, found, middles, drifts)
    ]
    log_weight, mean, variance, settles = (np.concatenate(part) for part in zip(*parts, strict=True))
    log_weight = TEMPER * (log_weight - log_weight.max())
    return PositionFit(
        log_weight=log_weight,
        rate=mean + gyros.offset,
        variance=variance,
        settles=settles,
        vertical=found.vertical,
        vertical_variance=found.vertical_variance,
        white=found.white,
        attitude=data.attitude,
        seconds=n * data.row_s,
        yaw=float(turned[-1]),
        bias_rotation=gyros.bias_rotation,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Gyros:
    """Normal equations of the gyros for the constant rate and the amplitudes of the exponentials.

    `constant` is the weight of the rate, `rate` its weighted sum, `by_tilt` (8,) its products with the slopes
    of the exponentials; `tilt` (8, 8) and `tilt_sum` (8,) are those of the slopes with the rate eliminated.
    The rates are less `offset`; `bias_rotation` is the mean factor of the bias.
    """

    constant: float
    rate: complex
    by_tilt: FloatArray
    tilt: FloatArray
    tilt_sum: ColumnArray
    offset: complex
    bias_rotation: complex


def _gyros(found: cells.Cells, columns: FloatArray) -> _Gyros:
    """Return the normal equations, by the means of columns in all cells, (J, 8 + 4 l + 2).

    These are the slopes of the exponentials, the sways, and real and imaginary part of the factor by which
    rates were turned.  The sways are eliminated, with the prior that they are as large as found, and so is a
    bias of any size that this factor turned from cell to cell.
    """
    used, tilts = found.used, len(SETTLING_TAU_S)
    offset = complex(found.rate[used].mean())
    data = found.rate[used] - offset
    every = np.column_stack([np.ones(len(data)), columns[used], data.real, data.imag])
    factored = np.linalg.cholesky(_overlapping(len(data)))
    white = np.linalg.solve(factored, every * np.sqrt(found.weight[used] / found.variance)[:, None])
    constant = float(white[:, 0] @ white[:, 0])
    turned = complex(*(white[:, 0] @ white[:, -4:-2]) / constant)
    white[:, -3] = LARGEST_BIAS * (white[:, -3] - turned.imag * white[:, 0])
    normal = white.T @ white
    kept = np.r_[: tilts + 1, len(normal) - 2 : len(normal)]
    gone = np.r_[tilts + 1 : len(normal) - 4, len(normal) - 3]
    across = normal[np.ix_(kept, gone)]
    normal = normal[np.ix_(kept, kept)] - across @ np.linalg.solve(
        normal[np.ix_(gone, gone)] + np.eye(len(gone)), across.T
    )
    constant, rate = float(normal[0, 0]), complex(normal[0, -2], normal[0, -1])
    by_tilt = normal[1:-2, 0]
    tilt = normal[1:-2, 1:-2] - np.outer(by_tilt, by_tilt) / constant
    tilt_sum = normal[1:-2, -2] + 1j * normal[1:-2, -1] - by_tilt * rate / constant
    return _Gyros(constant, rate, by_tilt, tilt, tilt_sum, offset, turned)


def _overlapping(m: int) -> FloatArray:
    """Return the correlation of the noise of m cells, (m, m)."""
    return np.asarray(np.eye(m) + cells.OVERLAP * (np.eye(m, k=1) + np.eye(m, k=-1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Accelerometers:
    """Normal equations of the accelerometers for the amplitudes of the exponentials, by one size of warm-up.

    `tilt` (8, 8), `tilt_sum` (8,) and the log density of the level of a unit that stands, with the prior.
    """

    tilt: FloatArray
    tilt_sum: ColumnArray
    log_density: float


def _accelerometers(
    data: Levelled, tilt: ColumnArray, found: cells.Cells, middles: FloatArray, drifts: Sequence[Drift]
) -> list[_Accelerometers]:
    """Return one for each drift; `middles` are the exponentials in the used cells, (m, 8)."""
    used, count, n = found.used, len(found.used), len(tilt)
    time_s = cells.hann_means(data.row_s * (np.arange(float(n))[:, None] + 0.5), count)[:, 0]
    level = cells.hann_means(np.column_stack([tilt.real, tilt.imag]), count)
    noise, _, _ = cells.scatter(level, cells.all_valid(data.valid, count), LEVEL_TREND_ORDER)
    level = level[used] - level[used].mean(axis=0)
    at, root = time_s[used], np.sqrt(found.weight[used])
    m = len(at)
    covariance = noise * _overlapping(m) / np.outer(root, root) + LEVEL_SD**2 + 1e-14 * np.eye(m)
    # Behind a knock, where cells are left out, the level is unknown anew.
    knocked = ~used & np.r_[True, used[:-1]]
    for knock_s in time_s[knocked]:
        behind = (at > knock_s).astype(np.float64)
        covariance += LEVEL_SD**2 * np.outer(behind, behind)
    warm_up = -np.expm1(-at[:, None] / WARM_UP_TAU_S)
    parts = []
    for drift in drifts:
        course = drift.warm_up_sd**2 * warm_up @ warm_up.T + drift.walk**2 * np.minimum.outer(at, at)
        factor = np.linalg.cholesky(covariance + course)
        white = np.linalg.solve(factor, np.column_stack([middles, level]))
        normal = white.T @ white
        log_density = -2.0 * float(np.log(np.diag(factor)).sum()) - 0.5 * float(
            normal[-1, -1] + normal[-2, -2]
        )
        parts.append(
            _Accelerometers(
                normal[:-2, :-2],
                normal[:-2, -2] + 1j * normal[:-2, -1],
                log_density + math.log(drift.probability),
            )
        )
    return parts


def _stands_or_settles(
    gyros: _Gyros, level: _Accelerometers
) -> tuple[FloatArray, ColumnArray, FloatArray, BoolArray]:
    """Return log weight, mean rate, its variance and whether it settles, (19,) each.

    The amplitudes A of three exponentials have the precision Λ = tilts of gyros and accelerometers + 1/σ²,
    the mean Λ⁻¹ r, and the log evidence ½ rᴴ Λ⁻¹ r - log |Λ| - 6 log σ of two real parts.
    """
    first = np.arange(len(SETTLING_TAU_S) - NEIGHBOURS + 1)[:, None] + np.arange(NEIGHBOURS)
    which = np.repeat(first, len(TILT_SD), axis=0)
    size = np.tile(TILT_SD, len(first))
    both = gyros.tilt + level.tilt
    precision = both[which[:, :, None], which[:, None, :]] + np.eye(NEIGHBOURS) / size[:, None, None] ** 2
    right = (gyros.tilt_sum + level.tilt_sum)[which]
    by_tilt = gyros.by_tilt[which]
    solved = np.linalg.solve(precision, np.stack([right.real, right.imag, by_tilt], axis=-1))
    amplitude, gain = solved[..., 0] + 1j * solved[..., 1], solved[..., 2]
    evidence = 0.5 * np.sum(right.real * amplitude.real + right.imag * amplitude.imag, axis=1)
    evidence -= np.linalg.slogdet(precision)[1] + 2.0 * NEIGHBOURS * np.log(size)
    mean = (gyros.rate - np.sum(by_tilt * amplitude, axis=1)) / gyros.constant
    variance = 1.0 / gyros.constant + np.sum(by_tilt * gain, axis=1) / gyros.constant**2
    log_weight = np.r_[math.log1p(-P_SETTLES), evidence + math.log(P_SETTLES / len(size))]
    return (
        log_weight + level.log_density,
        np.r_[gyros.rate / gyros.constant, mean],
        np.r_[1.0 / gyros.constant, variance],
        np.arange(len(log_weight)) > 0,
    )
