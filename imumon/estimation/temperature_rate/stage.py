"""Temperature rate as a stage of the pipeline, and its default method, the multiple-model filter.

The method goes from samples to slots, through the gate to the filters, to an output, and back to samples.
The gate decides what of a thermometer is a fault and not a temperature.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES, Column
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.protocols.thermometer import TemperatureRateParameters

from .filter import Filters, correct, estimate, predict, start
from .measurement import evaluate
from .thermometer import FASTEST_RATE, SLOT_S, SPIKE, Slot, Thermometer

GATE_SIGMA, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 3
"""A slot is an outlier that lies so many sigmas, so many steps, and farther than a temperature moves from the
prediction; after so many slots it may be the truth.  Assumed: wide, as the filters weigh what is nearer."""
POWER_ON_S = 60.0
"""For so long without a change, readings may be a value of power-on, s.  Assumed: sensors take seconds."""
GAP_S = 600.0
"""After so long without a reading, or of a dead sensor, nothing is known, s.  Assumed: of a warm-up."""
LINEARITY, HYSTERESIS = 0.05, 0.5
"""Standard deviation of the place of an edge, steps: of a good converter; of one that may have hysteresis, as
long as readings have not gone back.  Ablation: "edges known from the start"."""
RAMP_S = 75.0
"""The sigma of the rate is at least that of the temperature over this, s: a ramp may begin.  Ablation."""
LAG_S = 3.0
"""Time constant with which the rate in the output follows the estimate, s.  Ablation: "no output lag"."""

STATISTICS = "count", "changes", "step_squares", "mean", "variance", "smallest", "largest", "first", "last"
"""Those of `Slots` that are the last fields of `Slot`, in their order."""
Outcome = Literal["ignore", "use", "leap", "restart"]
"""A slot is ignored (nothing is learned of the thermometer) or is a measurement.  Or the filters begin anew
with it: after a leap the last reading and its time are kept, after a restart they are not."""


class RateEstimate(NamedTuple):
    """Temperature and its rate with their standard deviations, of each sample, (n,); NaN where unknown."""

    temperature: FloatArray  # °C
    rate: FloatArray  # °C/s
    temperature_sd: FloatArray
    rate_sd: FloatArray


class RateMethod(Protocol):
    """A method that estimates the rate sample by sample, from readings up to that sample."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call."""


class Output(NamedTuple):
    """Estimate from the end of a slot on: a temperature of constant rate."""

    segment: float = math.nan
    end_s: float = 0.0
    temperature: float = math.nan  # at the end, °C
    slope: float = math.nan  # its rate, °C/s
    rate: float = math.nan  # the rate that is reported, °C/s: it follows with `LAG_S`
    temperature_sd: float = math.nan
    rate_sd: float = math.nan
    late_s: float = math.inf  # age beyond which this does not hold, as rows are missing
    reading_sd: float = math.nan  # standard deviation of a single reading, °C


