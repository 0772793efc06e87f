"""Kalman filters on model L of Shi Gang et al. (eqs. 3 and 4), φ, δ¹ and δ² known, in square-root form.

The strong-tracking filter multiplies the propagated covariance by a fading factor λ ≥ 1 that brings the
innovation's variance up to what is seen: λ = max(1, (V - q - βR) / (H F P Fᵀ Hᵀ)), q = δ¹² + δ²²,
with V = e² at the first innovation, then V ← (ρV + e²)/(1 + ρ), ρ = 0.95.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray

FORGETTING = 0.95
SEEN, BEGUN, LARGEST = range(3)
"""Places of the fading state: V, whether there was an innovation, the largest λ."""


@dataclass(frozen=True, slots=True)
class ModelL:
    """Model L and where it begins.

    Parameters
    ----------
    phi, delta1, delta2 : float
        Parameters of x_k = (1+φ) x_k-1 - φ x_k-2 + δ¹ a_k - δ² a_k-1.
    mean, variance : tuple of 2 float
        (x_k, x_k-1) and the diagonal of its covariance.
    noise_variance : float
        R, of one measurement.
    """

    phi: float
    delta1: float
    delta2: float
    mean: tuple[float, float]
    variance: tuple[float, float]
    noise_variance: float


@dataclass(frozen=True, slots=True, eq=False)
class LinearSeries:
    """x_k|k-1, x_k|k and its standard deviation at each sample, (n,), in the unit of the data."""

    predicted: FloatArray
    estimate: FloatArray
    sd: FloatArray


class LinearFilter:
    """Kalman filter on model L.

    Parameters
    ----------
    model : ModelL
        Model, start and R.
    softening : float or None
        β of the strong-tracking filter; None for the plain Kalman filter.
    """

    def __init__(self, model: ModelL, softening: float | None = None) -> None:
        self._model = model
        self._softening = -1.0 if softening is None else softening
        self.mean = np.array(model.mean, np.float64)
        self.factor = np.diag(np.sqrt(np.array(model.variance, np.float64)))
        self._fading = np.zeros(3)

    @property
    def largest_fading(self) -> float:
        """The largest λ so far."""
        return float(self._fading[LARGEST])

    def process(self, reading: FloatArray, measured: npt.NDArray[np.bool_] | None = None) -> LinearSeries:
        """Return what the filter says at samples that follow; those NaN or not `measured` are passed over."""
        n = len(reading)
        use = np.isfinite(reading) if measured is None else measured & np.isfinite(reading)
        out = [np.empty(n) for _ in range(3)]
        model = self._model
        _run(
            reading,
            use,
            model.phi,
            model.delta1,
            model.delta2,
            model.noise_variance,
            self._softening,
            self.mean,
            self.factor,
            self._fading,
            *out,
        )
        return LinearSeries(*out)


@njit(cache=True, nogil=True)
def _run(
    reading: FloatArray,
    use: npt.NDArray[np.bool_],
    phi: float,
    delta1: float,
    delta2: float,
    noise_variance: float,
    softening: float,
    mean: FloatArray,
    factor: FloatArray,
    fading: FloatArray,
    predicted: FloatArray,
    estimate: FloatArray,
    sd: FloatArray,
) -> None:
    process = delta1 * delta1 + delta2 * delta2
    for k in range(reading.size):
        before = mean[0]
        mean[0] += phi * (mean[0] - mean[1])
        mean[1] = before
        # Row of x after the model, and the row of x before it; S is lower triangular.
        a, b = (1.0 + phi) * factor[0, 0] - phi * factor[1, 0], -phi * factor[1, 1]
        scale = 1.0
        residual = reading[k] - mean[0]
        if use[k] and softening >= 0.0:
            if fading[BEGUN] == 0.0:
                fading[SEEN], fading[BEGUN] = residual * residual, 1.0
            else:
                fading[SEEN] = (FORGETTING * fading[SEEN] + residual * residual) / (1.0 + FORGETTING)
            wanted = fading[SEEN] - process - softening * noise_variance
            had = a * a + b * b
            if had > 0.0 and wanted > had:
                scale = math.sqrt(wanted / had)
            fading[LARGEST] = max(fading[LARGEST], scale * scale)
        _triangular(factor, scale * a, scale * b, scale * factor[0, 0], process)
        predicted[k] = mean[0]
        if use[k]:
            spread = factor[0, 0]
            total = spread * spread + noise_variance
            shrink = math.sqrt(noise_variance / total)
            for i in range(2):
                mean[i] += factor[i, 0] * spread / total * residual
                factor[i, 0] *= shrink
        estimate[k], sd[k] = mean[0], factor[0, 0]


@njit(cache=True, nogil=True)
def _triangular(factor: FloatArray, a: float, b: float, c: float, process: float) -> None:
    """Set the factor of the covariance whose rows are [a, b, √process] and [c, 0, 0]."""
    square = a * a + b * b + process
    top = math.sqrt(square)
    factor[0, 0] = top
    if top > 0.0:
        factor[1, 0] = a * c / top
        factor[1, 1] = abs(c) * math.sqrt((b * b + process) / square)
    else:
        factor[1, 0], factor[1, 1] = 0.0, abs(c)
