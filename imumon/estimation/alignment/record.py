"""What the alignment keeps: slots of a unit at rest, in poses, with the turns between them.

Slots are cells of a quarter of a second at first; when there are too many, neighbours are merged.  A slot in
which the unit was disturbed keeps its place and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.alignment.fit import PoseFit

CAPACITY = 4096
"""Cells that are kept: 17 minutes of quarters of a second, then of halves, and so on."""
AXES = 3


@dataclass
class Pose:
    """A position in which the unit rested.

    Parameters
    ----------
    attitude : array (3, 3)
        Body axes to the frame of the first pose: its `geodesy.forward`, left of that, and up.
    turn_variance : float
        Of the angle about the vertical by which the unit was turned since the first pose, rad².
    counted_s : float
        Undisturbed time before it.
    passage_variance : float
        Of the angle since the pose before.
    crept_after : float
        How far it has turned about the vertical unnoticed after this pose, rad, counter-clockwise.
    told : PoseFit and array (3, 3), or None
        What it tells, and its attitude with the level of all of it, once it is over.
    """

    attitude: FloatArray
    turn_variance: float
    counted_s: float
    passage_variance: float = 0.0
    crept_after: float = 0.0
    told: tuple[PoseFit, FloatArray] | None = None


@dataclass
class Record:
    """Cells side by side, the first `count` rows of each array.

    Parameters
    ----------
    time_s : array (CAPACITY,)
        Middle of the cell, since the first sample of the segment.
    weight : array (CAPACITY,)
        Samples in it; zero where the unit was disturbed or nothing came.
    rate, force : array (CAPACITY, 3)
        Mean of the gyros, rad/s, and of the accelerometers, m/s², body axes.
    pose : array of int64, (CAPACITY,)
    """

    time_s: FloatArray = field(default_factory=lambda: np.zeros(CAPACITY))
    weight: FloatArray = field(default_factory=lambda: np.zeros(CAPACITY))
    rate: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, AXES)))
    force: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, AXES)))
    pose: IntArray = field(default_factory=lambda: np.zeros(CAPACITY, np.int64))
    count: int = 0
    merged: int = 1
    """Slots in a cell."""
    open: int = 0
    """Slots that the last cell lacks."""

    def add(self, time_s: float, weight: float, rate: FloatArray, force: FloatArray, pose: int) -> None:
        """Add a slot."""
        if self.open and self.pose[self.count - 1] == pose:
            k = self.count - 1
            done = self.merged - self.open
            self.time_s[k] += (time_s - self.time_s[k]) / (done + 1)
            total = self.weight[k] + weight
            share = weight / total if total > 0.0 else 0.5
            self.rate[k] += share * (rate - self.rate[k])
            self.force[k] += share * (force - self.force[k])
            self.weight[k] = total
            self.open -= 1
            return
        if self.count == CAPACITY:
            self._halve()
        k, self.count, self.open = self.count, self.count + 1, self.merged - 1
        self.time_s[k], self.weight[k], self.pose[k] = time_s, weight, pose
        self.rate[k], self.force[k] = rate, force

    def leave_out(self, since_s: float) -> None:
        """Count nothing of what was added since a time."""
        first = int(np.searchsorted(self.time_s[: self.count], since_s))
        self.weight[first : self.count] = 0.0

    def _halve(self) -> None:
        """Merge neighbours; two of different poses were a turn, and do not count."""
        same = self.pose[0::2] == self.pose[1::2]
        pair = self.weight.reshape(-1, 2)
        total = pair.sum(1)
        share = np.divide(pair, total[:, None], out=np.full_like(pair, 0.5), where=total[:, None] > 0.0)
        half, self.count = len(same), len(same)
        self.time_s[:half] = self.time_s.reshape(-1, 2).mean(1)
        for values in (self.rate, self.force):
            values[:half] = np.einsum("kj,kji->ki", share, values.reshape(-1, 2, AXES))
        self.weight[:half] = np.where(same, total, 0.0)
        self.pose[:half] = self.pose[1::2]
        self.merged, self.open = 2 * self.merged, 0

    def of_pose(self, number: int) -> npt.NDArray[np.int64]:
        """Return the rows of a pose from its first to its last that counts."""
        rows = np.flatnonzero((self.pose[: self.count] == number) & (self.weight[: self.count] > 0.0))
        return np.arange(rows[0], rows[-1] + 1) if len(rows) else rows
