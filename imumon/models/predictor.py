"""The bias that a model expects, sample by sample."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.effects.base import ACCEL, TEMPERATURE, Drive, Effect, Memory
from imumon.effects.vibration import VIBRATION, Vibration
from imumon.errors import bad_config

from .model import REACH, BiasModel


class Carrier:
    """Carries an effect along live: the bias that it adds, and how unsure its state at power-on leaves it.

    Whatever the division into blocks; where the device restarts the state is forgotten.
    """

    def __init__(self, effect: Effect) -> None:
        self._effect = effect
        self._segment: int | None = None
        self._start_ns = 0
        self._memories: list[Memory] = []

    def process(
        self, time_ns: IntArray, segment: IntArray, drivers: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bias at each sample, from this sample and those before it, and the standard deviation
        that the unknown state at power-on leaves it, (n,) each.

        `drivers` are the temperature in °C, (n,), the specific force in m/s², (n, 3), and other columns by
        their names, (n,).  They are NaN only before their first value in a segment, where the bias is NaN, as
        it is where a column is missing.  An effect of the specific force adds nothing without it.
        """
        n, needed = len(segment), (TEMPERATURE, *self._effect.inputs)
        bias, start_sd = np.zeros(n), np.zeros(n)
        if ACCEL in needed and ACCEL not in drivers:
            return bias, start_sd
        driven = {name: drivers.get(name, np.full(n, np.nan)) for name in needed}
        known = np.isfinite(np.column_stack(list(driven.values()))).all(axis=1)
        cuts = np.flatnonzero(np.diff(segment)) + 1
        for a, b in pairwise([0, *cuts.tolist(), n]):
            if a < b and segment[a] != self._segment:
                self._segment, self._start_ns, self._memories = int(segment[a]), int(time_ns[a]), []
            first = a + int(np.argmax(known[a:b])) if known[a:b].any() else b
            bias[a:first] = np.nan
            if first < b:
                seconds = np.asarray((time_ns[first:b] - self._start_ns) * 1e-9, np.float64)
                part = {name: values[first:b].copy() for name, values in driven.items()}
                drive = Drive(seconds, part.pop(TEMPERATURE), part.pop(ACCEL, None), part)
                if not self._memories:
                    self._memories = [Memory(), *(self._effect.starts(drive) or ())]
                bias[first:b], *ends = [self._effect.added(memory, drive) for memory in self._memories]
                if ends:
                    start_sd[first:b] = 0.5 * self._effect.start_share * np.abs(ends[1] - ends[0])
        return bias, start_sd


class Prediction(NamedTuple):
    """What a model expects of k channels at n samples."""

    bias: FloatArray  # rad/s or m/s², (n, k); NaN before the first temperature
    slope: FloatArray  # db/dT of the curve, per °C, (n, k); NaN before the first temperature
    inside: BoolArray  # whether the temperature is where the model was calibrated, (n, k); else False
    start_sd: FloatArray  # sd of the bias by the unknown state at power-on, which dies away, (n, k)


