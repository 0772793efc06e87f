"""One estimate from a forward and a backward filter (Fraser and Potter 1969).

If their errors are independent, their difference has the variance P_f + P_b, and the weights are the inverse
variances.  Let r be the rms over a recording of the normalised residual |f - b| / sqrt(P_f + P_b)::

    r < 1    the errors have a common covariance c = (1 - r²) (P_f + P_b) / 2, which averaging cannot reduce
    r > 1    the model lacks an effect: all standard deviations are multiplied by r, or by the median
             residual over that of a normal one if that is smaller (scale factor of the Particle Data
             Group); where a single residual exceeds two, the standard deviation is multiplied by it
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray

SUSPECT = 2.0
"""A standard normal value exceeds this in magnitude with a probability of 5 %."""
MEDIAN = 0.6745
"""Median of the magnitude of a standard normal value."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Estimate and standard deviation, (n,) each, and r as above."""

    value: FloatArray
    sd: FloatArray
    residual: float


def combine(
    forward: FloatArray, forward_sd: FloatArray, backward: FloatArray, backward_sd: FloatArray
) -> Smoothed:
    """Return the estimate from both directions, (n,); the only one where there is one; NaN where none."""
    both = np.isfinite(forward + forward_sd + backward + backward_sd)
    has_forward = np.isfinite(forward_sd)
    value, sd = np.where(has_forward, forward, backward), np.where(has_forward, forward_sd, backward_sd)
    if not both.any():
        return Smoothed(value, sd, math.nan)
    p_f, p_b = forward_sd[both] ** 2, backward_sd[both] ** 2
    residual = np.abs(forward - backward)[both] / np.sqrt(p_f + p_b)
    r = float(np.sqrt(np.mean(residual**2)))
    # At most the smaller variance: then the direction that has it is taken alone.
    common = np.minimum(max(1.0 - r * r, 0.0) * 0.5 * (p_f + p_b), np.minimum(p_f, p_b))
    own_f, own_b = p_f - common, p_b - common
    weight = np.divide(own_b, own_f + own_b, out=np.full(len(p_f), 0.5), where=own_f + own_b > 0.0)
    value[both] = weight * forward[both] + (1.0 - weight) * backward[both]
    variance = weight**2 * own_f + (1.0 - weight) ** 2 * own_b + common
    usual = max(min(r, float(np.median(residual)) / MEDIAN), 1.0)
    sd *= usual  # also where there is one direction
    sd[both] = np.sqrt(variance) * np.where(residual > SUSPECT, np.maximum(residual, usual), usual)
    return Smoothed(value, sd, r)
