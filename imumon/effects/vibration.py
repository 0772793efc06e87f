"""Vibration as a driver: the variance of the specific force within a second, summed over its components."""

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.filters.slots import SlotGatherer, held

VIBRATION = "vibration"
"""Its name among the drivers; in (m/s²)²."""
SECOND_NS = 1_000_000_000


class Vibration:
    """The vibration of the last whole second, sample by sample; NaN before there is one."""

    def __init__(self) -> None:
        self._slots = SlotGatherer(3, SECOND_NS)
        self._last = np.full(1, np.nan)

    def process(self, time_ns: IntArray, segment: IntArray, accel: FloatArray) -> FloatArray:
        """Return it at the next samples, (n,); `accel` is the specific force in m/s², (n, 3), or NaN."""
        ended = self._slots.process(time_ns, segment, accel)
        count = ended.count.astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            unbiased = np.where(count > 1, ended.variance * count / (count - 1), np.nan).sum(axis=1)
        found = held(ended.row, unbiased[:, None], self._last, len(time_ns))
        if len(found):
            self._last = found[-1].copy()
        return found[:, 0]
