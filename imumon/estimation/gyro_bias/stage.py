"""Rest and gyro bias as stages of the pipeline: zero-velocity updates, and the thermal model at all times."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column, vector_columns
from imumon.estimation.rest.parameters import GyroBiasParameters, RestParameters
from imumon.estimation.rest.slots import ACCEL, GATHERED, GYRO, GYRO_SETS, SENSORS, SLOT_S, Timing, heading_of
from imumon.filters.slots import SlotGatherer, Slots
from imumon.geodesy import DEG_PER_H, EARTH_RATE
from imumon.models.model import BiasModel

from .bank import SLOPE_LEFT_PER_SIGMA, SLOPE_PER_SIGMA, LinearBias, at_samples
from .estimator import Estimator
from .place import Attitude
from .thermal import BiasTrail, Thermal

Mode = Literal["standard", "thermal", "learned"]
LONGEST_PAUSE_S = 2.5  # over which a rest goes on, and holds where readings are missing.  Assumed.
LEAST_READINGS = 16  # of a gyro that the unit has, not a stray one.  Assumed.
REST = (
    Column("at_rest", "1", "int64", "1 while the unit is at rest, 0 while it moves or nothing is known"),
    *vector_columns("turn_hypothesis", "rad/s", "turn that may be a change of bias"),
)
BIAS = (
    *vector_columns("gyro_bias", "rad/s", "bias of the raw rate"),
    *vector_columns("gyro_bias_sd", "rad/s", "standard deviation of the bias"),
    *vector_columns("gyro_corrected", "rad/s", "angular rate minus bias"),
    *vector_columns(
        "zupt_innovation", "1", "zero-velocity innovation over its standard deviation; missing otherwise"
    ),
    *vector_columns(
        "gyro_random_error", "rad/s", "bias less the model's curve; the bias where there is no model"
    ),
    *vector_columns("gyro_random_error_sd", "rad/s", "its standard deviation"),
)


class RestAndBias:
    """Rest and motion, and the bias of each gyro with its standard deviation, whatever the attitude.

    Neither noise nor bias of the sensors needs to be known.  Rest is decided at the end of each slot of a
    quarter of a second; a single sample far from the mean ends it at that sample.

    ``turn_hypothesis_{x,y,z}`` is in sigma: the difference between a steady turn and a changed bias, rad/s,
    times the root of the probability of what is not shown, with the error by rounding (root of squares).

    ``gyro_bias_{x,y,z}`` is the bias of the raw rate, with what is not known of the earth rate: all of it, or
    without a heading its level part.  It is NaN until the unit was at rest for some seconds, or for a minute
    in motion, which leaves an upright axis unknown.

    Raises BAD_CONFIG when the model lacks a gyro.

    Parameters
    ----------
    model : BiasModel or None
        Bias over temperature.
    mode : "standard", "thermal" or "learned"
        standard, thermal: a model's increments are added to the bias (TCZUPT); without a model sigma does not
        contain the temperature.  learned: the slope is estimated, and used where it is evident.
    latitude_deg, heading_deg : float or None
        Of the place, and of the body's x axis (if vertical: -z) at the first rest of each segment, clockwise
        from north.  Sigma does not contain their errors.
    rest : RestParameters or None
        What a resting unit may do.
    """

    columns: Sequence[Column] = (*REST, *BIAS)

    def __init__(
        self,
        parameters: GyroBiasParameters | None = None,
        model: BiasModel | None = None,
        mode: Mode = "standard",
        latitude_deg: float | None = None,
        heading_deg: float | None = None,
        rest: RestParameters | None = None,
    ) -> None:
        # Sd of the slope over σ, 1/°C: each makes a mode of the filters.
        slopes = (0.0, SLOPE_LEFT_PER_SIGMA if model else SLOPE_PER_SIGMA) if mode == "learned" else (0.0,)
        self._thermal = Thermal(model)
        latitude, heading = (None if a is None else math.radians(a) for a in (latitude_deg, heading_deg))
        attitude = Attitude(latitude, heading)
        self._estimator = Estimator(
            parameters or GyroBiasParameters(), slopes, rest or RestParameters(), self._thermal, attitude
        )
        self._timing = Timing()
        self._slots = SlotGatherer(GATHERED, round(SLOT_S * 1e9), turns=True)
        self._bias = self._estimator.output(0.0)
        self._trail = BiasTrail(model)
        self._last_ns = NO_INT
        self._readings = np.zeros(3, np.int64)  # of each gyro so far
        self._notices = _notices_of_place(latitude, heading)

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; takes what there is of gyro_{x,y,z} in rad/s and
        accel_{x,y,z} in m/s², of mag_{x,y,z}, yaw or q_{w,x,y,z}, and, in °C, of temperature_estimate and its
        _sd, or of temperature: that is taken as exact, so its noise draws a learned slope to zero.
        """
        n, time_ns = len(block), block["device_time_ns"]
        readings = block.stacked(SENSORS)
        readings[time_ns == NO_INT] = np.nan
        usable = np.isfinite(readings).any(1)
        absent = self._absent(readings[:, GYRO])
        readings[:, GYRO][absent] = 0.0
        (temperature, sd), (modelled, curve, power_on_sd) = self._thermal.process(block)
        segment = GYRO_SETS * block["segment"] + absent.sum(1)  # a gyro that comes late begins another
        block = block.with_columns({"segment": segment})
        given = np.full(n, np.nan)  # rest is to be detected
        if self._estimator.parameters.assume_at_rest:
            given[:] = block.columns.get("at_rest", np.ones(n)) == 1
        values = np.column_stack([readings, modelled, power_on_sd, heading_of(block), temperature, sd, given])
        slots = self._slots.process(np.where(usable, time_ns, NO_INT), segment, values)
        rest, innovation, biases = self._estimate(block, slots, readings, temperature)
        # Rest ends where readings are missing for long, and at unknown times.
        latest = np.maximum.accumulate(np.where(usable, np.arange(n), -1))
        latest_ns = np.where(latest < 0, self._last_ns, time_ns[latest])  # -1: none yet in this block
        rest[(time_ns == NO_INT) | (time_ns - latest_ns > int(LONGEST_PAUSE_S * 1e9))] = 0
        self._last_ns = int(latest_ns[-1]) if n else self._last_ns
        if self._estimator.parameters.assume_at_rest:
            rest[:] = given
        bias, variance, turn = at_samples(slots.row, biases, readings[:, ACCEL], rest == 0)
        bias, sd = bias + modelled, np.sqrt(variance + turn**2)
        bias[absent] = sd[absent] = innovation[absent] = turn[absent] = np.nan
        self._trail.add(temperature[slots.row], bias[slots.row])
        # In the order of `columns`, of which a detector of rest has the first four.
        vectors = np.hstack([turn, bias, sd, readings[:, GYRO] - bias, innovation, bias - curve, sd])
        return {column.name: values for column, values in zip(self.columns, (rest, *vectors.T), strict=False)}

    def _absent(self, gyro: FloatArray) -> BoolArray:
        """Return which gyros the unit lacks, (n, 3): those of few readings so far, beside one of more."""
        count = np.cumsum(np.vstack([self._readings, np.isfinite(gyro)]), axis=0)
        self._readings = count[-1]
        present = count[1:] >= LEAST_READINGS
        return ~present & present.any(1, keepdims=True)

    def _estimate(
        self, block: SampleBlock, slots: Slots, readings: FloatArray, temperature: FloatArray
    ) -> tuple[IntArray, FloatArray, list[LinearBias]]:
        """Return at_rest, (n,), innovations, (n, 3), and the bias before the first slot and behind each."""
        rest, innovation = np.zeros(len(block), np.int64), np.full((len(block), 3), np.nan)
        biases, start = [self._bias], 0
        for k, slot in enumerate(self._timing.make_slots(slots)):
            row = int(slots.row[k])
            self._continue_rest(rest, readings, start, row)
            if slot.length_s > 0.0:
                innovation[row] = self._estimator.step(slot)
            until_s = self._restart_or_bridge_gap(block, slots, k, temperature[row])
            biases.append(self._estimator.output(until_s))
            start = row
        self._continue_rest(rest, readings, start, len(rest))
        self._bias = biases[-1]
        return rest, innovation, biases

    def _restart_or_bridge_gap(self, block: SampleBlock, slots: Slots, k: int, degc: FloatArray) -> float:
        """Restart, or bridge a gap, by the first sample behind a slot; return until when to predict, s."""
        row = int(slots.row[k])
        time_ns, segment = int(block["device_time_ns"][row]), block["segment"][row]
        if segment != slots.segment[k] or time_ns < slots.end_ns[k]:
            self._estimator.restart()
            return self._timing.end_s
        behind_s = self._timing.since_origin_s(time_ns)
        gap_s = self._timing.gap_s(behind_s)
        if not gap_s:
            return self._timing.end_s
        lag = self._thermal.unseen_lag(gap_s, block.rows(row, row + 1))
        self._estimator.bridge_gap(degc, lag, gap_s > LONGEST_PAUSE_S)
        return behind_s

    def _continue_rest(self, rest: IntArray, readings: FloatArray, start: int, stop: int) -> None:
        """Continue rest over the rows of the open slot, up to a sample far from the mean."""
        if start < stop and not self.unrest:
            rest[start:stop] = self._estimator.quiet.rest_until_far(readings[start:stop])

    @property
    def unrest(self) -> str:
        """Why the latest slot is no rest; empty where it is, or readings are missing."""
        return self._estimator.unrest

    def charts(self) -> Sequence[Chart]:
        """Return the bias over temperature, beside the model's curve where there is a model."""
        return self._trail.charts()

    def notices(self) -> list[str]:
        """Return what is missing, assumed, or out of range, and how often the bias has jumped."""
        found = [*self._notices, *self._thermal.notices]
        if jumps := self._estimator.jumps:
            found.append(
                f"at rest the rate contradicted the bias, so it has jumped, {jumps} times so far: "
                "the bias is estimated anew"
            )
        return found


class RestDetector(RestAndBias):
    """Rest and motion alone: the columns ``at_rest`` and ``turn_hypothesis_{x,y,z}``."""

    columns = REST

    def __init__(self, parameters: RestParameters | None = None) -> None:
        super().__init__(mode="learned", rest=parameters)  # with a slope, as it has no model

    def notices(self) -> list[str]:
        """Return nothing: its bias is not reported."""
        return []


def _notices_of_place(latitude: float | None, heading: float | None) -> list[str]:
    taken = "is taken as part of the gyro bias"
    if latitude is None:
        return [f"the latitude is not known: the earth rate, up to 15 °/h, {taken}"]
    if heading is None:
        level = EARTH_RATE / DEG_PER_H * math.cos(latitude)
        return [f"the heading is not known: the horizontal earth rate, {level:.1f} °/h, {taken}"]
    return []
