"""Gyro bias as a stage of the pipeline: zero-velocity updates at rest, the thermal model at all times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.estimation.temperature_rate.series import SegmentClock
from imumon.estimation.zupt import kernel
from imumon.estimation.zupt.bank import known_family, unknown_family
from imumon.estimation.zupt.parameters import ZuptParameters
from imumon.estimation.zupt.thermal_input import ThermalInput
from imumon.estimation.zupt.trail import BiasTrail
from imumon.models.model import BiasModel

Mode = Literal["standard", "thermal", "learned"]
NAMES = ("gyro_bias", "gyro_bias_sd", "gyro_corrected", "zupt_innovation")
_MEANINGS = (
    ("rad/s", "bias of the raw rate"),
    ("rad/s", "standard deviation of the bias"),
    ("rad/s", "angular rate less bias"),
    ("1", "zero-velocity innovation over its standard deviation, at the end of a slot; NaN between"),
)


class ZeroVelocity:
    """Bias of each gyro with its standard deviation, whatever the attitude of the unit.

    The columns ``gyro_bias_{x,y,z}`` hold the whole bias of the raw rate.  The earth rate is not in it where
    latitude and heading are given; with the latitude alone its vertical part is not; else it is part of the
    bias, and `notices` says so.  There is no estimate (NaN) until the unit was at rest for some seconds.

    Parameters
    ----------
    parameters : ZuptParameters
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

    Raises
    ------
    ImumonError
        BAD_CONFIG when the thermal mode has no model, or the model lacks a gyro.
    """

    def __init__(
        self,
        parameters: ZuptParameters | None = None,
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
        self._parameters = parameters or ZuptParameters()
        self._thermal = ThermalInput(
            model, self._parameters.thermal_form if mode == "thermal" else "increments"
        )
        self._settings = _settings(self._parameters, latitude_deg, heading_deg)
        self._learns = mode == "learned"
        self._state = kernel.empty_state(self._settings, self._learns, self._parameters.zeroing_s)
        kernel.restart(self._state)
        self._trail = BiasTrail(model)
        self._clock = SegmentClock()
        self._begun = False
        self._pending = _notices_at_start(latitude_deg, heading_deg)
        self._said: set[str] = set()
        self._lacks_rest = False
        self._jumps = 0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return [
            Column(f"{name}_{axis}", unit, description=f"{meaning}, {axis}")
            for name, (unit, meaning) in zip(NAMES, _MEANINGS, strict=True)
            for axis in "xyz"
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``, the gyros, and ``at_rest``; the accelerometers tell a slow
        rotation from a bias.
        """
        n = len(block)
        gyro = block.gyro
        if gyro is None:
            gyro = np.full((n, 3), np.nan)
        result = [np.empty((n, 3)) for _ in NAMES]
        first = 0
        if not self._begun:
            valid = np.flatnonzero(np.isfinite(gyro).all(1))
            first = int(valid[0]) if len(valid) else n
            self._begun = bool(len(valid))
        for part in result:
            part[:first] = np.nan
        if first < n:
            later = block.rows(first, n) if first else block
            self._follow(later, gyro[first:], [part[first:] for part in result])
        return {
            f"{name}_{axis}": part[:, j]
            for name, part in zip(NAMES, result, strict=True)
            for j, axis in enumerate("xyz")
        }

    def _follow(self, block: SampleBlock, gyro: FloatArray, result: Sequence[FloatArray]) -> None:
        """Fill bias, sd, corrected rate and innovation of rows from the first valid one on."""
        bias, sd, corrected, innovation = result
        innovation[:] = np.nan
        accel, rest = block.accel, self._rest(block)
        if accel is None:
            accel = np.full_like(gyro, np.nan)
        temperature = self._thermal.temperature(block)
        for start, stop, begins, seconds in self._clock.runs(block["device_time_ns"], block["segment"]):
            if begins:
                kernel.restart(self._state)
                self._thermal.begin()
            part = slice(start, stop)
            rows = block if stop - start == len(block) else block.rows(start, stop)
            total, variance = self._thermal.process(seconds, rows, temperature[part])
            kernel.process(
                seconds,
                gyro[part],
                accel[part],
                rest[part],
                total,
                variance,
                temperature[part],
                self._settings,
                self._state,
                bias[part],
                sd[part],
                innovation[part],
            )
            self._trail.add(block["device_time_ns"][part], temperature[part], bias[part])
        np.subtract(gyro, bias, out=corrected)

    def charts(self) -> Sequence[Chart]:
        """Return the bias over temperature, beside the model's curve where there is a model."""
        return self._trail.charts()

    def _rest(self, block: SampleBlock) -> npt.NDArray[np.bool_]:
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
        jumps = int(self._state.flag[kernel.JUMPS])
        if jumps > self._jumps:
            self._jumps = jumps
            texts.append(
                f"for {kernel.PATIENCE_S:.0f} s at rest the rate contradicted the bias: it has jumped, or "
                "the unit turns; the bias is estimated anew"
            )
        return texts


def _settings(
    parameters: ZuptParameters, latitude_deg: float | None, heading_deg: float | None
) -> kernel.Settings:
    def axes(value: float | list[float] | None, absent: float) -> FloatArray:
        return np.array(np.broadcast_to(absent if value is None else value, 3), np.float64)

    def angle(value: float | None) -> float:
        return math.nan if value is None else math.radians(value)

    instability = parameters.bias_instability_rad_per_s
    walk = parameters.rate_random_walk_rad_per_s_per_sqrt_s
    tilt = parameters.velocity_random_walk_m_per_s_per_sqrt_s
    unknown = instability is None and walk is None
    return kernel.Settings(
        unknown_family() if unknown else known_family(axes(instability, 0.0), axes(walk, 0.0)),
        axes(parameters.angle_random_walk_rad_per_sqrt_s, math.nan),
        math.nan if tilt is None else tilt,
        angle(latitude_deg),
        angle(heading_deg),
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
