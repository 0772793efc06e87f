"""Temperature rate as a stage of the pipeline: samples to slots, slots to filters, and back to samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.temperature_rate.filter import Output, State, step
from imumon.estimation.temperature_rate.gate import GATE_SLOTS
from imumon.estimation.temperature_rate.model import SLOT_S, Params
from imumon.estimation.temperature_rate.thermometer import (
    COARSEST_DEGC,
    Reading,
    StepFinder,
    Thermometer,
)
from imumon.filters.rates import FASTEST_RATE, RateEstimate, RateMethod
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.protocols.thermometer import TemperatureRateParameters

CHANNELS = ("temperature", *(f"temperature_{axis}" for axis in "xyz"))


class MultipleModelRate:
    """Temperature and rate of one thermometer by a multiple-model Kalman filter.

    Parameters
    ----------
    step_degc : float, optional
        Quantization step in °C, if it is declared; it holds until the first change of the readings.
    params : Params, optional
        Assumptions of the model.
    """

    def __init__(self, step_degc: float | None = None, params: Params | None = None) -> None:
        self.params = params or Params()
        self.state = State(Thermometer(StepFinder(step_degc or COARSEST_DEGC)))
        self.stuck: float | None = None
        """Where readings stuck last after a leap that no temperature makes, °C; None if they never did."""
        self._gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
        self._origin_ns = 0
        self._before = (math.nan, -math.inf)
        """Last reading, and the end of its slot, s."""
        self._end_s = 0.0
        self._output = np.array(Output())
        self._output_ns: IntArray = np.array(0, np.int64)
        self._segment: IntArray = np.array(NO_INT, np.int64)

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call; the same in blocks of any size.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts anew but keeps what is known of
            the sensor.
        reading : array, (n,)
            °C; NaN where there is none.
        """
        slots = self._gatherer.process(time_ns, segment, reading[:, np.newaxis])
        outputs = np.empty((len(slots), len(self._output)))
        for i in range(len(slots)):
            taken = self._reading(slots, i)
            if slots.begins[i]:
                self.state.begin()
            outputs[i] = step(self.params, self.state, taken)
            gate = self.state.gate
            if gate.rejected == GATE_SLOTS and gate.constant:
                self.stuck = gate.outlier_degc
        n = len(reading)
        columns = held(slots.row, outputs, self._output, n).T
        output_ns = held(slots.row, slots.end_ns, self._output_ns, n)
        output_segment = held(slots.row, slots.segment, self._segment, n)
        if len(slots):
            self._output = outputs[-1]
            self._output_ns, self._segment = np.array(slots.end_ns[-1]), np.array(slots.segment[-1])
        age = np.asarray((time_ns - output_ns) * 1e-9, np.float64)
        known = (segment == output_segment) & (age >= 0.0)
        return extrapolate(age, known, reading, Output(*columns), self.params.output_lag_s)

    def _reading(self, slots: Slots, i: int) -> Reading:
        """Return the readings of a slot."""
        if slots.begins[i]:
            self._origin_ns, self._end_s = int(slots.start_ns[i]), 0.0
            self._before = (math.nan, -math.inf)
        start_s, end_s = (int(ns[i] - self._origin_ns) * 1e-9 for ns in (slots.start_ns, slots.end_ns))
        before, before_s = self._before
        first = float(slots.first[i, 0])
        if not start_s - before_s < self.state.gate.neighbour_s:
            before = first
        reading = Reading(
            start_s=start_s,
            end_s=end_s,
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
            gap_s=(end_s - self._end_s) / int(slots.samples[i]),
        )
        if reading.count:
            self._before = (reading.last, end_s)
        self._end_s = end_s
        return reading


