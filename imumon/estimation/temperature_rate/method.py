"""The default method on the samples of one thermometer: samples to slots, and slots back to samples."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray
from imumon.estimation.temperature_rate.filter import Shown, State, step
from imumon.estimation.temperature_rate.model import SLOT_S, Params
from imumon.estimation.temperature_rate.sensor import Reading, StepFinder, Thermometer
from imumon.filters.rates import FASTEST_RATE, START_ACCELERATION, UNSEEN_RATE, RateEstimate
from imumon.filters.slots import SlotGatherer, Slots, held

SLOT_NS = round(SLOT_S * 1e9)
NEIGHBOUR_S = 10.0
"""Readings farther apart than this are no neighbours, unless the slots are as far apart, s."""
DEFAULT = Params()


class Readings:
    """Gathers samples into the readings of slots, the same whatever the division into blocks."""

    def __init__(self) -> None:
        self._gatherer = SlotGatherer(1, SLOT_NS)
        self._origin_ns = 0
        self._before = (math.nan, -math.inf)
        self._end_s = 0.0

    def gather(
        self, time_ns: IntArray, segment: IntArray, reading: FloatArray
    ) -> tuple[Slots, list[Reading]]:
        """Return the slots that end within these samples, (n,) each, and what was read in each."""
        slots = self._gatherer.process(time_ns, segment, reading[:, np.newaxis])
        return slots, [self._reading(slots, i) for i in range(len(slots))]

    def _reading(self, slots: Slots, i: int) -> Reading:
        if slots.begins[i]:
            self._origin_ns, self._end_s = int(slots.start_ns[i]), 0.0
            self._before = (math.nan, -math.inf)
        start_s = (int(slots.start_ns[i]) - self._origin_ns) * 1e-9
        end_s = (int(slots.end_ns[i]) - self._origin_ns) * 1e-9
        samples, count = int(slots.samples[i]), int(slots.count[i, 0])
        before, before_s = self._before
        reading = Reading(
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
            before=before if start_s - before_s < NEIGHBOUR_S else math.nan,
            gap_s=(end_s - start_s) / (samples - 1) if samples > 1 else max(start_s - self._end_s, 1e-9),
        )
        if count:
            self._before = (reading.last, end_s)
        self._end_s = end_s
        return reading


class MultipleModelRate:
    """Temperature and rate of one thermometer by a multiple-model Kalman filter.

    Raises ValueError when the step is not positive.

    Parameters
    ----------
    step_degc : float, optional
        Quantization step in °C, if it is declared; it is found from the readings in any case.
    params : Params, optional
        Assumptions of the model.
    """

    def __init__(self, step_degc: float | None = None, params: Params = DEFAULT) -> None:
        self.params = params
        self.state = State(Thermometer(StepFinder(step_degc)))
        self._readings = Readings()
        self._shown = np.array(Shown())
        self._shown_ns: IntArray = np.array(0, np.int64)
        self._segment: IntArray = np.array(NO_INT, np.int64)

    @property
    def step(self) -> float | None:
        """The step in °C that the readings show, None as long as they do not."""
        return self.state.thermometer.finder.step

    @property
    def stuck(self) -> float | None:
        """Where readings stuck last after a leap that no temperature makes, °C; None if they never did."""
        at = self.state.gate.stuck_at
        return at if math.isfinite(at) else None

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts anew but keeps what is known of
            the sensor.
        reading : array, (n,)
            °C; NaN where there is none.
        """
        slots, readings = self._readings.gather(time_ns, segment, reading)
        shown = np.empty((len(slots), len(self._shown)))
        for i, taken in enumerate(readings):
            if slots.begins[i]:
                self.state.begin()
            shown[i] = step(self.params, self.state, taken)
        n = len(reading)
        columns = held(slots.row, shown, self._shown, n).T
        shown_ns = held(slots.row, slots.end_ns, self._shown_ns, n)
        shown_segment = held(slots.row, slots.segment, self._segment, n)
        if len(slots):
            self._shown = shown[-1]
            self._shown_ns, self._segment = np.array(slots.end_ns[-1]), np.array(slots.segment[-1])
        age = np.asarray((time_ns - shown_ns) * 1e-9, np.float64)
        known = (segment == shown_segment) & (age >= 0.0)
        return extrapolate(age, known, reading, Shown(*columns), self.params.glide_s)


def extrapolate(
    age: FloatArray, known: BoolArray, reading: FloatArray, shown: Shown, glide_s: float
) -> RateEstimate:
    """Return the estimates at samples from what the last slot shows; all arrays, also in `shown`, are (n,).

    Before the first slot of a segment ends, and behind a gap until the next slot ends, there is the reading,
    with its standard deviation (NaN while nothing shows it), and a rate that may have changed meanwhile.
    """
    late = known & (age > shown.late_s) & np.isfinite(shown.rate)
    fading = np.exp(-age / glide_s, where=known, out=np.zeros_like(age)) * shown.rate_offset
    # A slot is known when the next begins; readings farther apart leave the temperature to the rate.
    waited = np.maximum(age - 2.0 * SLOT_S, 0.0)
    result = RateEstimate(
        temperature=shown.temperature + age * shown.rate,
        rate=shown.rate + age * shown.acceleration + fading,
        temperature_sd=np.hypot(shown.temperature_sd, waited * shown.rate_sd),
        rate_sd=np.hypot(shown.rate_sd, fading),
    )
    reads = np.isfinite(reading)
    # Where the reading is not where the rate led, the rate is another: in the mean by so much.
    astray = np.maximum(np.abs(reading - result.temperature) - shown.reading_sd, 0.0)
    changed = 2.0 * astray / np.maximum(age, SLOT_S)
    unseen = np.minimum(START_ACCELERATION * age, UNSEEN_RATE)
    late_sd = np.sqrt(shown.rate_sd**2 + unseen**2 + changed**2)
    for values, if_late, if_unknown in (
        (result.temperature, reading, reading),
        (result.rate, shown.rate, 0.0),
        (result.temperature_sd, shown.reading_sd, shown.reading_sd),
        (result.rate_sd, late_sd, FASTEST_RATE),
    ):
        np.copyto(values, np.where(reads, if_late, np.nan), where=late)
        np.copyto(values, np.where(reads, if_unknown, np.nan), where=~known)
    return result


class StepWatch:
    """Finds the step of a thermometer whatever the method that estimates its rate.

    Parameters
    ----------
    declared : float
        The step in °C that the device file declares.
    """

    def __init__(self, declared: float) -> None:
        self.finder = StepFinder(declared)
        self._readings = Readings()

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> None:
        """Learn from samples, (n,) each."""
        for taken in self._readings.gather(time_ns, segment, reading)[1]:
            if taken.count:
                self.finder.learn(taken)
