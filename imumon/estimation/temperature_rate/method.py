"""The multiple-model method: samples to slots, gate, thermometer, filters, output, and back to samples.

The gate decides what of a thermometer is a fault and not a temperature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray
from imumon.estimation.temperature_rate.filter import Filters, correct, predict, start
from imumon.estimation.temperature_rate.measurement import evaluate
from imumon.estimation.temperature_rate.thermometer import FASTEST_RATE, SLOT_S, Slot, Thermometer
from imumon.filters.slots import SlotGatherer, Slots, held

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is an outlier that lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth.  Assumed: wide, as the filters weigh what is nearer."""
SPIKE = 8.0
"""A slot has a spike that spans more than so many °C and more than so many steps.  Assumed."""
GAP_S = 600.0
"""After so long without a reading, or of a sensor that is dead or sticks, there is no estimate, s.  Assumed:
in that time a board goes through most of a warm-up."""
LINEARITY, HYSTERESIS = 0.05, 0.5
"""Standard deviation of the place of an edge, steps: of a good converter; of one that may have hysteresis, as
long as readings have not gone back.  Ablation."""
RAMP_S = 75.0
"""A rate is not known better than the temperature's sigma over this time, s: a ramp may just have begun.
Ablation."""
LAG_S = 3.0
"""Time constant with which the rate in the output follows the estimate, s, so that it does not jump.
Ablation."""

SLOT_VALUES = tuple(field.name for field in fields(Slot))[4:]
"""Those fields that are as in `Slots`: all after `before`."""
Outcome = Literal["ignore", "use", "restart", "return"]
"""A slot is ignored (nothing is learned of the thermometer), is a measurement, a restart, or shows that the
last restart was a fault: what was before it holds again, as if all slots since had been ignored."""


class RateEstimate(NamedTuple):
    """Temperature and its rate with their standard deviations: °C, °C/s, °C and °C/s; NaN where unknown."""

    temperature: FloatArray
    rate: FloatArray
    temperature_sd: FloatArray
    rate_sd: FloatArray
    """One value per sample, (n,)."""


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""


class Output(NamedTuple):
    """Estimate from the end of a slot on: a temperature of constant rate."""

    end_s: float = 0.0
    temperature: float = math.nan
    """°C."""
    slope: float = math.nan
    """Its rate, °C/s."""
    rate: float = math.nan
    """The rate that is reported, °C/s: it follows with `LAG_S`."""
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    late_s: float = math.inf
    """Age beyond which the output does not hold, as rows are missing, s; any slot renews it."""
    reading_sd: float = math.nan
    """Standard deviation of a single reading, °C."""