def extrapolate(
    age: FloatArray, known: BoolArray, reading: FloatArray, output: Output, output_lag_s: float
) -> RateEstimate:
    """Return the estimates at samples from the output of the last slot; all arrays are (n,).

    Before the first slot of a segment ends, and behind a gap until the next slot ends, there is the reading,
    with its standard deviation (NaN while it is unknown), and any rate.
    """
    late = known & (age > output.late_s) & np.isfinite(output.rate)
    known = known & ~late
    fading = np.exp(-age / output_lag_s, where=known, out=np.zeros_like(age)) * output.rate_offset
    # A slot is known when the next begins; readings farther apart leave the temperature to the rate.
    waited = np.maximum(age - 2.0 * SLOT_S, 0.0)
    unknown = 0.0 * reading
    temperature_sd = np.hypot(output.temperature_sd, waited * output.rate_sd)
    return RateEstimate(
        temperature=np.where(known, output.temperature + age * output.rate, reading),
        rate=np.where(
            known,
            output.rate + age * output.acceleration + fading,
            unknown + np.where(late, output.rate, 0.0),
        ),
        temperature_sd=np.where(known, temperature_sd, unknown + output.reading_sd),
        rate_sd=np.where(known, np.hypot(output.rate_sd, fading), unknown + FASTEST_RATE),
    )


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel that comes.

    These are the columns "temperature" and "temperature_x" and so on; what follows "temperature" is added to
    the names of the results.

    Parameters
    ----------
    parameters : TemperatureRateParameters
        One set for all channels.
    new_method : callable, optional
        Makes the method of a channel; default the multiple-model filter.
    """

    def __init__(
        self,
        parameters: TemperatureRateParameters | None = None,
        new_method: Callable[[], RateMethod] | None = None,
    ) -> None:
        self._parameters = parameters or TemperatureRateParameters()
        self._new_method = new_method or partial(MultipleModelRate, self._parameters.step_degc)
        self._methods: dict[str, RateMethod] = {}
        self._last: dict[str, float] = {}
        """Last reading of each channel that has had one, °C."""
        self._finders: dict[str, StepFinder] = {}
        """The steps that each channel shows, as long as they may contradict the declared one."""
        self._notices: list[str] = []
        self._noticed: set[tuple[str, str]] = set()

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds so far."""
        return [column for channel in self._methods for column in _columns(channel)]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        for channel in CHANNELS:
            if channel in block and channel not in self._methods:
                self._methods[channel] = self._new_method()
                self._finders[channel] = StepFinder()
        added: dict[str, ColumnArray] = {}
        for channel in self._methods:
            for column, part in zip(_columns(channel), self._estimate(channel, block), strict=True):
                added[column.name] = part
        return added

    def _estimate(self, channel: str, block: SampleBlock) -> Sequence[FloatArray]:
        """Return temperature, rate and their standard deviations, (n,) each.

        Rows before the first reading are kept from the method: there may have been no column for them, and
        what follows must not depend on that.
        """
        reading = self._reading(channel, block)
        valid = np.flatnonzero(np.isfinite(reading))
        first = 0 if channel in self._last else int(valid[0]) if len(valid) else len(block)
        if len(valid):
            self._compare_step(channel, reading[valid])
            self._last[channel] = float(reading[valid[-1]])
        method = self._methods[channel]
        result = method.process(block["device_time_ns"][first:], block["segment"][first:], reading[first:])
        if isinstance(method, MultipleModelRate) and method.stuck is not None:
            text = f"it leapt to {method.stuck:g} °C, as no temperature does, and stuck there: "
            self._notice(channel, "stuck", text + "taken for a fault of the thermometer until it changes")
        estimates = np.full((4, len(block)), np.nan)
        estimates[:, first:] = result.temperature, result.rate, result.temperature_sd, result.rate_sd
        return [*estimates]

    def _reading(self, channel: str, block: SampleBlock) -> FloatArray:
        """Return the readings, NaN where there is none or it is out of range."""
        given = block[channel] if channel in block else np.full(len(block), np.nan)
        low, high = self._parameters.lowest_degc, self._parameters.highest_degc
        with np.errstate(invalid="ignore"):
            inside = (given >= low) & (given <= high)
        if (outside := given[np.isfinite(given) & ~inside]).size:
            text = f"{outside[0]:g} °C is left out, as all beyond {low:g} to {high:g} (lowest_degc, "
            self._notice(channel, "outside", text + "highest_degc): is its unit right?")
        return np.where(inside, given, np.nan)

    def _compare_step(self, channel: str, reading: FloatArray) -> None:
        """Compare the declared step with what the changes of valid readings show, until they show it."""
        declared, finder = self._parameters.step_degc, self._finders[channel]
        if declared is None or finder.changes >= 1000:
            return
        changes = np.abs(np.diff(reading, prepend=self._last.get(channel, reading[0])))
        for change in changes[changes > 0.0].tolist():
            finder.learn(change)
        if (found := finder.contradiction(declared)) is not None:
            self._notice(channel, "step", f"step_degc contradicts the data: {found}")

    def _notice(self, channel: str, what: str, text: str) -> None:
        """Add a notice, once for each channel and kind."""
        if (channel, what) not in self._noticed:
            self._noticed.add((channel, what))
            self._notices.append(f"{channel}: {text}")

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the declared step and with the readings; for the log."""
        notices, self._notices = self._notices, []
        return notices


def _columns(channel: str) -> list[Column]:
    suffix = channel.removeprefix("temperature")
    of = f" of {channel}" if suffix else ""
    return [
        Column(f"temperature_estimate{suffix}", "degC", description=f"estimated temperature{of}"),
        Column(f"temperature_rate{suffix}", "degC/s", description=f"estimated rate{of}"),
        Column(f"temperature_estimate_sd{suffix}", "degC", description="its standard deviation"),
        Column(f"temperature_rate_sd{suffix}", "degC/s", description="its standard deviation"),
    ]
