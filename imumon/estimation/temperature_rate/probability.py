"""Moments of a Gaussian that is known to lie in an interval, or weighed by what a noisy quantizer read."""

from __future__ import annotations

import math

from imumon.compiled import njit

ROOT_2 = math.sqrt(2.0)
ROOT_2_PI = math.sqrt(2.0 * math.pi)
FAR = -8.0
"""Below this the normal distribution is replaced by the first term of its asymptotic series."""
NEWTON_STEPS = 20


@njit
def normal_cdf(x: float) -> float:
    """Return Φ(x)."""
    return 0.5 * math.erfc(-x / ROOT_2)


@njit
def log_normal_cdf(x: float) -> float:
    """Return log Φ(x)."""
    return -0.5 * x * x - math.log(-x * ROOT_2_PI) if x < FAR else math.log(normal_cdf(x))


@njit
def inverse_mills(x: float) -> float:
    """Return φ(x)/Φ(x)."""
    return -x - 1.0 / x if x < FAR else math.exp(-0.5 * x * x) / ROOT_2_PI / normal_cdf(x)


@njit
def truncated(a: float, b: float) -> tuple[float, float, float]:
    """Return mean, variance and log probability of a standard normal between a < b."""
    if a > 0.0:
        mean, variance, log_mass = _truncated(-b, -a)
        return -mean, variance, log_mass
    return _truncated(a, b)


@njit
def _truncated(a: float, b: float) -> tuple[float, float, float]:
    """Do the work of `truncated` for a ≤ 0, where Φ(b) - Φ(a) loses no digits."""
    mass = normal_cdf(b) - normal_cdf(a)
    if mass < 1e-14:
        # So far out the density falls exponentially from b; unless it is flat between a and b.
        slope = -b - 1.0 / min(b, -1.0)
        if (b - a) * slope < 3.0:
            return 0.5 * (a + b), (b - a) ** 2 / 12.0, -0.5 * b * b + math.log((b - a) / ROOT_2_PI)
        return b - 1.0 / slope, 1.0 / (slope * slope), -0.5 * b * b - math.log(slope * ROOT_2_PI)
    at_a, at_b = math.exp(-0.5 * a * a) / ROOT_2_PI, math.exp(-0.5 * b * b) / ROOT_2_PI
    mean = (at_a - at_b) / mass
    variance = 1.0 + (a * at_a - b * at_b) / mass - mean * mean
    return mean, max(variance, 1e-6), math.log(mass)


@njit
def weigh(
    mean: float, sd: float, low: float, high: float, above: float, below: float, sigma: float
) -> tuple[float, float, float]:
    """Weigh a Gaussian by readings above `low` and below `high`: Φ((T-low)/σ)^above Φ((high-T)/σ)^below.

    Laplace's approximation: the product is log-concave, so Newton's iteration finds its only maximum.
    Returns mean, variance and the log of the normalization.
    """
    # Far beyond the edges one side outweighs the other, and which is not known yet: start at the edge.
    t = min(max(mean, low - sigma), high + sigma)
    last = 0.0
    for _ in range(NEWTON_STEPS):
        gradient, curvature = (mean - t) / (sd * sd), 1.0 / (sd * sd)
        if above > 0.0:
            u = (t - low) / sigma
            ratio = inverse_mills(u)
            gradient += above * ratio / sigma
            curvature += above * ratio * (ratio + u) / (sigma * sigma)
        if below > 0.0:
            u = (high - t) / sigma
            ratio = inverse_mills(u)
            gradient -= below * ratio / sigma
            curvature += below * ratio * (ratio + u) / (sigma * sigma)
        change = gradient / curvature
        if change * last < 0.0 and abs(change) > 0.5 * abs(last):
            change *= 0.5
        last = change
        t += change
        if abs(change) < 1e-3 / math.sqrt(curvature):
            break
    log_mass = -0.5 * ((t - mean) / sd) ** 2 - 0.5 * math.log(curvature * sd * sd)
    if above > 0.0:
        log_mass += above * log_normal_cdf((t - low) / sigma)
    if below > 0.0:
        log_mass += below * log_normal_cdf((high - t) / sigma)
    return t, 1.0 / curvature, log_mass