class MultipleModelRate:
    """Temperature and rate of one thermometer by a multiple-model Kalman filter.

    A declared quantization step, °C, holds until the first change of the readings.
    """

    def __init__(self, step_degc: float | None = None) -> None:
        self.thermometer = Thermometer(step_degc) if step_degc else Thermometer()
        self.stuck_degc = math.nan
        """Where readings stuck last after a leap that no temperature makes, °C; NaN if they never did."""
        self._gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
        self._begin(0)
        self._ended: IntArray = np.array([0, NO_INT])
        """End of the last slot, ns, and its segment."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call; the same in blocks of any size.

        Device time, segment, and reading, °C or NaN, are (n,).  A new segment starts anew, but what is known
        of the sensor stays.
        """
        n, before = len(reading), np.array(self._output)
        slots = self._gatherer.process(time_ns, segment, reading[:, np.newaxis])
        readings = zip(*(getattr(slots, name)[:, 0].tolist() for name in SLOT_VALUES), strict=True)
        outputs = [self._update(self._slot(slots, i, values)) for i, values in enumerate(readings)]
        ends = np.stack([slots.end_ns, slots.segment], 1)
        end_ns, of_segment = held(slots.row, ends, self._ended, n).T
        self._ended = np.array([self._ended, *ends])[-1]
        age = np.asarray((time_ns - end_ns) * 1e-9, np.float64)
        known = (segment == of_segment) & (age >= 0.0)
        shown = held(slots.row, np.reshape(outputs, (-1, len(before))), before, n)
        return extrapolate(age, known, reading, Output(*shown.T))

    def _begin(self, origin_ns: int) -> None:
        self.thermometer.begin()
        self._filters: Filters | None = None
        self._output = Output()
        self._rejected, self._outlier_degc = 0, math.nan
        """Outliers in a row, and the last reading of the last of them, °C."""
        self._before: tuple[Filters, Thermometer] | None = None
        """What the last restart has replaced, for `GATE_SLOTS` slots."""
        self._accepted = 0
        """Slots used since the last restart."""
        self._origin_ns, self._read_s = origin_ns, 0.0

    def _slot(self, slots: Slots, i: int, values: Sequence[Any]) -> Slot:
        """Return a slot with its fields `SLOT_VALUES`; the first of a segment begins anew."""
        if slots.begins[i]:
            self._begin(int(slots.start_ns[i]))
        start_s, end_s = (int(ns[i] - self._origin_ns) * 1e-9 for ns in (slots.start_ns, slots.end_ns))
        count = int(values[0])
        sample_s = (end_s - self._read_s) / max(count, 1)
        self._read_s = end_s if count else self._read_s
        slot = Slot(0.5 * (start_s + end_s), end_s, sample_s, self.thermometer.last, *values)
        if start_s - self.thermometer.used_s >= self.thermometer.neighbour_s:
            return replace(slot, before=slot.first)
        changes = slot.changes - (self._rejected > 0)  # back from an outlier is no change
        return replace(slot, changes=max(changes, int(slot.before != slot.first)))

    def _update(self, slot: Slot) -> Output:
        """Process a slot; return the output from its end on."""
        thermometer = self.thermometer
        if slot.end_s - thermometer.used_s > GAP_S:
            self._filters, self._before, self._output = None, None, Output()
        if self._filters is not None:
            self._filters = predict(thermometer, self._filters, slot.time_s)
        new, shown = thermometer.unrepeated(slot), self._filters
        outcome = self._gate(new) if new else "ignore"
        if new and outcome == "restart":
            self._before = (self._filters, replace(thermometer)) if self._filters else None
            self._accepted = 0
            thermometer.means = ()
            thermometer.learn(new)
            shown = self._filters = start(thermometer, new)
            self._output = Output()
        elif self._before and outcome == "return":
            (filters, self.thermometer), self._before = self._before, None
            shown = self._filters = predict(self.thermometer, filters, slot.time_s)
            thermometer, self._output = self.thermometer, Output()
        elif new and self._filters is not None and outcome == "use":
            self._accepted += 1
            thermometer.learn(new)
            enters, shows = evaluate(thermometer, new, self._filters)
            predicted, self._filters = self._filters, correct(self._filters, enters)
            shown = self._filters if shows is enters else correct(predicted, shows)
        if shown is not None:
            self._output = output(thermometer, shown, self._output, slot.end_s)
        return self._output

    def _gate(self, slot: Slot) -> Outcome:
        """Return the outcome of a slot that has readings: that of the first row that holds."""
        thermometer, span = self.thermometer, slot.largest - slot.smallest
        no_value = thermometer.is_dead(slot) or span > SPIKE * max(1.0, thermometer.step)
        if self._accepted >= GATE_SLOTS:
            self._before = None
        near = self._filters and self._is_near(slot, self._filters)
        returns = not near and self._before and self._is_near(slot, self._before[0])
        table: tuple[tuple[object, Outcome], ...] = (
            (no_value, "ignore"),  # noise of more than a step has stopped, or there is a spike
            (returns, "return"),  # the restart was a fault
            (slot.smallest == slot.largest == self._outlier_degc, "ignore"),  # the outlier before: it sticks
            (self._filters is None, "restart"),
            (near, "use"),
            (math.isnan(thermometer.last_change), "restart"),  # until now it was a value of power-on
            (not thermometer.repeat_s and thermometer.leaps(slot), "restart"),  # repeats were taken for new
            (self._rejected + 1 >= GATE_SLOTS, "restart"),  # a new temperature
            (True, "ignore"),
        )
        outcome = next(outcome for holds, outcome in table if holds)
        if outcome != "ignore":
            self._rejected, self._outlier_degc = 0, math.nan
        elif not no_value:
            self._rejected, self._outlier_degc = self._rejected + 1, slot.last
            if self._rejected >= GATE_SLOTS:
                self.stuck_degc = slot.last
        return outcome

    def _is_near(self, slot: Slot, filters: Filters) -> bool:
        """Return whether a temperature may have got there since it was last observed."""
        thermometer = self.thermometer
        mean, variance = filters.mixture(*filters.reading)
        noise = variance + thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (slot.time_s - thermometer.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(noise))
        return max(slot.largest - mean, mean - slot.smallest) < reach


def output(thermometer: Thermometer, filters: Filters, before: Output, end_s: float) -> Output:
    """Return mean and standard deviation of the mixture from the end of a slot on, with what it lacks.

    To the variance of the temperature are added: the place of the edges, and the time for which a reading is
    repeated.  To that of the rate: a ramp may just have begun, hidden by the temperature's sigma or by
    rounding, whichever is larger.
    """
    temperature, variance, rate, rate_variance = filters.temperature_and_rate
    edge_sd = thermometer.step * (LINEARITY if thermometer.flickers else HYSTERESIS)
    variance += edge_sd**2 + (rate * thermometer.repeat_s) ** 2 / 3.0
    rate_variance += max(variance, thermometer.step**2 / 12.0) / RAMP_S**2
    lag = 0.0 if math.isnan(before.rate) else math.exp(-(end_s - before.end_s) / LAG_S) * (before.rate - rate)
    return Output(
        end_s=end_s,
        temperature=temperature + (end_s - filters.time_s) * rate,
        slope=rate,
        rate=rate + lag,
        temperature_sd=math.sqrt(variance),
        rate_sd=math.sqrt(rate_variance + lag**2),
        late_s=SLOT_S + thermometer.neighbour_s,
        reading_sd=math.sqrt(thermometer.step**2 / 12.0 + max(thermometer.scatter, thermometer.rho)),
    )


def extrapolate(age: FloatArray, known: BoolArray, reading: FloatArray, shown: Output) -> RateEstimate:
    """Return the estimates at samples from the output of the last slot; all arrays are (n,).

    Before the first slot of a segment ends, and behind missing rows until the next slot ends, there is the
    reading, with its standard deviation (NaN while it is unknown), and the last rate or zero, ±
    `FASTEST_RATE`.
    """
    known = known & (age <= shown.late_s)
    # A slot is known when the next begins; readings farther apart leave the temperature to the rate.
    waited = np.maximum(age - 2.0 * SLOT_S, 0.0)
    unknown = 0.0 * reading
    return RateEstimate(
        np.where(known, shown.temperature + age * shown.slope, reading),
        np.where(known, shown.rate, unknown + np.nan_to_num(shown.rate)),
        np.where(known, np.hypot(shown.temperature_sd, waited * shown.rate_sd), unknown + shown.reading_sd),
        np.where(known, shown.rate_sd, unknown + FASTEST_RATE),
    )
