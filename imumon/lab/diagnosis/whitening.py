"""Noise of a slowly varying bias: white noise, flicker as a sum of Gauss-Markov processes, and a random walk.

As a state space, x is the walk and the m processes, the bias their sum::

    x(t + dt) = F x(t) + w,   F = diag(1, exp(-dt/tau_i)),   Q = diag(K² dt, sd_i² (1 - exp(-2 dt/tau_i)))

Processes whose correlation times lie evenly on a logarithmic scale have a spectrum close to 1/f between them.
Leading axes of the parameters are filters side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """The filters of means of a bias with white noise, f of them side by side; independent of the data.

    The innovations over their standard deviations are the data behind the inverse Cholesky factor of the
    covariance, in linear time.
    """

    decay: FloatArray
    """Diagonal of F up to each mean, (n, m + 1)."""
    gain: FloatArray
    """Array, (n, f, m + 1)."""
    sd: FloatArray
    """Standard deviation of each innovation, (n, f)."""

    def __call__(self, columns: FloatArray, at: int = 0) -> FloatArray:
        """Return columns (n, k) whitened by one of the filters."""
        gain, sd = np.ascontiguousarray(self.gain[:, at]), np.ascontiguousarray(self.sd[:, at])
        return np.asarray(_whitened(self.decay, gain, sd, np.ascontiguousarray(columns)))


@njit(fastmath=True)
def _whitened(decay: FloatArray, gain: FloatArray, sd: FloatArray, columns: FloatArray) -> FloatArray:
    """Predict, and correct by the innovation, all columns at once: compiled, for a search has thousands.

    Columns come innermost: they lie side by side in memory.
    """
    n, m = columns.shape
    states = decay.shape[1]
    out = np.empty((n, m))
    x = np.zeros((states, m))
    innovation = np.empty(m)
    for k in range(n):
        for c in range(m):
            innovation[c] = columns[k, c]
        for j in range(states):
            kept = decay[k, j]
            for c in range(m):
                x[j, c] *= kept
                innovation[c] -= x[j, c]
        for c in range(m):
            out[k, c] = innovation[c] / sd[k]
        for j in range(states):
            moved = gain[k, j]
            for c in range(m):
                x[j, c] += moved * innovation[c]
    return out


def whitener(
    taus_s: FloatArray, markov_sd: FloatArray, walk: FloatArray, time_s: FloatArray, white: FloatArray
) -> Whitener:
    """Return f filters of n means, at times since power-on.

    The m processes, with correlation times (m,) and standard deviations (f, m) in the unit of the bias, begin
    stationary; the walk, K in that unit per sqrt(s), (f,), begins at zero.  `white` is the variance of the
    white noise of each mean, (n,).
    """
    dt = np.diff(time_s, prepend=0.0)[:, np.newaxis]
    decay = np.column_stack([np.ones(len(dt)), np.exp(-dt / taus_s)])
    growth = np.concatenate(
        [
            walk[:, np.newaxis] ** 2 * dt[:, np.newaxis],
            markov_sd**2 * -np.expm1(-2.0 * dt / taus_s)[:, np.newaxis],
        ],
        axis=2,
    )
    growth[0, :, 1:] = markov_sd**2
    return Whitener(decay, *_filtered(decay, growth, np.asarray(white, np.float64)))


@njit
def _filtered(decay: FloatArray, growth: FloatArray, white: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gain (n, f, m) and standard deviation of the innovation (n, f) of filters whose one measurement
    is the sum of the states; compiled, for there are many."""
    n, filters, states = growth.shape
    gain, sd = np.empty((n, filters, states)), np.empty((n, filters))
    covariance, spread = np.empty((states, states)), np.empty(states)
    for f in range(filters):
        covariance[:] = 0.0
        for k in range(n):
            variance = white[k]
            for i in range(states):
                spread[i] = 0.0
                for j in range(states):
                    covariance[i, j] *= decay[k, i] * decay[k, j]
                covariance[i, i] += growth[k, f, i]
                for j in range(states):
                    spread[i] += covariance[i, j]
                variance += spread[i]
            sd[k, f] = np.sqrt(variance)
            for i in range(states):
                gain[k, f, i] = spread[i] / variance
                for j in range(states):
                    covariance[i, j] -= spread[i] * spread[j] / variance
    return gain, sd
