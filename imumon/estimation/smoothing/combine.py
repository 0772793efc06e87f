"""One estimate of two: what the past says, and what the future says (Fraser and Potter 1969).

Were their errors independent, their difference would have the variance P_f + P_b, and the weights were the
inverse variances.  A disagreement over that of r, rms over a recording, tells how it is::

    r < 1    the errors have a part in common, c = (1 - r²) (P_f + P_b) / 2, which no weighing takes away
    r > 1    there is an effect that the model lacks: all standard deviations are larger by r, or by what is
             usual (the median) when that is less; those of a moment at which both sides are further apart
             than twice their standard deviation by as much as they are (the rule of the Particle Data Group)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray

SUSPECT = 2.0
"""χ² with one degree of freedom is beyond the square of this in 5 %."""
MEDIAN = 0.6745
"""Of the magnitude of a standard normal value."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Estimate and standard deviation, (n,) each, and the disagreement of both sides in units of theirs."""

    value: FloatArray
    sd: FloatArray
    disagreement: float


def combine(
    forward: FloatArray, forward_sd: FloatArray, backward: FloatArray, backward_sd: FloatArray
) -> Smoothed:
    """Return the estimate by both sides, (n,); where there is one side only, that one; NaN where none.

    Parameters
    ----------
    forward, forward_sd, backward, backward_sd : array (n,)
        NaN where nothing is known.
    """
    past, future = forward_sd**2, backward_sd**2
    both = np.isfinite(forward + past + backward + future)
    ratio = (forward - backward)[both] / np.sqrt((past + future)[both])
    r = float(np.sqrt(np.mean(ratio**2))) if both.any() else math.nan
    value, variance = np.where(np.isfinite(forward_sd), forward, backward), np.fmin(past, future)
    only_past, only_future = np.isfinite(past) & ~both, np.isfinite(future) & ~both
    variance[only_past], variance[only_future] = past[only_past], future[only_future]
    f, b = past[both], future[both]
    # No more in common than the better of the two has: with all of it the better alone is taken.
    common = np.minimum(max(1.0 - r * r, 0.0) * 0.5 * (f + b), np.minimum(f, b)) if both.any() else f
    difference = f + b - 2.0 * common
    weight = np.where(difference > 0.0, (b - common) / np.where(difference > 0.0, difference, 1.0), 0.5)
    value[both] = weight * forward[both] + (1.0 - weight) * backward[both]
    variance[both] = weight**2 * f + (1.0 - weight) ** 2 * b + 2.0 * weight * (1.0 - weight) * common
    if both.any():
        apart = np.abs(ratio)
        usual = max(min(r, float(np.median(apart)) / MEDIAN), 1.0)
        variance[both] *= np.maximum(usual, np.where(apart > SUSPECT, apart, 1.0)) ** 2
    return Smoothed(value, np.sqrt(variance), r)
