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
"""B over the standard deviation per decade of correlation time: the processes, sd² in a
decade, have together the density sd² pi / (2 pi f ln 10), which is to be that of flicker, B² / (2 pi f)."""


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
        return np.asarray(np.concatenate([[1.0], np.exp(-dt / self.taus_s)]))

    def growth(self, dt: float) -> FloatArray:
        """Return the diagonal of Q, (..., m + 1)."""
        markov = self.markov_sd**2 * -np.expm1(-2.0 * dt / self.taus_s)
        return np.asarray(np.concatenate([self.walk[..., np.newaxis] ** 2 * dt, markov], -1))

    def covariance(self, time_s: FloatArray) -> FloatArray:
        """Return the covariance of the bias at these times since the walk began, (..., n, n)."""
        lag: FloatArray = np.abs(np.subtract.outer(time_s, time_s))
        markov = np.einsum("...m,mij->...ij", self.markov_sd**2, np.exp(-lag / self.taus_s[:, None, None]))
        walk = self.walk[..., np.newaxis, np.newaxis] ** 2 * np.minimum.outer(time_s, time_s)
        return np.asarray(walk + markov)


def flicker_sd(instability: FloatArray, taus_s: FloatArray) -> FloatArray:
    """Return the standard deviation of each process for a bias instability B, (..., m).

    Parameters
    ----------
    instability : array (...)
    taus_s : array (m,)
        Correlation times, evenly spaced on a logarithmic scale.
    """
    decades = math.log10(taus_s[-1] / taus_s[0]) / (len(taus_s) - 1)
    share = math.sqrt(decades) / INSTABILITY_PER_DECADE
    return np.asarray(np.asarray(instability)[..., np.newaxis] * np.full(len(taus_s), share))


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


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """White noise N, bias instability B and rate random walk K; B or K is zero where it is not needed.

    Parameters
    ----------
    white, instability, walk : float
        rad/sqrt(s), rad/s and rad/s/sqrt(s), or of any unit.
    """

    white: float
    instability: float
    walk: float


FIT_TAUS_S = 10.0 ** np.arange(0.0, 4.1)
CHI_SQUARE_95 = 3.84
"""A deviance may exceed the least by this within 95 %."""
USUAL_FLICKER, FLICKER_DECADES = 1e-2, 0.7
"""Variance of flicker per decade over the density of the white noise, 1/s: data sheets of MEMS gyros have
1e-3 to 1e-1, here a normal distribution over the logarithm."""
STEPS = (1.0, 0.3, 0.1, 0.03)
"""Decades between what is tried, in turn."""


def fit_noise(elapsed_s: FloatArray, mean: FloatArray, covered_s: FloatArray) -> NoiseFit:
    """Fit white noise, flicker and walk to means at rest, by likelihood.

    A kind of drift without which all is as likely (within 95 %) is zero; flicker, which every gyro has, is
    kept rather than the walk.

    Parameters
    ----------
    elapsed_s, mean : array (n,)
        As of `whiten`.
    covered_s : array (n,)
        Over how long each mean was taken.
    """

    def deviance(flicker: FloatArray, walk: FloatArray) -> tuple[FloatArray, FloatArray]:
        markov = np.sqrt(flicker)[:, np.newaxis] * np.ones(len(FIT_TAUS_S))
        found = whiten(BiasNoise(FIT_TAUS_S, markov, np.sqrt(walk)), elapsed_s, mean, 1.0 / covered_s)
        values, white = found.deviance
        with np.errstate(divide="ignore"):
            usual = np.where(flicker > 0.0, np.log10(flicker / USUAL_FLICKER) / FLICKER_DECADES, 0.0)
        return values + usual**2, white

    def best(flicker: FloatArray, walk: FloatArray) -> tuple[float, float, float, float]:
        """Return flicker, walk, deviance and white noise at the least deviance of a finer and finer grid."""
        for finer in (*STEPS[1:], 0.0):
            f, w = (grid.ravel() for grid in np.meshgrid(flicker, walk))
            values, white = deviance(f, w)
            at = int(np.argmin(values))
            around = 10.0 ** (finer * np.arange(-3.0, 4.0))
            flicker, walk = np.unique(f[at] * around), np.unique(w[at] * around)
        return float(f[at]), float(w[at]), float(values[at]), float(white[at])

    flickers, walks, none = 10.0 ** np.arange(-5.0, 0.1), 10.0 ** np.arange(-9.0, -0.9), np.zeros(1)
    both, flicker_alone, walk_alone = best(flickers, walks), best(flickers, none), best(none, walks)
    least = min(both[2], flicker_alone[2], walk_alone[2])
    chosen = next(x for x in (flicker_alone, walk_alone, both) if x[2] < least + CHI_SQUARE_95)
    flicker, walk, _, white = chosen
    return NoiseFit(
        math.sqrt(white), math.sqrt(flicker * white) * INSTABILITY_PER_DECADE, math.sqrt(walk * white)
    )
