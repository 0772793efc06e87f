"""Noise of a slowly varying bias: white noise, flicker as a sum of Gauss-Markov processes, and a random walk.

One model in three forms, for the filter of the bias, the diagnosis and the Allan curves.  As a state space,
x is the walk and the m processes, the bias their sum::

    x(t + dt) = F x(t) + w,   F = diag(1, exp(-dt/tau_i)),   Q = diag(K² dt, sd_i² (1 - exp(-2 dt/tau_i)))

and as a covariance, E[b(s) b(t)] = K² min(s, t) + Σ sd_i² exp(-|t - s|/tau_i).  Processes whose correlation
times lie evenly on a logarithmic scale have a spectrum close to 1/f between them.  The Allan variance is
that of N, B and K.  Leading axes of the parameters are filters side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
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
class Whitener:
    """The filters of means of a bias with white noise, f of them side by side; independent of the data.

    The innovations over their standard deviations are the data behind the inverse Cholesky factor of the
    covariance, in linear time.

    Parameters
    ----------
    decay : array (n, m + 1)
        Diagonal of F up to each mean; zero where the filter begins anew.
    gain : array (n, f, m + 1)
    sd : array (n, f)
        Standard deviation of each innovation.
    """

    decay: FloatArray
    gain: FloatArray
    sd: FloatArray

    def __call__(self, columns: FloatArray, at: int = 0) -> FloatArray:
        """Return columns (n, k) whitened by one of the filters."""
        gain, sd = np.ascontiguousarray(self.gain[:, at]), np.ascontiguousarray(self.sd[:, at])
        return np.asarray(_whitened(self.decay, gain, sd, np.ascontiguousarray(columns)))


@njit(fastmath=True)
def _whitened(decay: FloatArray, gain: FloatArray, sd: FloatArray, columns: FloatArray) -> FloatArray:
    """Predict, and correct by the innovation, all columns at once: compiled, for a search has thousands."""
    n, m = columns.shape
    states = decay.shape[1]
    out = np.empty((n, m))
    x = np.zeros((states, m))
    for k in range(n):
        for c in range(m):
            predicted = 0.0
            for j in range(states):
                x[j, c] *= decay[k, j]
                predicted += x[j, c]
            innovation = columns[k, c] - predicted
            out[k, c] = innovation / sd[k]
            for j in range(states):
                x[j, c] += gain[k, j] * innovation
    return out


def whitener(noise: BiasNoise, elapsed_s: FloatArray, white: FloatArray, level: FloatArray) -> Whitener:
    """Return the filters of means.

    Parameters
    ----------
    noise : BiasNoise
        With one leading axis, (f,).
    elapsed_s : array (n,)
        Since the mean before; infinity begins anew.
    white : array (n,)
        Variance of the white part of each; infinity where there is no mean.
    level : array (f,)
        Variance of the walk at the first mean, and wherever it begins anew.
    """
    n, m, f = len(elapsed_s), len(noise.taus_s) + 1, len(level)
    row, unit = np.ones((1, m)), np.eye(m)
    start = np.concatenate([level[:, np.newaxis], noise.markov_sd**2], 1)[..., np.newaxis] * unit
    decay, gain, sd = np.zeros((n, m)), np.empty((n, f, m)), np.empty((n, f))
    covariance = start
    for k in range(n):
        estimate = Estimate(np.zeros((f, m)), start)
        if k and np.isfinite(elapsed_s[k]):
            decay[k] = noise.decay(elapsed_s[k])
            growth = noise.growth(elapsed_s[k])[..., np.newaxis] * unit
            estimate = predict(Estimate(estimate.mean, covariance), np.diag(decay[k]), growth)
        found = correct(estimate, np.ones((f, 1)), row, np.full((1, 1), white[k]))
        # From a mean of zero, a measurement of one moves the state by the gain.
        gain[k], covariance = found.estimate
        sd[k] = np.sqrt(found.innovation_covariance[:, 0, 0])
    return Whitener(decay, gain, sd)


VAGUE = 1e8
"""Variance of a level that nobody knows, over that of the rest of a mean: rounding stays below 1e-7."""


def deviance(
    noise: BiasNoise, elapsed_s: FloatArray, mean: FloatArray, white: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return -2 log likelihood of means, (f,), and the common factor of all variances with which it is least.

    The level is not known beforehand: the first mean of a run only gives it.

    Parameters
    ----------
    noise, elapsed_s, white
        As of `whitener`.
    mean : array (n,)
        NaN where there is none.
    """
    known = np.isfinite(mean)
    runs = np.cumsum(~np.isfinite(elapsed_s))
    rows = np.flatnonzero(known)
    counted = rows[np.diff(runs[rows], prepend=-1) == 0]
    level = VAGUE * (white[known].max() + (noise.markov_sd**2).sum(-1))
    filters = whitener(noise, elapsed_s, np.where(known, white, np.inf), level)
    values = np.where(known, mean, 0.0)[:, np.newaxis]
    squares = np.array([np.sum(filters(values, at)[counted] ** 2) for at in range(len(level))])
    scale = squares / len(counted) + np.finfo(np.float64).tiny
    return len(counted) * np.log(scale) + 2.0 * np.log(filters.sd[counted]).sum(0), scale


