"""Kalman filters on model L of Shi Gang et al. (3, 4): φ, δ¹ and δ² known, x_k and x_k-1 the states.

The strong-tracking filter (STF) multiplies the propagated covariance by a fading factor λ ≥ 1 that brings
the innovation's variance up to what is observed: λ = max(1, (V - q - βR) / (H F P Fᵀ Hᵀ)), q = δ¹² + δ²²,
with V = e² at the first innovation, then V ← (ρV + e²)/(1 + ρ), ρ = 0.95.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit

FORGETTING = 0.95


@dataclass(frozen=True, slots=True)
class Model:
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
    sd: FloatArray
    """x_k|k-1, x_k|k and its standard deviation, in the unit of the data."""
    phi: FloatArray
    phi_sd: FloatArray
    """φ of the model and its standard deviation."""


class SampleFilter:
    """A recursive filter of one axis: a compiled run over samples, and the state that it changes in place."""

    _run: Callable[..., None]

    def __init__(self, settings: NamedTuple, state: NamedTuple) -> None:
        self._settings, self._state = settings, state

    def process(self, reading: FloatArray, steps: FloatArray | None = None) -> Series:
        """Return the results at samples that follow those of the last call.

        Parameters
        ----------
        reading : array, (n,)
            Data; predicted only where it is NaN.
        steps : array, (n,), optional
            Time since the last sample in sampling intervals.  Default 1.
        """
        steps = np.ones(len(reading)) if steps is None else steps
        series = Series(*np.empty((len(Series._fields), len(reading))))
        type(self)._run(reading, steps, self._settings, self._state, series)
        return series


class Settings(NamedTuple):
    """φ, q = δ¹² + δ²², R, and β of the strong-tracking filter, negative for the plain Kalman filter."""

    phi: float
    process_variance: float
    noise_variance: float
    softening: float


class State(NamedTuple):
    """What the filter carries from sample to sample, changed in place."""

    mean: FloatArray
    covariance: FloatArray
    """Of (x_k, x_k-1), (2,)."""
    innovation_variance: FloatArray
    """V, the variance of the innovations as estimated so far, (1,); NaN before the first."""


@njit
def _run(reading: FloatArray, steps: FloatArray, settings: Settings, state: State, series: Series) -> None:
    """Filter samples; the state changes in place, the series is filled."""
    x, p, phi, noise = state.mean, state.covariance, settings.phi, settings.noise_variance
    for k in range(reading.size):
        use = np.isfinite(reading[k])
        x[0], x[1] = (1.0 + phi) * x[0] - phi * x[1], x[0]
        # F P Fᵀ with F = [[1 + φ, -φ], [1, 0]].
        across = (1.0 + phi) * p[0, 0] - phi * p[0, 1]
        p[0, 0], p[1, 1] = (1.0 + phi) * across - phi * ((1.0 + phi) * p[0, 1] - phi * p[1, 1]), p[0, 0]
        p[0, 1] = p[1, 0] = across
        process = settings.process_variance * steps[k]
        innovation = reading[k] - x[0]
        if use and settings.softening >= 0.0:
            p *= _fading(innovation, p[0, 0], process, settings, state)
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


@njit
def _fading(innovation: float, had: float, process: float, settings: Settings, state: State) -> float:
    """Return λ after an innovation, `had` being H F P Fᵀ Hᵀ."""
    v = state.innovation_variance
    square = innovation * innovation
    v[0] = square if np.isnan(v[0]) else (FORGETTING * v[0] + square) / (1.0 + FORGETTING)
    wanted = v[0] - process - settings.softening * settings.noise_variance
    return wanted / had if had > 0.0 and wanted > had else 1.0


class LinearFilter(SampleFilter):
    """Kalman filter on model L.

    Parameters
    ----------
    model : Model
    softening : float or None
        β of the strong-tracking filter; None for the plain Kalman filter.
    """

    _run = _run

    def __init__(self, model: Model, softening: float | None = None) -> None:
        _, _, phi, delta1, delta2 = model.mean
        beta = -1.0 if softening is None else softening
        mean, variance = np.array(model.mean[:2], np.float64), np.array(model.variance[:2], np.float64)
        super().__init__(
            Settings(phi, delta1**2 + delta2**2, model.noise_variance, beta),
            State(mean, np.diag(variance), np.full(1, np.nan)),
        )
