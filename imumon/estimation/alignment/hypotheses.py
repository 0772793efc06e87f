"""Rate of one position in horizontal axes, given each hypothesis about slow tilts and accelerometer drift.

In horizontal axes, complex, per cell::

    gyros                       y = c + b + dφ/dt + n       c earth rate, b bias
    accelerometers, as angle    α = φ + d + m

φ stands, or settles: three neighbours of Σ A_k (1 - exp(-t/τ_k)).  d is a random walk, with or without
a warm-up, Σ B_j (1 - exp(-t/T_j)).  The unknowns are the constant rate c + b and the eight amplitudes A, with
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
from imumon.estimation.alignment.record import HorizontalRows
from imumon.estimation.alignment.sway import without_sway

SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod that settles, in octaves."""
TILT_SD, STANDS_SD = np.array([1e-5, 1e-4, 1e-3]), 1e-9
"""rad: sizes of a tilt, and what is none."""
P_SETTLES = 0.3
"""Prior probability of a settling tripod.  With 0.03 a slow tilt passes for a bias, 9 sigma off; ablation: 0
makes up to 8 times the error."""
OFFSET_SD = 1e-3
"""Standard deviation of the constant part of α, and of its step in a knock, rad."""
LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""
LARGEST_BIAS = 1e-3
"""Standard deviation of a bias while the unit creeps, rad/s: 200 °/h, more than any gyro that shows north."""


class Drift(NamedTuple):
    """Accelerometer drift d: probability, random walk, g/√s, sd of warm-up amplitudes, g, and their τ, s.

    A drift of 1 µg is read as a tilt of 1 µrad.
    """

    probability: float
    walk: float
    warm_up_sd: float
    warm_up_tau_s: tuple[float, ...] = (100.0, 300.0, 1000.0)


DRIFTS = (Drift(0.495, 1e-7, 0.0), Drift(0.495, 1e-7, 1e-4), Drift(0.01, 3e-6, 0.0))
"""Warmed up, warming up, or with a sudden step.  Ablation: without a warm-up errors are up to 8 sigma;
without a step, one of 30 µg hides the north."""


def tilt_hypotheses(neighbours: int = 3) -> FloatArray:
    """Return the prior sd of the amplitude of each exponential, rad, (19, 8).

    The first hypothesis is that the unit stands; in the others some neighbouring exponentials have one size.
    A single exponential makes up to 10 times the error (ablation).
    """
    rows = [np.full(len(SETTLING_TAU_S), STANDS_SD)]
    for first in range(len(SETTLING_TAU_S) - neighbours + 1):
        for size in TILT_SD:
            rows.append(rows[0].copy())
            rows[-1][first : first + neighbours] = size
    return np.array(rows)


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


def information(design: FloatArray, data: FloatArray, covariance: FloatArray) -> Information:
    """Return the information of data (m, k) = design (m, n) x + noise with this covariance (m, m)."""
    weighted = np.linalg.solve(covariance, design).T
    return Information(weighted @ design, weighted @ data)


class PositionFit(NamedTuple):
    """Rate of one position given each of h likely hypotheses, in horizontal axes at the end of the record.

    `log_weight` (h,) is that of prior and evidence, the largest 0; `rate` (h,) earth rate and bias, rad/s,
    with the variance of each part, and `settles` (h,) whether φ settles; `vertical` is the vertical gyro,
    rad/s, and `white` the white noise of the quietest gyro, (rad/s)²/Hz; `attitude` as in `HorizontalRows`.

    If the unit creeps about the vertical, it does so for `creep_s` and by `yaw`, rad; else both are 0.
    `bias_rotation` is the mean of e^{i yaw}, the factor that turning the rates back gives to a constant bias.
    """

    log_weight: FloatArray
    rate: ColumnArray
    variance: FloatArray
    settles: BoolArray
    vertical: float
    vertical_variance: float
    white: float
    attitude: FloatArray
    creep_s: float
    yaw: float
    bias_rotation: complex

    def moments(self) -> tuple[ColumnArray, FloatArray]:
        """Return mean and variance of each part of the rate over all hypotheses, (1,)."""
        weight = np.exp(self.log_weight)
        weight /= weight.sum()
        mean = weight @ self.rate
        variance = weight @ (self.variance + 0.5 * np.abs(self.rate - mean) ** 2)
        return np.array([mean]), np.array([variance])


