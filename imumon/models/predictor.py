"""The bias that a model expects, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.effects.base import Carrier
from imumon.errors import ImumonError, Reason
from imumon.models.model import BiasModel, ChannelModel

PIECES = 2048
"""Pieces of the table that stands for a curve live; its error is 1e-9 of the curve's span or less."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a model expects of k channels at n samples.

    Parameters
    ----------
    bias : array (n, k)
        rad/s or m/s²; NaN before the first temperature.
    slope : array (n, k)
        db/dT of the curve, per °C; NaN before the first temperature.
    inside : array (n, k) of bool
        Whether the temperature is where the model was calibrated; False before the first.
    doubt : array (n, k)
        Standard deviation of the bias due to the unknown state at power-on of effects with memory; it dies
        away.
    """

    bias: FloatArray
    slope: FloatArray
    inside: npt.NDArray[np.bool_]
    doubt: FloatArray


class BiasPredictor:
    """Bias over temperature with its effects, causal, whatever the division into blocks.

    Where there is no temperature the last one holds.  After a restart of the device (a new segment) there is
    none until the next reading: nobody knows how long the unit was off.  Outside the calibrated range see
    `imumon.models.model.REACH`; effects see a temperature that is held there.  Costs about 10 ns per sample
    and channel, whatever the curve; an effect costs 40 to 90 ns in long blocks, and 0.2 ms for each block.

    Parameters
    ----------
    model : BiasModel
    channels : sequence of str
        Such as gyro_x; the columns of the result, in this order.

    Raises
    ------
    ImumonError
        BAD_CONFIG when the model lacks a channel.
    """

    def __init__(self, model: BiasModel, channels: Sequence[str]) -> None:
        if lacking := [name for name in channels if name not in model.channels]:
            raise ImumonError(
                Reason.BAD_CONFIG,
                f"the bias model has no {', '.join(lacking)}; it has {', '.join(model.channels)}",
                "calibrate with data that has these columns",
            )
        models = [model.channels[name] for name in channels]
        self.temperature_columns = tuple(channel.temperature_column for channel in models)
        """Column to take each channel's temperature from."""
        self._ranges = np.array([_range(channel) for channel in models]).reshape(-1, 5)
        self._tables = np.stack([_table(channel) for channel in models]) if models else np.empty((0, 0, 2))
        self._last = np.full(len(models), np.nan)
        self._segment = np.full(1, -1, np.int64)
        self._effects = [(at, Carrier(effect)) for at, m in enumerate(models) for effect in m.effects]

    def process(
        self,
        time_ns: IntArray,
        segment: IntArray,
        temperature: FloatArray,
        accel: FloatArray | None = None,
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
        """
        n, k = len(time_ns), len(self._last)
        if temperature.shape != (n, k) or len(segment) != n:
            raise ValueError(f"temperature of shape {temperature.shape} for {n} samples of {k} channels")
        bias, slope, inside = np.empty((n, k)), np.empty((n, k)), np.empty((n, k), np.bool_)
        follow(
            segment, temperature, self._ranges, self._tables, self._last, self._segment, bias, slope, inside
        )
        variance = np.zeros((n, k))
        for at, carrier in self._effects:
            low, high, reach = self._ranges[at, :3]
            held = np.clip(temperature[:, at], low - reach, high + reach)
            added, doubt = carrier.process(time_ns, segment, held, accel)
            bias[:, at] += added
            variance[:, at] += doubt**2
        return Prediction(bias, slope, inside, np.sqrt(variance))


def _range(channel: ChannelModel) -> list[float]:
    """Return low and high end, reach, width of a piece, and pieces per °C."""
    low, high = channel.temperature_range_degc
    return [low, high, channel.reach_degc, (high - low) / PIECES, PIECES / (high - low)]


def _table(channel: ChannelModel) -> FloatArray:
    """Return value and slope at the ends of `PIECES` pieces of the range, (PIECES + 1, 2)."""
    low, high = channel.temperature_range_degc
    at = np.linspace(low, high, PIECES + 1)
    return np.column_stack([channel.curve.value(at), channel.curve.slope(at)])


@njit
def follow(
    segment: IntArray,
    temperature: FloatArray,
    ranges: FloatArray,
    tables: FloatArray,
    last: FloatArray,
    last_segment: IntArray,
    bias: FloatArray,
    slope: FloatArray,
    inside: npt.NDArray[np.bool_],
) -> None:
    """Fill bias, slope and inside, (n, k); carry `last` (k,) and `last_segment` (1,).

    Cubic Hermite interpolation between the rows of `tables` (k, pieces + 1, 2).
    """
    pieces = tables.shape[1] - 1
    for i in range(len(segment)):
        if segment[i] != last_segment[0]:
            last_segment[0] = segment[i]
            last[:] = np.nan
        for j in range(len(last)):
            if np.isfinite(temperature[i, j]):
                last[j] = temperature[i, j]
            if np.isnan(last[j]):
                bias[i, j], slope[i, j], inside[i, j] = np.nan, np.nan, False
                continue
            low, high, reach = ranges[j, 0], ranges[j, 1], ranges[j, 2]
            near = min(max(last[j], low), high)
            h, per_degc = ranges[j, 3], ranges[j, 4]
            position = (near - low) * per_degc
            at = min(int(position), pieces - 1)
            s = position - at
            y0, d0 = tables[j, at, 0], tables[j, at, 1] * h
            y1, d1 = tables[j, at + 1, 0], tables[j, at + 1, 1] * h
            c2, c3 = 3.0 * (y1 - y0) - 2.0 * d0 - d1, 2.0 * (y0 - y1) + d0 + d1
            b = y0 + s * (d0 + s * (c2 + s * c3))
            d = (d0 + s * (2.0 * c2 + 3.0 * s * c3)) * per_degc
            beyond = last[j] - near
            inside[i, j] = beyond == 0.0
            bias[i, j] = b + d * min(max(beyond, -reach), reach)
            slope[i, j] = d if abs(beyond) <= reach else 0.0
