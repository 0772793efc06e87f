"""What any filter of drift must beat: an exponential mean, and the mean of the beginning held for ever."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

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
        # Time at rest so far, and the mean.
        self._state = np.array([0.0, np.nan])

    def process(self, slots: Slots) -> FloatArray:
        """Return the mean after each slot, (m,); NaN before the first reading of a segment."""
        out = np.empty(len(slots))
        _average(slots.begins, slots.covered_s, slots.mean, self._constant, self._longest, self._state, out)
        return out


@njit(cache=True, nogil=True)
def _average(
    begins: npt.NDArray[np.bool_],
    covered: FloatArray,
    mean: FloatArray,
    constant: float,
    longest: float,
    state: FloatArray,
    out: FloatArray,
) -> None:
    for k in range(mean.size):
        if begins[k]:
            state[0], state[1] = 0.0, np.nan
        if covered[k] > 0.0 and state[0] < longest:
            state[0] += covered[k]
            before = mean[k] if np.isnan(state[1]) else state[1]
            gain = max(covered[k] / state[0], -math.expm1(-covered[k] / constant))
            state[1] = before + gain * (mean[k] - before)
        out[k] = state[1]


def hold(seconds: float) -> ExponentialMean:
    """Return a mean of the first seconds at rest that stays."""
    return ExponentialMean(math.inf, seconds)