class BiasPredictor:
    """Bias over temperature with its effects, causal, whatever the division into blocks.

    Where there is no temperature the last one holds.  After a restart of the device (a new segment) there is
    none until the next reading: how long the unit was off is not known.  Outside the calibrated range see
    `imumon.models.model.REACH`; effects receive a temperature that is held there, and so any other driver.

    Raises BAD_CONFIG when the model lacks a channel.

    `channels`: such as gyro_x; the columns of the result, in this order.
    """

    def __init__(self, model: BiasModel, channels: Sequence[str]) -> None:
        if lacking := [name for name in channels if name not in model.channels]:
            raise bad_config(
                f"the bias model has no {', '.join(lacking)}; it has {', '.join(model.channels)}",
                "calibrate with data that has these columns",
            )
        self._models = models = [model.channels[name] for name in channels]
        self.temperature_columns = tuple(channel.temperature_column for channel in models)
        """Column to take each channel's temperature from."""
        self._effects = [(at, effect, Carrier(effect)) for at, m in enumerate(models) for effect in m.effects]
        inputs = dict.fromkeys(name for _, effect, _ in self._effects for name in effect.inputs)
        self._vibration = Vibration() if VIBRATION in inputs else None
        self.drivers = tuple(name for name in inputs if name not in (ACCEL, VIBRATION))
        """Further columns that effects need."""
        self._others = [name for name in inputs if name != ACCEL]
        self._last = np.full(len(models) + 3 + len(self._others), np.nan)
        self._segment = -1

    def process(
        self,
        time_ns: IntArray,
        segment: IntArray,
        temperature: FloatArray,
        accel: FloatArray | None = None,
        others: Mapping[str, FloatArray] = {},
    ) -> Prediction:
        """Return the expected bias of the next samples.

        `time_ns`, `segment` (n,): device time and its segment.
        `temperature` (n, k): °C, of each channel; NaN where there is none.
        `accel` (n, 3): specific force, m/s²; without it an effect of the specific force adds nothing.
        `others` (n,): the columns `drivers`; without one of them the bias of a channel that needs it is NaN.
        """
        n, k = temperature.shape
        if self._vibration is not None and accel is not None and VIBRATION not in others:
            others = {**others, VIBRATION: self._vibration.process(time_ns, segment, accel)}
        force, none = np.full((n, 3), np.nan) if accel is None else accel, np.full(n, np.nan)
        columns = [temperature, force, *(others.get(name, none) for name in self._others)]
        held = self._held(segment, np.column_stack(columns))
        bias, slope, inside = np.empty((n, k)), np.empty((n, k)), np.empty((n, k), bool)
        for at, model in enumerate(self._models):
            bias[:, at], slope[:, at] = model.value_and_slope(held[:, at])
            inside[:, at] = model.inside(held[:, at])
        drivers = dict(zip(self._others, held[:, k + 3 :].T, strict=True))
        if accel is not None:
            drivers[ACCEL] = held[:, k : k + 3]
        variance = np.zeros((n, k))
        for at, effect, carrier in self._effects:
            within = _within(effect, drivers)
            model = self._models[at]
            low, high = model.temperature_range_degc
            within[TEMPERATURE] = np.clip(held[:, at], low - model.reach_degc, high + model.reach_degc)
            added, start_sd = carrier.process(time_ns, segment, within)
            bias[:, at] += added
            variance[:, at] += start_sd**2
        return Prediction(bias, slope, inside, np.sqrt(variance))

    def of_block(self, block: SampleBlock, temperature: FloatArray | None = None) -> Prediction:
        """Return the expected bias at the samples of a block; columns that it lacks are missing.

        A `temperature` (n, k) is taken instead of the columns of each channel.
        """
        if temperature is None:
            temperature = block.stacked(self.temperature_columns)
        others = {name: block[name] for name in self.drivers if name in block}
        return self.process(block["device_time_ns"], block["segment"], temperature, block.accel, others)

    def _held(self, segment: IntArray, values: FloatArray) -> FloatArray:
        """Return the last value of each column in the segment, (n, m), and carry it on."""
        n = len(segment)
        if not n:
            return values
        known = np.isfinite(values)
        known[segment != np.concatenate([[self._segment], segment[:-1]])] = True  # nothing is held across
        row = np.maximum.accumulate(np.where(known, np.arange(1, n + 1)[:, None], 0), axis=0)
        held = np.concatenate([self._last[None], values])[row, np.arange(values.shape[1])]
        self._last, self._segment = held[-1].copy(), int(segment[-1])
        return held


def _within(effect: Effect, drivers: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the drivers of an effect, held where they leave what training showed."""
    found = {name: drivers[name] for name in effect.inputs if name in drivers}
    for name, values in found.items():
        if name != ACCEL and (scale := effect.scale_of(name)) is not None:
            far = scale.half_span * (1.0 + 2.0 * REACH)
            found[name] = np.clip(values, scale.middle - far, scale.middle + far)
    return found
