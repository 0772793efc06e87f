"""Random errors that keep their state between blocks, each with its own generator.

A generator's seed is the seed of the unit and the name of the error, so one error that is switched off leaves
the others as they were.
"""

import zlib

import numpy as np
from numpy.typing import ArrayLike

from imumon.blocks import FloatArray
from imumon.compiled import njit


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the generator of the error of this name."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


class White:
    """Independent normal values; `sd` is the standard deviation of a sample of each of k columns."""

    def __init__(self, sd: ArrayLike, random: np.random.Generator) -> None:
        self._sd, self._random = np.asarray(sd, np.float64), random

    def take(self, n: int) -> FloatArray:
        """Return the next n values of each column, (n, k)."""
        return self._random.standard_normal((n, len(self._sd))) * self._sd


class GaussMarkov:
    """First-order Gauss-Markov process in equilibrium: x' = -x / tau + noise.

    `sd`: standard deviation of x, for each of k columns.
    `tau_s`, `step_s`: correlation time, and time between samples.
    """

    def __init__(self, sd: ArrayLike, tau_s: float, step_s: float, random: np.random.Generator) -> None:
        self._decay = np.exp(-step_s / tau_s)
        self._last = White(sd, random).take(1)[0]
        self._drive = White(np.sqrt(-np.expm1(-2.0 * step_s / tau_s)) * np.asarray(sd), random)

    def take(self, n: int) -> FloatArray:
        """Return the next n values of each column, (n, k)."""
        values = _first_order(self._drive.take(n), self._decay, self._last)
        self._last = values[-1]
        return values


@njit
def _first_order(noise: FloatArray, decay: float, last: FloatArray) -> FloatArray:
    """Return x[i] = decay x[i-1] + noise[i] of each column, (n, k); scipy.signal takes 0.5 s to import."""
    values = np.empty_like(noise)
    for column in range(noise.shape[1]):
        x = last[column]
        for row in range(len(noise)):
            x = noise[row, column] + decay * x
            values[row, column] = x
    return values


class RandomWalk:
    """Sums of independent normal steps, from 0 at power-on.

    `density` is the standard deviation after one second, of each of k columns.
    """

    def __init__(self, density: ArrayLike, step_s: float, random: np.random.Generator) -> None:
        self._steps = White(np.asarray(density) * np.sqrt(step_s), random)
        self._last = np.zeros(1)

    def take(self, n: int) -> FloatArray:
        """Return the next n values of each column, (n, k)."""
        values = self._last + np.cumsum(self._steps.take(n), axis=0)
        self._last = values[-1]
        return values
