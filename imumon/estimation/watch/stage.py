"""The watch over the bias filter as a stage of the pipeline, behind `ZeroVelocity`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.watch.evidence import BLOCK, LEARNING, State, limit, step
from imumon.estimation.watch.parameters import WatchParameters
from imumon.estimation.watch.verdict import interpret
from imumon.filters.segments import Breaks

SUSPECT = Column("model_suspect", "1", "int64", "1 once the bias filter is caught at being wrong, else 0")


class ModelWatch:
    """Detects when the innovations of the bias filter are not what the filter expects.

    They should be white, standard normal, and have nothing to do with temperature, its rate or the time.  A
    suspicion stays until the device restarts: a model that has failed does not get better when the
    temperature comes to rest.  What is tested for, and how often in vain, is in docs/closing-the-loop.md.

    Parameters
    ----------
    modelled : bool
        Whether the filter uses a bias model; it decides what is advised.
    """

    def __init__(self, parameters: WatchParameters | None = None, modelled: bool = False) -> None:
        given = parameters or WatchParameters()
        self._alarm_at = limit(given.false_alarm_hours)
        self._modelled = modelled
        self._state = State()
        self._breaks, self._origin_ns = Breaks(), NO_INT
        self._suspect_segment: int | None = None
        self._pending: list[str] = []
        self._reported: set[str] = set()

    @property
    def columns(self) -> Sequence[Column]:
        """The column ``model_suspect``."""
        return [SUSPECT]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return ``model_suspect`` of a block, int64.

        Needs ``device_time_ns``, ``segment`` and ``zupt_innovation_{x,y,z}``; takes what there is of
        ``temperature_estimate`` and ``temperature_rate``, of each axis before those of the unit.
        """
        suspect = np.zeros(len(block), np.int64)
        names = [f"zupt_innovation_{axis}" for axis in "xyz"]
        if any(name not in block for name in names):
            return {SUSPECT.name: suspect}
        segment = block["segment"]
        slots = np.flatnonzero(np.isfinite(block[names[0]]))
        innovation = np.column_stack([block[name][slots] for name in names])
        known = np.isfinite(innovation).all(1)
        since = 0
        for row, segment_of_alarm in self._follow(block, slots[known], innovation[known]):
            self._mark(suspect, segment, since, row)
            self._suspect_segment, since = segment_of_alarm, row
        self._mark(suspect, segment, since, len(block))
        return {SUSPECT.name: suspect}

    def _mark(self, suspect: IntArray, segment: ColumnArray, start: int, stop: int) -> None:
        """Mark the rows of the segment that is suspect."""
        if self._suspect_segment is not None:
            suspect[start:stop] = segment[start:stop] == self._suspect_segment

    def _follow(
        self, block: SampleBlock, slots: IntArray, innovation: FloatArray
    ) -> list[tuple[int, int | None]]:
        """Take the slots; return the rows from which on a segment, or none, is suspect."""
        changes: list[tuple[int, int | None]] = []
        time_ns, segments = block["device_time_ns"][slots], block["segment"][slots]
        temperature = _of_axes(block, "temperature_estimate", slots)
        rate = _of_axes(block, "temperature_rate", slots)
        breaks = set(self._breaks.rows(time_ns, segments))
        for k, row in enumerate(slots.tolist()):
            if k in breaks:
                self._state = State()
                changes.append((row, None))
            if k in breaks or self._origin_ns == NO_INT:
                self._origin_ns = int(time_ns[k])
            now_s = 1e-9 * (int(time_ns[k]) - self._origin_ns)
            highest = step(self._state, now_s, innovation[k], temperature[k], rate[k])
            if highest >= self._alarm_at and not self._state.alarm:
                self._state.alarm = True
                changes.append((row, int(segments[k])))
                self._report(interpret(self._state.peaks, self._modelled).notice)
        return changes

    def _report(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._pending.append(text)

    def lanes(self) -> Mapping[str, str]:
        """Return the lane ``model``: MODEL OK, MODEL SUSPECT with the reason, waiting, or no model."""
        if self._state.alarm:
            return {"model": f"MODEL SUSPECT: {interpret(self._state.peaks, self._modelled).reason}"}
        if self._state.slots < LEARNING + BLOCK:
            return {"model": "waiting for rest"}
        return {"model": "MODEL OK" if self._modelled else "no model; the filter agrees with itself"}

    def notices(self) -> list[str]:
        """Return, once each, what is suspected and which command tells more; for the log."""
        texts, self._pending = self._pending, []
        return texts


def _of_axes(block: SampleBlock, name: str, rows: IntArray) -> FloatArray:
    """Return a column at some rows, of each axis where it has its own, else of the unit, (rows, 3)."""
    common = np.asarray(block[name][rows]) if name in block else np.full(len(rows), np.nan)
    result = np.tile(common[:, np.newaxis], (1, 3))
    for j, axis in enumerate("xyz"):
        own = block.columns.get(f"{name}_{axis}")
        if own is not None:
            result[:, j] = np.where(np.isfinite(own[rows]), own[rows], common)
    return result
