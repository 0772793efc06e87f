"""The model of a gyro's bias, and the modes: hypotheses of its noise and slope.

Per axis the state is::

    x = [w, g1, g2, g3, s, m1, m2, m3]

    w   walk, rad/s                 w' = w + s dT + N(0, K² dt)
    gi  flicker, rad/s              gi' = e^(-dt/τi) gi + N(0, σg² (1 - e^(-2 dt/τi))),  τ = 1, 30, 1000 s
    s   slope over temperature      s' = s + N(0, σs² |dT| / 30 °C)
    m   sensitivity to the specific force, rad/s per m/s², constant

    bias = w + g1 + g2 + g3 + m f = H x

All variances are in units of the variance σ² of the mean of one second of white noise, which is not known.
Three Gauss-Markov processes of one variance, a decade and a half apart, are flicker noise of coefficient B:
σg² = B² ln(τ3/τ2) / π: flicker has a variance of B² ln(ratio) / π in each interval of time constants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import STANDARD_GRAVITY

STATES = 8
WALK, FLICKER, SLOPE, SENSITIVITY = 0, slice(1, 4), 4, slice(5, 8)
TAUS_S = np.array([1.0, 30.0, 1000.0])
"""Time constants of the flicker: from a second to the longest rest that matters."""
FLOOR_OF_FLICKER = 0.664
"""Floor of the Allan deviation over B, sqrt(2 ln 2 / π) (IEEE 952)."""
FLICKER_CORNERS_S = (100.0, 10.0, 1.0, 0.1)
"""Averaging times at which flicker overtakes white noise."""
STRONG_FLICKER = 2.0
"""Prior of flicker that overtakes at 1 s over that of any other level: it is not observable in the first
seconds, and a gyro of 40 °/h was off by 8 sigmas in them."""
WALK_CORNER_S = 10.0
"""The same of a random walk: white noise and a walk of K are equal at √3 σ/K."""
SLOPE_PER_SIGMA = 3.6
"""Standard deviation of the slope over σ, 1/°C: 60 °/h/°C for a gyro of 0.28 °/√h."""
SLOPE_LEFT_PER_SIGMA = 0.25
"""The same of what a model's curve leaves."""
SLOPE_DEGC = 30.0
"""Difference of temperature over which a slope changes by as much as itself."""
SENSITIVITY_SD = math.radians(0.05) / STANDARD_GRAVITY
"""Standard deviation of an entry of the matrix of sensitivity, rad/s per m/s², of an uncompensated gyro; with
a second, smaller level a gyro between both was off by 9 sigma."""
FASTEST_S = 0.02
"""Down to here the flicker of single samples goes on."""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """F modes, each a filter: a noise level and a size of the slope.

    Variances are over σ²; arrays (3, F, ...) are of the three axes.
    """

    process: FloatArray
    """Q: of w per second, of each gi when it is in equilibrium, of s per °C, (3, F, 8)."""
    fast: FloatArray
    """Flicker of a sample that the filter does not follow, (3, F)."""
    log_prior: FloatArray
    """Logarithm of the prior weight of each mode, (3, F)."""

    @property
    def count(self) -> int:
        """F."""
        return int(self.fast.shape[1])


def modes_of(
    white: FloatArray, b: FloatArray | None, k: FloatArray | None, slopes: tuple[float, ...]
) -> Modes:
    """Return each noise level with each slope.

    Flicker B, rad/s, and walk K, rad/s/√s, (3,) each, are of the one declared level, over white noise σ² of a
    second, (rad/s)², (3,); or None.  `slopes` are standard deviations of the slope over σ, 1/°C.
    """
    if b is None or k is None:
        corners = np.array(FLICKER_CORNERS_S)
        flicker = 1.0 / (FLOOR_OF_FLICKER * np.sqrt(corners))
        b = np.tile([*flicker, 0.05 * flicker[0]], (3, 1))
        k = np.tile([*0.0 * corners, math.sqrt(3.0) / WALK_CORNER_S], (3, 1))
        prior = np.array([*np.where(corners == 1.0, STRONG_FLICKER, 1.0), 1.0])
    else:
        b, k = ((one / np.sqrt(white))[:, np.newaxis] for one in (b, k))
        prior = np.ones(1)
    slope = np.tile(slopes, len(prior))
    b, k, prior = (np.repeat(one, len(slopes), axis=-1) for one in (b, k, prior))
    variance = b**2 * math.log(TAUS_S[2] / TAUS_S[1]) / math.pi
    process = np.zeros((*b.shape, STATES))
    process[..., WALK] = k**2
    process[..., FLICKER] = variance[..., np.newaxis]
    process[..., SLOPE] = slope**2 / SLOPE_DEGC
    # What is faster than the fastest process, and that process at the end of a second less its mean over it:
    # 1 + 0.736 - 2 x 0.632 of its variance.
    fast = b**2 / math.pi * math.log(TAUS_S[0] / FASTEST_S) + 0.47 * variance
    return Modes(process, fast, np.tile(np.log(prior), (3, 1)))


def propagated(
    mean: FloatArray, covariance: FloatArray, process: FloatArray, dt: float, warming: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return F x, (3, ..., 8), and F P Fᵀ + Q, (3, ..., 8, 8), over dt seconds and `warming` °C, (3,).

    NaN is no change of temperature; `process` is `Modes.process`.
    """
    warming, keeps = np.nan_to_num(warming), np.exp(-dt / TAUS_S)
    f = np.zeros((3, STATES, STATES))
    f[:] = np.diag([1.0, *keeps, 1.0, 1.0, 1.0, 1.0])
    f[:, WALK, SLOPE] = warming
    grows = np.zeros((3, STATES))
    grows[:, WALK], grows[:, FLICKER], grows[:, SLOPE] = dt, 1.0 - keeps**2, np.abs(warming)
    modes = (1,) * (mean.ndim - 2)
    f, grows = f.reshape(3, *modes, STATES, STATES), grows.reshape(3, *modes, STATES)
    covariance = f @ covariance @ f.swapaxes(-1, -2)
    np.einsum("...ii->...i", covariance)[...] += process * grows
    return (f @ mean[..., np.newaxis])[..., 0], covariance


def measurement_row(force: FloatArray) -> FloatArray:
    """Return H, (8,), at a specific force, m/s², (3,); zero where it is not known."""
    return np.array([1.0, 1.0, 1.0, 1.0, 0.0, *force])
