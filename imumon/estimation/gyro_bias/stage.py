"""Rest and gyro bias as stages of the pipeline: zero-velocity updates, and the thermal model at all times."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.estimation.gyro_bias.estimator import Params, Slot, State, miss, restarted, shown, step
from imumon.estimation.gyro_bias.inputs import heading_of, readings_of, slots_of
from imumon.estimation.gyro_bias.modes import SLOPE_LEFT_PER_SIGMA, SLOPE_PER_SIGMA
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.place import Place
from imumon.estimation.gyro_bias.prediction import NOTHING, Shown, at_samples
from imumon.estimation.gyro_bias.thermal_input import ThermalInput, unseen_lag
from imumon.estimation.gyro_bias.timing import Timing
from imumon.estimation.gyro_bias.trail import BiasTrail
from imumon.estimation.rest import quiet
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.quiet import ACCEL, AXES, GYRO, SLOT_S
from imumon.filters.segments import Breaks
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.models.model import BiasModel

Mode = Literal["standard", "thermal", "learned"]
HEADING, MODELLED, DEGC, INITIAL_SD = (slice(AXES + 3 * i, AXES + 3 * i + 3) for i in range(4))
GIVEN, GATHERED = AXES + 12, AXES + 13
"""Columns of the gatherer, behind the readings."""
LONGEST_PAUSE_S = 2.5
"""A rest goes on over a pause as long as this; it holds as long where readings are missing."""
SHOWN_S = 1.0 - 1e-6
"""In motion the prediction of the bias is evaluated as often."""
REST = (
    Column("at_rest", "1", "int64", "1 while the unit is at rest, 0 while it moves or nothing is known"),
    *(
        Column(f"turn_hypothesis_{axis}", "rad/s", description=f"turn that may be a change of bias, {axis}")
        for axis in "xyz"
    ),
)
BIAS = tuple(
    Column(f"{name}_{axis}", unit, description=f"{meaning}, {axis}")
    for name, unit, meaning in (
        ("gyro_bias", "rad/s", "bias of the raw rate"),
        ("gyro_bias_sd", "rad/s", "standard deviation of the bias"),
        ("gyro_corrected", "rad/s", "angular rate less bias"),
        ("zupt_innovation", "1", "zero-velocity innovation over its standard deviation; NaN between slots"),
        ("gyro_random_error", "rad/s", "bias less the model's curve; the bias where there is no model"),
        ("gyro_random_error_sd", "rad/s", "its standard deviation"),
    )
    for axis in "xyz"
)


class RestAndBias:
    """Rest and motion, and the bias of each gyro with its standard deviation, whatever the attitude.

    Neither noise nor bias of the sensors needs to be known.  Rest is decided at the end of each slot of a
    quarter of a second; a single sample far from the mean ends it at that sample.

    While a steady turn cannot be distinguished from a bias that has changed, ``turn_hypothesis_{x,y,z}`` is
    the difference of both, rad/s, times the square root of the probability of what is not shown; else the
    largest error by rounding.  Its square is in the variance of the bias.  ``at_rest`` is 0 where a turn is
    more likely.

    The columns ``gyro_bias_{x,y,z}`` hold the whole bias of the raw rate.  The earth rate is not in it where
    latitude and heading are given; with the latitude alone its vertical part is not; else it is part of the
    bias, and `notices` reports it.  No estimate (NaN) until the unit was at rest for some seconds, or
    for a minute in motion, which leaves an upright axis unknown.

    Raises BAD_CONFIG when the thermal mode has no model, or the model lacks a gyro.

    Parameters
    ----------
    model : BiasModel or None
        Bias over temperature.
    mode : "standard", "thermal" or "learned"
        standard: the bias is a random walk with flicker noise, of data that the model, if there is one, has
        calibrated.  thermal: raw data, and the model's increments are added to the bias (TCZUPT; with the
        same noise these two are one filter).  learned: the slope over temperature is estimated as well, and
        used where the evidence is for it.
    latitude_deg, heading_deg : float or None
        Of the place, and of the body's x axis (where that is vertical: of -z) at the first rest, clockwise
        from north.
    rest : RestParameters or None
        What a resting unit may do.
    """

    _detects = True
    """Whether rest is detected here, and not given by a column."""

    def __init__(
        self,
        parameters: GyroBiasParameters | None = None,
        model: BiasModel | None = None,
        mode: Mode = "standard",
        latitude_deg: float | None = None,
        heading_deg: float | None = None,
        rest: RestParameters | None = None,
    ) -> None:
        if mode == "thermal" and model is None:
            raise ImumonError(
                Reason.BAD_CONFIG,
                "the thermal mode needs a bias model and has none",
                "give a model, or take the mode learned",
            )
        self._parameters = parameters or GyroBiasParameters()
        self._thermal = ThermalInput(model)
        slopes = (0.0, SLOPE_LEFT_PER_SIGMA if model else SLOPE_PER_SIGMA) if mode == "learned" else (0.0,)
        place = Place(_angle(latitude_deg), _angle(heading_deg))
        self._params = _params(self._parameters, slopes, place, rest)
        self._state = State()
        self._timing = Timing()
        self._slots = SlotGatherer(GATHERED, round(SLOT_S * 1e9), rates=GYRO.start)
        self._shown: Shown = NOTHING
        self._growth = np.zeros(3)
        self._trail = BiasTrail(model)
        self._breaks = Breaks()
        self._pending = _notices_at_start(latitude_deg, heading_deg)
        self._pending += [f"the gyro bias does not use {key} any more" for key in self._parameters.retired]
        self._pending += _retired(rest)
        self._reported: set[str] = set()
        self._lacks_rest = False
        self._jumped = 0
        self._now_s = 0.0
        self._last_ns, self._last_segment = NO_INT, 0
        self._at_rest = 0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return [*REST, *BIAS]

    def snapshot(self) -> dict[str, object]:
        """Return a copy of all that is carried from block to block."""
        return copy.deepcopy({name: value for name, value in vars(self).items() if name != "_params"})

    def restore(self, saved: Mapping[str, object]) -> None:
        """Go on from what `snapshot` returned."""
        vars(self).update(copy.deepcopy(dict(saved)))

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; takes what there is of gyro_{x,y,z} in rad/s and
        accel_{x,y,z} in m/s², of mag_{x,y,z}, yaw or q_{w,x,y,z}, and of temperature_estimate or temperature
        in °C.
        """
        n = len(block)
        dated = np.asarray(block["device_time_ns"] != NO_INT)
        readings = readings_of(block, dated)
        usable = np.asarray(np.isfinite(readings).any(1))
        first = 0
        if not self._breaks.begun:
            first = int(np.argmax(usable)) if usable.any() else n
        rest, turn = np.zeros(n, np.int64), np.zeros((n, 3))
        result = np.full((len(BIAS) // 3, 3, n), np.nan)
        if first < n:
            later = block.rows(first, n) if first else block
            parts = result[:, :, first:].swapaxes(1, 2)
            self._follow(later, readings[first:], usable[first:], rest[first:], turn[first:], parts)
        values = [rest, *turn.T, *result.reshape(len(BIAS), n)]
        added = dict(zip((column.name for column in (*REST, *BIAS)), values, strict=True))
        return {column.name: added[column.name] for column in self.columns}

    def _follow(
        self,
        block: SampleBlock,
        readings: FloatArray,
        usable: BoolArray,
        rest: IntArray,
        turn: FloatArray,
        result: FloatArray,
    ) -> None:
        """Fill at_rest, turn, and bias, sd, corrected rate, innovation, drift and its sd, (6, n, 3)."""
        bias, sd, corrected, innovation, drift, drift_sd = result
        n, temperature, given = len(block), self._thermal.temperature(block), self._given_rest(block)
        time_ns, segment = block["device_time_ns"], block["segment"]
        total, curve, initial_sd = self._model_input(block, temperature, self._breaks.rows(time_ns, segment))
        values = np.column_stack([readings, heading_of(block), total, temperature, initial_sd, given])
        slots = self._slots.process(np.where(usable, time_ns, NO_INT), segment, values)
        rows, every, turns = [], [self._shown], [self._state.turn_rate]
        each, start = slots_of(slots), 0
        for k, row in enumerate(slots.row.tolist()):
            self._hold(rest, readings, start, row)
            found = self._step(slots, each[k], k)
            if found is not None:
                innovation[row] = found
            self._look_ahead(block, slots, k, temperature)
            if self._now_s - self._state.shown_s >= SHOWN_S:
                rows.append(row)
                every.append(self._present())
            self._at_rest, start = int(self._state.at_rest), row
            turns.append(self._state.turn_rate)
        self._hold(rest, readings, start, n)
        turn[:] = held(slots.row, np.array(turns[1:]).reshape(-1, 3), turns[0], n)
        self._expire(rest, time_ns, segment, usable)
        self._shown = every[-1]
        if not self._detects:
            rest[:] = given
            reported = block.vector("turn_hypothesis")
            if reported is not None:
                np.maximum(np.abs(turn), np.abs(np.nan_to_num(reported)), out=turn)
        force = np.where(np.isfinite(readings[:, ACCEL].sum(1))[:, np.newaxis], readings[:, ACCEL], np.nan)
        bias[:], variance = at_samples(np.array(rows, np.int64), every, force, rest == 0)
        np.sqrt(variance + turn**2, out=sd)
        bias += total
        drift_sd[:] = sd
        np.subtract(readings[:, GYRO], bias, out=corrected)
        np.subtract(bias, curve, out=drift)
        ended = slots.row[slots.row < n]
        self._trail.add(temperature[ended], bias[ended])

    def _step(self, slots: Slots, readings: quiet.Slot, k: int) -> FloatArray | None:
        """Take a slot; return the innovations."""
        begins, samples = bool(slots.begins[k]), int(slots.count[k, GYRO].max()) or int(slots.samples[k])
        span = self._timing.next(int(slots.start_ns[k]), int(slots.end_ns[k]), samples, begins)
        if begins:
            self._thermal.variance.begin()
            self._growth = np.zeros(3)
        self._now_s = span.end_s
        if not span.seconds > 0.0:
            return None
        growth = self._thermal.variance.step(slots.last[k, DEGC], slots.last[k, INITIAL_SD])
        self._growth, added = growth, growth - self._growth
        mean = slots.mean[k]
        slot = Slot(
            span, readings._replace(seconds=span.seconds), mean[MODELLED], mean[DEGC], added, mean[HEADING],
            slots.turns.at(k), None if self._detects else bool(slots.smallest[k, GIVEN] == 1.0),
        )  # fmt: skip
        return step(self._state, self._params, slot)

    def _look_ahead(self, block: SampleBlock, slots: Slots, k: int, degc: FloatArray) -> None:
        """Detect a restart or a gap by the first sample behind a slot."""
        row = int(slots.row[k])
        time_ns, segment = block["device_time_ns"][row], block["segment"][row]
        if segment != slots.segment[k] or time_ns < slots.end_ns[k]:
            self._state = restarted(self._state)
            return
        behind_s = 1e-9 * (int(time_ns) - self._timing.origin_ns)
        gap_s = self._timing.pause(behind_s)
        if gap_s:
            lag = unseen_lag(gap_s, self._thermal.rate_sd(block.rows(row, row + 1))[0])
            self._thermal.variance.miss(lag)
            self._state.degc = np.where(np.isfinite(degc[row]), degc[row], self._state.degc)
            growth = self._thermal.variance.step(degc[row], np.full(3, np.nan))
            self._state.added = self._state.added + growth - self._growth
            self._growth, self._now_s = growth, behind_s
            miss(self._state, lag, gap_s > max(LONGEST_PAUSE_S, 3.0 * self._timing.interval_s))

    def _hold(self, rest: IntArray, readings: FloatArray, start: int, stop: int) -> None:
        """Fill in rows of the slot that is open: a sample outside the band of a unit at rest ends it
        there."""
        rest[start:stop] = self._at_rest
        if self._at_rest and start < stop and self._detects:
            low, high = self._state.quiet.band
            outside = ((readings[start:stop] < low) | (readings[start:stop] > high)).any(1)
            if outside.any():
                rest[start + int(np.argmax(outside)) : stop] = self._at_rest = 0
                self._state.quiet.disturbed = True

    def _expire(self, rest: IntArray, time_ns: IntArray, segment: IntArray, usable: BoolArray) -> None:
        """End rest where readings are missing for long, behind their segment, and at unknown times."""
        if not usable.all():
            latest = np.maximum.accumulate(np.where(usable, np.arange(len(usable)), -1))
            last_ns = np.where(latest < 0, self._last_ns, time_ns[latest])
            last_segment = np.where(latest < 0, self._last_segment, segment[latest])
            expired = (time_ns == NO_INT) | (segment != last_segment)
            rest[expired | (time_ns - last_ns > int(LONGEST_PAUSE_S * 1e9))] = 0
        if usable.any():
            last = int(np.flatnonzero(usable)[-1])
            self._last_ns, self._last_segment = int(time_ns[last]), int(segment[last])

    def _present(self) -> Shown:
        """Return the prediction from now on."""
        prediction, added = shown(self._state, self._params, self._now_s)
        return NOTHING if prediction is None else prediction.shown(added, self._state.force)

    def _model_input(
        self, block: SampleBlock, temperature: FloatArray, breaks: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return `ThermalInput.process` of each run of the unit."""
        edges = [0, *(row for row in breaks if row > 0), len(block)]
        parts = []
        for start, stop in pairwise(edges):
            if start in breaks:
                self._thermal.begin()
            rows = block if stop - start == len(block) else block.rows(start, stop)
            parts.append(self._thermal.process(rows, temperature[start:stop]))
        total, curve, initial_sd = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return total, curve, initial_sd

    def charts(self) -> Sequence[Chart]:
        """Return the bias over temperature, beside the model's curve where there is a model."""
        return self._trail.charts()

    def _given_rest(self, block: SampleBlock) -> BoolArray:
        if "at_rest" in block:
            return np.asarray(block["at_rest"] == 1)
        self._lacks_rest |= not (self._parameters.assume_at_rest or self._detects)
        return np.full(len(block), self._parameters.assume_at_rest)

    def notices(self) -> list[str]:
        """Return, once each, what is missing, assumed, or out of range; for the log."""
        texts, self._pending = self._pending, []
        conditions = {
            "no column at_rest: the bias is not estimated (a rest detector gives it; assume_at_rest does "
            "without)": self._lacks_rest,
            "the bias model lacks its temperature: the bias is taken as constant": self._thermal.lacking,
            _outside(self._thermal.ranges_degc): self._thermal.outside,
        }
        for text, true in conditions.items():
            if true and text not in self._reported:
                self._reported.add(text)
                texts.append(text)
        if self._state.decision.jumped > self._jumped:
            self._jumped = self._state.decision.jumped
            texts.append(
                "at rest the rate contradicted the bias, so it has jumped: the bias is estimated anew"
            )
        return texts


class GyroBias(RestAndBias):
    """The bias alone, where a column ``at_rest`` is given.

    What is given is believed: a rate that differs for a minute is another bias.  The squares of columns
    ``turn_hypothesis_{x,y,z}`` are in the variance.
    """

    _detects = False

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return BIAS


class RestDetector(RestAndBias):
    """Rest and motion alone: the columns ``at_rest`` and ``turn_hypothesis_{x,y,z}``.

    Parameters
    ----------
    parameters : RestParameters
        What a resting unit may do.
    """

    def __init__(self, parameters: RestParameters | None = None) -> None:
        super().__init__(mode="learned", rest=parameters)
        self._pending = _retired(parameters)

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return REST

    def notices(self) -> list[str]:
        """Return, once, which parameters are not used any more."""
        texts, self._pending = self._pending, []
        return texts

    def charts(self) -> Sequence[Chart]:
        """Return none."""
        return []


def _retired(rest: RestParameters | None) -> list[str]:
    keys = sorted(rest.retired) if rest is not None else []
    return [f"the rest detector does not use {' and '.join(keys)} any more"] if keys else []


def _angle(degrees: float | None) -> float:
    return math.nan if degrees is None else math.radians(degrees)


def _params(
    parameters: GyroBiasParameters,
    slopes: tuple[float, ...],
    place: Place,
    rest: RestParameters | None,
) -> Params:
    def axes(value: float | list[float] | None, absent: float) -> FloatArray:
        return np.array(np.broadcast_to(absent if value is None else value, 3), np.float64)

    instability = parameters.bias_instability_rad_per_s
    walk = parameters.rate_random_walk_rad_per_s_per_sqrt_s
    absent = math.nan if instability is None and walk is None else 0.0
    white = axes(parameters.angle_random_walk_rad_per_sqrt_s, math.nan)
    b, k = axes(instability, absent), axes(walk, absent)
    return Params(white, b, k, place, slopes, rest or RestParameters())


def _notices_at_start(latitude_deg: float | None, heading_deg: float | None) -> list[str]:
    if latitude_deg is None:
        return [
            "the latitude is not known: the earth rate, up to 15 °/h, is taken as part of the gyro bias"
            + (", in spite of the heading" if heading_deg is not None else "")
        ]
    if heading_deg is None:
        level = 15.041 * math.cos(math.radians(latitude_deg))
        return [
            f"the heading is not known: the horizontal earth rate, {level:.1f} °/h, is taken as part of the "
            "gyro bias; its vertical part is not"
        ]
    return []


def _outside(ranges_degc: FloatArray) -> str:
    low, high = ranges_degc[:, 0].max(), ranges_degc[:, 1].min()
    return (
        f"the temperature is outside the range of the bias model, {low:.1f} to {high:.1f} °C: the bias is "
        "extrapolated and its standard deviation widened"
    )
