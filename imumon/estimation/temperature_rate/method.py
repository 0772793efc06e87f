"""The multiple-model method: samples to slots, gate, thermometer, filters, output, and back to samples.

The gate decides what of a thermometer is a fault and not a temperature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.estimation.temperature_rate.filter import Filters, correct, predict, start
from imumon.estimation.temperature_rate.measurement import evaluate
from imumon.estimation.temperature_rate.output import Output, RateEstimate, extrapolate, output
from imumon.estimation.temperature_rate.thermometer import (
    FASTEST_RATE,
    SLOT_S,
    UNKNOWN_STEP_DEGC,
    Slot,
    Thermometer,
)
from imumon.filters.slots import SlotGatherer, Slots, held

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is an outlier that lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth.  Assumed: wide, as the filters weigh what is nearer."""
SPIKE = 8.0
"""A slot has a spike that spans more than so many °C and more than so many steps.  Assumed."""
GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate, s.  Assumed:
in that time a board goes through half a warm-up."""


class Outcome(Enum):
    """A slot only predicts (nothing is learned of the thermometer), is a measurement, or a restart."""

    PREDICT = auto()
    USE = auto()
    RESTART = auto()


@dataclass(slots=True)
class Gate:
    """State of the gate in one segment."""

    used_s: float = -math.inf
    """Time of the last slot that was a temperature, s."""
    rejected: int = 0
    """Outliers in a row."""
    outlier_degc: float = math.nan
    """Last reading of the last of them, °C."""

    def decide(self, slot: Slot, thermometer: Thermometer, expected: tuple[float, float] | None) -> Outcome:
        """Return the outcome of a slot that has readings: that of the first row that holds.

        `expected` are mean and variance of the predicted reading, °C and °C²; None without an estimate.
        """
        no_value = thermometer.is_dead(slot) or slot.high - slot.low > SPIKE * max(1.0, thermometer.step)
        stuck = slot.low == slot.high == self.outlier_degc
        near = expected is not None and self._is_near(slot, thermometer, *expected)
        power_on = math.isnan(thermometer.last_change)
        repeats = not thermometer.repeat_s and thermometer.leaps(slot)
        lasts = self.rejected + 1 >= GATE_SLOTS
        table = (
            (no_value, Outcome.PREDICT),  # noise of more than a step has stopped, or there is a spike
            (stuck, Outcome.PREDICT),  # an outlier that has not moved, as 85 °C of a restart
            (expected is None, Outcome.RESTART),
            (near, Outcome.USE),  # a temperature may be there by now
            (power_on, Outcome.RESTART),  # the reading had never changed: it was a value at power-on
            (repeats, Outcome.RESTART),  # repeated readings were taken for new ones
            (lasts, Outcome.RESTART),  # a new temperature
            (True, Outcome.PREDICT),
        )
        outcome = next(outcome for holds, outcome in table if holds)
        if outcome is not Outcome.PREDICT:
            self.used_s, self.rejected, self.outlier_degc = slot.time_s, 0, math.nan
        elif not no_value:
            self.rejected, self.outlier_degc = self.rejected + 1, slot.last
        return outcome

    def _is_near(self, slot: Slot, thermometer: Thermometer, mean: float, variance: float) -> bool:
        """Return whether a temperature may have got there since it was last observed."""
        noise = variance + thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (slot.time_s - self.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(noise))
        return max(slot.high - mean, mean - slot.low) < reach


class MultipleModelRate:
    """Temperature and rate of one thermometer by a multiple-model Kalman filter.

    A declared quantization step, °C, holds until the first change of the readings.
    """

    def __init__(self, step_degc: float | None = None) -> None:
        self.thermometer = Thermometer(step_degc or UNKNOWN_STEP_DEGC)
        self.stuck_degc = math.nan
        """Where readings stuck last after a leap that no temperature makes, °C; NaN if they never did."""
        self._gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
        self._begin(0)
        self._output_ns: IntArray = np.array(0, np.int64)
        self._segment: IntArray = np.array(NO_INT, np.int64)

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call; the same in blocks of any size.

        Device time, segment, and reading, °C or NaN, are (n,).  A new segment starts anew, but what is known
        of the sensor stays.
        """
        n, before = len(reading), np.array(self._output)
        slots = self._gatherer.process(time_ns, segment, reading[:, np.newaxis])
        outputs = np.array([self._update(slots, i) for i in range(len(slots))]).reshape(-1, len(before))
        output_ns = held(slots.row, slots.end_ns, self._output_ns, n)
        output_segment = held(slots.row, slots.segment, self._segment, n)
        if len(slots):
            self._output_ns, self._segment = np.array(slots.end_ns[-1]), np.array(slots.segment[-1])
        age = np.asarray((time_ns - output_ns) * 1e-9, np.float64)
        known = (segment == output_segment) & (age >= 0.0)
        return extrapolate(age, known, reading, Output(*held(slots.row, outputs, before, n).T))

    def _begin(self, origin_ns: int) -> None:
        self.thermometer.begin()
        self._gate, self._output = Gate(), Output()
        self._filters: Filters | None = None
        self._origin_ns, self._end_s = origin_ns, 0.0
        self._last, self._last_s = math.nan, -math.inf
        """Latest reading that was no fault, °C, and the end of its slot, s."""

    def _update(self, slots: Slots, i: int) -> Output:
        """Process a slot; return the output from its end on."""
        if slots.begins[i]:
            self._begin(int(slots.start_ns[i]))
        slot = self._slot(slots, i)
        if slot.end_s - self._gate.used_s > GAP_S:
            self._filters, self._output = None, Output()
        if self._filters is not None:
            self._filters = predict(self.thermometer, self._filters, slot.time_s)
        shown = self._measure(slot)
        if shown is not None:
            self._output = output(self.thermometer, shown, self._output, slot.end_s)
        return self._output

    def _measure(self, slot: Slot) -> Filters | None:
        """Correct the filters by new readings of a slot; return those to show, None without an estimate."""
        thermometer, filters = self.thermometer, self._filters
        new, outcome = thermometer.unrepeated(slot), None
        if new is not None:
            outcome = self._gate.decide(new, thermometer, filters.expected if filters else None)
        if outcome is Outcome.PREDICT:
            if self._gate.rejected >= GATE_SLOTS:
                self.stuck_degc = self._gate.outlier_degc
            return filters
        if slot.count:
            self._last, self._last_s = slot.last, slot.end_s
        if new is None:
            return filters
        thermometer.learn(new, anew=outcome is Outcome.RESTART)
        if outcome is Outcome.RESTART or filters is None:
            self._filters, self._output = start(thermometer, new), Output()
            return self._filters
        entering, confining = evaluate(thermometer, new, filters)
        self._filters = correct(filters, entering)
        return correct(self._filters, confining) if confining else self._filters

    def _slot(self, slots: Slots, i: int) -> Slot:
        start_s, end_s = (int(ns[i] - self._origin_ns) * 1e-9 for ns in (slots.start_ns, slots.end_ns))
        first = float(slots.first[i, 0])
        before = self._last if start_s - self._last_s < self.thermometer.neighbour_s else first
        gap_s = (end_s - self._end_s) / int(slots.samples[i])
        self._end_s = end_s
        return Slot(
            time_s=0.5 * (start_s + end_s),
            end_s=end_s,
            gap_s=gap_s,
            spacing_s=max(SLOT_S, gap_s),
            count=int(slots.count[i, 0]),
            mean=float(slots.mean[i, 0]),
            variance=float(slots.variance[i, 0]),
            low=float(slots.smallest[i, 0]),
            high=float(slots.largest[i, 0]),
            before=before,
            first=first,
            last=float(slots.last[i, 0]),
            changes=max(int(slots.changes[i, 0]), int(before != first)),
            step_squares=float(slots.step_squares[i, 0]),
        )
