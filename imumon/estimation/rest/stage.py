"""The rest detector as a stage of the pipeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.rest.compass import reference
from imumon.estimation.rest.detector import GAP_S, begin, step
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import AXES, SLOT_S, Slot, State
from imumon.filters.slots import SlotGatherer, Slots, held

INPUTS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
AT_REST = Column("at_rest", "1", "int64", "1 while the unit is at rest, 0 while it moves or nothing is known")
TURN = tuple(
    Column(f"turn_hypothesis_{axis}", "rad/s", description=f"turn that may be a change of bias, {axis}")
    for axis in "xyz"
)


class RestDetector:
    """Finds rest and motion, without knowing the sensors' noise or bias.

    It decides at the end of each slot of an eighth of a second; a single sample far from the mean ends a rest
    at that sample.

    The columns ``turn_hypothesis_{x,y,z}`` are for who estimates the bias: by so much, rad/s, the gyros
    differ from the last rest while nothing tells a steady turn from a bias that has changed, or so much of
    the beginning of a slow turn may have been taken for rest.  Its square belongs in the variance of the
    bias as long as it is not zero (``at_rest`` is 0 meanwhile); the measurements of the next rest begin from
    that variance.

    Parameters
    ----------
    parameters : RestParameters
        What a resting unit may do.
    """

    def __init__(self, parameters: RestParameters | None = None) -> None:
        self._parameters = parameters or RestParameters()
        self._slots = SlotGatherer(AXES + 3, int(SLOT_S * 1e9))
        self._state = State()
        self._last_ns, self._last_segment = NO_INT, 0
        self._at_rest = 0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns ``at_rest`` and ``turn_hypothesis_{x,y,z}``."""
        return [AT_REST, *TURN]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return ``at_rest``, int64, and ``turn_hypothesis_{x,y,z}`` of a block.

        Needs ``device_time_ns`` and ``segment``; takes what there is of gyro_{x,y,z} in rad/s and
        accel_{x,y,z} in m/s², and of mag_{x,y,z}, yaw or q_{w,x,y,z}.
        """
        n = len(block)
        readings = np.full((n, AXES + 3), np.nan)
        for place, name in enumerate(INPUTS):
            readings[:, place] = block.columns.get(name, np.nan)
        heading = reference(block)
        if heading is not None:
            readings[:, AXES:] = heading
        time_ns, segment = block["device_time_ns"], block["segment"]
        rows = np.flatnonzero((time_ns != NO_INT) & np.isfinite(readings[:, :AXES]).any(1))
        before = self._last_ns, self._last_segment, self._at_rest
        turn = np.empty((len(rows), 3))
        before_turn = self._state.turn
        found = self._follow(time_ns[rows], segment[rows], readings[rows], turn)
        if len(rows) < n:
            found = _held(rows, found, time_ns, segment, before)
            turn = held(rows, turn, before_turn, n)
        return {AT_REST.name: found, **{column.name: turn[:, j] for j, column in enumerate(TURN)}}

    def _follow(
        self, time_ns: IntArray, segment: IntArray, readings: FloatArray, turn: FloatArray
    ) -> IntArray:
        """Return at_rest of rows that have a time and a reading, and fill turn, (n, 3)."""
        n = len(time_ns)
        at_rest = np.empty(n, np.int64)
        if not n:
            return at_rest
        slots = self._slots.process(time_ns, segment, readings)
        if self._last_ns == NO_INT:
            begin(self._state, 1e-9 * float(time_ns[0]), other=True)
        start = 0
        with np.errstate(invalid="ignore", divide="ignore"):
            for k, slot in enumerate(_each(slots, time_ns)):
                stop = int(slots.row[k])
                self._fill(at_rest, readings, start, stop)
                turn[start:stop] = self._state.turn
                other = bool(slots.segment[k] != segment[stop]) or slot.end_s < slot.start_s
                if other or 1e-9 * float(time_ns[stop] - slots.end_ns[k]) > GAP_S:
                    begin(self._state, slot.end_s, other)
                else:
                    step(self._state, self._parameters, slot)
                self._at_rest, start = int(self._state.at_rest), stop
        self._fill(at_rest, readings, start, n)
        turn[start:] = self._state.turn
        self._last_ns, self._last_segment = int(time_ns[-1]), int(segment[-1])
        return at_rest

    def _fill(self, at_rest: IntArray, readings: FloatArray, start: int, stop: int) -> None:
        """Fill in rows of the slot that is open: at rest as before, until a sample leaves the band."""
        at_rest[start:stop] = self._at_rest
        if self._at_rest:
            part = readings[start:stop, :AXES]
            outside = ((part < self._state.low) | (part > self._state.high)).any(1)
            if outside.any():
                at_rest[start + int(np.argmax(outside)) : stop] = self._at_rest = 0

    def notices(self) -> list[str]:
        """Return nothing: there is nothing to declare that the data could contradict."""
        return []

    def snapshot(self) -> dict[str, Any]:
        """Return a copy of the state."""
        return deepcopy({name: value for name, value in vars(self).items() if name != "_parameters"})

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from a state that `snapshot` returned."""
        vars(self).update(deepcopy(saved))


def _each(slots: Slots, time_ns: IntArray) -> list[Slot]:
    """Return the slots one by one; time_ns is that of the rows."""
    start_s, end_s = 1e-9 * slots.start_ns, 1e-9 * time_ns[slots.row]
    count = slots.count[:, :AXES].astype(np.float64)
    within = np.where(count > 1, slots.variance[:, :AXES] * count / np.maximum(count - 1.0, 1.0), np.nan)
    mean = slots.mean[:, :AXES]
    others = [part[:, :AXES] for part in (slots.smallest, slots.largest, slots.first, slots.last)]
    return [
        Slot(*values)
        for values in zip(
            start_s.tolist(), end_s.tolist(), count, mean, within, *others, slots.mean[:, AXES:], strict=True
        )
    ]


def _held(
    rows: IntArray, found: IntArray, time_ns: IntArray, segment: IntArray, before: tuple[int, int, int]
) -> IntArray:
    """Spread what was found in some rows over all: it holds for a while, in its segment, at known times.

    before is time, segment and at_rest of the last such row of the block before.
    """
    latest = np.searchsorted(rows, np.arange(len(time_ns)), side="right")
    last_ns, last_segment, last = (
        np.concatenate([[old], new])[latest]
        for old, new in zip(before, (time_ns[rows], segment[rows], found), strict=True)
    )
    holds: npt.NDArray[np.bool_] = (time_ns != NO_INT) & (last_ns != NO_INT) & (segment == last_segment)
    recent = time_ns - last_ns <= int(GAP_S * 1e9)
    return np.where(holds & recent, last, 0)