def fit_position(data: HorizontalRows, earth_vertical: float, drifts: Sequence[Drift]) -> PositionFit | None:
    """Return the fit of one position given each hypothesis; None if the record is too short.

    `earth_vertical` is Ω sin L, rad/s; `drifts` are models of the accelerometers.
    """
    n = len(data.rate)
    # Vectors of a unit that creeps about the vertical are turned into the axes at the end of the record.
    # There a bias, which is constant in body axes, turns: one more nuisance.
    creeps = rotates_slowly(data)
    yaw = np.cumsum(creeps * data.valid * (data.vertical - earth_vertical)) * data.row_s
    back = np.exp(1j * (yaw - yaw[-1]))
    rate, alpha = data.rate * back, data.alpha * back

    courses = -np.expm1(-data.row_s * np.arange(n + 1.0)[:, None] / SETTLING_TAU_S)
    slopes, middles = np.diff(courses, axis=0) / data.row_s, 0.5 * (courses[1:] + courses[:-1])
    slow = np.column_stack([trend(n, TREND_ORDER), slopes])
    (rate, alpha), sways = without_sway(rate, alpha, data.valid, slow)
    cells = divide(data, rate, creeps)
    if cells is None:
        return None

    turning_bias = LARGEST_BIAS * (back.imag - back.imag.mean())
    by_gyros = _by_gyros(cells, slopes, np.column_stack([sways, turning_bias]))
    parts = []
    for drift in drifts:
        by_tilt, log_density = _by_accelerometers(cells, alpha, data.row_s, middles, drift)
        parts.append(_rate_of_each_tilt(by_gyros.plus(by_tilt), log_density + math.log(drift.probability)))
    log_weight, mean, variance, settles = (np.concatenate(part) for part in zip(*parts, strict=True))
    log_weight -= log_weight.max()
    likely = log_weight > LIKELY
    return PositionFit(
        log_weight=log_weight[likely],
        rate=mean[likely] + cells.mean_rate,
        variance=variance[likely],
        settles=settles[likely],
        vertical=cells.vertical,
        vertical_variance=cells.vertical_variance,
        white=cells.white,
        attitude=data.attitude,
        creep_s=creeps * n * data.row_s,
        yaw=float(yaw[-1]),
        bias_rotation=complex(back.mean()),
    )


def _by_gyros(cells: Cells, slopes: FloatArray, nuisance: FloatArray) -> Information:
    """Return the information of the gyros on the rate, less the mean of the cells, and the amplitudes A.

    `slopes` (n, 8) are the derivatives of the exponentials.  `nuisance` (n, ...), sways and a bias in axes
    that creep, have amplitudes of N(0, 1) and are a correlated noise.
    """
    windows = cells.windows[cells.used]
    other = windows @ nuisance
    return information(
        np.column_stack([np.ones(len(windows)), windows @ slopes]),
        _real_parts(cells.rate[cells.used] - cells.mean_rate),
        cells.variance * cells.correlation + other @ other.T,
    )


def _by_accelerometers(
    cells: Cells, alpha: ColumnArray, row_s: float, middles: FloatArray, drift: Drift
) -> tuple[Information, float]:
    """Return the information of α, (n,), on rate and amplitudes, and its log density if the unit stands.

    `middles` (n, 8) are the exponentials.
    """
    used, means = cells.used, cells.windows @ alpha
    time_s = row_s * alpha.size / (len(used) + 1) * np.arange(1.0, len(used) + 1)
    knocks_s, at_s = time_s[~used & np.r_[True, used[:-1]]], time_s[used]
    noise, _, _ = scatter(means, used, TREND_ORDER)
    warm_up = -drift.warm_up_sd * np.expm1(-at_s[:, None] / np.array(drift.warm_up_tau_s))
    covariance = noise * cells.correlation + OFFSET_SD**2 + 1e-14 * np.eye(len(at_s))
    covariance += warm_up @ warm_up.T + drift.walk**2 * np.minimum.outer(at_s, at_s)
    for knock_s in knocks_s:  # the offset is unknown anew behind it
        covariance += OFFSET_SD**2 * np.outer(at_s > knock_s, at_s > knock_s)
    data = _real_parts(means[used] - means[used].mean())
    square = float(np.sum(data * np.linalg.solve(covariance, data)))
    log_density = -0.5 * square - float(np.linalg.slogdet(covariance)[1])
    design = np.column_stack([np.zeros(len(at_s)), cells.windows[used] @ middles])
    return information(design, data, covariance), log_density


def _rate_of_each_tilt(
    known: Information, log_density: float
) -> tuple[FloatArray, ColumnArray, FloatArray, BoolArray]:
    """Return log weight, mean rate, variance of each part, and whether φ settles, by hypothesis, (19,)."""
    of_rate, evidence = known.without(TILTS)
    precision = of_rate.matrix[:, 0, 0]
    mean = of_rate.vector[:, 0, :] / precision[:, None]
    evidence += 0.5 * precision * np.sum(mean**2, axis=1) - np.log(precision)
    settles = TILTS.max(axis=1) > STANDS_SD
    prior = np.where(settles, P_SETTLES / (len(TILTS) - 1), 1.0 - P_SETTLES)
    return evidence + np.log(prior) + log_density, mean @ np.array([1.0, 1j]), 1.0 / precision, settles


def _real_parts(values: ColumnArray) -> FloatArray:
    return np.column_stack([values.real, values.imag])
