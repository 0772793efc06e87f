"""The rest detector as a stage of the pipeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.rest.compass import reference
from imumon.estimation.rest.detector import GAP_S, begin, step
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import AXES, SLOT_S, Slot, State, empty_slots
from imumon.estimation.rest.thermometer import temperature
from imumon.estimation.rest.windows import compile_kernels
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
    the beginning of a slow turn may have been taken for rest, or the steps of the sensor hide.  Its square
    belongs in the variance of the bias as long as it is not zero (``at_rest`` is 0 meanwhile); the
    measurements of the next rest begin from that variance.

    Parameters
    ----------
    parameters : RestParameters
        What a resting unit may do.
    """

    def __init__(self, parameters: RestParameters | None = None) -> None:
        self._parameters = parameters or RestParameters()
        self._slots = SlotGatherer(AXES + 4, int(SLOT_S * 1e9))
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
        accel_{x,y,z} in m/s², of mag_{x,y,z}, yaw or q_{w,x,y,z}, and of temperature_estimate or temperature
        in °C.
        """
        n = len(block)
        readings = np.full((n, AXES + 4), np.nan)
        for place, name in enumerate(INPUTS):
            readings[:, place] = block.columns.get(name, np.nan)
        heading = reference(block)
        if heading is not None:
            readings[:, AXES:-1] = heading
        readings[:, -1] = temperature(block)
        time_ns, segment = block["device_time_ns"], block["segment"]
        rows = np.flatnonzero((time_ns != NO_INT) & np.isfinite(readings[:, :AXES]).any(1))
        if len(rows) == n:
            found, turn = self._follow(time_ns, segment, readings)
        else:
            before = self._last_ns, self._last_segment, self._at_rest
            before_turn = self._state.shown
            found, turn = self._follow(time_ns[rows], segment[rows], readings[rows])
            found = _held(rows, found, time_ns, segment, before)
            turn = held(rows, turn, before_turn, n)
        return {AT_REST.name: found, **{column.name: turn[:, j] for j, column in enumerate(TURN)}}

    def _follow(
        self, time_ns: IntArray, segment: IntArray, readings: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return at_rest and turn, (n, 3), of rows that have a time and a reading."""
        n, state = len(time_ns), self._state
        if not n:
            return np.empty(0, np.int64), np.empty((0, 3))
        ended = self._slots.process(time_ns, segment, readings)
        if self._last_ns == NO_INT:
            compile_kernels()  # before the first slot, not with it
            begin(state, 1e-9 * float(time_ns[0]), other=True)
        edges = [0, *ended.row.tolist(), n]
        rest, turn = np.empty(len(edges) - 1, np.int64), np.empty((len(edges) - 1, 3))
        outside: list[tuple[int, int]] = []
        other = (ended.segment != segment[ended.row]) | (time_ns[ended.row] < ended.start_ns)
        gap = time_ns[ended.row] - ended.end_ns > int(GAP_S * 1e9)
        broken = np.flatnonzero(other | gap).tolist()
        with np.errstate(invalid="ignore", divide="ignore"):
            slots, end_s = _slots_of(ended, time_ns), (1e-9 * time_ns[ended.row]).tolist()
            first = 0
            while first < len(end_s):
                was, undecided = self._at_rest, state.shown
                if broken and broken[0] == first:
                    begin(state, end_s[first], bool(other[broken.pop(0)]))
                    last = first
                else:
                    stop = broken[0] if broken else len(end_s)
                    last = first + step(state, self._parameters, slots, end_s, first, stop) - 1
                rest[first : last + 1], turn[first : last + 1] = was, undecided
                if was and not state.at_rest:
                    outside.append(self._outside(readings, edges[last], edges[last + 1]))
                self._at_rest, first = int(state.at_rest), last + 1
            rest[-1], turn[-1] = self._at_rest, state.shown
            if self._at_rest:
                outside.append(self._outside(readings, edges[-2], n))
                self._at_rest = int(outside[-1][0] == n)
        lengths = np.diff(edges)
        found = np.repeat(rest, lengths)
        for start, stop in outside:
            found[start:stop] = 0
        self._last_ns, self._last_segment = int(time_ns[-1]), int(segment[-1])
        return found, np.repeat(turn, lengths, axis=0)

    def _outside(self, readings: FloatArray, start: int, stop: int) -> tuple[int, int]:
        """Return the rows of a slot from the first sample on that is outside the band of a unit at rest."""
        part, windows = readings[start:stop, :AXES], self._state.windows
        out = ((part < windows.low) | (part > windows.high)).any(1)
        return start + (int(np.argmax(out)) if out.any() else stop - start), stop

    def notices(self) -> list[str]:
        """Return nothing: there is nothing to declare that the data could contradict."""
        return []

    def snapshot(self) -> dict[str, Any]:
        """Return a copy of the state."""
        return deepcopy({name: value for name, value in vars(self).items() if name != "_parameters"})

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from a state that `snapshot` returned."""
        vars(self).update(deepcopy(saved))


def _slots_of(ended: Slots, time_ns: IntArray) -> Sequence[Slot]:
    """Return the slots as the detector takes them; time_ns is that of the rows."""
    made = empty_slots(len(ended))
    slots: Any = made
    slots["start_s"], slots["end_s"] = 1e-9 * ended.start_ns, 1e-9 * time_ns[ended.row]
    count = ended.count[:, :AXES].astype(np.float64)
    slots["samples"], slots["average"] = count, ended.mean[:, :AXES]
    slots["within"] = np.where(
        count > 1.0, ended.variance[:, :AXES] * count / np.maximum(count - 1.0, 1.0), np.nan
    )
    pairs = ended.step_count[:, :AXES]
    slots["jumps"] = np.where(pairs > 0, 0.5 * ended.step_squares[:, :AXES] / np.maximum(pairs, 1), np.nan)
    slots["smallest"], slots["largest"] = ended.smallest[:, :AXES], ended.largest[:, :AXES]
    slots["first"], slots["last"] = ended.first[:, :AXES], ended.last[:, :AXES]
    slots["reference"], slots["degc"] = ended.mean[:, AXES:-1], ended.mean[:, -1]
    return made


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
    holds: BoolArray = (time_ns != NO_INT) & (last_ns != NO_INT) & (segment == last_segment)
    recent = time_ns - last_ns <= int(GAP_S * 1e9)
    return np.where(holds & recent, last, 0)
