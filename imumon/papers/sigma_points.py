"""SR-UKF and SR-RSUKF of Shi Gang et al. on model NL: X = (x_k, x_k-1, φ, δ¹, δ²), in square-root form.

Equation numbers are the paper's.  X is augmented with the noises (a_k, a_k-1): n = 7 states, 14 sigma points
X ± √7 S_j besides the central one (α = 1, β = κ = 0: weights 1/14, none negative, and the central point
counts for nothing).  The noise states are reset after every update (21), so only the five real states are
carried on, and the decomposition of (14) goes onto their five rows.

Risk (15) is P ← (P⁻¹ - 2μ)⁻¹.  The inverses, and the printed 7-state P, are singular at φ = 0, so it is
done on S: removing 2μ_i from the information is removing a measurement of variance 1/(2μ_i), entry by entry.
Equation (20) as printed, U = P_xz S_z, is wrong by S_z²: it must be P_xz / S_z.

The steps are compiled: they run at every sample, and in NumPy one takes 52 µs, compiled 0.5.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.papers.linear import Model, SampleFilter, Series

N = 5
X, BEFORE, PHI, DELTA1, DELTA2 = range(N)
"""Places of the states in X."""
NOISES = 2
POINTS = 2 * (N + NOISES)
"""Sigma points besides the central one."""
GAMMA = math.sqrt(N + NOISES)

STEP_CEILING = 0.9999
"""2 μ_i P_ii may not be more in any step; μ_i is shrunk for the step when it would."""
REGULAR = 1.5
"""A step of so many intervals or more is a gap: φ does not describe it."""


class Settings(NamedTuple):
    """R, the diagonal of μ (5,), and the limit of φ."""

    noise_variance: float
    risk: FloatArray
    phi_limit: float


class State(NamedTuple):
    """What the filter carries from sample to sample, changed in place."""

    mean: FloatArray
    factor: FloatArray
    """X and the lower triangular S of its covariance S Sᵀ, (5,)."""
    shrunk: IntArray
    """Steps with a smaller μ, (1,)."""


@njit
def _run(reading: FloatArray, steps: FloatArray, settings: Settings, state: State, series: Series) -> None:
    """Filter samples; the state changes in place, the series is filled."""
    mean, factor = state.mean, state.factor
    deviations = np.empty((N, POINTS))
    for k in range(reading.size):
        use = np.isfinite(reading[k])
        if use and steps[k] < REGULAR:
            predict(mean, factor, deviations, steps[k])
        else:
            hold(mean, factor, deviations, steps[k])
        if use and take_risk(factor, settings.risk):
            state.shrunk[0] += 1
        series.predicted[k] = mean[X]
        if use:
            measure(mean, factor, reading[k], settings.noise_variance)
            mean[PHI] = min(max(mean[PHI], -settings.phi_limit), settings.phi_limit)
        series.estimate[k], series.sd[k] = mean[X], factor[X, X]
        series.phi[k] = mean[PHI]
        series.phi_sd[k] = math.sqrt(factor[PHI, X] ** 2 + factor[PHI, BEFORE] ** 2 + factor[PHI, PHI] ** 2)


@njit
def _model(x: FloatArray, newer: float, older: float) -> float:
    """Return x_k of model NL (5) from X_k-1 and the noises a_k, a_k-1."""
    return float((1.0 + x[PHI]) * x[X] - x[PHI] * x[BEFORE] + x[DELTA1] * newer - x[DELTA2] * older)


@njit
def predict(mean: FloatArray, factor: FloatArray, deviations: FloatArray, noise: float) -> None:
    """Apply model NL to sigma points (12 to 14); `noise` is Q, `deviations` (5, 14) is room to work in."""
    centre = _model(mean, 0.0, 0.0)
    point, root = np.empty(N), GAMMA * math.sqrt(noise)
    shift, scale = 0.0, 1.0 / math.sqrt(POINTS)
    for j in range(POINTS):
        column, sign = j // 2, 1.0 - 2.0 * (j % 2)
        newer = sign * root if column == N else 0.0
        older = sign * root if column == N + 1 else 0.0
        for i in range(N):
            more = sign * GAMMA * factor[i, column] if column < N else 0.0
            point[i] = mean[i] + more
            # x_k-1 is the x_k of before, and φ, δ¹ and δ² stay: their means do, too.
            if i == X:
                deviations[BEFORE, j] = scale * more
            elif i != BEFORE:
                deviations[i, j] = scale * more
        deviations[X, j] = _model(point, newer, older) - centre
        shift += deviations[X, j] / POINTS
    mean[BEFORE], mean[X] = mean[X], centre + shift
    for j in range(POINTS):
        deviations[X, j] = scale * (deviations[X, j] - shift)
    _lower(deviations, factor)


@njit
def hold(mean: FloatArray, factor: FloatArray, deviations: FloatArray, noise: float) -> None:
    """Let x stay where it is, less and less known: in motion and in gaps there is no difference to go on."""
    for j in range(POINTS):
        for i in range(N):
            same = X if i == BEFORE else i
            deviations[i, j] = factor[same, j] if j < N else 0.0
    deviations[X, N] = math.sqrt((mean[DELTA1] ** 2 + mean[DELTA2] ** 2) * noise)
    mean[BEFORE] = mean[X]
    _lower(deviations, factor)


@njit
def _lower(wide: FloatArray, factor: FloatArray) -> None:
    """Fill the lower triangular S with S Sᵀ = W Wᵀ, by Householder reflections; W (5, 14) is used up."""
    columns = wide.shape[1]
    for i in range(N):
        total = 0.0
        for j in range(i, columns):
            total += wide[i, j] ** 2
        length = math.copysign(math.sqrt(total), wide[i, i])
        # Twice the inverse square of the reflection's vector v = row + length e_i.
        scale = total + abs(length * wide[i, i])
        if scale > 0.0:
            wide[i, i] += length
            for row in range(i + 1, N):
                along = 0.0
                for j in range(i, columns):
                    along += wide[i, j] * wide[row, j]
                along /= scale
                for j in range(i, columns):
                    wide[row, j] -= along * wide[i, j]
        # The sign of a column of S is free: the diagonal is kept positive.
        factor[i, i] = abs(length)
        for row in range(i + 1, N):
            factor[row, i] = -math.copysign(1.0, length) * wide[row, i]
            factor[i, row] = 0.0


@njit
def take_risk(factor: FloatArray, risk: FloatArray) -> bool:
    """Raise the covariance by the risk (15); return whether an entry of it had to be smaller.

    With f = row i of S, σ² = 1/(2μ_i) and d_j = σ² - Σ_{k≥j} f_k², the lower triangular B with
    B Bᵀ = E + f fᵀ/(σ² - fᵀf) has B_jj = √(d_j+1/d_j) and B_lj = f_l f_j / √(d_j+1 d_j), l > j; then S ← S B.
    """
    shrunk = False
    for i in range(N):
        if risk[i] == 0.0:
            continue
        variance = 0.0
        for j in range(i + 1):
            variance += factor[i, j] ** 2
        limit = 0.5 / risk[i]
        if variance > STEP_CEILING * limit:
            limit = variance / STEP_CEILING
            shrunk = True
        if limit == 0.0:
            continue
        gain = np.zeros(N)
        above = limit
        for j in range(i, -1, -1):
            f = factor[i, j]
            d = above - f * f
            b, c = math.sqrt(above / d), f / math.sqrt(above * d)
            for row in range(j, N):
                old = factor[row, j]
                factor[row, j] = b * old + c * gain[row]
                gain[row] += old * f
            above = d
    return shrunk


@njit
def measure(mean: FloatArray, factor: FloatArray, reading: float, noise_variance: float) -> None:
    """Take in x + noise (16 to 20): with x first, only the first column of S changes."""
    spread = factor[X, X]
    total = spread * spread + noise_variance
    residual = reading - mean[X]
    shrink = math.sqrt(noise_variance / total)
    for i in range(N):
        mean[i] += factor[i, X] * spread / total * residual
        factor[i, X] *= shrink


class SigmaPointFilter(SampleFilter):
    """SR-RSUKF of one axis; with μ = 0 it is the SR-UKF.

    The limit of a lasting risk on a random walk is 2 μ_x (R + q) = 1, where the variance escapes; what would
    cross `STEP_CEILING` in a step is shrunk.

    Parameters
    ----------
    model : Model
    risk : sequence of 5 float
        Diagonal of μ in 1/unit²; zero for φ, δ¹ and δ², which nothing measures.
    phi_limit : float
        φ is held within ±phi_limit; infinity lets it go, as the paper does.
    """

    _run = _run

    def __init__(self, model: Model, risk: Sequence[float] = (0.0,) * N, phi_limit: float = math.inf) -> None:
        self.settings = Settings(model.noise_variance, np.array(risk, np.float64), phi_limit)
        factor = np.diag(np.sqrt(np.array(model.variance, np.float64)))
        self.state = State(np.array(model.mean, np.float64), factor, np.zeros(1, np.int64))
        super().__init__(self.settings, self.state)
