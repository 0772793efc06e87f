"""Noise of the block means: white, flicker-like and random walk, as one filter that whitens in linear time.

Covariance of a run is s² [I + r F + q R]: F the mean of exp(-|lag|/tau) over `TAUS_S` (a sum of
Ornstein-Uhlenbeck processes whose spectrum is close to 1/f), R = min(ti, tj)/7200 s.  Each is a state of a
Kalman filter, so the innovations over their standard deviations are the whitened data: the same as with the
inverse Cholesky factor, for irregular times as well, and without any matrix of the size of the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit

TAUS_S = np.array([30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0])
WALK_S = 7200.0
FLICKER = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0, 10000.0)
WALK = (0.0, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0, 10000.0)


@dataclass(frozen=True, slots=True)
class Whitener:
    """The filter of one run for one r and q; independent of the data."""

    decay: FloatArray
    gain: FloatArray
    scale: FloatArray

    @property
    def log_determinant(self) -> float:
        """Half the logarithm of the determinant of the covariance over s²."""
        return float(np.log(self.scale).sum())

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, m) whitened."""
        return _whiten(self.decay, self.gain, self.scale, np.ascontiguousarray(columns))


def whitener(time_s: FloatArray, white: FloatArray, flicker: float, walk: float) -> Whitener:
    """Return the filter for block means at these times.

    Parameters
    ----------
    time_s : array of shape (n,)
        Since power-on, increasing.
    white : array of shape (n,)
        Variance of the white part of each block over s²: 1 for a full block.
    flicker, walk : float
        r and q.
    """
    return Whitener(*_filter(time_s, white, flicker, walk, TAUS_S, WALK_S))


@njit
def _filter(
    time_s: FloatArray, white: FloatArray, flicker: float, walk: float, taus: FloatArray, walk_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, m = len(time_s), len(taus) + 1
    decay, gain, scale = np.ones((n, m)), np.zeros((n, m)), np.ones(n)
    p = np.zeros((m, m))
    share = flicker / len(taus)
    for j in range(len(taus)):
        p[j, j] = share
    p[m - 1, m - 1] = walk * time_s[0] / walk_s
    for k in range(n):
        if k > 0:
            dt = time_s[k] - time_s[k - 1]
            for j in range(m - 1):
                decay[k, j] = np.exp(-dt / taus[j])
            for i in range(m):
                for j in range(m):
                    p[i, j] *= decay[k, i] * decay[k, j]
            for j in range(m - 1):
                p[j, j] += share * (1.0 - decay[k, j] ** 2)
            p[m - 1, m - 1] += walk * dt / walk_s
        total = p.sum() + white[k]
        scale[k] = np.sqrt(total)
        column = p.sum(axis=1)
        for j in range(m):
            gain[k, j] = column[j] / total
        for i in range(m):
            for j in range(m):
                p[i, j] -= column[i] * column[j] / total
    return decay, gain, scale


@njit(fastmath=True)
def _whiten(decay: FloatArray, gain: FloatArray, scale: FloatArray, columns: FloatArray) -> FloatArray:
    n, m = columns.shape
    states = decay.shape[1]
    out = np.empty((n, m))
    x = np.zeros((states, m))
    for k in range(n):
        inverse = 1.0 / scale[k]
        for c in range(m):
            predicted = 0.0
            for j in range(states):
                predicted += decay[k, j] * x[j, c]
            innovation = columns[k, c] - predicted
            out[k, c] = innovation * inverse
            for j in range(states):
                x[j, c] = decay[k, j] * x[j, c] + gain[k, j] * innovation
    return out
