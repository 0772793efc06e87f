"""Level rate of one position given each hypothesis about slow tilts and accelerometer drift.

In level axes, complex, per cell::

    gyros            y = c + b + dphi/dt + n          c = earth rate, b = bias
    accelerometers   alpha = phi + d + m

phi stands, or settles: three neighbours of sum A_k (1 - exp(-t/tau_k)).  d is a random walk, with or without
a warm-up, sum B_j (1 - exp(-t/T_j)).  The state is the constant rate c + b and the eight amplitudes A, with
two real parts each; a hypothesis is a prior of A and a covariance of d.  All are linear and Gaussian, so that
mean, variance and evidence of each are closed forms; c has a flat prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.estimation.alignment.cells import TREND_ORDER, Cells, divide, rotates_slowly, scatter, trend
from imumon.estimation.alignment.record import Levelled
from imumon.estimation.alignment.sway import find_sway

SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod that settles, in octaves."""
TILT_SD, STANDS_SD = np.array([1e-5, 1e-4, 1e-3]), 1e-9
"""rad: sizes of a tilt, and what is none."""
P_SETTLES = 0.3
"""Prior probability of a settling tripod.  With 0.03 a slow tilt passes for a bias, 9 sigma off; ablation: 0
makes up to 8 times the error."""
WARM_UP_TAU_S = np.array([100.0, 300.0, 1000.0])
"""Time constants of the warm-up of the accelerometers."""
LEVEL_SD = 1e-3
"""Standard deviation of the level's constant, and of its step in a knock, rad."""
TEMPER = 0.7
"""Exponent of prior times evidence (tempered posterior): below 1 because real tilts are no exact exponentials
and the noise is estimated."""
LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""
LARGEST_BIAS = 1e-3
"""Standard deviation of a bias while the unit creeps, rad/s: 200 °/h, more than any gyro that shows north."""


class Drift(NamedTuple):
    """Accelerometer drift: prior probability, random walk, g/√s, and sd of the warm-up amplitudes, g."""

    probability: float
    walk: float
    warm_up_sd: float


DRIFTS = (Drift(0.495, 1e-7, 0.0), Drift(0.495, 1e-7, 1e-4), Drift(0.01, 3e-6, 0.0))
"""Warmed up, warming up, or with a sudden step.  Ablation: without a warm-up errors are up to 8 sigma;
without a step, one of 30 µg hides the north."""


def tilt_hypotheses(neighbours: int = 3) -> FloatArray:
    """Return the prior sd of the amplitude of each exponential, rad, (19, 8).

    The first hypothesis is that the unit stands; in the others some neighbouring exponentials have one size.
    A single exponential, or all eight, would be up to 18 sigma off (ablation).
    """
    rows = [np.full(len(SETTLING_TAU_S), STANDS_SD)]
    for first in range(len(SETTLING_TAU_S) - neighbours + 1):
        for size in TILT_SD:
            rows.append(rows[0].copy())
            rows[-1][first : first + neighbours] = size
    return np.array(rows)


TILTS = tilt_hypotheses()


