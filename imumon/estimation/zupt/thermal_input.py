"""What a bias model tells the filter: how far the bias has moved, and how far to trust that."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import FloatArray, SampleBlock
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

GYROS = ("gyro_x", "gyro_y", "gyro_z")
CORRELATION_DEGC = 5.0
"""Errors of a curve at temperatures farther apart than about this have little to do with each other."""
MARK_DEGC = 0.5
"""The temperature has moved when it is this far from where it was last noted: noise does not count."""
# What is carried per axis: last prediction, sum of increments, variance, temperature noted, farthest outside,
# doubt of the state at power-on when the sums began, and the variance that its fading has brought since.
LAST, TOTAL, VARIANCE, MARK, OUTSIDE, DOUBT, FADED = range(7)


class ThermalInput:
    """Sum of the model's increments since the start, and of the variance that they bring.

    Parameters
    ----------
    model : BiasModel or None
        None: the bias stays where it is.
    form : "increments" or "slope_rate"
        b(T_k) - b(T_k-1), or the published T_s (∂b/∂T) Ṫ with the rate from the columns temperature_rate.

    Raises
    ------
    ImumonError
        BAD_CONFIG when the model lacks a gyro.
    """

    def __init__(self, model: BiasModel | None, form: str = "increments") -> None:
        self._predictor = BiasPredictor(model, GYROS) if model is not None else None
        self._by_rate = form == "slope_rate"
        columns = self._predictor.temperature_columns if self._predictor is not None else ["temperature"] * 3
        self._sources = [_sources(name, axis) for name, axis in zip(columns, "xyz", strict=True)]
        self._trust = np.zeros((3, 4))
        if model is not None:
            for trust, name in zip(self._trust, GYROS, strict=True):
                channel = model.channels[name]
                low, high = channel.temperature_range_degc
                slopes = channel.slope(np.linspace(low, high, 101))
                trust[:] = channel.residual_sd, np.sqrt(np.mean(slopes**2)), low, high
        self._temperature = np.full(3, np.nan)
        self._carried = np.zeros((3, 7))
        self.begin()
        self.outside = False
        """Whether the temperature has been outside the range that the model was made for."""
        self.lacking = False
        """Whether what the model needs was missing in a block with samples."""

    @property
    def ranges_degc(self) -> FloatArray:
        """Calibrated range of each axis, (3, 2)."""
        return self._trust[:, 2:]

    def begin(self) -> None:
        """Start the sums at nought."""
        self._carried[:] = 0.0
        self._carried[:, [LAST, MARK, DOUBT]] = np.nan

    def temperature(self, block: SampleBlock) -> FloatArray:
        """Return the temperature of each gyro in °C, the estimated one where there is one, (n, 3)."""
        result = np.empty((len(block), 3))
        for j, sources in enumerate(self._sources):
            # The reading is a stopgap where the estimate has not begun; mixed with it, it would jump.
            name = next((name for name in sources if name in block), None)
            result[:, j] = np.nan if name is None else block[name]
        return result

    def process(
        self, seconds: FloatArray, block: SampleBlock, temperature: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what the model has added to the bias since `begin` (rad/s), and to its variance, (n, 3).

        Parameters
        ----------
        seconds : array (n,)
            Time, s.
        block : SampleBlock
            Of one segment.
        temperature : array (n, 3)
            As from `temperature`.
        """
        total, variance = np.zeros((len(block), 3)), np.zeros((len(block), 3))
        if self._predictor is None:
            return total, variance
        predicted = self._predictor.process(
            block["device_time_ns"], block["segment"], temperature, block.accel
        )
        bias, doubt = predicted.bias, predicted.doubt
        if self._by_rate:
            bias, doubt = np.full_like(bias, np.nan), np.zeros_like(doubt)
            for j, axis in enumerate("xyz"):
                rates = [f"temperature_rate_{axis}", "temperature_rate"]
                name = next((name for name in rates if name in block), None)
                if name is not None:
                    bias[:, j] = predicted.slope[:, j] * block[name]
        self.outside |= bool((np.isfinite(temperature) & ~predicted.inside).any())
        self.lacking |= bool(len(block) and not np.isfinite(bias).any())
        _accumulate(
            seconds, bias, doubt, temperature, self._by_rate, self._trust, self._carried, total, variance
        )
        return total, variance


def _sources(column: str, axis: str) -> list[str]:
    suffix = column.removeprefix("temperature").removeprefix("_estimate")
    suffixes = [suffix] if suffix else ["", f"_{axis}"]
    return [f"temperature{kind}{end}" for kind in ("_estimate", "") for end in suffixes]


@njit(cache=True, nogil=True)
def _accumulate(
    seconds: FloatArray,
    bias: FloatArray,
    doubt: FloatArray,
    temperature: FloatArray,
    by_rate: bool,
    trust: FloatArray,
    carried: FloatArray,
    total: FloatArray,
    variance: FloatArray,
) -> None:
    """Sum increments of the bias (or its rate times dt) and the variance that comes with them.

    Within the calibrated range the error of the curve is a random walk over temperature; outside it the slope
    itself is unknown.  An unknown state at power-on has moved the bias by its doubt at first less that now.
    """
    for j in range(3):
        residual, steep, low, high = trust[j, 0], trust[j, 1], trust[j, 2], trust[j, 3]
        state = carried[j]
        for i in range(len(seconds)):
            if math.isfinite(bias[i, j]):
                if by_rate:
                    if math.isfinite(state[LAST]):
                        state[TOTAL] += bias[i, j] * (seconds[i] - state[LAST])
                    state[LAST] = seconds[i]
                else:
                    if math.isfinite(state[LAST]):
                        state[TOTAL] += bias[i, j] - state[LAST]
                    state[LAST] = bias[i, j]
                    if not math.isfinite(state[DOUBT]):
                        state[DOUBT] = doubt[i, j]
                    state[FADED] = max(state[FADED], (doubt[i, j] - state[DOUBT]) ** 2)
            t = temperature[i, j]
            if math.isfinite(t):
                if not math.isfinite(state[MARK]):
                    state[MARK] = t
                moved = abs(t - state[MARK])
                if moved >= MARK_DEGC:
                    state[VARIANCE] += 2.0 * residual * residual * moved / CORRELATION_DEGC
                    state[MARK] = t
                beyond = max(low - t, t - high, 0.0)
                if beyond > state[OUTSIDE]:
                    state[VARIANCE] += steep * steep * (beyond**2 - state[OUTSIDE] ** 2)
                    state[OUTSIDE] = beyond
                elif beyond == 0.0:
                    state[OUTSIDE] = 0.0
            total[i, j] = state[TOTAL]
            variance[i, j] = state[VARIANCE] + state[FADED]
