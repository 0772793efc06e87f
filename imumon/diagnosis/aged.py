"""A run from power-on that may go on for days, in bounded memory: its slots become longer as it ages."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import REST_SHARE
from imumon.diagnosis.runs import SECOND_NS, Run, add_vibration
from imumon.recordings.reduced import ACCEL, GYRO, KeptSlots

MOST_SLOTS = 7200
"""Two hours of seconds: a glance at that takes some tenths of a second.  A column takes 32 bytes of each."""


class AgedRun:
    """Sums over slots of 1, 2, 4, ... s: where a slot more would be too many, they are joined in pairs.

    Gyros count at rest alone, so that a slot in which the unit moved for a while still tells of the rest of
    it.

    Parameters
    ----------
    names : sequence of str
        The m columns.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._gyros = [at for at, name in enumerate(names) if name in GYRO]
        shape = (MOST_SLOTS, len(names))
        self._count, self._total = np.zeros(shape), np.zeros(shape)
        self._scatter, self._free = np.zeros(shape), np.zeros(shape)
        self._width, self._last = 1, -1
        self._begun_ns = 0

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, however long the run is."""
        return sum(part.nbytes for part in self._sums)

    @property
    def _sums(self) -> tuple[FloatArray, ...]:
        """Of each slot and column: values, their sum, squares about the means of seconds, and what is free
        in these."""
        return self._count, self._total, self._scatter, self._free

    def has_any(self, names: Collection[str]) -> bool:
        """Tell whether any of these columns has values in several slots."""
        among = [at for at, name in enumerate(self._names) if name in names]
        return bool(((self._count[:, among] > 0).sum(axis=0) > 1).any())

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
            self._join()
        count = part.count[:, :-1].astype(np.float64)
        count[:, self._gyros] *= (part.mean[:, -1] >= REST_SHARE)[:, np.newaxis]
        there = count > 0
        mean, variance = (np.where(there, values[:, :-1], 0.0) for values in (part.mean, part.variance))
        free = np.maximum(count - 1.0, 0.0)
        for total, more in zip(self._sums, (count, mean * count, variance * count, free), strict=True):
            np.add.at(total, second // self._width, more)

    def _join(self) -> None:
        half = MOST_SLOTS // 2
        for total in self._sums:
            total[:half] = total[::2] + total[1::2]
            total[half:] = 0.0
        self._width *= 2

    def run(self) -> Run:
        """Return the run so far, in slots that have ended; at rest where a gyro was."""
        n = max(1, (self._last + 1) // self._width)
        count, total, scatter, free = (part[:n] for part in self._sums)
        there = [at for at in range(len(self._names)) if at in self._gyros or count[:, at].any()]

        def over(sums: FloatArray, by: FloatArray) -> dict[str, FloatArray]:
            values = np.where(by > 0, sums / np.maximum(by, 1.0), np.nan)
            return {self._names[at]: values[:, at] for at in there}

        mean, variance = over(total, count), over(scatter, free)
        if all(name in mean for name in ACCEL):
            add_vibration(mean, variance)
        if self._width > 1:
            # How samples scatter within seconds does not tell how means of many seconds do.
            variance = {name: np.full(n, np.nan) for name in variance}
        return Run(
            "this session",
            np.asarray((np.arange(n) + 0.5) * self._width),
            {self._names[at]: count[:, at].copy() for at in there},
            mean,
            variance,
            np.asarray((count[:, self._gyros] > 0).all(axis=1), np.float64),
            slot_s=float(self._width),
        )
