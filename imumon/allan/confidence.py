"""Confidence intervals of deviations, by chi-square."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray

CONFIDENCE = 0.683
"""Probability of the intervals: one standard deviation of a normal distribution."""
TRUSTED_FREEDOM = 4.0
"""An averaging time is trusted when its variance has so many degrees of freedom: the deviation is then known
to about 35 %."""


def intervals(variances: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper ends of the intervals of deviations, (n,) each, for degrees of freedom, (n,)."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    scaled = variances * freedom
    return np.sqrt(scaled / _quantile(1.0 - tail, freedom)), np.sqrt(scaled / _quantile(tail, freedom))


def _quantile(probability: float, freedom: FloatArray) -> FloatArray:
    """Return the quantile of chi-square with these degrees of freedom."""
    from scipy.special import gammaincinv  # 0.13 s, which no command spends before the first curve

    return np.asarray(2.0 * gammaincinv(0.5 * freedom, probability))
