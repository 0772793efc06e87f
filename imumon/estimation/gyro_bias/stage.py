"""Gyro bias as a stage of the pipeline: zero-velocity updates at rest, the thermal model at all times."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.estimation.gyro_bias.estimator import (
    SLOT_S,
    Params,
    Slot,
    State,
    miss,
    restarted,
    shown,
    step,
)
from imumon.estimation.gyro_bias.law import NOTHING, Shown, at_samples
from imumon.estimation.gyro_bias.modes import SLOPE_LEFT_PER_SIGMA, SLOPE_PER_SIGMA
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.place import Place
from imumon.estimation.gyro_bias.thermal_input import ThermalInput, unseen_lag
from imumon.estimation.gyro_bias.timing import Timing
from imumon.estimation.gyro_bias.trail import BiasTrail
from imumon.filters.segments import Breaks
from imumon.filters.slots import SlotGatherer, Slots
from imumon.models.model import BiasModel

Mode = Literal["standard", "thermal", "learned"]
RATE, FORCE, DEGC, INITIAL_SD, TURN = (slice(3 * i, 3 * i + 3) for i in range(5))
REST, GATHERED = 15, 16
"""Columns of the gatherer."""
_COLUMNS = (
    ("gyro_bias", "rad/s", "bias of the raw rate"),
    ("gyro_bias_sd", "rad/s", "standard deviation of the bias"),
    ("gyro_corrected", "rad/s", "angular rate less bias"),
    ("zupt_innovation", "1", "zero-velocity innovation over its standard deviation; NaN between slots"),
    ("gyro_random_error", "rad/s", "bias less the model's curve; the bias where there is no model"),
    ("gyro_random_error_sd", "rad/s", "its standard deviation"),
)


class GyroBias:
    """Bias of each gyro with its standard deviation, whatever the attitude of the unit.

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
    """

    def __init__(
        self,
        parameters: GyroBiasParameters | None = None,
        model: BiasModel | None = None,
        mode: Mode = "standard",
        latitude_deg: float | None = None,
        heading_deg: float | None = None,
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
        self._params = _params(self._parameters, slopes, Place(_angle(latitude_deg), _angle(heading_deg)))
        self._state = State()
        self._timing = Timing()
        self._slots = SlotGatherer(GATHERED, round(SLOT_S * 1e9), rates=RATE.start)
        self._shown: Shown = NOTHING
        self._growth = np.zeros(3)
        self._trail = BiasTrail(model)
        self._breaks = Breaks()
        self._pending = _notices_at_start(latitude_deg, heading_deg)
        self._pending += [f"the gyro bias does not use {key} any more" for key in self._parameters.retired]
        self._reported: set[str] = set()
        self._lacks_rest = False
        self._jumped = 0
        self._now_s = 0.0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return [
            Column(f"{name}_{axis}", unit, description=f"{meaning}, {axis}")
            for name, unit, meaning in _COLUMNS
            for axis in "xyz"
        ]

    def snapshot(self) -> dict[str, object]:
        """Return a copy of all that is carried from block to block."""
        return copy.deepcopy({name: value for name, value in vars(self).items() if name != "_params"})

    def restore(self, saved: Mapping[str, object]) -> None:
        """Go on from what `snapshot` returned."""
        vars(self).update(copy.deepcopy(dict(saved)))

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``, the gyros, and ``at_rest``; the accelerometers distinguish a
        slow rotation from a bias, and ``turn_hypothesis_{x,y,z}`` is a turn that the rest detector has not
        excluded.
        """
        n = len(block)
        gyro = block.gyro
        if gyro is None:
            gyro = np.full((n, 3), np.nan)
        first = 0
        if not self._breaks.begun:
            usable = (block["device_time_ns"] != NO_INT) & np.isfinite(gyro).all(1)
            first = int(np.argmax(usable)) if usable.any() else n
        result = np.full((6, 3, n), np.nan)
        if first < n:
            later = block.rows(first, n) if first else block
            self._follow(later, gyro[first:], result[:, :, first:].swapaxes(1, 2))
        return {
            f"{name}_{axis}": part[j]
            for (name, _, _), part in zip(_COLUMNS, result, strict=True)
            for j, axis in enumerate("xyz")
        }

    def _follow(self, block: SampleBlock, gyro: FloatArray, result: FloatArray) -> None:
        """Fill bias, sd, corrected rate, innovation, and drift with its sd, (6, n, 3)."""
        bias, sd, corrected, innovation, drift, drift_sd = result
        n, rest = len(block), self._rest(block)
        temperature, reported = self._thermal.temperature(block), block.vector("turn_hypothesis")
        breaks = self._breaks.rows(block["device_time_ns"], block["segment"])
        total, curve, initial_sd = self._model_input(block, temperature, breaks)
        turn = np.zeros((n, 3)) if reported is None else np.nan_to_num(reported)
        force = np.full((n, 3), np.nan) if block.accel is None else block.accel
        force = np.where(np.isfinite(force.sum(1))[:, np.newaxis], force, np.nan)
        values = np.column_stack([gyro - total, force, temperature, initial_sd, turn, rest])
        time_ns = np.where(np.isfinite(values[:, RATE]).all(1), block["device_time_ns"], NO_INT)
        slots = self._slots.process(time_ns, block["segment"], values)
        rows, every = [], [self._shown]
        for k, row in enumerate(slots.row.tolist()):
            found, another = self._step(slots, k, reported is not None)
            if found is not None:
                innovation[row] = found
            another |= self._look_ahead(block, slots, k, temperature)
            if another:
                rows.append(row)
                every.append(self._present())
        self._shown = every[-1]
        bias[:], variance = at_samples(np.array(rows, np.int64), every, force, ~rest, turn)
        np.sqrt(variance, out=sd)
        bias += total
        drift_sd[:] = sd
        np.subtract(gyro, bias, out=corrected)
        np.subtract(bias, curve, out=drift)
        ended = slots.row[slots.row < n]
        self._trail.add(temperature[ended], bias[ended])

    def _step(self, slots: Slots, k: int, is_reported: bool) -> tuple[FloatArray | None, bool]:
        """Take a slot; return the innovations, and whether the bias is another."""
        begins = bool(slots.begins[k])
        span = self._timing.next(int(slots.start_ns[k]), int(slots.end_ns[k]), int(slots.samples[k]), begins)
        if begins:
            self._thermal.variance.begin()
            self._growth = np.zeros(3)
        self._now_s = span.end_s
        if not span.seconds > 0.0:
            return None, False
        growth = self._thermal.variance.step(slots.last[k, DEGC], slots.last[k, INITIAL_SD])
        self._growth, added = growth, growth - self._growth
        slot = Slot(
            span, bool(slots.smallest[k, REST] == 1.0), slots.mean[k, RATE], slots.mean[k, FORCE],
            slots.mean[k, DEGC], added, slots.last[k, TURN] if is_reported else None, slots.turns.at(k),
        )  # fmt: skip
        return step(self._state, self._params, slot)

    def _look_ahead(self, block: SampleBlock, slots: Slots, k: int, degc: FloatArray) -> bool:
        """Detect a restart or a gap by the first sample behind a slot."""
        row = int(slots.row[k])
        time_ns, segment = block["device_time_ns"][row], block["segment"][row]
        if segment != slots.segment[k] or time_ns < slots.end_ns[k]:
            self._state = restarted(self._state)
            return True
        behind_s = 1e-9 * (int(time_ns) - self._timing.origin_ns)
        gap_s = self._timing.pause(behind_s)
        if gap_s:
            lag = unseen_lag(gap_s, self._thermal.rate_sd(block.rows(row, row + 1))[0])
            self._thermal.variance.miss(lag)
            self._state.degc = np.where(np.isfinite(degc[row]), degc[row], self._state.degc)
            growth = self._thermal.variance.step(degc[row], np.full(3, np.nan))
            self._state.added = self._state.added + growth - self._growth
            self._growth, self._now_s = growth, behind_s
            miss(self._state, lag)
        return bool(gap_s)

    def _present(self) -> Shown:
        """Return the law from now on."""
        law, added, ambiguity = shown(self._state, self._params, self._now_s)
        return NOTHING if law is None else law.shown(added, ambiguity, self._state.force)

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

    def _rest(self, block: SampleBlock) -> BoolArray:
        if "at_rest" in block:
            return np.asarray(block["at_rest"] == 1)
        self._lacks_rest |= not self._parameters.assume_at_rest
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
        if self._state.beliefs.jumped > self._jumped:
            self._jumped = self._state.beliefs.jumped
            texts.append(
                "at rest the rate contradicted the bias, so it has jumped: the bias is estimated anew"
            )
        return texts


def _angle(degrees: float | None) -> float:
    return math.nan if degrees is None else math.radians(degrees)


def _params(parameters: GyroBiasParameters, slopes: tuple[float, ...], place: Place) -> Params:
    def axes(value: float | list[float] | None, absent: float) -> FloatArray:
        return np.array(np.broadcast_to(absent if value is None else value, 3), np.float64)

    instability = parameters.bias_instability_rad_per_s
    walk = parameters.rate_random_walk_rad_per_s_per_sqrt_s
    absent = math.nan if instability is None and walk is None else 0.0
    white = axes(parameters.angle_random_walk_rad_per_sqrt_s, math.nan)
    return Params(white, axes(instability, absent), axes(walk, absent), place, slopes)


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
