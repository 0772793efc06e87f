"""Noise of a slowly varying bias: white noise, flicker as a sum of Gauss-Markov processes, and a random walk.

One model in two forms.  As a state space, x is the walk and the m processes, the bias their sum::

    x(t + dt) = F x(t) + w,   F = diag(1, exp(-dt/tau_i)),   Q = diag(K² dt, sd_i² (1 - exp(-2 dt/tau_i)))

and as a covariance, E[b(s) b(t)] = K² min(s, t) + Σ sd_i² exp(-|t - s|/tau_i).  Processes whose correlation
times lie evenly on a logarithmic scale have a spectrum close to 1/f between them.  Leading axes of the
parameters are filters side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.kalman import Estimate, correct, predict

FLOOR_PER_INSTABILITY = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Floor of the Allan deviation of flicker, over the bias instability B (IEEE Std 952, C.1.3)."""
INSTABILITY_PER_DECADE = math.sqrt(math.pi / math.log(10.0))
"""B over the standard deviation per decade of correlation time: S(f) = B²/(2 pi f) has the variance
B² ln(10)/pi in a decade, as the processes together have (their density is 4 sd² tau / (1 + (2 pi f tau)²))."""


@dataclass(frozen=True, slots=True, eq=False)
class BiasNoise:
    """Flicker and random walk; the white noise belongs to the measurement.

    Parameters
    ----------
    taus_s : array (m,)
        Correlation times.
    markov_sd : array (..., m)
        Standard deviation of each process, in the unit of the bias.
    walk : array (...)
        K, per sqrt(s).
    """

    taus_s: FloatArray
    markov_sd: FloatArray
    walk: FloatArray

    def decay(self, dt: float) -> FloatArray:
        """Return the diagonal of F, (m + 1,)."""
        return np.concatenate([[1.0], np.exp(-dt / self.taus_s)])

    def growth(self, dt: float) -> FloatArray:
        """Return the diagonal of Q, (..., m + 1)."""
        markov = self.markov_sd**2 * -np.expm1(-2.0 * dt / self.taus_s)
        return np.concatenate([self.walk[..., np.newaxis] ** 2 * dt, markov], -1)

    def covariance(self, time_s: FloatArray) -> FloatArray:
        """Return the covariance of the bias at these times since the walk began, (..., n, n)."""
        lag = np.abs(np.subtract.outer(time_s, time_s))
        markov = np.einsum("...m,mij->...ij", self.markov_sd**2, np.exp(-lag / self.taus_s[:, None, None]))
        walk = self.walk[..., np.newaxis, np.newaxis] ** 2 * np.minimum.outer(time_s, time_s)
        return np.asarray(walk + markov)


def flicker_sd(instability: FloatArray, taus_s: FloatArray) -> FloatArray:
    """Return the standard deviation of each process for a bias instability B, (..., 1).

    Parameters
    ----------
    instability : array (...)
    taus_s : array (m,)
        Correlation times, evenly spaced on a logarithmic scale.
    """
    decades = math.log10(taus_s[-1] / taus_s[0]) / (len(taus_s) - 1)
    return np.asarray(instability)[..., np.newaxis] * math.sqrt(decades) / INSTABILITY_PER_DECADE


@dataclass(frozen=True, slots=True, eq=False)
class Whitened:
    """Innovations of means of a bias whose level is not known beforehand.

    Parameters
    ----------
    innovation, variance : array (n, ...)
        NaN where there was no mean, and at the first, which only gives the level.
    """

    innovation: FloatArray
    variance: FloatArray

    @property
    def deviance(self) -> tuple[FloatArray, FloatArray]:
        """-2 log likelihood with a common factor of all variances at its best, and that factor, (...)."""
        count = np.isfinite(self.innovation).sum(0)
        scale = np.nansum(self.innovation**2 / self.variance, 0) / count + np.finfo(np.float64).tiny
        return np.asarray(count * np.log(scale) + np.nansum(np.log(self.variance), 0)), scale


def whiten(noise: BiasNoise, elapsed_s: FloatArray, mean: FloatArray, white: FloatArray) -> Whitened:
    """Return the innovations of means.

    Parameters
    ----------
    noise : BiasNoise
    elapsed_s : array (n,)
        Since the mean before; infinity begins anew.
    mean : array (n,)
        NaN where there is none.
    white : array (n,)
        Variance of the white part of each.
    """
    m = len(noise.taus_s) + 1
    shape = noise.walk.shape
    row, unit = np.ones((1, m)), np.eye(m)
    innovation, variance = np.full((2, len(mean), *shape), np.nan)
    estimate: Estimate | None = None
    for k in range(len(mean)):
        if not np.isfinite(elapsed_s[k]):
            estimate = None
        if estimate is not None:
            growth = noise.growth(elapsed_s[k])[..., np.newaxis] * unit
            estimate = predict(estimate, np.diag(noise.decay(elapsed_s[k])), growth)
        if not np.isfinite(mean[k]):
            continue
        if estimate is None:
            estimate = first_mean(noise, mean[k], white[k])
            continue
        found = correct(estimate, np.full((*shape, 1), mean[k]), row, np.full((1, 1), white[k]))
        estimate = found.estimate
        innovation[k] = found.innovation[..., 0]
        variance[k] = found.innovation_covariance[..., 0, 0]
    return Whitened(innovation, variance)


def first_mean(noise: BiasNoise, mean: float, white: float) -> Estimate:
    """Return what one mean says: the sum is known as well as the mean, its parts are not."""
    m = len(noise.taus_s) + 1
    x, p = np.zeros((*noise.walk.shape, m)), np.zeros((*noise.walk.shape, m, m))
    x[..., 0] = mean
    i = np.arange(1, m)
    p[..., i, i] = noise.markov_sd**2
    p[..., 0, 1:] = p[..., 1:, 0] = -(noise.markov_sd**2)
    p[..., 0, 0] = white + (noise.markov_sd**2).sum(-1)
    return Estimate(x, p)
