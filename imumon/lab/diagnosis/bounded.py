"""A run from power-on that may go on for days, in bounded memory: its slots become longer as it ages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import SECOND_NS, Run, add_vibration
from imumon.recordings.reduced import GYRO, KeptSlots

MOST_SLOTS = 7200
"""Two hours of seconds; a column takes 32 bytes of each."""


class BoundedRun:
    """Sums over slots of 1, 2, 4, ... s: where they would be too many, neighbours are added in pairs.

    Gyros count at rest only, so that the rest of a slot counts in which the unit moved for a while.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._gyros = [at for at, name in enumerate(names) if name in GYRO]
        self._sums = np.zeros((MOST_SLOTS, 4, len(names)))
        """Samples, their sum, squares about the means of seconds, and degrees of freedom of these."""
        self._width, self._last, self._begun_ns = 1, -1, 0

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, however long the run is."""
        return self._sums.nbytes

    def elapsed_s(self, part: KeptSlots) -> FloatArray:
        """Return the time from the first sample to the end of each second, (n,)."""
        begun_ns = self._begun_ns if self._last >= 0 else int(part.start_ns[0])
        return np.asarray((part.end_ns - begun_ns) / SECOND_NS)

    def take(self, part: KeptSlots) -> None:
        """Add seconds; the last column of the part is the share at rest, which is not one of the run's."""
        if self._last < 0:
            self._begun_ns = int(part.start_ns[0])
        second = (part.start_ns - self._begun_ns) // SECOND_NS
        self._last = int(second[-1])
        while self._last // self._width >= MOST_SLOTS:
            half = MOST_SLOTS // 2
            self._sums[:half] = self._sums[::2] + self._sums[1::2]
            self._sums[half:] = 0.0
            self._width *= 2
        count = part.count[:, :-1].astype(np.float64)
        count[:, self._gyros] *= (part.mean[:, -1] == 1.0)[:, np.newaxis]
        mean, variance = (np.where(count > 0, part_of[:, :-1], 0.0) for part_of in (part.mean, part.variance))
        more = np.stack([count, mean * count, variance * count, np.maximum(count - 1.0, 0.0)], axis=1)
        np.add.at(self._sums, second // self._width, more)

    def run(self) -> Run:
        """Return the run so far, in slots that have ended; at rest where a gyro was."""
        n = max(1, (self._last + 1) // self._width)
        count, total, scatter, free = self._sums[:n].swapaxes(0, 1)
        there = [at for at in range(len(self._names)) if at in self._gyros or count[:, at].any()]

        def ratio(sums: FloatArray, by: FloatArray) -> dict[str, FloatArray]:
            values = np.where(by > 0, sums / np.maximum(by, 1.0), np.nan)
            return {self._names[at]: values[:, at] for at in there}

        mean, variance = ratio(total, count), ratio(scatter, free)
        add_vibration(mean, variance)
        if self._width > 1:
            # The scatter of samples within seconds does not show that of means of many seconds.
            variance = {name: np.full(n, np.nan) for name in variance}
        return Run(
            name="this session",
            time_s=np.asarray((np.arange(n) + 0.5) * self._width),
            count={self._names[at]: count[:, at].copy() for at in there},
            mean=mean,
            variance=variance,
            rest=np.asarray((count[:, self._gyros] > 0).all(axis=1), np.float64),
            slot_s=float(self._width),
        )
