"""Samples gathered into slots of equal length: the one place where estimators touch samples.

Estimators think a few times a second; a sensor sends a hundred to some thousand samples.  A slot keeps of its
samples what any estimator needs: how many, their mean and spread, extremes, the first and the last, and how
neighbours differ.  Slots lie on a grid that begins with the first sample of a segment.  A slot ends with the
first sample behind it, so what a slot says is known from that row on.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.compiled import njit


@dataclass(frozen=True, slots=True, eq=False)
class Slots:
    """m slots of k columns that ended, in order.

    Parameters
    ----------
    row : array of int64, (m,)
        First row of the block behind the slot: from there on what the slot says is known.
    segment : array of int64, (m,)
        Segment of the slot's samples.
    begins : array of bool, (m,)
        Whether this is the first slot of its segment, or of a time that ran back.
    start_ns, end_ns : array of int64, (m,)
        Device time of the first and the last sample in it.
    samples : array of int64, (m,)
        Rows in the slot, whether or not they have values.
    count : array of int64, (m, k)
        Finite values.
    mean, variance : array, (m, k)
        Of the finite values, the variance about their mean; NaN without any.
    smallest, largest, first, last : array, (m, k)
        Of the finite values; NaN without any.
    step_count : array of int64, (m, k)
        Pairs of finite values in successive rows of the segment, the later of which is in the slot.
    step_squares : array, (m, k)
        Sum of their squared differences.
    changes : array of int64, (m, k)
        How many of them differ at all.
    """

    row: IntArray
    segment: IntArray
    begins: npt.NDArray[np.bool_]
    start_ns: IntArray
    end_ns: IntArray
    samples: IntArray
    count: IntArray
    mean: FloatArray
    variance: FloatArray
    smallest: FloatArray
    largest: FloatArray
    first: FloatArray
    last: FloatArray
    step_count: IntArray
    step_squares: FloatArray
    changes: IntArray

    def __len__(self) -> int:
        """Return the number of slots."""
        return len(self.row)

    def __getitem__(self, which: slice | npt.NDArray[np.bool_]) -> Slots:
        """Return some of the slots."""
        return Slots(*(getattr(self, field.name)[which] for field in fields(self)))

    @property
    def middle_ns(self) -> IntArray:
        """Mean of first and last time, (m,): what the mean of a slot refers to."""
        return np.asarray(self.start_ns + (self.end_ns - self.start_ns) // 2)


class _Open(NamedTuple):
    """The slot that is being filled; scalars are arrays of one."""

    begun: IntArray
    begins: IntArray
    segment: IntArray
    origin_ns: IntArray
    start_ns: IntArray
    last_ns: IntArray
    samples: IntArray
    present: IntArray
    shift: FloatArray
    total: FloatArray
    squares: FloatArray
    smallest: FloatArray
    largest: FloatArray
    first: FloatArray
    last: FloatArray
    previous: FloatArray
    step_count: IntArray
    step_squares: FloatArray
    changes: IntArray


def _empty(columns: int) -> _Open:
    """Return a slot that has seen nothing."""
    scalar = np.zeros((7, 1), np.int64)
    integer = np.zeros((3, columns), np.int64)
    number = np.zeros((8, columns))
    return _Open(
        scalar[0], scalar[1], scalar[2], scalar[3], scalar[4], scalar[5], scalar[6], integer[0],
        number[0], number[1], number[2], number[3], number[4], number[5], number[6], number[7],
        integer[1], np.zeros(columns), integer[2],
    )  # fmt: skip


class SlotGatherer:
    """Gathers rows into slots; the same slots whatever the division into blocks.

    Parameters
    ----------
    columns : int
        Columns of the values.
    length_ns : int
        Length of a slot.

    Raises
    ------
    ValueError
        When the length is not positive.
    """

    def __init__(self, columns: int, length_ns: int) -> None:
        if length_ns <= 0:
            raise ValueError(f"slots of {length_ns} ns")
        self.length_ns = length_ns
        self._columns = columns
        self._open = _empty(columns)

    def process(self, time_ns: IntArray, segment: IntArray, values: FloatArray) -> Slots:
        """Return the slots that end within these rows.

        Parameters
        ----------
        time_ns, segment : array of int64, (n,)
            Device time and its segment; a row whose time is `NO_INT` is left out.  A new segment, or a time
            that runs back, begins anew.
        values : array, (n, k)
            Any unit; NaN where there is none.
        """
        n = len(time_ns)
        if values.shape != (n, self._columns):
            raise ValueError(f"values of shape {values.shape} for {n} rows of {self._columns} columns")
        integers, numbers = np.empty((n, 6), np.int64), np.empty((n, 7, self._columns))
        counts = np.empty((n, 3, self._columns), np.int64)
        values = np.ascontiguousarray(values, np.float64)
        m = _gather(time_ns, segment, values, self.length_ns, self._open, integers, numbers, counts)
        row, label, begins, start, end, samples = integers[:m].T
        mean, variance, smallest, largest, first, last, squares = np.moveaxis(numbers[:m], 1, 0)
        count, step_count, changes = np.moveaxis(counts[:m], 1, 0)
        return Slots(
            row, label, begins == 1, start, end, samples, count, mean, variance,
            smallest, largest, first, last, step_count, squares, changes,
        )  # fmt: skip

    def finish(self) -> Slots:
        """Return the slot that is open at the end of the rows, if there is one; then begin as new."""
        behind = self._open.segment + 1
        last = self.process(np.zeros(1, np.int64), behind, np.full((1, self._columns), np.nan))
        self._open = _empty(self._columns)
        return last

    def snapshot(self) -> dict[str, npt.NDArray[np.int64] | FloatArray]:
        """Return a copy of the state."""
        return {name: values.copy() for name, values in self._open._asdict().items()}

    def restore(self, saved: dict[str, npt.NDArray[np.int64] | FloatArray]) -> None:
        """Go on from a state that `snapshot` returned."""
        for name, values in self._open._asdict().items():
            values[...] = saved[name]


def held(row: IntArray, values: FloatArray, before: FloatArray, n: int) -> FloatArray:
    """Return for each of n rows what the latest slot said, (n, ...).

    Parameters
    ----------
    row : array of int64, (m,)
        Where each value begins to hold (`Slots.row`).
    values : array, (m, ...)
    before : array, (...)
        What held before the first of them.
    """
    which = np.searchsorted(row, np.arange(n), side="right")
    return np.asarray(np.concatenate([np.asarray(before)[np.newaxis], values])[which])


@njit
def _clear(slot: _Open, time_ns: int) -> None:
    """Begin a slot with the row at this time."""
    slot.start_ns[0] = time_ns
    slot.samples[0] = 0
    slot.present[:] = 0
    slot.total[:] = 0.0
    slot.squares[:] = 0.0
    slot.step_count[:] = 0
    slot.step_squares[:] = 0.0
    slot.changes[:] = 0


@njit
def _close(slot: _Open, row: int, m: int, integers: IntArray, numbers: FloatArray, counts: IntArray) -> None:
    """Write the slot into row m of the results."""
    integers[m, 0], integers[m, 1], integers[m, 2] = row, slot.segment[0], slot.begins[0]
    integers[m, 3], integers[m, 4], integers[m, 5] = slot.start_ns[0], slot.last_ns[0], slot.samples[0]
    slot.begins[0] = 0
    for j in range(len(slot.present)):
        n = slot.present[j]
        counts[m, 0, j], counts[m, 1, j], counts[m, 2, j] = n, slot.step_count[j], slot.changes[j]
        numbers[m, 6, j] = slot.step_squares[j]
        if n == 0:
            numbers[m, :6, j] = np.nan
            continue
        offset = slot.total[j] / n
        numbers[m, 0, j] = slot.shift[j] + offset
        numbers[m, 1, j] = max(slot.squares[j] / n - offset * offset, 0.0)
        numbers[m, 2, j], numbers[m, 3, j] = slot.smallest[j], slot.largest[j]
        numbers[m, 4, j], numbers[m, 5, j] = slot.first[j], slot.last[j]


@njit
def _add(slot: _Open, values: FloatArray, i: int) -> None:
    """Add a row; sums are taken from the slot's first value, so that a large mean costs no digits."""
    slot.samples[0] += 1
    for j in range(len(slot.present)):
        x = values[i, j]
        if not np.isfinite(x):
            slot.previous[j] = np.nan
            continue
        if slot.present[j] == 0:
            slot.shift[j] = slot.smallest[j] = slot.largest[j] = slot.first[j] = x
        slot.present[j] += 1
        offset = x - slot.shift[j]
        slot.total[j] += offset
        slot.squares[j] += offset * offset
        slot.smallest[j] = min(slot.smallest[j], x)
        slot.largest[j] = max(slot.largest[j], x)
        slot.last[j] = x
        step = x - slot.previous[j]
        if np.isfinite(step):
            slot.step_count[j] += 1
            slot.step_squares[j] += step * step
            slot.changes[j] += step != 0.0
        slot.previous[j] = x


@njit
def _gather(
    time_ns: IntArray, segment: IntArray, values: FloatArray, length_ns: int, slot: _Open,
    integers: IntArray, numbers: FloatArray, counts: IntArray,
) -> int:  # fmt: skip
    """Add the rows and write the slots that end; return how many."""
    m = 0
    for i in range(len(time_ns)):
        now = time_ns[i]
        if now == NO_INT:
            continue
        anew = segment[i] != slot.segment[0] or now < slot.last_ns[0]
        if slot.begun[0] and (
            anew
            or (now - slot.origin_ns[0]) // length_ns != (slot.start_ns[0] - slot.origin_ns[0]) // length_ns
        ):
            _close(slot, i, m, integers, numbers, counts)
            m += 1
            _clear(slot, now)
        if anew or not slot.begun[0]:
            slot.begun[0] = slot.begins[0] = 1
            slot.segment[0] = segment[i]
            slot.origin_ns[0] = now
            slot.previous[:] = np.nan
            _clear(slot, now)
        slot.last_ns[0] = now
        _add(slot, values, i)
    return m
