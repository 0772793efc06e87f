"""Samples of a thermometer gathered into slots of a second."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.sensor import Reading
from imumon.estimation.temperature_rate.step import StepFinder
from imumon.filters.slots import SlotGatherer, Slots

SLOT_NS = 1_000_000_000
FAR_S = 10.0
"""Readings farther apart than this are no neighbours."""


class Taken(NamedTuple):
    """A slot that ended: the row from which on it is known, whether it begins a segment, what was read."""

    row: int
    begins: bool
    reading: Reading


class Readings:
    """Turns samples into the readings of slots, the same whatever the division into pieces."""

    def __init__(self) -> None:
        self.gatherer = SlotGatherer(1, SLOT_NS)
        self.origin_ns = 0
        self.segment = 0
        self._before = (np.nan, -np.inf)
        self._end_s = 0.0

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> Iterator[Taken]:
        """Yield the slots that end within these samples, (n,) each."""
        slots = self.gatherer.process(time_ns, segment, reading[:, np.newaxis])
        for i in range(len(slots)):
            if slots.begins[i]:
                self.origin_ns, self.segment = int(slots.start_ns[i]), int(slots.segment[i])
                self._before = (np.nan, -np.inf)
                self._end_s = 0.0
            yield Taken(int(slots.row[i]), bool(slots.begins[i]), self._reading(slots, i))

    def _reading(self, slots: Slots, i: int) -> Reading:
        start_s = (int(slots.start_ns[i]) - self.origin_ns) * 1e-9
        end_s = (int(slots.end_ns[i]) - self.origin_ns) * 1e-9
        samples, count = int(slots.samples[i]), int(slots.count[i, 0])
        gap_s = (end_s - start_s) / (samples - 1) if samples > 1 else max(start_s - self._end_s, 1e-9)
        before, before_s = self._before
        near = count > 0 and start_s - before_s < FAR_S
        taken = Reading(
            start_s=start_s,
            end_s=end_s,
            count=count,
            mean=float(slots.mean[i, 0]),
            variance=float(slots.variance[i, 0]),
            low=float(slots.smallest[i, 0]),
            high=float(slots.largest[i, 0]),
            first=float(slots.first[i, 0]),
            last=float(slots.last[i, 0]),
            changes=int(slots.changes[i, 0]),
            step_squares=float(slots.step_squares[i, 0]),
            before=before if near else np.nan,
            gap_s=gap_s,
        )
        if count:
            self._before = (taken.last, end_s)
        self._end_s = end_s
        return taken


class StepWatch:
    """Finds the step of a sensor whatever the method that estimates its rate.

    Parameters
    ----------
    declared : float
        The step in °C that the sensor is said to have.
    """

    def __init__(self, declared: float) -> None:
        self.finder = StepFinder(declared)
        self._readings = Readings()

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> None:
        """Learn from samples, (n,) each."""
        for taken in self._readings.process(time_ns, segment, reading):
            self.finder.learn(taken.reading.differences)