@dataclass(frozen=True, slots=True)
class NoiseTerms:
    """White noise N, bias instability B and rate random walk K of a sensor, as IEEE Std 952 has them.

    Parameters
    ----------
    white, instability, walk : float
        rad/sqrt(s), rad/s and rad/s/sqrt(s), or of any unit; zero where there is none.
    """

    white: float
    instability: float
    walk: float

    def allan_variance(self, tau_s: FloatArray) -> FloatArray:
        """Return the Allan variance at averaging times."""
        flicker = (FLOOR_PER_INSTABILITY * self.instability) ** 2
        return np.asarray(self.white**2 / tau_s + flicker + self.walk**2 * tau_s / 3.0)


FIT_TAUS_S = 10.0 ** np.arange(0.0, 4.1)
CHI_SQUARE_95 = 3.84
"""A deviance may exceed the least by this within 95 %."""
USUAL_FLICKER, FLICKER_DECADES = 1e-2, 0.7
"""Variance of flicker per decade over the density of the white noise, 1/s: data sheets of MEMS gyros have
1e-3 to 1e-1, here a normal distribution over the logarithm."""
STEPS = (1.0, 0.3, 0.1, 0.03)
"""Decades between what is tried, in turn."""


def fit_noise(elapsed_s: FloatArray, mean: FloatArray, covered_s: FloatArray) -> NoiseTerms:
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

    def penalised(flicker: FloatArray, walk: FloatArray) -> tuple[FloatArray, FloatArray]:
        markov = np.sqrt(flicker)[:, np.newaxis] * np.ones(len(FIT_TAUS_S))
        noise = BiasNoise(FIT_TAUS_S, markov, np.sqrt(walk))
        values, white = deviance(noise, elapsed_s, mean, 1.0 / covered_s)
        with np.errstate(divide="ignore"):
            usual = np.where(flicker > 0.0, np.log10(flicker / USUAL_FLICKER) / FLICKER_DECADES, 0.0)
        return values + usual**2, white

    def best(flicker: FloatArray, walk: FloatArray) -> tuple[float, float, float, float]:
        """Return flicker, walk, deviance and white noise at the least deviance of a finer and finer grid."""
        for finer in (*STEPS[1:], 0.0):
            f, w = (grid.ravel() for grid in np.meshgrid(flicker, walk))
            values, white = penalised(f, w)
            at = int(np.argmin(values))
            around = 10.0 ** (finer * np.arange(-3.0, 4.0))
            flicker, walk = np.unique(f[at] * around), np.unique(w[at] * around)
        return float(f[at]), float(w[at]), float(values[at]), float(white[at])

    flickers, walks, none = 10.0 ** np.arange(-5.0, 0.1), 10.0 ** np.arange(-9.0, -0.9), np.zeros(1)
    both, flicker_alone, walk_alone = best(flickers, walks), best(flickers, none), best(none, walks)
    least = min(both[2], flicker_alone[2], walk_alone[2])
    chosen = next(x for x in (flicker_alone, walk_alone, both) if x[2] < least + CHI_SQUARE_95)
    flicker, walk, _, white = chosen
    return NoiseTerms(
        math.sqrt(white), math.sqrt(flicker * white) * INSTABILITY_PER_DECADE, math.sqrt(walk * white)
    )
