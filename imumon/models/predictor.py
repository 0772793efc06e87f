"""The bias that a model expects, sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.effects.base import ACCEL, TEMPERATURE, Effect
from imumon.effects.live import Carrier
from imumon.effects.vibration import VIBRATION, Vibration
from imumon.errors import bad_config
from imumon.models.model import REACH, BiasModel, ChannelModel

NO_DRIVERS: Mapping[str, FloatArray] = {}
PIECES = 2048
"""Pieces of the table that stands for a curve live; its error is 1e-9 of the curve's span or less."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a model expects of k channels at n samples."""

    bias: FloatArray
    """rad/s or m/s², (n, k); NaN before the first temperature."""
    slope: FloatArray
    """db/dT of the curve, per °C; NaN before the first temperature, (n, k)."""
    inside: BoolArray
    """Whether the temperature is where the model was calibrated, (n, k); False before the first."""
    start_sd: FloatArray
    """Standard deviation of the bias due to the unknown state at power-on of effects with memory, (n, k);
    it dies away."""


class BiasPredictor:
    """Bias over temperature with its effects, causal, whatever the division into blocks.

    Where there is no temperature the last one holds.  After a restart of the device (a new segment) there is
    none until the next reading: nobody knows how long the unit was off.  Outside the calibrated range see
    `imumon.models.model.REACH`; effects see a temperature that is held there, and so any other driver.  Costs
    about 0.1 µs per sample and channel, whatever the curve, and 50 µs per block; an effect costs 40 to 90 ns
    in long blocks, and 0.2 ms for each block.

    Raises BAD_CONFIG when the model lacks a channel.

    Parameters
    ----------
    channels : sequence of str
        Such as gyro_x; the columns of the result, in this order.
    """

    def __init__(self, model: BiasModel, channels: Sequence[str]) -> None:
        if lacking := [name for name in channels if name not in model.channels]:
            raise bad_config(
                f"the bias model has no {', '.join(lacking)}; it has {', '.join(model.channels)}",
                "calibrate with data that has these columns",
            )
        models = [model.channels[name] for name in channels]
        self.temperature_columns = tuple(channel.temperature_column for channel in models)
        """Column to take each channel's temperature from."""
        ranges = [channel.temperature_range_degc for channel in models]
        self._low, self._high = np.array(ranges, np.float64).reshape(-1, 2).T
        self._reach = np.array([channel.reach_degc for channel in models])
        self._per_degc = PIECES / (self._high - self._low)
        self._cubics = np.stack([_cubics(m) for m in models]) if models else np.empty((0, PIECES, 4))
        self._effects = [(at, effect, Carrier(effect)) for at, m in enumerate(models) for effect in m.effects]
        inputs = dict.fromkeys(name for _, effect, _ in self._effects for name in effect.inputs)
        self._vibration = Vibration() if VIBRATION in inputs else None
        self.drivers = tuple(name for name in inputs if name not in (ACCEL, VIBRATION))
        """Further columns that effects need."""
        self._others = [name for name in inputs if name != ACCEL]
        self._forced = ACCEL in inputs
        self._last = np.full(len(models) + len(self._others) + 3 * self._forced, np.nan)
        self._segment = -1

    def process(
        self,
        time_ns: IntArray,
        segment: IntArray,
        temperature: FloatArray,
        accel: FloatArray | None = None,
        others: Mapping[str, FloatArray] = NO_DRIVERS,
    ) -> Prediction:
        """Return the expected bias of the next samples.

        Parameters
        ----------
        time_ns, segment : array (n,)
            Device time and its segment.
        temperature : array (n, k)
            °C, of each channel; NaN where there is none.
        accel : array (n, 3), optional
            Specific force, m/s²; without it an effect of the specific force adds nothing.
        others : mapping of str to array (n,)
            The columns `drivers`; without one of them the bias of a channel that needs it is NaN.
        """
        n, k = len(time_ns), len(self._low)
        if temperature.shape != (n, k) or len(segment) != n:
            raise ValueError(f"temperature of shape {temperature.shape} for {n} samples of {k} channels")
        if self._vibration is not None and accel is not None and VIBRATION not in others:
            others = {**others, VIBRATION: self._vibration.process(time_ns, segment, accel)}
        columns = [temperature, *(others.get(name, np.full(n, np.nan)) for name in self._others)]
        if self._forced:
            columns.append(np.full((n, 3), np.nan) if accel is None else accel)
        held = self._held(segment, np.column_stack(columns))
        near = np.clip(held[:, :k], self._low, self._high)
        bias, slope = self._curve(near)
        outside = held[:, :k] - near
        bias += np.where(outside == 0.0, 0.0, slope * np.clip(outside, -self._reach, self._reach))
        slope[np.abs(outside) > self._reach] = 0.0
        drivers = dict(zip(self._others, held[:, k:].T, strict=False))
        if self._forced and accel is not None:
            drivers[ACCEL] = held[:, -3:]
        variance = np.zeros((n, k))
        for at, effect, carrier in self._effects:
            within = _within(effect, drivers)
            low, high = self._low[at] - self._reach[at], self._high[at] + self._reach[at]
            within[TEMPERATURE] = np.clip(held[:, at], low, high)
            added, start_sd = carrier.process(time_ns, segment, within)
            bias[:, at] += added
            variance[:, at] += start_sd**2
        return Prediction(bias, slope, outside == 0.0, np.sqrt(variance))

    def of_block(self, block: SampleBlock) -> Prediction:
        """Return the expected bias at the samples of a block; columns that it lacks are missing."""
        none = np.full(len(block), np.nan)
        temperature = [block.columns.get(name, none) for name in self.temperature_columns]
        others = {name: block[name] for name in self.drivers if name in block}
        stacked = np.column_stack(temperature).astype(np.float64)
        return self.process(block["device_time_ns"], block["segment"], stacked, block.accel, others)

    def _held(self, segment: IntArray, values: FloatArray) -> FloatArray:
        """Return the last value of each column in the segment, (n, m), and carry it on."""
        n = len(segment)
        if not n:
            return values
        known = np.isfinite(values)
        known[segment != np.concatenate([[self._segment], segment[:-1]])] = True  # nothing is held across
        row = np.maximum.accumulate(np.where(known, np.arange(1, n + 1)[:, np.newaxis], 0), axis=0)
        held = np.concatenate([self._last[np.newaxis], values])[row, np.arange(values.shape[1])]
        self._last, self._segment = held[-1].copy(), int(segment[-1])
        return held

    def _curve(self, temperature: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return value and slope of the curves at temperatures within their ranges, (n, k) each."""
        position = (temperature - self._low) * self._per_degc
        piece = np.minimum(np.where(np.isnan(position), 0.0, position).astype(np.int64), PIECES - 1)
        s = position - piece
        c0, c1, c2, c3 = self._cubics[np.arange(len(self._low)), piece].transpose(2, 0, 1)
        return c0 + s * (c1 + s * (c2 + s * c3)), (c1 + s * (2.0 * c2 + 3.0 * s * c3)) * self._per_degc


def _within(effect: Effect, drivers: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the drivers of an effect, held where they leave what training showed."""
    found = {name: drivers[name] for name in effect.inputs if name in drivers}
    for name, values in found.items():
        if name != ACCEL and (scale := effect.scale_of(name)) is not None:
            far = scale.half_span * (1.0 + 2.0 * REACH)
            found[name] = np.clip(values, scale.middle - far, scale.middle + far)
    return found


def _cubics(channel: ChannelModel) -> FloatArray:
    """Return the curve over `PIECES` pieces of its range as cubics of 0 to 1, (PIECES, 4).

    They have the curve's values and slopes where they meet.
    """
    low, high = channel.temperature_range_degc
    at, width = np.linspace(low, high, PIECES + 1), (high - low) / PIECES
    value, slope = channel.curve.value(at), channel.curve.slope(at) * width
    y0, y1, d0, d1 = value[:-1], value[1:], slope[:-1], slope[1:]
    return np.column_stack([y0, d0, 3.0 * (y1 - y0) - 2.0 * d0 - d1, 2.0 * (y0 - y1) + d0 + d1])
