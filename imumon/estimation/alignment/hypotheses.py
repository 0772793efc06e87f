"""Level rate of one position given each hypothesis about slow tilts and accelerometer drift.

In level axes, complex, per cell::

    gyros            y = c + b + dphi/dt + n          c = earth rate, b = bias
    accelerometers   alpha = phi + d + m

phi stands, or settles: three neighbours of sum A_k (1 - exp(-t/tau_k)).  d is a random walk, with or without
a warm-up, sum B_j (1 - exp(-t/T_j)).  All are linear and Gaussian, so that mean, variance and evidence of
each are closed forms; c has a flat prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment import cells
from imumon.estimation.alignment.record import Levelled
from imumon.estimation.alignment.sway import find_sway

SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod, in octaves."""
NEIGHBOURS = 3
"""Exponentials side by side."""
TILT_SD, STANDS_SD = np.array([1e-5, 1e-4, 1e-3]), 1e-9
"""rad: sizes of a tilt, and what is none."""
WARM_UP_TAU_S = np.array([100.0, 300.0, 1000.0])
P_SETTLES = 0.3
"""Prior probability of a settling tripod.  With 0.03 a slow tilt passes for a bias, 9 sigma off; ablation: 0
makes up to 8 times the error."""
LEVEL_SD = 1e-3
"""Constant of an accelerometer's level, rad."""
TEMPER = 0.7
"""Exponent of prior times evidence (tempered posterior): below 1 because real tilts are no exact exponentials
and the noise is estimated."""
LARGEST_BIAS = 1e-3
"""rad/s: 200 °/h."""
LEVEL_TREND_ORDER = 8
"""Coefficients of the course of the level that is no noise."""


class Drift(NamedTuple):
    """Accelerometer drift: prior probability, random walk, g/√s, and sd of the warm-up amplitudes, g."""

    probability: float
    walk: float
    warm_up_sd: float


DRIFTS = (Drift(0.495, 1e-7, 0.0), Drift(0.495, 1e-7, 1e-4), Drift(0.01, 3e-6, 0.0))
"""Warmed up, warming up, or with a sudden step.  Ablation: without a warm-up errors are up to 8 sigma;
without a step, one of 30 µg hides the north."""


class PositionFit(NamedTuple):
    """Level rate of one position given each of h hypotheses, in the axes at the end of the record.

    `log_weight` (h,) is that of prior and evidence, the largest 0; `rate` (h,) earth rate and bias, rad/s,
    with the variance of each part; `white` the white noise of the quietest gyro, (rad/s)²/Hz; `yaw` the slow
    rotation about the vertical by the vertical gyro, rad, 0 if none was detected, and `bias_rotation` the
    mean of e^{i yaw}, the factor that turning the rates back gives to a constant bias.
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

    `earth_vertical` is Ω sin L, rad/s; `drifts` are models of the accelerometers.
    """
    n = len(data.rate)
    creeps = cells.rotates_slowly(data)
    turned = np.cumsum(creeps * data.valid * (data.vertical - earth_vertical)) * data.row_s
    back = np.exp(1j * (turned - turned[-1]))
    rate = data.rate * back
    settling = -np.expm1(-data.row_s * np.arange(n + 1.0)[:, None] / SETTLING_TAU_S)
    slopes = np.diff(settling, axis=0) / data.row_s
    slow = np.column_stack([cells.trend(n, cells.TREND_ORDER), slopes])
    sways = find_sway(rate, data.level, data.valid, slow)
    found = cells.divide(data, rate - sways.rate, creeps)
    if found is None:
        return None
    turning_bias = LARGEST_BIAS * (back.imag - back.imag.mean())
    columns = np.column_stack([np.ones(n), slopes, sways.columns, turning_bias])
    offset = complex(found.rate[found.used].mean())
    gyros = _gyros(found, cells.hann_means(columns, len(found.used))[found.used], offset)
    level = data.level - sways.level
    middles = 0.5 * (settling[1:] + settling[:-1])
    parts = [_tilts(gyros, *_accelerometers(data, level, found.used, middles, drift)) for drift in drifts]
    log_weight, mean, variance = (np.concatenate(part) for part in zip(*parts, strict=True))
    return PositionFit(
        log_weight=TEMPER * (log_weight - log_weight.max()),
        rate=mean + offset,
        variance=variance,
        settles=np.tile(SIZE > STANDS_SD, len(drifts)),
        vertical=found.vertical,
        vertical_variance=found.vertical_variance,
        white=found.white,
        attitude=data.attitude,
        seconds=n * data.row_s,
        yaw=float(turned[-1]),
        bias_rotation=complex(back.mean()),
    )


