"""The covariance of a noisy bias, which its filters are compared with, and flicker of a given size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray

INSTABILITY_PER_DECADE = math.sqrt(math.pi / math.log(10.0))
"""B over the standard deviation per decade of correlation time: the processes, sd² in a
decade, have together the density sd² pi / (2 pi f ln 10), which is to be that of flicker, B² / (2 pi f)."""


@dataclass(frozen=True, slots=True, eq=False)
class BiasNoise:
    """Flicker as m Gauss-Markov processes, and random walk; with leading axes, several side by side."""

    taus_s: FloatArray
    markov_sd: FloatArray
    walk: FloatArray


def covariance(noise: BiasNoise, time_s: FloatArray) -> FloatArray:
    """Return K² min(s, t) + Σ sd_i² exp(-|t - s|/tau_i), (..., n, n)."""
    lag: FloatArray = np.abs(np.subtract.outer(time_s, time_s))
    markov = np.einsum("...m,mij->...ij", noise.markov_sd**2, np.exp(-lag / noise.taus_s[:, None, None]))
    walk = noise.walk[..., np.newaxis, np.newaxis] ** 2 * np.minimum.outer(time_s, time_s)
    return np.asarray(walk + markov)


def flicker(instability: list[float], walk: list[float], taus_s: FloatArray) -> BiasNoise:
    """Return noise of a bias instability B and a walk K; correlation times evenly on a logarithmic scale."""
    decades = math.log10(taus_s[-1] / taus_s[0]) / (len(taus_s) - 1)
    share = np.full(len(taus_s), math.sqrt(decades) / INSTABILITY_PER_DECADE)
    return BiasNoise(taus_s, np.outer(instability, share), np.array(walk))
