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
from imumon.estimation.gyro_bias.attitude import Place
from imumon.estimation.gyro_bias.bank import known_family, unknown_family
from imumon.estimation.gyro_bias.contrary import PATIENCE_S
from imumon.estimation.gyro_bias.filter import Params, State, restarted, step
from imumon.estimation.gyro_bias.intake import SLOT_S, Intake, Samples, complete
from imumon.estimation.gyro_bias.law import PATH, Laws, at_samples, no_law
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.thermal_input import ThermalInput
from imumon.estimation.gyro_bias.trail import BiasTrail
from imumon.filters.segments import Breaks
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.model import BiasModel

SENSITIVITIES = np.radians([0.001, 0.007, 0.05]) / STANDARD_GRAVITY
"""What data sheets say of MEMS gyros, rad/s per m/s²: from 0.001 °/s/g, compensated, to 0.1.  Steps by seven
make the error of a unit that has none 12 % larger, a step by ten from 0.005 on 57 %."""
Mode = Literal["standard", "thermal", "learned"]
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
    bias, and `notices` says so.  There is no estimate (NaN) until the unit was at rest for some seconds, or
    for a minute in motion, which says nothing of an upright axis.

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
        self._params = _params(self._parameters, mode, Place(_angle(latitude_deg), _angle(heading_deg)))
        self._state = State()
        self._intake = Intake(self._thermal.variance)
        self._law, self._path = no_law(), np.zeros(1, PATH)
        self._trail = BiasTrail(model)
        self._breaks = Breaks()
        self._pending = _notices_at_start(latitude_deg, heading_deg)
        self._said: set[str] = set()
        self._lacks_rest = False
        self._jumps = 0

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

        Needs ``device_time_ns`` and ``segment``, the gyros, and ``at_rest``; the accelerometers tell a slow
        rotation from a bias, and ``turn_hypothesis_{x,y,z}`` what the rest detector has not decided.
        """
        n = len(block)
        gyro = block.gyro
        if gyro is None:
            gyro = np.full((n, 3), np.nan)
        first = 0
        if not self._breaks.begun:
            usable = (block["device_time_ns"] != NO_INT) & complete(gyro)
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
        n, accel = len(block), block.accel
        temperature = self._thermal.temperature(block)
        breaks = self._breaks.rows(block["device_time_ns"], block["segment"])
        total, curve, initial_sd = self._model_input(block, temperature, breaks)
        samples = Samples(
            block["device_time_ns"],
            block["segment"],
            gyro - total,
            np.full((n, 3), np.nan) if accel is None else accel,
            temperature,
            initial_sd,
            self._thermal.rate_sd(block),
            _undecided(block),
            self._rest(block),
        )
        said: list[tuple[int, Laws]] = []
        for row, begins, slot in self._intake.process(samples):
            if begins:
                self._state = restarted(self._state)
            if slot is not None:
                at = min(row, n - 1)
                innovation[at] = step(self._state, self._params, slot)
            said.append((row, self._state.law))
        # What was known before a restart is void from there until a slot has said something.
        said = sorted([*said, *((row, no_law()) for row in breaks)], key=lambda one: one[0])
        rows = np.array([row for row, _ in said], np.int64)
        laws = np.empty(len(said) + 1, self._law.dtype)
        laws[:1] = self._law
        for k, (_, law) in enumerate(said, 1):
            laws[k : k + 1] = law  # concatenate finds a common type of every two anew, in ten times the time
        self._law = laws[-1:].copy()
        sent = samples.gyro, samples.accel, temperature, samples.turn
        at_samples(rows, laws, self._path, samples.time_ns, ~samples.rest, *sent, bias, sd)
        bias += total
        drift_sd[:] = sd
        np.subtract(gyro, bias, out=corrected)
        np.subtract(bias, curve, out=drift)
        seen = rows[rows < n]
        self._trail.add(block["device_time_ns"][seen], temperature[seen], bias[seen])

    def _model_input(
        self, block: SampleBlock, temperature: FloatArray, breaks: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `ThermalInput.process` says, run by run."""
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
            if true and text not in self._said:
                self._said.add(text)
                texts.append(text)
        jumps = self._state.jumps
        if jumps > self._jumps:
            self._jumps = jumps
            texts.append(
                f"at rest the rate contradicted the bias, and gravity, or {PATIENCE_S:.0f} s, say that it "
                "has jumped: the bias is estimated anew"
            )
        return texts


def _undecided(block: SampleBlock) -> FloatArray:
    """Return the turn that may be a change of the bias, 0 where there is none, (n, 3)."""
    hypothesis = block.vector("turn_hypothesis")
    if hypothesis is None:
        return np.zeros((len(block), 3))
    return np.nan_to_num(hypothesis, copy=False)


def _angle(degrees: float | None) -> float:
    return math.nan if degrees is None else math.radians(degrees)


def _params(parameters: GyroBiasParameters, mode: Mode, place: Place) -> Params:
    def axes(value: float | list[float] | None, absent: float) -> FloatArray:
        return np.array(np.broadcast_to(absent if value is None else value, 3), np.float64)

    instability = parameters.bias_instability_rad_per_s
    walk = parameters.rate_random_walk_rad_per_s_per_sqrt_s
    tilt = parameters.velocity_random_walk_m_per_s_per_sqrt_s
    unknown = instability is None and walk is None
    return Params(
        unknown_family(SENSITIVITIES, parameters.angle_random_walk_rad_per_sqrt_s is not None)
        if unknown
        else known_family(axes(instability, 0.0), axes(walk, 0.0), SENSITIVITIES),
        axes(parameters.angle_random_walk_rad_per_sqrt_s, math.nan),
        math.nan if tilt is None else tilt,
        place,
        mode == "learned",
        round(parameters.zeroing_s / SLOT_S),
    )


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