class MultipleModelRate:
    """Temperature and rate of one thermometer by a multiple-model Kalman filter.

    A declared quantization step, °C, holds until the first change of the readings.
    """

    def __init__(self, step_degc: float | None = None) -> None:
        self.thermometer = Thermometer(step_degc) if step_degc else Thermometer()
        self.faults: dict[str, None] = {}  # what is wrong with it, each text once
        self._gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
        self._begin()

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call; the same in blocks of any size.

        Device time, segment, and reading, °C or NaN, are (n,).  A new segment keeps what the sensor is.
        """
        before = np.array(self._output)
        slots = self._gatherer.process(time_ns, segment, reading[:, None])
        statistics = zip(*(getattr(slots, name)[:, 0].tolist() for name in STATISTICS), strict=True)
        outputs = [self._update(slots, i, values) for i, values in enumerate(statistics)]
        shown = held(slots.row, np.reshape(outputs, (-1, len(before))), before, len(reading))
        return extrapolate(np.asarray(time_ns * 1e-9), segment, reading, Output(*shown.T))

    def _begin(self) -> None:
        self.thermometer.begin()
        self._filters: Filters | None = None
        self._output = Output()
        self._outliers, self._outlier_degc = 0, math.nan
        """Outliers in a row, and the last reading of the last of them, °C."""
        self._refused_degc = math.nan
        """Last reading of the last slot that has one, if the gate has ignored it, °C; else NaN."""
        self._read_s = math.nan  # end of the last slot that has a reading, s

    def _update(self, slots: Slots, i: int, values: Sequence[Any]) -> Output:
        """Process slot i with these `STATISTICS`; return the output from its end on."""
        if slots.begins[i]:
            self._begin()
        thermometer = self.thermometer
        slot = self._slot(slots.start_ns[i] * 1e-9, slots.end_ns[i] * 1e-9, values)
        if slot.end_s - thermometer.used_s > GAP_S:
            self._filters, self._output = None, Output()
        if self._filters is not None:
            self._filters = predict(thermometer, self._filters, slot.time_s)
        slot, shown = thermometer.unrepeated(slot), self._filters
        outcome = self._gate(slot)
        if slot.count:
            self._refused_degc = slot.last if outcome == "ignore" else math.nan
        if outcome == "restart":
            thermometer.begin()
            slot = slot.alone()
            thermometer.leapt &= self._filters is None  # a leap that does not last was a glitch
        if outcome in ("restart", "leap"):
            thermometer.means = ()
            thermometer.learn(slot)
            thermometer.leapt |= outcome == "leap"  # also before any change that it could be compared with
            self._output = Output()
            shown = self._filters = start(thermometer, slot)
        elif self._filters is not None and outcome == "use":
            thermometer.learn(slot)
            enters, shows = evaluate(thermometer, slot, self._filters)  # one object but for a single code
            predicted, self._filters = self._filters, correct(self._filters, enters)
            shown = self._filters if shows is enters else correct(predicted, shows)
        if shown is not None:
            self._output = output(thermometer, shown, self._output, slot.end_s)
        self._output = self._output._replace(segment=float(slots.segment[i]), end_s=slot.end_s)
        return self._output

    def _slot(self, start_s: float, end_s: float, values: Sequence[Any]) -> Slot:
        count, thermometer = int(values[0]), self.thermometer
        since_s = start_s if math.isnan(self._read_s) else self._read_s
        self._read_s = end_s if count else since_s
        sample_s = (end_s - since_s) / max(count, 1)
        slot = Slot(0.5 * (start_s + end_s), end_s, sample_s, thermometer.last, *values)
        if start_s - thermometer.used_s >= thermometer.neighbour_s:
            return slot.alone()
        back = math.isfinite(self._refused_degc) and slot.first != self._refused_degc  # that is no change
        return replace(slot, changes=max(slot.changes - back, int(slot.before != slot.first)))

    def _gate(self, slot: Slot) -> Outcome:
        """Return the outcome of a slot: that of the first row that holds."""
        thermometer, filters = self.thermometer, self._filters
        dead, span = bool(slot.count) and thermometer.is_dead(slot), slot.largest - slot.smallest
        no_value = not slot.count or dead or span > SPIKE * max(1.0, thermometer.step)
        stuck = slot.smallest == slot.largest == self._outlier_degc
        waits = math.isnan(thermometer.last_change) and slot.time_s - thermometer.changed_s < POWER_ON_S
        young = waits or len(thermometer.means) < GATE_SLOTS
        table: tuple[tuple[object, Outcome], ...] = (
            (no_value, "ignore"),  # no reading, noise of more than a step has stopped, or a spike
            (stuck, "ignore"),  # still exactly at the outlier
            (filters is None, "restart"),
            (filters and self._is_near(slot, filters), "use"),
            (young, "restart"),  # what came first may be a value of power-on, or a fault
            (not thermometer.repeat_s and thermometer.leaps(slot), "leap"),  # repeats were taken for new
            (self._outliers + 1 >= GATE_SLOTS, "restart"),  # a new temperature
            (True, "ignore"),
        )
        outcome = next(outcome for holds, outcome in table if holds)
        if dead:
            self.faults["its noise has stopped: taken for dead until it changes"] = None
        if outcome != "ignore":
            self._outliers, self._outlier_degc = 0, math.nan
        elif not no_value:
            self._outliers, self._outlier_degc = self._outliers + 1, slot.last
            if self._outliers >= GATE_SLOTS:
                self.faults[
                    f"it leapt to {slot.last:g} °C, as no temperature does, and stuck there: taken for a "
                    "fault of the thermometer until it changes"
                ] = None
        return outcome

    def _is_near(self, slot: Slot, filters: Filters) -> bool:
        """Return whether a temperature may have got there since it was last observed."""
        thermometer = self.thermometer
        mean, variance = filters.mixture(*filters.y)
        variance += thermometer.step**2 + thermometer.scatter + thermometer.rho
        moved = FASTEST_RATE * (slot.time_s - thermometer.used_s + SLOT_S)
        reach = max(GATE_STEPS * thermometer.step, moved, GATE_SIGMA * math.sqrt(variance))
        return max(slot.largest - mean, mean - slot.smallest) < reach


def output(thermometer: Thermometer, filters: Filters, before: Output, end_s: float) -> Output:
    """Return mean and standard deviation of the mixture from the end of a slot on, (10) and (11).

    To the variance of the temperature are added: the place of the edges, and the time for which a reading is
    repeated.  To that of the rate: a ramp may just have begun, hidden by rounding or the other sigma.
    """
    (temperature, variance), (rate, rate_variance) = estimate(thermometer, filters)
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


def extrapolate(time_s: FloatArray, segment: IntArray, reading: FloatArray, shown: Output) -> RateEstimate:
    """Return the estimates at samples from the output of the last slot; all arrays are (n,).

    Before the first slot of a segment ends, and behind missing rows until the next slot ends, there is the
    reading, with its standard deviation or NaN, and the last rate or zero, ± `FASTEST_RATE`.
    """
    age = time_s - shown.end_s
    known = (segment == shown.segment) & (age >= 0.0) & (age <= shown.late_s)
    # Two slots of age are usual: a slot is known when the next begins.  Later only the rate carries on.
    waited = np.maximum(age - 2.0 * SLOT_S, 0.0)
    zero = 0.0 * reading  # NaN where there is no reading
    return RateEstimate(
        np.where(known, shown.temperature + age * shown.slope, reading),
        np.where(known, shown.rate, zero + np.nan_to_num(shown.rate)),
        np.where(known, np.hypot(shown.temperature_sd, waited * shown.rate_sd), zero + shown.reading_sd),
        np.where(known, shown.rate_sd, zero + FASTEST_RATE),
    )


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel that comes.

    These are the columns "temperature" and "temperature_x" and so on; what follows "temperature" is added to
    the names of the results.  `new_method` makes the method of a channel, the multiple-model filter.
    """

    prefix, title = "", "estimated"
    """Of the names and of the descriptions of the results."""

    def __init__(
        self,
        parameters: TemperatureRateParameters | None = None,
        new_method: Callable[[], RateMethod] | None = None,
    ) -> None:
        given = parameters or TemperatureRateParameters()
        self._new_method = new_method or partial(MultipleModelRate, given.step_degc)
        self._methods: dict[str, RateMethod | None] = {}  # of each channel; None until its first reading

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds so far."""
        found = []
        for name in self._methods:
            suffix = name.removeprefix("temperature")
            of, sd = (f" of {name}" if suffix else ""), "its standard deviation"
            for result, unit, text in (
                ("estimate", "degC", f"{self.title} temperature{of}"),
                ("rate", "degC/s", f"{self.title} rate{of}"),
                ("estimate_sd", "degC", sd),
                ("rate_sd", "degC/s", sd),
            ):
                found.append(Column(f"{self.prefix}temperature_{result}{suffix}", unit, description=text))
        return found

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        self._methods |= {name: self._methods.get(name) for name in TEMPERATURES if name in block}
        values = [each for name in self._methods for each in self._estimate(name, block)]
        return {column.name: each for column, each in zip(self.columns, values, strict=True)}

    def _estimate(self, name: str, block: SampleBlock) -> FloatArray:
        """Return temperature, rate and their standard deviations, (4, n).

        Rows before the first reading are kept from the method: there may have been no column for them.
        """
        estimates = np.full((4, len(block)), np.nan)
        reading, first = block.columns.get(name, estimates[0]), 0
        method = self._methods[name]
        if method is None:
            known = np.flatnonzero(np.isfinite(reading))
            if not len(known):
                return estimates
            first, method = int(known[0]), self._new_method()
            self._methods[name] = method
        new = (values[first:] for values in (block["device_time_ns"], block["segment"], reading))
        estimates[:, first:] = method.process(*new)
        return estimates

    def notices(self) -> list[str]:
        """Return what is wrong with the readings."""
        methods = ((name, one) for name, one in self._methods.items() if isinstance(one, MultipleModelRate))
        return [f"{name}: {text}" for name, method in methods for text in method.faults]
