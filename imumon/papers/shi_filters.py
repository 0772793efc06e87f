"""The filters of Shi Gang et al., in the paper's equation numbers: STF on model L, SR-UKF and SR-RSUKF on NL.

Model L (3, 4): φ, δ¹ and δ² are known, x_k and x_k-1 the states.  The strong-tracking filter (STF)
multiplies the propagated covariance by a fading factor λ ≥ 1 that brings the innovation's variance up to what
is observed: λ = max(1, (V - q - βR) / (H F P Fᵀ Hᵀ)), q = δ¹² + δ²²,
with V = e² at the first innovation, then V ← (ρV + e²)/(1 + ρ), ρ = 0.95.

Model NL: X = (x_k, x_k-1, φ, δ¹, δ²), in square-root form.  X is augmented with the noises (a_k, a_k-1):
n = 7 states, 14 sigma points X ± √7 S_j besides the central one (α = 1, β = κ = 0: weights 1/14, none
negative, and the central point counts for nothing).  The noise states are reset after every update (21), so
only the five real states are carried on, and the decomposition of (14) goes onto their five rows.

Risk (15) is P ← (P⁻¹ - 2μ)⁻¹.  The inverses, and the printed 7-state P, are singular at φ = 0, so it is
done on S.  Here only μ_x is not zero: removing 2μ_x from the information is removing a measurement of x of
variance 1/(2μ_x), which scales the first column of S.
Equation (20) as printed, U = P_xz S_z, is wrong by S_z²: it must be P_xz / S_z.

The steps are compiled: they run at every sample, and in NumPy one takes 52 µs, compiled 0.5.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit

FORGETTING = 0.95
N = 5
X, BEFORE, PHI, DELTA1, DELTA2 = range(N)
"""Places of the states in X."""
NOISES = 2
POINTS = 2 * (N + NOISES)
"""Sigma points besides the central one."""
GAMMA = math.sqrt(N + NOISES)

STEP_CEILING = 0.9999
"""2 μ_x P_xx may not be more in any step; μ_x is shrunk for the step when it would."""
REGULAR = 1.5
"""A step of so many intervals or more is a gap: φ does not describe it."""


class Model(NamedTuple):
    """Where a filter begins: X = (x_k, x_k-1, φ, δ¹, δ²) of x_k = (1+φ) x_k-1 - φ x_k-2 + δ¹ a_k - δ² a_k-1.

    In model L the last three are known.
    """

    mean: Sequence[float]
    variance: Sequence[float]
    """X and the diagonal of its covariance, in the unit of the data and its square (φ has none)."""
    noise_variance: float
    """R, of one measurement."""


class Series(NamedTuple):
    """Results of a filter at each sample, (n,)."""

    predicted: FloatArray
    estimate: FloatArray
    sd: FloatArray  # x_k|k-1, x_k|k and its standard deviation, in the unit of the data
    phi: FloatArray
    phi_sd: FloatArray  # φ of the model and its standard deviation


class SampleFilter:
    """A recursive filter of one axis: a compiled run over samples, and the arrays that it changes in place.

    `run`: fills a series, given readings, steps and what follows.
    """

    def __init__(self, run: Callable[..., None], *carried: object) -> None:
        self._run, self._carried = run, carried

    def process(self, reading: FloatArray, steps: FloatArray | None = None) -> Series:
        """Return the results at samples that follow those of the last call.

        `reading` (n,): data; predicted only where it is NaN.
        `steps` (n,): time since the last sample in sampling intervals.  Default 1.
        """
        steps = np.ones(len(reading)) if steps is None else steps
        series = Series(*np.empty((len(Series._fields), len(reading))))
        self._run(series, reading, steps, *self._carried)
        return series


@njit
def _run_linear(
    series: Series,
    reading: FloatArray,
    steps: FloatArray,
    phi: float,
    variance: float,
    noise: float,
    softening: float,
    x: FloatArray,
    p: FloatArray,
    v: FloatArray,
) -> None:
    """Filter samples with q and R; x and P of (x_k, x_k-1), and V, (1,), NaN before the first innovation, are
    carried."""
    for k in range(reading.size):
        use = np.isfinite(reading[k])
        x[0], x[1] = (1.0 + phi) * x[0] - phi * x[1], x[0]
        # F P Fᵀ with F = [[1 + φ, -φ], [1, 0]].
        across = (1.0 + phi) * p[0, 0] - phi * p[0, 1]
        p[0, 0], p[1, 1] = (1.0 + phi) * across - phi * ((1.0 + phi) * p[0, 1] - phi * p[1, 1]), p[0, 0]
        p[0, 1] = p[1, 0] = across
        process = variance * steps[k]
        innovation = reading[k] - x[0]
        if use:
            square = innovation * innovation
            v[0] = square if np.isnan(v[0]) else (FORGETTING * v[0] + square) / (1.0 + FORGETTING)
            wanted, had = v[0] - process - softening * noise, p[0, 0]  # H F P Fᵀ Hᵀ
            if had > 0.0 and wanted > had:
                p *= wanted / had
        p[0, 0] += process
        series.predicted[k] = x[0]
        if use:
            total = p[0, 0] + noise
            gain, before = p[0, 0] / total, p[1, 0] / total
            x[0] += gain * innovation
            x[1] += before * innovation
            p[1, 1] -= before * p[1, 0]
            p[0, 0] *= noise / total
            p[0, 1] = p[1, 0] = before * noise
        series.estimate[k], series.sd[k] = x[0], np.sqrt(p[0, 0])
        series.phi[k], series.phi_sd[k] = phi, 0.0


class LinearFilter(SampleFilter):
    """Strong-tracking filter on model L; with an infinite β (`softening`) it is the plain Kalman filter."""

    def __init__(self, model: Model, softening: float = math.inf) -> None:
        _, _, phi, delta1, delta2 = model.mean
        known = phi, delta1**2 + delta2**2, model.noise_variance, softening
        mean, variance = np.array(model.mean[:2], np.float64), np.array(model.variance[:2], np.float64)
        super().__init__(_run_linear, *known, mean, np.diag(variance), np.full(1, np.nan))


@njit
def _run_sigma_points(
    series: Series,
    reading: FloatArray,
    steps: FloatArray,
    noise_variance: float,
    phi_limit: float,
    risk: float,
    mean: FloatArray,
    factor: FloatArray,
) -> None:
    """Filter samples; X and S are carried."""
    deviations = np.empty((N, POINTS))
    for k in range(reading.size):
        use = np.isfinite(reading[k])
        if use and steps[k] < REGULAR:
            predict(mean, factor, deviations, steps[k])
        else:
            hold(mean, factor, deviations, steps[k])
        if use and risk > 0.0:
            take_risk(factor, risk)
        series.predicted[k] = mean[X]
        if use:
            measure(mean, factor, reading[k], noise_variance)
            mean[PHI] = min(max(mean[PHI], -phi_limit), phi_limit)
        series.estimate[k], series.sd[k] = mean[X], factor[X, X]
        series.phi[k] = mean[PHI]
        series.phi_sd[k] = math.sqrt((factor[PHI] ** 2).sum())


@njit
def _model(x: FloatArray, newer: float, older: float) -> float:
    """Return x_k of model NL (5) from X_k-1 and the noises a_k, a_k-1."""
    return float((1.0 + x[PHI]) * x[X] - x[PHI] * x[BEFORE] + x[DELTA1] * newer - x[DELTA2] * older)


@njit
def predict(mean: FloatArray, factor: FloatArray, deviations: FloatArray, noise: float) -> None:
    """Apply model NL to sigma points (12 to 14); `noise` is Q, `deviations` (5, 14) is room to work in."""
    centre, root, point = _model(mean, 0.0, 0.0), GAMMA * math.sqrt(noise), np.empty(N)
    for j in range(POINTS):
        column, sign = j // 2, 1.0 - 2.0 * (j % 2)
        for i in range(N):
            deviations[i, j] = sign * GAMMA * factor[i, column] if column < N else 0.0
            point[i] = mean[i] + deviations[i, j]
        # x_k-1 is the x_k of before, and φ, δ¹ and δ² stay: their means do, too.
        newer, older = sign * root * (column == N), sign * root * (column == N + 1)
        deviations[BEFORE, j], deviations[X, j] = deviations[X, j], _model(point, newer, older) - centre
    shift = deviations[X].mean()
    deviations[X] -= shift
    deviations /= math.sqrt(POINTS)
    mean[BEFORE], mean[X] = mean[X], centre + shift
    _lower(deviations, factor)


@njit
def hold(mean: FloatArray, factor: FloatArray, deviations: FloatArray, noise: float) -> None:
    """Let x stay where it is, less and less known: in motion and in gaps there is no difference to go on."""
    deviations[:] = 0.0
    deviations[:, :N] = factor
    deviations[BEFORE, :N] = factor[X]
    deviations[X, N] = math.sqrt((mean[DELTA1] ** 2 + mean[DELTA2] ** 2) * noise)
    mean[BEFORE] = mean[X]
    _lower(deviations, factor)


@njit
def _lower(wide: FloatArray, factor: FloatArray) -> None:
    """Fill the lower triangular S with S Sᵀ = W Wᵀ, by Householder reflections; W (5, 14) is used up."""
    for i in range(N):
        row = wide[i, i:]
        length = math.copysign(math.sqrt((row * row).sum()), row[0])
        row[0] += length  # now the reflection's vector
        half_square = length * row[0]
        # The sign of a column of S is free: the diagonal is kept positive.
        factor[i, i], factor[i, i + 1 :] = abs(length), 0.0
        for k in range(i + 1, N):
            if half_square > 0.0:
                along = 0.0
                for j in range(i, POINTS):
                    along += wide[i, j] * wide[k, j]
                for j in range(i, POINTS):
                    wide[k, j] -= along / half_square * wide[i, j]
            factor[k, i] = -math.copysign(1.0, length) * wide[k, i]


@njit
def take_risk(factor: FloatArray, risk: float) -> None:
    """Raise the covariance by the risk (15): of S the first column, by √(σ²/(σ² - P_xx)), σ² = 1/(2μ_x)."""
    variance, limit = factor[X, X] * factor[X, X], 0.5 / risk
    if variance > STEP_CEILING * limit:
        limit = variance / STEP_CEILING
    factor[:, X] *= math.sqrt(limit / (limit - variance))


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
    """SR-RSUKF of one axis; with μ_x = 0 it is the SR-UKF.

    The limit of a lasting risk on a random walk is 2 μ_x (R + q) = 1, where the variance escapes; what would
    cross `STEP_CEILING` in a step is shrunk.

    `risk`: μ_x in 1/unit²; φ, δ¹ and δ², which nothing measures, have none.
    `phi_limit`: φ is held within ±phi_limit; infinity lets it go, as the paper does.
    `mean`, `factor`: X and the lower triangular S of its covariance S Sᵀ, (5,).
    """

    def __init__(self, model: Model, risk: float = 0.0, phi_limit: float = math.inf) -> None:
        self.mean = np.array(model.mean, np.float64)
        self.factor = np.diag(np.sqrt(np.array(model.variance, np.float64)))
        super().__init__(_run_sigma_points, model.noise_variance, phi_limit, risk, self.mean, self.factor)
