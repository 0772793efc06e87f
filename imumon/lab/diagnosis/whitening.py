"""Noise of a slowly varying bias: white noise, flicker as a sum of Gauss-Markov processes, and a random walk.

As a state space, x is the walk and the m processes, the bias their sum::

    x(t + dt) = F x(t) + w,   F = diag(1, exp(-dt/tau_i)),   Q = diag(K² dt, sd_i² (1 - exp(-2 dt/tau_i)))

Processes whose correlation times lie evenly on a logarithmic scale have a spectrum close to 1/f between them.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit


def whiten(
    columns: FloatArray,
    time_s: FloatArray,
    white: FloatArray,
    taus_s: FloatArray,
    markov_sd: FloatArray,
    walk: float,
) -> tuple[FloatArray, FloatArray]:
    """Return columns (n, k) of means behind the inverse Cholesky factor of their covariance, and the factor's
    diagonal (n,): innovations of a Kalman filter over their standard deviations, in linear time.

    Parameters
    ----------
    time_s, white : array of shape (n,)
        Time of each mean since power-on, and variance of its white noise.
    taus_s, markov_sd : array of shape (m,)
        Correlation times and standard deviations of the processes, which begin stationary.
    walk : float
        K, in the unit of the bias per sqrt(s); the walk begins at zero.
    """
    dt = np.diff(time_s, prepend=0.0)[:, np.newaxis]
    decay = np.column_stack([np.ones(len(dt)), np.exp(-dt / taus_s)])
    growth = np.column_stack([walk**2 * dt, markov_sd**2 * -np.expm1(-2.0 * dt / taus_s)])
    growth[0, 1:] = markov_sd**2
    variance = np.asarray(white, np.float64)
    whitened, sd = _innovations(decay, growth, variance, np.ascontiguousarray(columns))
    return np.asarray(whitened), np.asarray(sd)


@njit(fastmath=True)
def _innovations(
    decay: FloatArray, growth: FloatArray, white: FloatArray, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predict, and correct by the innovation, all columns at once: compiled, for a search has thousands.

    The one measurement is the sum of the states.  Columns come innermost: they lie side by side in memory.
    """
    n, m = columns.shape
    states = decay.shape[1]
    out, sd = np.empty((n, m)), np.empty(n)
    x, innovation = np.zeros((states, m)), np.empty(m)
    covariance, spread = np.zeros((states, states)), np.empty(states)
    for k in range(n):
        variance = white[k]
        for i in range(states):
            spread[i] = 0.0
            for j in range(states):
                covariance[i, j] *= decay[k, i] * decay[k, j]
            covariance[i, i] += growth[k, i]
            for j in range(states):
                spread[i] += covariance[i, j]
            variance += spread[i]
        sd[k] = np.sqrt(variance)
        for c in range(m):
            innovation[c] = columns[k, c]
        for i in range(states):
            for c in range(m):
                x[i, c] *= decay[k, i]
                innovation[c] -= x[i, c]
        for c in range(m):
            out[k, c] = innovation[c] / sd[k]
        for i in range(states):
            gain = spread[i] / variance
            for c in range(m):
                x[i, c] += gain * innovation[c]
            for j in range(states):
                covariance[i, j] -= gain * spread[j]
    return out, sd