def _normal(covariance: FloatArray, columns: FloatArray) -> FloatArray:
    """Return columns' inverse(covariance) columns."""
    return np.asarray(columns.T @ np.linalg.solve(covariance, columns))


def _correlation(used: BoolArray) -> FloatArray:
    """Return the correlation of the noise of the used cells, (m, m)."""
    apart = np.abs(np.subtract.outer(np.flatnonzero(used), np.flatnonzero(used)))
    return np.asarray((apart == 0) + cells.OVERLAP * (apart == 1))


def _gyros(found: cells.Cells, columns: FloatArray, offset: complex) -> FloatArray:
    """Return the normal equations of rate, amplitudes of the exponentials, and the two parts of the data.

    The other columns, sways and a bias in axes that creep, are eliminated; their prior is N(0, 1).
    """
    data = found.rate[found.used] - offset
    every = np.column_stack([columns, data.real, data.imag])
    normal = _normal(found.variance * _correlation(found.used), every)
    other = np.zeros(len(normal), bool)
    other[1 + len(SETTLING_TAU_S) : -2] = True
    cross = normal[np.ix_(~other, other)]
    within = normal[np.ix_(other, other)] + np.eye(int(other.sum()))
    return np.asarray(normal[np.ix_(~other, ~other)] - cross @ np.linalg.solve(within, cross.T))


def _accelerometers(
    data: Levelled, level: ColumnArray, used: BoolArray, middles: FloatArray, drift: Drift
) -> tuple[FloatArray, float]:
    """Return normal equations as those of the gyros, and the log density of the level if the unit stands."""
    n = len(level)
    time_s = data.row_s * (np.arange(float(n)) + 0.5)
    means = cells.hann_means(np.column_stack([time_s, middles, level.real, level.imag]), len(used))
    noise, _, _ = cells.scatter(means[:, -2:], used, LEVEL_TREND_ORDER)
    at, columns = means[used, 0], means[used, 1:]
    columns[:, -2:] -= columns[:, -2:].mean(axis=0)
    warm_up = -drift.warm_up_sd * np.expm1(-at[:, None] / WARM_UP_TAU_S)
    covariance = noise * _correlation(used) + LEVEL_SD**2 + 1e-14 * np.eye(len(at))
    covariance += warm_up @ warm_up.T + drift.walk**2 * np.minimum.outer(at, at)
    for knock_s in means[~used & np.r_[True, used[:-1]], 0]:  # the level is unknown anew behind it
        covariance += LEVEL_SD**2 * np.outer(at > knock_s, at > knock_s)
    normal = _normal(covariance, np.column_stack([np.zeros(len(at)), columns]))
    log_density = -np.linalg.slogdet(covariance)[1] - 0.5 * (normal[-1, -1] + normal[-2, -2])
    return normal, float(log_density + np.log(drift.probability))


_FIRST = np.arange(len(SETTLING_TAU_S) - NEIGHBOURS + 1)
WHICH = 1 + np.r_[_FIRST[:1], np.repeat(_FIRST, len(TILT_SD))][:, None] + np.arange(NEIGHBOURS)
SIZE = np.r_[STANDS_SD, np.tile(TILT_SD, len(_FIRST))]
"""Exponentials, (19, 3), and size of their amplitudes, rad, (19,), of each hypothesis about the tilt."""


def _tilts(
    gyros: FloatArray, level: FloatArray, log_density: float
) -> tuple[FloatArray, ColumnArray, FloatArray]:
    """Return log weight, mean rate and its variance of each hypothesis about the tilt, (19,).

    Rate and amplitudes A ~ N(0, σ²) have the precision Λ, the mean Λ⁻¹ r, and the log evidence
    ½ rᴴ Λ⁻¹ r - log |Λ| - 2 log |σ| of two real parts.
    """
    both, index = gyros + level, np.insert(WHICH, 0, 0, axis=1)
    precision = both[index[:, :, None], index[:, None, :]]
    precision[:, 1:, 1:] += np.eye(NEIGHBOURS) / SIZE[:, None, None] ** 2
    right = both[index, -2] + 1j * both[index, -1]
    covariance = np.linalg.inv(precision)
    mean = (covariance @ right[:, :, None])[..., 0]
    evidence = 0.5 * np.sum(right.conj() * mean, axis=1).real - np.linalg.slogdet(precision)[1]
    evidence -= 2.0 * NEIGHBOURS * np.log(SIZE)
    prior = np.where(SIZE > STANDS_SD, P_SETTLES / (len(SIZE) - 1), 1.0 - P_SETTLES)
    return evidence + np.log(prior) + log_density, mean[:, 0], covariance[:, 0, 0]
