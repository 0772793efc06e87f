"""Samples gathered into slots of equal length: the one place where estimators touch samples.

Estimators are updated a few times a second; a sensor sends a hundred to some thousand samples.  A slot
keeps of its samples what any estimator needs: how many, their mean and spread, extremes, the first and the
last, how neighbours differ, and how the unit has turned.  Slots lie on a grid that begins with the first
sample of a segment.  A slot ends with the first sample behind it, so its results are known from that row on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray
from imumon.compiled import inner, njit

from .turns import TURN, Turn, add_rate, begin_segment, begin_turn, turn_of


@dataclass(frozen=True, eq=False)
class Slots:
    """m slots of k columns that ended, in order."""

    row: IntArray  # first row of the block behind the slot, (m,): there the results of the slot are known
    segment: IntArray  # of its samples, (m,)
    begins: BoolArray  # whether it is the first slot of its segment, or of a time that ran back, (m,)
    start_ns: IntArray  # device time of the first and the last sample in it, (m,)
    end_ns: IntArray
    samples: IntArray  # rows in the slot, whether or not they have values, (m,)
    count: IntArray  # finite values, (m, k); the next six are of these, NaN without any
    mean: FloatArray
    variance: FloatArray  # about their mean
    smallest: FloatArray
    largest: FloatArray
    first: FloatArray
    last: FloatArray
    step_count: IntArray  # pairs of values in successive rows, the later of which is in the slot, (m, k)
    step_squares: FloatArray  # sum of their squared differences, (m, k)
    changes: IntArray  # how many of them differ at all, (m, k)
    turns: Sequence[Turn]  # how the unit turned, (m,); empty if the gatherer has no rates of turn

    def __len__(self) -> int:
        return len(self.row)

    @property
    def middle_ns(self) -> IntArray:
        """Mean of first and last time, (m,): what the mean of a slot refers to."""
        return self.start_ns + (self.end_ns - self.start_ns) // 2


SLOT = np.dtype(
    [(name, np.int64) for name in ("row", "segment", "start_ns", "end_ns", "samples", "origin_ns", "stop_ns")]
    + [(name, np.bool_) for name in ("begins", "begun")]
)
"""A slot of compiled code: as `Slots`; first time of its segment, time at which it ends, whether it began."""
COLUMN = np.dtype(
    [(name, np.int64) for name in ("count", "step_count", "changes")]
    + [(name, np.float64) for name in ("mean", "variance", "smallest", "largest", "first", "last")]
    + [(name, np.float64) for name in ("step_squares", "total", "squares", "previous")]
)
"""Its column: as `Slots`; sums of differences from `first` and of their squares, value of the row before."""
ENDLESS_NS = 2**62
"""Length of slots that end with their segment, or where time runs back: their `Slots.row` are the breaks."""


class SlotGatherer:
    """Gathers rows of values into slots of a length; the same slots whatever the division into blocks.

    With `turns` the first three columns are the rates of turn about the body axes, rad/s, to be integrated.
    """

    def __init__(self, columns: int, length_ns: int, turns: bool = False) -> None:
        self.length_ns = length_ns
        self._turns = turns
        self._slot = np.zeros(1, SLOT)
        self._columns = np.zeros(columns, COLUMN)
        self._turn = np.zeros(1, TURN)

    def process(self, time_ns: IntArray, segment: IntArray, values: FloatArray) -> Slots:
        """Return the slots that end within these rows.

        Device time and segment are (n,); a row whose time is `NO_INT` is left out, and a new segment, or a
        time that runs back, begins anew.  Values, (n, k), are in any unit, NaN where there is none.
        """
        n = len(time_ns)
        slots, columns = np.empty(n, SLOT), np.empty((n, len(self._columns)), COLUMN)
        turns = np.empty(n if self._turns else 0, TURN)
        values = np.ascontiguousarray(values, np.float64)
        m = _gather(
            time_ns, segment, values, self.length_ns, self._turns, self._slot, self._columns, self._turn,
            slots, columns, turns,
        )  # fmt: skip
        found: dict[str, Any] = {"turns": [turn_of(one) for one in turns[:m].copy()]}
        for name in (field.name for field in fields(Slots) if field.name not in found):
            found[name] = (slots if name in (SLOT.names or ()) else columns)[name][:m]
        return Slots(**found)

    def finish(self) -> Slots:
        """Return the slot that is open at the end of the rows, if there is one; then begin as new."""
        behind = self._slot["segment"] + 1  # a row of another segment ends it
        last = self.process(np.zeros(1, np.int64), behind, np.full((1, len(self._columns)), np.nan))
        self._slot["begun"] = False
        return last


def held(row: IntArray, values: npt.NDArray[Any], before: npt.NDArray[Any], n: int) -> npt.NDArray[Any]:
    """Return for each of n rows the value of the latest slot, (n, ...).

    `values` (m, ...) hold from the rows (m,) on (`Slots.row`), `before` (...) held before the first of them.
    """
    return np.repeat(np.concatenate([before[None], values]), np.diff([0, *row, n]), axis=0)


# Records are passed as whole arrays: arrays in a tuple would cost more than all the sums, at each call.


@inner
def _begin_slot(slot: Any, columns: Any, time_ns: int, length_ns: int) -> None:
    slot.start_ns = time_ns
    slot.stop_ns = slot.origin_ns + ((time_ns - slot.origin_ns) // length_ns + 1) * length_ns
    slot.samples = 0
    for j in range(len(columns)):
        column = columns[j]
        column.count = column.step_count = column.changes = 0
        column.total = column.squares = column.step_squares = 0.0
        column.mean = column.variance = np.nan
        column.smallest = column.largest = column.first = column.last = np.nan


@inner
def _end_slot(slot: Any, columns: Any, row: int, ended_columns: Any) -> None:
    slot.row = row
    for j in range(len(columns)):
        column = columns[j]
        if column.count > 0:
            offset = column.total / column.count
            column.mean = column.first + offset
            column.variance = max(column.squares / column.count - offset * offset, 0.0)
        ended_columns[j] = column


@inner
def _add_row(columns: Any, values: FloatArray, i: int) -> None:
    """Add a row; sums are taken from the slot's first value, so that a large mean costs no digits."""
    for j in range(len(columns)):
        column, x = columns[j], values[i, j]
        if not np.isfinite(x):
            column.previous = np.nan
            continue
        if column.count == 0:
            column.smallest = column.largest = column.first = x
        column.count += 1
        offset = x - column.first
        column.total += offset
        column.squares += offset * offset
        column.smallest = min(column.smallest, x)
        column.largest = max(column.largest, x)
        column.last = x
        step = x - column.previous
        if np.isfinite(step):
            column.step_count += 1
            column.step_squares += step * step
            column.changes += step != 0.0
        column.previous = x


