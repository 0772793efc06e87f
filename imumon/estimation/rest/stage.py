"""The rest detector as a stage of the pipeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.gyro_bias.timing import Timing
from imumon.estimation.rest.detector import Reading, State, begin, step
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.quiet import AXES, COARSEST_STEPS, SLOT_S, Slot
from imumon.filters.slots import SlotGatherer, Slots, held

GAP_S = 2.5
"""A rest goes on over a pause as long as this; it holds as long where readings are missing."""
INPUTS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
AT_REST = Column("at_rest", "1", "int64", "1 while the unit is at rest, 0 while it moves or nothing is known")
TURN = tuple(
    Column(f"turn_hypothesis_{axis}", "rad/s", description=f"turn that may be a change of bias, {axis}")
    for axis in "xyz"
)


class RestDetector:
    """Finds rest and motion, without knowing the sensors' noise or bias.

    It decides at the end of each slot of a quarter of a second; a single sample far from the mean ends a rest
    at that sample.

    The columns ``turn_hypothesis_{x,y,z}`` are for who estimates the bias: while a steady turn cannot be
    distinguished from a bias that has changed, they are the difference of both, rad/s, times the square
    root of the probability of what is not shown; else the largest error by rounding.  Their squares belong
    in the variance of the bias.  ``at_rest`` is 0 where a turn is more likely.

    Parameters
    ----------
    parameters : RestParameters
        What a resting unit may do.
    """

    def __init__(self, parameters: RestParameters | None = None) -> None:
        self._parameters = parameters or RestParameters()
        self._slots = SlotGatherer(AXES + 4, int(SLOT_S * 1e9))
        self._timing = Timing()
        self._state = State()
        self._last_ns, self._last_segment = NO_INT, 0
        self._at_rest = 0
        self._pending = sorted(self._parameters.retired)

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
        readings[:, AXES:-1] = _heading(block)
        readings[:, -1] = _temperature(block)
        time_ns, segment = block["device_time_ns"], block["segment"]
        rows = np.flatnonzero((time_ns != NO_INT) & np.isfinite(readings[:, :AXES]).any(1))
        if len(rows) == n:
            found, turn = self._follow(time_ns, segment, readings)
        else:
            before = self._last_ns, self._last_segment, self._at_rest
            before_turn = self._state.turn
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
        slots, lengths = _slots_of(ended), np.diff([0, *ended.row.tolist(), n])
        found, turns = np.empty(n, np.int64), [state.turn]
        first = 0
        for k, row in enumerate(ended.row.tolist()):
            self._hold(found, readings, first, row)
            self._take(ended, slots, k)
            pause_s = 1e-9 * (int(time_ns[row]) - int(ended.end_ns[k]))
            other = int(segment[row]) != int(ended.segment[k]) or pause_s < 0.0
            if other or pause_s > max(GAP_S, 3.0 * self._timing.interval_s):
                begin(state, other)
            self._at_rest, first = int(state.at_rest), row
            turns.append(state.turn)
        self._hold(found, readings, first, n)
        self._last_ns, self._last_segment = int(time_ns[-1]), int(segment[-1])
        return found, np.repeat(np.array(turns), lengths, axis=0)

    def _take(self, ended: Slots, slots: Sequence[Slot], k: int) -> None:
        """Take the slot that has ended."""
        span = self._timing.next(
            int(ended.start_ns[k]), int(ended.end_ns[k]), int(ended.samples[k]), bool(ended.begins[k])
        )
        if span.seconds > 0.0:
            slot = slots[k]._replace(seconds=span.seconds)
            heading, degc = ended.mean[k, AXES:-1], float(ended.mean[k, -1])
            step(self._state, self._parameters, Reading(span, slot, degc, heading))

    def _hold(self, found: IntArray, readings: FloatArray, start: int, stop: int) -> None:
        """Fill in rows of the slot that is open: a sample outside the band of a unit at rest ends it
        there."""
        found[start:stop] = self._at_rest
        if self._at_rest and start < stop:
            low, high = self._state.quiet.band
            part = readings[start:stop, :AXES]
            outside = ((part < low) | (part > high)).any(1)
            if outside.any():
                found[start + int(np.argmax(outside)) : stop] = self._at_rest = 0
                self._state.quiet.disturbed = True

    def notices(self) -> list[str]:
        """Return, once, which parameters are not used any more."""
        keys, self._pending = self._pending, []
        return [f"the rest detector does not use {' and '.join(keys)} any more"] if keys else []

    def snapshot(self) -> dict[str, Any]:
        """Return a copy of the state."""
        return deepcopy({name: value for name, value in vars(self).items() if name != "_parameters"})

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from a state that `snapshot` returned."""
        vars(self).update(deepcopy(saved))


def _heading(block: SampleBlock) -> FloatArray:
    """Return a vector that turns with the heading, (n, 3): the magnetic field in body axes, else cosine and
    sine of the yaw and zero, else NaN."""
    if block.mag is not None:
        return block.mag
    yaw, q = block.columns.get("yaw"), block.quaternion
    if yaw is None and q is not None:
        w, x, y, z = q.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if yaw is None:
        return np.full((len(block), 3), np.nan)
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])


def _temperature(block: SampleBlock) -> FloatArray:
    """Return the temperature of the unit in °C, (n,): the estimate, else the reading, else NaN.

    The mean of the axes where each has a thermometer.
    """
    # The reading is a stopgap where there is no estimate at all; mixed with it, it would jump.
    for name in ("temperature_estimate", "temperature"):
        if name in block:
            return np.asarray(block[name])
        axes = block.vector(name)
        if axes is not None:
            return np.asarray(axes.mean(1))
    return np.full(len(block), np.nan)


def _slots_of(ended: Slots) -> list[Slot]:
    """Return the slots as the detector takes them; their length is not known yet."""
    count = ended.count[:, :AXES].astype(np.float64)
    several = count > 1.0
    variance = np.where(
        several, ended.variance[:, :AXES] * count / np.where(several, count - 1.0, 1.0), np.nan
    )
    changes, pairs = ended.changes[:, :AXES], ended.step_count[:, :AXES]
    rare = (changes > 0) & (2 * changes <= pairs)
    step = np.where(rare, np.sqrt(ended.step_squares[:, :AXES] / np.maximum(changes, 1)), np.inf)
    step = np.where(step <= np.repeat(COARSEST_STEPS, 3), step, np.inf)
    means = ended.mean[:, :AXES]
    return [Slot(0.0, *one) for one in zip(count, means, variance, step, strict=True)]


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
