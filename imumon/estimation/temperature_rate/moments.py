"""Moments of Gaussians that are known to lie in an interval, or weighed by what a noisy quantizer read.

All functions take arrays.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, ndtr

from imumon.blocks import FloatArray

ROOT_2_PI = float(np.sqrt(2.0 * np.pi))
FAR = -8.0
"""Below this the normal distribution is replaced by the first term of its asymptotic series."""
NEWTON_STEPS = 20


def _density(x: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * x * x) / ROOT_2_PI)


def truncated(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, variance and log probability of a standard normal between low < high."""
    mirrored = low > 0.0
    a, b = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    mass = ndtr(b) - ndtr(a)
    inside = np.maximum(mass, 1e-14)
    at_a, at_b = _density(a), _density(b)
    mean = (at_a - at_b) / inside
    variance = np.maximum(1.0 + (a * at_a - b * at_b) / inside - mean * mean, 1e-6)
    log_mass = np.log(inside)
    far = mass < 1e-14
    if far.any():
        # So far out the density falls exponentially from b; unless it is flat between a and b.
        slope = -b - 1.0 / np.minimum(b, -1.0)
        flat = (b - a) * slope < 3.0
        height = -0.5 * b * b - np.log(ROOT_2_PI)
        safe = np.where(flat, 1.0, slope)
        mean = np.where(far, np.where(flat, 0.5 * (a + b), b - 1.0 / safe), mean)
        variance = np.where(far, np.where(flat, (b - a) ** 2 / 12.0, safe**-2.0), variance)
        log_mass = np.where(far, height + np.where(flat, np.log(b - a), -np.log(safe)), log_mass)
    return np.where(mirrored, -mean, mean), variance, log_mass


def inverse_mills(x: FloatArray) -> FloatArray:
    """Return φ(x)/Φ(x)."""
    near = np.maximum(x, FAR)
    return np.where(x < FAR, -x - 1.0 / np.minimum(x, -1.0), _density(near) / ndtr(near))


def weigh(
    prior: tuple[FloatArray, FloatArray],
    edges: tuple[float, float],
    counts: tuple[float, float],
    sigma: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weigh Gaussians by readings above an edge and below another: Φ((T-low)/σ)^above Φ((high-T)/σ)^below.

    Laplace's approximation: the product is log-concave, so Newton's iteration finds its only maximum.

    Parameters
    ----------
    prior : array, array
        Mean and standard deviation.
    edges : float, float
        Low and high.
    counts : float, float
        Readings above low and below high.
    sigma : array
        Of the noise.

    Returns
    -------
    array, array, array
        Mean, variance and the log of the normalization.
    """
    (mean, sd), (low, high), (above, below) = prior, edges, counts
    precision = sd**-2.0
    # Far beyond the edges one side outweighs the other, and which is not known yet: start at the edge.
    t = np.clip(mean, low - sigma, high + sigma)
    last = np.zeros_like(t)
    curvature = precision
    for _ in range(NEWTON_STEPS):
        u, v = (t - low) / sigma, (high - t) / sigma
        up, down = inverse_mills(u), inverse_mills(v)
        gradient = (mean - t) * precision + (above * up - below * down) / sigma
        curvature = precision + (above * up * (up + u) + below * down * (down + v)) / sigma**2
        change = gradient / curvature
        change = np.where((change * last < 0.0) & (np.abs(change) > 0.5 * np.abs(last)), 0.5 * change, change)
        last = change
        t = t + change
        if (np.abs(change) < 1e-3 / np.sqrt(curvature)).all():
            break
    log_mass = -0.5 * (t - mean) ** 2 * precision - 0.5 * np.log(curvature / precision)
    log_mass += above * log_ndtr((t - low) / sigma) + below * log_ndtr((high - t) / sigma)
    return t, 1.0 / curvature, log_mass