@njit
def _gather(
    time_ns: IntArray, segment: IntArray, values: FloatArray, length_ns: int, with_turns: bool, opened: Any,
    columns: Any, turn: Any, ended: Any, ended_columns: Any, turns: Any,
) -> int:  # fmt: skip
    """Add the rows and write the slots that end; return how many."""
    m = 0
    slot = opened[0]
    for i in range(len(time_ns)):
        now = time_ns[i]
        if now == NO_INT:
            continue
        anew = segment[i] != slot.segment or now < slot.end_ns or not slot.begun
        if anew or now >= slot.stop_ns:
            if slot.begun:
                _end_slot(slot, columns, i, ended_columns[m])
                ended[m] = slot
                if with_turns:
                    turns[m] = turn[0]
                m += 1
            if anew:
                slot.segment, slot.origin_ns = segment[i], now
                for j in range(len(columns)):
                    columns[j].previous = np.nan
                begin_segment(turn[0])
            slot.begins, slot.begun = anew, True
            _begin_slot(slot, columns, now, length_ns)
            begin_turn(turn[0])
        slot.end_ns = now
        slot.samples += 1
        _add_row(columns, values, i)
        if with_turns:
            add_rate(turn[0], now, (values[i, 0], values[i, 1], values[i, 2]))
    return m
