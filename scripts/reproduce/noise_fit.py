"""White noise, flicker and random walk of a recording at rest, by the likelihood of its means."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.whitening import INSTABILITY_PER_DECADE, BiasNoise, whitener

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
        As of `imumon.lab.diagnosis.whitening.whitener`.
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


FIT_TAUS_S = 10.0 ** np.arange(0.0, 4.1)
CHI_SQUARE_95 = 3.84
"""A deviance may exceed the least by this within 95 %."""
USUAL_FLICKER, FLICKER_DECADES = 1e-2, 0.7
"""Variance of flicker per decade over the density of the white noise, 1/s: data sheets of MEMS gyros have
1e-3 to 1e-1, here a normal distribution over the logarithm."""
STEPS = (1.0, 0.3, 0.1, 0.03)
"""Decades between what is tried, in turn."""


class NoiseTerms(NamedTuple):
    """N, B and K of IEEE Std 952, rad/sqrt(s), rad/s and rad/s/sqrt(s); zero where there is none."""

    white: float
    instability: float
    walk: float


def fit_noise(elapsed_s: FloatArray, mean: FloatArray, covered_s: FloatArray) -> NoiseTerms:
    """Fit white noise, flicker and walk to means at rest, by likelihood.

    A kind of drift without which all is as likely (within 95 %) is zero; flicker, which every gyro has, is
    kept rather than the walk.

    Parameters
    ----------
    elapsed_s, mean : array (n,)
        As of `imumon.lab.diagnosis.whitening.whitener`.
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
