"""SR-UKF and SR-RSUKF of Shi Gang et al. on model NL: X = (x_k, x_k-1, φ, δ¹, δ²), in square-root form.

The paper augments X with the noises (a_k, a_k-1): 7 states, 14 sigma points X ± √7 S_j (α = 1, β = κ = 0:
all weights 1/14, none negative, and the central point counts for nothing).  The noise states are reset after
every update (eq. 21), so only X need be carried on, and QR onto its 5 rows is enough.

Two facts make that cheap.

- Rotate each pair of columns ±j by 45°.  One becomes the odd part of the model, the other the even part,
  which only x_k has: with Δ = x_k-1 - x_k-2 and rows s of S, x_k = x + φΔ + √7 o_j + 7 c_j,
  o_j = (1+φ) s_0j - φ s_1j + Δ s_2j and c_j = s_2j (s_0j - s_1j).  The mean gains Σc, the variance
  (δ¹² + δ²²) Q + 7 Σc² - (Σc)²: one column beside the five odd ones.
- With x_k first and S lower triangular, a measurement of x_k changes the first column of S only.

Risk (eq. 15) is P ← (P⁻¹ - 2μ)⁻¹.  The inverses, and the printed 7-state P, are singular at φ = 0, so it is
done on S: removing 2μ_i from the information is removing a measurement of variance 1/(2μ_i), entry by entry.
Equation (20) as printed, U = P_xz S_z, is wrong by S_z²: it must be P_xz / S_z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.estimation.random_error.parameters import LARGEST_RISK

STATES = ("x", "x_before", "phi", "delta1", "delta2")
N = len(STATES)
X, BEFORE, PHI, DELTA1, DELTA2 = range(N)

CEILING = LARGEST_RISK
"""2 μ_x (R + q) may not be more: at 1 the variance escapes (limit of a lasting risk on a random walk)."""
STEP_CEILING = 0.9999
"""2 μ_i P_ii may not be more in any step; μ_i is shrunk for the step when it would."""
REGULAR = 1.5
"""A step of so many intervals or more is a gap: φ says nothing of it."""

SHRUNK, CLAMPED = range(2)
"""Places of the counters: steps with a smaller μ, and steps at which φ was held back."""


@dataclass(frozen=True, slots=True)
class ModelNL:
    """Where model NL begins.

    Parameters
    ----------
    mean, variance : sequence of 5 float
        X and the diagonal of its covariance, in the unit of the data and its square (φ has none).
    noise_variance : float
        R, of one measurement.
    """

    mean: Sequence[float]
    variance: Sequence[float]
    noise_variance: float

    @property
    def process_variance(self) -> float:
        """What a step adds to the variance of x: δ¹² + δ²²."""
        return self.mean[DELTA1] ** 2 + self.mean[DELTA2] ** 2


@dataclass(frozen=True, slots=True, eq=False)
class FilterSeries:
    """What a filter says at each sample, arrays of shape (n,).

    Parameters
    ----------
    predicted, estimate, sd : array
        x_k|k-1, x_k|k and its standard deviation, in the unit of the data.
    phi, phi_sd : array
        φ and its standard deviation.
    """

    predicted: FloatArray
    estimate: FloatArray
    sd: FloatArray
    phi: FloatArray
    phi_sd: FloatArray


class SigmaPointFilter:
    """SR-RSUKF of one axis; with μ = 0 it is the SR-UKF.

    Parameters
    ----------
    model : ModelNL
        Mean and covariance to start from, and R.
    risk : sequence of 5 float
        Diagonal of μ in 1/unit²; nought for φ, δ¹ and δ².
    phi_limit : float
        φ is held within ±phi_limit; infinity lets it go, as the paper does.

    Raises
    ------
    ImumonError
        BAD_CONFIG when μ would make the covariance lose its sign, with the limit.
    """

    def __init__(
        self, model: ModelNL, risk: Sequence[float] = (0.0,) * N, phi_limit: float = math.inf
    ) -> None:
        check_risk(model, risk)
        self._noise_variance = model.noise_variance
        self._risk = np.array(risk, np.float64)
        self._phi_limit = phi_limit
        self.mean = np.array(model.mean, np.float64)
        self.factor = np.diag(np.sqrt(np.array(model.variance, np.float64)))
        self._counts: IntArray = np.zeros(2, np.int64)

    @property
    def shrunk_steps(self) -> int:
        """Steps at which μ had to be smaller."""
        return int(self._counts[SHRUNK])

    @property
    def clamped_steps(self) -> int:
        """Steps at which φ wanted to leave its limits."""
        return int(self._counts[CLAMPED])

    def process(
        self,
        reading: FloatArray,
        measured: npt.NDArray[np.bool_] | None = None,
        steps: FloatArray | None = None,
    ) -> FilterSeries:
        """Return what the filter says at samples that follow those of the last call.

        Parameters
        ----------
        reading : array, (n,)
            Data; not used where it is NaN or not `measured`.
        measured : array of bool, (n,), optional
            Whether the sample may be learnt from: the unit is at rest.  Default always.
        steps : array, (n,), optional
            Time since the last sample in sampling intervals.  Default 1.
        """
        n = len(reading)
        use = np.isfinite(reading) if measured is None else measured & np.isfinite(reading)
        steps = np.ones(n) if steps is None else steps
        out = [np.empty(n) for _ in range(5)]
        run_sigma_points(
            reading,
            use,
            steps,
            self._noise_variance,
            self._risk,
            self._phi_limit,
            self.mean,
            self.factor,
            self._counts,
            *out,
        )
        return FilterSeries(*out)


def check_risk(model: ModelNL, risk: Sequence[float]) -> None:
    """Refuse a risk that breaks the filter at once or in the long run.

    Raises
    ------
    ImumonError
        BAD_CONFIG, with what was given and the limit.
    """
    names = dict(zip(STATES, risk, strict=True))
    if any(value < 0.0 or not math.isfinite(value) for value in risk):
        raise ImumonError(Reason.BAD_CONFIG, f"risk μ {names}", "μ must be finite and not negative")
    for i in (PHI, DELTA1, DELTA2):
        if risk[i] > 0.0 and model.variance[i] > 0.0:
            escape = 1.0 / (2.0 * risk[i] * model.variance[i])
            raise ImumonError(
                Reason.BAD_CONFIG,
                f"risk μ {risk[i]:g} on {STATES[i]}: its variance {model.variance[i]:g} escapes at step "
                f"{escape:.0f}, because nothing measures it",
                "put the risk on x alone",
            )
    both = risk[X] + risk[BEFORE]
    scale = 2.0 * (model.noise_variance + model.process_variance)
    if both * scale > CEILING * (1.0 + 1e-9):
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"risk μ {both:g} on x: 2μ(R + q) is {both * scale:.3g}, and the variance escapes at 1",
            f"μ may be {CEILING / scale:.6g} at most with R + q = {scale / 2:.6g}",
        )
    phi, x, before = model.mean[PHI], model.variance[X], model.variance[BEFORE]
    delta = model.mean[X] - model.mean[BEFORE]
    first = (1 + phi) ** 2 * x + phi**2 * before + delta**2 * model.variance[PHI] + model.process_variance
    if 2.0 * risk[X] * first >= 1.0:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"risk μ {risk[X]:g} on x: 2μP is {2 * risk[X] * first:.3g} at the first step, 1 or more",
            f"μ must be below {0.5 / first:.6g}, or the start better known",
        )


@njit(cache=True, nogil=True)
def run_sigma_points(
    reading: FloatArray,
    use: npt.NDArray[np.bool_],
    steps: FloatArray,
    noise_variance: float,
    risk: FloatArray,
    phi_limit: float,
    mean: FloatArray,
    factor: FloatArray,
    counts: IntArray,
    predicted: FloatArray,
    estimate: FloatArray,
    sd: FloatArray,
    phi: FloatArray,
    phi_sd: FloatArray,
) -> None:
    """Filter samples; mean (5,), factor (5, 5) and counts (2,) change in place, the last five are filled."""
    work = np.zeros((N, N + 1))
    for k in range(reading.size):
        if use[k] and steps[k] < REGULAR:
            predict(mean, factor, work, steps[k])
        else:
            hold(mean, factor, work, steps[k])
        if use[k]:
            if take_risk(factor, risk):
                counts[SHRUNK] += 1
            predicted[k] = mean[X]
            measure(mean, factor, reading[k], noise_variance)
            if abs(mean[PHI]) > phi_limit:
                mean[PHI] = math.copysign(phi_limit, mean[PHI])
                counts[CLAMPED] += 1
        else:
            predicted[k] = mean[X]
        estimate[k], sd[k] = mean[X], abs(factor[X, X])
        phi[k] = mean[PHI]
        total = 0.0
        for j in range(PHI + 1):
            total += factor[PHI, j] ** 2
        phi_sd[k] = math.sqrt(total)


@njit(cache=True, nogil=True)
def predict(mean: FloatArray, factor: FloatArray, work: FloatArray, noise: float) -> None:
    """Apply model NL (eqs. 12 to 14) to mean and factor; `noise` is Q."""
    phi, delta = mean[PHI], mean[X] - mean[BEFORE]
    shift, squares = 0.0, 0.0
    for j in range(PHI + 1):
        c = factor[PHI, j] * (factor[X, j] - factor[BEFORE, j])
        shift += c
        squares += c * c
        work[X, j] = (1.0 + phi) * factor[X, j] - phi * factor[BEFORE, j] + delta * factor[PHI, j]
    work[X, DELTA1] = work[X, DELTA2] = 0.0
    even = max(7.0 * squares - shift * shift, 0.0)
    work[X, N] = math.sqrt((mean[DELTA1] ** 2 + mean[DELTA2] ** 2) * noise + even)
    mean[BEFORE], mean[X] = mean[X], mean[X] + phi * delta + shift
    _triangular(factor, work)


@njit(cache=True, nogil=True)
def hold(mean: FloatArray, factor: FloatArray, work: FloatArray, noise: float) -> None:
    """Let x stay where it is, less and less known: in motion and in gaps there is no difference to go on."""
    for j in range(N):
        work[X, j] = factor[X, j]
    work[X, N] = math.sqrt((mean[DELTA1] ** 2 + mean[DELTA2] ** 2) * noise)
    mean[BEFORE] = mean[X]
    _triangular(factor, work)


@njit(cache=True, nogil=True)
def _triangular(factor: FloatArray, work: FloatArray) -> None:
    """Turn the new row of x in `work` and the rows of `factor` into the new lower triangular factor.

    Givens rotations of columns; most entries are nought, so few are needed.
    """
    for j in range(N):
        work[BEFORE, j] = factor[X, j]
        for i in range(PHI, N):
            work[i, j] = factor[i, j]
    for i in range(BEFORE, N):
        work[i, N] = 0.0
    for i in range(N):
        for j in range(i + 1, N + 1):
            b = work[i, j]
            if b == 0.0:
                continue
            a = work[i, i]
            length = math.sqrt(a * a + b * b)
            if length == 0.0:
                # Both squares vanish: too small to matter beside anything that is measured.
                work[i, j] = 0.0
                continue
            c, s = a / length, b / length
            work[i, i], work[i, j] = length, 0.0
            for row in range(i + 1, N):
                a, b = work[row, i], work[row, j]
                work[row, i] = c * a + s * b
                work[row, j] = c * b - s * a
    for i in range(N):
        for j in range(N):
            factor[i, j] = work[i, j]


@njit(cache=True, nogil=True)
def take_risk(factor: FloatArray, risk: FloatArray) -> bool:
    """Raise the covariance by the risk (eq. 15); return whether an entry of it had to be smaller.

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


@njit(cache=True, nogil=True)
def measure(mean: FloatArray, factor: FloatArray, reading: float, noise_variance: float) -> None:
    """Take in x + noise (eqs. 16 to 20): the first column of S is all that changes."""
    spread = factor[X, X]
    total = spread * spread + noise_variance
    residual = reading - mean[X]
    shrink = math.sqrt(noise_variance / total)
    for i in range(N):
        mean[i] += factor[i, X] * spread / total * residual
        factor[i, X] *= shrink
