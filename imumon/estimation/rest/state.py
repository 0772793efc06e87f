"""What the rest detector remembers, by name: the noise at rest, the latest slots, and the last rest."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray

SLOT_S = 0.125
AXES = 6
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
GYRO, ACCEL = slice(0, 3), slice(3, 6)
LEVELS = 8
"""Windows of 1, 2, 4 ... 128 slots are compared with their predecessors."""
KEPT: int = 7 * 2 ** (LEVELS - 1)
"""Slots that the longest windows and what they are compared with take."""
CAPACITY = 3 * KEPT

COARSEST_STEPS = (2.2e-3, 0.16)
"""No gyro (rad/s) and no accelerometer (m/s²) reads in coarser steps."""

BoolArray = npt.NDArray[np.bool_]


@dataclass(slots=True)
class Slot:
    """One slot of samples of the six axes; arrays are (6,).

    Parameters
    ----------
    start_s, end_s : float
        Time of its first sample and of the first behind it, s.
    count, mean, within : array
        Finite samples, their mean, and their variance about it (n - 1; NaN for a single one).
    smallest, largest, first, last : array
        Of the finite samples; NaN without any.
    reference : array, (3,)
        Mean of what turns with the heading (`compass`); NaN without any.
    """

    start_s: float
    end_s: float
    count: FloatArray
    mean: FloatArray
    within: FloatArray
    smallest: FloatArray
    largest: FloatArray
    first: FloatArray
    last: FloatArray
    reference: FloatArray

    @property
    def seconds(self) -> float:
        """Length of the slot."""
        return self.end_s - self.start_s


@dataclass
class History:
    """The latest slots, oldest first; the mean of any window of them is a difference of running sums.

    Parameters
    ----------
    length : int
        Slots in it.
    total, count : array, (CAPACITY + 1, 6)
        Sum and number of the samples of all slots before each.
    seconds : array, (CAPACITY + 1,)
        Seconds of all slots before each.
    mean, within : array, (CAPACITY, 6)
        Of each slot.
    reference : array, (CAPACITY, 3)
        The same of what turns with the heading.
    """

    length: int = 0
    total: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY + 1, AXES)))
    count: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY + 1, AXES)))
    seconds: FloatArray = field(default_factory=lambda: np.zeros(CAPACITY + 1))
    mean: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, AXES)))
    within: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, AXES)))
    reference: FloatArray = field(default_factory=lambda: np.zeros((CAPACITY, 3)))

    def add(self, slot: Slot) -> int:
        """Add a slot; return by how many places the older ones have moved to make room."""
        moved = 0
        if self.length == CAPACITY:
            moved = self._make_room()
        n = self.length
        self.total[n + 1] = self.total[n] + np.where(slot.count > 0, slot.count * slot.mean, 0.0)
        self.count[n + 1] = self.count[n] + slot.count
        self.seconds[n + 1] = self.seconds[n] + slot.seconds
        self.mean[n], self.within[n], self.reference[n] = slot.mean, slot.within, slot.reference
        self.length = n + 1
        return moved

    def _make_room(self) -> int:
        moved = CAPACITY - KEPT
        for sums in (self.total, self.count, self.seconds):
            sums[: KEPT + 1] = sums[moved:] - sums[moved]
        for values in (self.mean, self.within, self.reference):
            values[:KEPT] = values[moved:]
        self.length = KEPT
        return moved

    def means(self, cuts: npt.NDArray[np.intp]) -> FloatArray:
        """Return the means of the windows between neighbouring cuts, (..., k, 6) for (..., k + 1).

        The cuts fall; NaN where a window is empty.
        """
        total, count = self.total[cuts], self.count[cuts]
        difference = total[..., :-1, :] - total[..., 1:, :]
        return np.asarray(difference / (count[..., :-1, :] - count[..., 1:, :]))

    def latest(self, slots: int) -> tuple[FloatArray, FloatArray]:
        """Return mean and number of the samples of the latest slots, (6,) each; NaN without any."""
        n = self.length
        count = self.count[n] - self.count[n - slots]
        return (self.total[n] - self.total[n - slots]) / count, count


def _six(value: float) -> FloatArray:
    return np.full(AXES, value)


@dataclass
class State:
    """All that is carried from slot to slot; arrays are (6,) unless another shape is given.

    Parameters
    ----------
    at_rest : bool
    history : History
    known : array of bool
        Axes whose noise at rest is known.
    sample_variance : array
        Variance of a sample at rest.
    variance, gain : array, (LEVELS, 6)
        Variance of the mean of a window at rest, and the share of the next window in it.
    step : array
        Least difference of two readings that was seen.
    last : array
        Last reading.
    low, high : array
        Band of single readings of a unit at rest.
    rest_mean : array
        Mean at rest, while there is rest.
    windows_from, ring_from : int
        Places in the history where the windows, and the slots of a trial, may begin.
    hold_s, long_hold_s : float
        Times before which there is no rest again; the latter for a trial.
    slots : int
        Slots since the beginning.
    anchored : bool
        Whether there is a mean of the rest before, `anchor`, of variance `anchor_variance` at `anchor_s`.
    doubted_since_s : float
        Since when a mean has been steady that differs from the anchor; NaN when none has.
    turn : array, (3,)
        Rate, rad/s, by which the gyros differ from the anchor while nothing tells a turn from a bias.
    rest_since_s : float
        When the last rest was found.
    caution : float
        Factor of the time for which motion that is no longer seen is watched for.
    slow, turning : bool
        Whether the last rest ended so slowly that its end was hard to see, and whether a steady turn has been
        the hypothesis since.
    """

    at_rest: bool = False
    history: History = field(default_factory=History)
    known: BoolArray = field(default_factory=lambda: np.zeros(AXES, np.bool_))
    sample_variance: FloatArray = field(default_factory=lambda: _six(0.0))
    variance: FloatArray = field(default_factory=lambda: np.zeros((LEVELS, AXES)))
    gain: FloatArray = field(default_factory=lambda: np.zeros((LEVELS, AXES)))
    step: FloatArray = field(default_factory=lambda: np.repeat(COARSEST_STEPS, 3))
    last: FloatArray = field(default_factory=lambda: _six(np.nan))
    low: FloatArray = field(default_factory=lambda: _six(-np.inf))
    high: FloatArray = field(default_factory=lambda: _six(np.inf))
    rest_mean: FloatArray = field(default_factory=lambda: _six(0.0))
    windows_from: int = 0
    ring_from: int = 0
    hold_s: float = -np.inf
    long_hold_s: float = -np.inf
    slots: int = 0
    anchored: bool = False
    anchor: FloatArray = field(default_factory=lambda: _six(0.0))
    anchor_variance: FloatArray = field(default_factory=lambda: _six(0.0))
    anchor_s: float = 0.0
    doubted_since_s: float = np.nan
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    rest_since_s: float = -np.inf
    caution: float = 1.0
    slow: bool = False
    turning: bool = False

    @property
    def quiet_slots(self) -> int:
        """Slots since the last sign of motion."""
        return self.history.length - self.windows_from

    @property
    def resolution(self) -> FloatArray:
        """Step of each axis whose noise does not hide it, else 0, (6,)."""
        return np.where(self.sample_variance < 0.25 * self.step**2, self.step, 0.0)

    def add(self, slot: Slot) -> None:
        """Add a slot to the history, and see how fine the sensor's steps are."""
        moved = self.history.add(slot)
        self.windows_from = max(self.windows_from - moved, 0)
        self.ring_from = max(self.ring_from - moved, 0)
        least = ROUNDING * (np.abs(slot.mean) + 1e-3)
        for step in (slot.largest - slot.smallest, np.abs(slot.first - self.last)):
            self.step = np.where((step > least) & (step < self.step), step, self.step)
        self.last = np.where(slot.count > 0, slot.last, self.last)


ROUNDING = 1e-9
"""Samples that differ by less than this share are equal: means of equal samples differ by rounding."""
