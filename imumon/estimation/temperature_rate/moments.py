"""Moments of Gaussians that are known to lie in an interval, or weighed by what a noisy quantizer read."""

from __future__ import annotations

import math

from imumon.compiled import inner

ROOT_2_PI = math.sqrt(2.0 * math.pi)
ROOT_HALF = math.sqrt(0.5)
FAR = -8.0
"""Below this the normal distribution is replaced by the first terms of its asymptotic series."""
NEWTON_STEPS = 20


@inner
def density(x: float) -> float:
    """Return φ(x), the density of the standard normal distribution."""
    return math.exp(-0.5 * x * x) / ROOT_2_PI


@inner
def probability(x: float) -> float:
    """Return Φ(x), the probability below x."""
    return 0.5 * math.erfc(-x * ROOT_HALF)


@inner
def log_probability(x: float) -> float:
    """Return ln Φ(x)."""
    if x < FAR:
        return -0.5 * x * x - math.log(-x * ROOT_2_PI) - 1.0 / (x * x)
    return math.log(probability(x))


@inner
def inverse_mills(x: float) -> float:
    """Return φ(x)/Φ(x)."""
    if x < FAR:
        return -x - 1.0 / x
    return density(x) / probability(x)


@inner
def truncated(low: float, high: float) -> tuple[float, float, float]:
    """Return mean, variance and log probability of a standard normal between low < high."""
    mirrored = low > 0.0
    a, b = (-high, -low) if mirrored else (low, high)
    mass = probability(b) - probability(a)
    if mass >= 1e-14:
        at_a, at_b = density(a), density(b)
        mean = (at_a - at_b) / mass
        variance = max(1.0 + (a * at_a - b * at_b) / mass - mean * mean, 1e-6)
        log_mass = math.log(mass)
    else:
        # So far out the density falls exponentially from b; unless it is flat between a and b.
        slope = -b - 1.0 / min(b, -1.0)
        flat = (b - a) * slope < 3.0
        mean = 0.5 * (a + b) if flat else b - 1.0 / slope
        variance = (b - a) ** 2 / 12.0 if flat else 1.0 / slope**2
        log_mass = -0.5 * b * b - math.log(ROOT_2_PI) + (math.log(b - a) if flat else -math.log(slope))
    return -mean if mirrored else mean, variance, log_mass


@inner
def weigh(
    mean: float, sd: float, low: float, high: float, above: float, below: float, sigma: float
) -> tuple[float, float, float]:
    """Weigh a Gaussian by readings above an edge and below another: Φ((T-low)/σ)^above Φ((high-T)/σ)^below.

    Laplace's approximation: the product is log-concave, so Newton's iteration finds its only maximum.

    Parameters
    ----------
    mean, sd : float
        Of the Gaussian.
    low, high : float
        The edges.
    above, below : float
        Readings above low and below high.
    sigma : float
        Of the noise.

    Returns
    -------
    float, float, float
        Mean, variance and the log of the normalization.
    """
    precision, sharp = 1.0 / (sd * sd), 1.0 / sigma
    # Far beyond the edges one side outweighs the other, and which is not known yet: start at the edge.
    t = min(max(mean, low - sigma), high + sigma)
    curvature, last = precision, 0.0
    for _ in range(NEWTON_STEPS):
        u, v = (t - low) * sharp, (high - t) * sharp
        up, down = inverse_mills(u), inverse_mills(v)
        gradient = (mean - t) * precision + (above * up - below * down) * sharp
        curvature = precision + (above * up * (up + u) + below * down * (down + v)) * sharp * sharp
        change = gradient / curvature
        if change * last < 0.0 and abs(change) > 0.5 * abs(last):
            change *= 0.5
        last = change
        t += change
        if change * change * curvature < 1e-6:
            break
    log_mass = -0.5 * (t - mean) ** 2 * precision - 0.5 * math.log(curvature / precision)
    log_mass += above * log_probability((t - low) * sharp) + below * log_probability((high - t) * sharp)
    return t, 1.0 / curvature, log_mass
