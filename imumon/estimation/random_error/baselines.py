"""What any filter of drift must beat: an exponential mean, and the mean of the beginning held for ever."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.random_error.slots import Slots


class ExponentialMean:
    """Mean with exponentially fading memory; over what there is so far until that is as long as the memory.

    Parameters
    ----------
    time_constant_s : float
        s at rest; infinity for the mean of everything.
    longest_s : float
        After so many s at rest the mean is held.
    """

    def __init__(self, time_constant_s: float, longest_s: float = math.inf) -> None:
        self._constant, self._longest = time_constant_s, longest_s
        self._seen, self._mean = 0.0, math.nan

    def process(self, slots: Slots) -> FloatArray:
        """Return the mean after each slot, (m,); NaN before the first reading of a segment."""
        out = np.empty(len(slots))
        for k, (begins, covered, mean) in enumerate(
            zip(slots.begins.tolist(), slots.covered_s.tolist(), slots.mean.tolist(), strict=True)
        ):
            if begins:
                self._seen, self._mean = 0.0, math.nan
            if covered > 0.0 and self._seen < self._longest:
                self._seen += covered
                before = mean if math.isnan(self._mean) else self._mean
                gain = max(covered / self._seen, -math.expm1(-covered / self._constant))
                self._mean = before + gain * (mean - before)
            out[k] = self._mean
        return out


def hold(seconds: float) -> ExponentialMean:
    """Return a mean of the first seconds at rest that stays."""
    return ExponentialMean(math.inf, seconds)
