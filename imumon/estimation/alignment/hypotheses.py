"""Rate of one position in horizontal axes, given each hypothesis about slow tilts and accelerometer drift.

One linear regression, complex (forward + i left), on the cells of a record::

    gyros                       y = c + b + Σ A_k d/dt s_k + noise                  c earth rate, b bias
    accelerometers, as angle    α =         Σ A_k s_k + Σ B_j w_j + walk + noise
    unit that settles, accelerometers that warm up: s_k = 1 - exp(-t/τ_k), w_j = 1 - exp(-t/T_j)

The unknowns are the constant rate c + b and the amplitudes A and B, with two real parts each.  A hypothesis
is a prior of the amplitudes: the unit stands, or settles by three neighbours of the τ_k; the accelerometers
have warmed up, or warm up.  Mean, variance and evidence are closed forms; c + b has a flat prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.cells import (
    TREND_ORDER,
    Cells,
    correlation,
    divide,
    scatter,
    trend,
    without_sway,
)
from imumon.estimation.alignment.parameters import RemainingWarmUp
from imumon.estimation.alignment.record import HorizontalRows

SETTLING_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a tripod that settles, in octaves."""
TILT_SD, NOTHING = (1e-5, 1e-4, 1e-3), 1e-9
"""rad: sizes of a tilt; rad or g: what is none."""
P_SETTLES = 0.3
"""Prior probability of a settling tripod.  With 0.03 a slow tilt passes for a bias, 9 sigma off; ablation: 0
makes up to 8 times the error."""
WALK = 1e-7
"""Random walk of a warmed-up accelerometer, g/√s.  A drift of 1 µg is read as a tilt of 1 µrad."""
OFFSET_SD = 1e-3
"""Standard deviation of the constant part of α, and of its step in a knock, rad."""
LIKELY = -15.0
"""Log weight relative to the largest below which a hypothesis is dropped."""


def tilt_hypotheses(neighbours: int = 3) -> FloatArray:
    """Return the prior sd of the amplitude of each exponential, rad, (19, 8).

    The first hypothesis is that the unit stands; in the others some neighbouring exponentials have one size.
    A single exponential makes up to 10 times the error (ablation).
    """
    first = np.arange(len(SETTLING_TAU_S) - neighbours + 1)[:, None]
    offset = np.arange(len(SETTLING_TAU_S)) - first
    chosen = (offset >= 0) & (offset < neighbours)
    settles = [np.where(chosen, size, NOTHING) for size in TILT_SD]
    return np.concatenate([np.full((1, len(SETTLING_TAU_S)), NOTHING), *settles])


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


def information(design: FloatArray, data: ColumnArray, covariance: FloatArray) -> Information:
    """Return the information of complex data (m,) = design (m, n) x + noise with this covariance (m, m)."""
    weighted = np.linalg.solve(covariance, design).T
    return Information(weighted @ design, weighted @ np.column_stack([data.real, data.imag]))


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


def fit_position(data: HorizontalRows, warm_up: RemainingWarmUp) -> PositionFit | None:
    """Return the fit of one position given each hypothesis; None if the record is too short."""
    n = len(data.rate)
    courses = -np.expm1(-data.row_s * np.arange(n + 1.0)[:, None] / SETTLING_TAU_S)
    slopes, middles = np.diff(courses, axis=0) / data.row_s, 0.5 * (courses[1:] + courses[:-1])
    slow = np.column_stack([trend(n, TREND_ORDER), slopes])
    rate, alpha = without_sway(data.rate, data.alpha, data.valid, slow)
    cells = divide(data, rate)
    if cells is None:
        return None
    windows = cells.windows[cells.used]
    by_gyros = information(
        np.column_stack(
            [np.ones(len(windows)), windows @ slopes, np.zeros((len(windows), len(warm_up.tau_s)))]
        ),
        cells.rate[cells.used] - cells.mean_rate,
        cells.variance * correlation(cells.used),
    )
    by_accelerometers = _by_accelerometers(cells, alpha, data.row_s, middles, warm_up.tau_s)
    log_weight, rate, variance = _of_each_hypothesis(by_gyros.plus(by_accelerometers), warm_up)
    likely = log_weight > log_weight.max() + LIKELY
    return PositionFit(
        log_weight=log_weight[likely] - log_weight.max(),
        rate=rate[likely] + cells.mean_rate,
        variance=variance[likely],
        vertical=cells.vertical,
        vertical_variance=cells.vertical_variance,
        white=cells.white,
        attitude=data.attitude,
    )


def _by_accelerometers(
    cells: Cells, alpha: ColumnArray, row_s: float, middles: FloatArray, warm_up_tau_s: Sequence[float]
) -> Information:
    """Return the information of α, (n,), on rate and amplitudes; `middles` (n, 8) are the exponentials."""
    means, count = cells.windows @ alpha, len(cells.used)
    noise, used, _ = scatter(means, cells.used, TREND_ORDER)
    time_s = row_s * alpha.size / (count + 1) * np.arange(1.0, count + 1)
    at_s = time_s[used]
    covariance = noise * correlation(used) + WALK**2 * np.minimum.outer(at_s, at_s)
    covariance += OFFSET_SD**2 + 1e-14 * np.eye(len(at_s))
    for knock_s in time_s[~used & np.r_[True, used[:-1]]]:  # the offset is unknown anew behind it
        covariance += OFFSET_SD**2 * np.outer(at_s > knock_s, at_s > knock_s)
    warm = -np.expm1(-at_s[:, None] / np.array(warm_up_tau_s))
    design = np.column_stack([np.zeros(len(at_s)), cells.windows[used] @ middles, warm])
    return information(design, means[used] - means[used].mean(), covariance)


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