class PositionFit(NamedTuple):
    """Level rate of one position given each of h likely hypotheses, in the axes at the end of the record.

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

    def moments(self) -> tuple[ColumnArray, FloatArray]:
        """Return mean and variance of each part of the rate over all hypotheses, (1,)."""
        weight = np.exp(self.log_weight)
        weight /= weight.sum()
        mean = weight @ self.rate
        variance = weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2)
        return np.array([mean]), np.array([variance])


def fit_position(data: Levelled, earth_vertical: float, drifts: Sequence[Drift]) -> PositionFit | None:
    """Return the fit of one position given each hypothesis; None if the record is too short.

    `earth_vertical` is Ω sin L, rad/s; `drifts` are models of the accelerometers.
    """
    n = len(data.rate)
    # Rates of a unit that creeps about the vertical are turned into the axes at the end of the record.  There
    # a bias, which is constant in body axes, turns: one more nuisance.
    creeps = rotates_slowly(data)
    yaw = np.cumsum(creeps * data.valid * (data.vertical - earth_vertical)) * data.row_s
    back = np.exp(1j * (yaw - yaw[-1]))
    rate = data.rate * back

    settling = -np.expm1(-data.row_s * np.arange(n + 1.0)[:, None] / SETTLING_TAU_S)
    slopes = np.diff(settling, axis=0) / data.row_s
    middles = 0.5 * (settling[1:] + settling[:-1])
    sways = find_sway(rate, data.level, data.valid, np.column_stack([trend(n, TREND_ORDER), slopes]))
    cells = divide(data, rate - sways.rate, creeps)
    if cells is None:
        return None

    turning_bias = LARGEST_BIAS * (back.imag - back.imag.mean())
    gyros = _gyros(cells, slopes, np.column_stack([sways.columns, turning_bias]))
    parts = []
    for drift in drifts:
        level, log_density = _accelerometers(cells, data.level - sways.level, data.row_s, middles, drift)
        parts.append(_tilts(gyros.plus(level), log_density + math.log(drift.probability)))
    log_weight, mean, variance = (np.concatenate(part) for part in zip(*parts, strict=True))
    log_weight = TEMPER * (log_weight - log_weight.max())
    likely = log_weight > LIKELY
    return PositionFit(
        log_weight=log_weight[likely],
        rate=mean[likely] + cells.mean_rate,
        variance=variance[likely],
        settles=np.tile(TILTS.max(axis=1) > STANDS_SD, len(drifts))[likely],
        vertical=cells.vertical,
        vertical_variance=cells.vertical_variance,
        white=cells.white,
        attitude=data.attitude,
        seconds=n * data.row_s,
        yaw=float(yaw[-1]),
        bias_rotation=complex(back.mean()),
    )


class Information(NamedTuple):
    """Information on a constant rate and the amplitudes of the exponentials.

    It is Hᵀ R⁻¹ H, (9, 9), and Hᵀ R⁻¹ y, (9,), complex, of observations y with the covariance R.
    """

    matrix: FloatArray
    vector: ColumnArray

    def plus(self, other: Information) -> Information:
        """Return the information of both."""
        return Information(self.matrix + other.matrix, self.vector + other.vector)


def _information(design: FloatArray, data: ColumnArray, covariance: FloatArray) -> Information:
    weighted = np.asarray(np.linalg.solve(covariance, design).T, np.float64)
    return Information(weighted @ design, weighted @ data)


def _gyros(cells: Cells, slopes: FloatArray, nuisance: FloatArray) -> Information:
    """Return the information of the gyros, for the rate less the mean of the cells.

    `slopes` (n, 8) are the derivatives of the exponentials.  `nuisance` (n, ...), sways and a bias in axes
    that creep, have amplitudes of N(0, 1) and are a correlated noise.
    """
    windows = cells.windows[cells.used]
    design = np.column_stack([np.ones(len(windows)), windows @ slopes])
    other = windows @ nuisance
    covariance = cells.variance * cells.correlation + other @ other.T
    return _information(design, cells.rate[cells.used] - cells.mean_rate, covariance)


def _accelerometers(
    cells: Cells, level: ColumnArray, row_s: float, middles: FloatArray, drift: Drift
) -> tuple[Information, float]:
    """Return the information of the level, (n,), and its log density if the unit stands.

    `middles` (n, 8) are the exponentials.
    """
    used, means = cells.used, cells.windows @ level
    time_s = row_s * level.size / (len(used) + 1) * np.arange(1.0, len(used) + 1)
    knocks_s, at_s = time_s[~used & np.r_[True, used[:-1]]], time_s[used]
    noise, _, _ = scatter(means, used, TREND_ORDER)
    warm_up = -drift.warm_up_sd * np.expm1(-at_s[:, None] / WARM_UP_TAU_S)
    covariance = noise * cells.correlation + LEVEL_SD**2 + 1e-14 * np.eye(len(at_s))
    covariance += warm_up @ warm_up.T + drift.walk**2 * np.minimum.outer(at_s, at_s)
    for knock_s in knocks_s:  # the level is unknown anew behind it
        covariance += LEVEL_SD**2 * np.outer(at_s > knock_s, at_s > knock_s)
    data = means[used] - means[used].mean()
    design = np.column_stack([np.zeros(len(at_s)), cells.windows[used] @ middles])
    square = float((data.conj() @ np.linalg.solve(covariance, data)).real)
    log_density = -0.5 * square - float(np.linalg.slogdet(covariance)[1])
    return _information(design, data, covariance), log_density


def _tilts(known: Information, log_density: float) -> tuple[FloatArray, ColumnArray, FloatArray]:
    """Return log weight, mean rate and its variance of each hypothesis about the tilt, (19,).

    Rate and amplitudes A ~ N(0, σ²) have the precision Λ, the mean Λ⁻¹ r, and the log evidence
    ½ rᴴ Λ⁻¹ r - log |Λ| - 2 log |σ| of two real parts.
    """
    precision = known.matrix + np.zeros((len(TILTS), 1, 1))
    precision[:, 1:, 1:] += np.eye(len(SETTLING_TAU_S)) / TILTS[:, None, :] ** 2
    covariance: FloatArray = np.asarray(np.linalg.inv(precision), np.float64)
    mean = covariance @ known.vector
    evidence = 0.5 * (mean @ known.vector.conj()).real - np.linalg.slogdet(precision)[1]
    evidence -= 2.0 * np.log(TILTS).sum(axis=1)
    prior = np.where(TILTS.max(axis=1) > STANDS_SD, P_SETTLES / (len(TILTS) - 1), 1.0 - P_SETTLES)
    return evidence + np.log(prior) + log_density, mean[:, 0], covariance[:, 0, 0]
