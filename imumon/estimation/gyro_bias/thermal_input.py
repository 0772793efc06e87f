"""The increments of a thermal bias model as a known input, and the variance that they add."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.effects.thermal_lag import UNTOLD_S
from imumon.filters.rates import UNSEEN_RATE
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

GYROS = ("gyro_x", "gyro_y", "gyro_z")
MOVED_DEGC = 0.5
"""The temperature has moved when it is this far from where it was last noted: noise does not count."""
CORRELATION_DEGC = 5.0
"""Errors of a curve at temperatures farther apart than about this have little to do with each other."""


def unseen_lag(gap_s: float, rate_sd: FloatArray) -> FloatArray:
    """Return by how much the lag of each gyro's temperature may have changed in a gap (sd), °C, (3,).

    `rate_sd` (3,) is what is known of the thermometer's rate behind it, °C/s; NaN without an estimate.
    """
    unseen = np.where(np.isfinite(rate_sd), rate_sd, UNSEEN_RATE)
    return np.asarray(-UNTOLD_S * math.expm1(-gap_s / UNTOLD_S) * unseen)


@dataclass(slots=True, eq=False)
class ThermalVariance:
    """Variance that an uncertain thermal model has brought since the start, of three axes.

    Within the calibrated range the error of the curve is a random walk over temperature; outside it the slope
    itself is unknown, and the farthest counts.  An unknown state at power-on fades: what has
    faded, its sd at first less that now, has moved the bias.
    """

    residual: FloatArray
    """Of the curve, rad/s, (3,)."""
    steepness: FloatArray
    """Rms slope of the curve, rad/s/°C, (3,)."""
    low_degc: FloatArray
    """Lower end of the calibrated range, (3,)."""
    high_degc: FloatArray
    """Its upper end, (3,); zero without a model."""
    walk: FloatArray = field(init=False)
    """Variance of the random walk so far, (3,)."""
    mark_degc: FloatArray = field(init=False)
    """Temperature up to which it has been counted, (3,)."""
    beyond_degc: FloatArray = field(init=False)
    """Farthest outside of the calibrated range, (3,)."""
    first_sd: FloatArray = field(init=False)
    """Of the state at power-on, (3,)."""
    faded: FloatArray = field(init=False)
    """Variance by what has faded of it, (3,)."""

    def __post_init__(self) -> None:
        """Begin."""
        self.begin()

    def begin(self) -> None:
        """Start at zero."""
        self.walk, self.beyond_degc, self.faded = np.zeros((3, 3))
        self.mark_degc, self.first_sd = np.full((2, 3), np.nan)

    def step(self, degc: FloatArray, sd: FloatArray) -> FloatArray:
        """Return the variance at these temperatures, with this sd of the state, (3,); NaN changes nothing."""
        if not self.high_degc.any():
            return self.walk  # there is no model
        self.mark_degc = np.where(np.isfinite(self.mark_degc), self.mark_degc, degc)
        moved = np.abs(degc - self.mark_degc)
        far = moved >= MOVED_DEGC
        self.walk = self.walk + np.where(far, 2.0 * self.residual**2 * moved / CORRELATION_DEGC, 0.0)
        self.mark_degc = np.where(far, degc, self.mark_degc)
        self.beyond_degc = np.fmax(self.beyond_degc, np.fmax(self.low_degc - degc, degc - self.high_degc))
        self.first_sd = np.where(np.isfinite(self.first_sd), self.first_sd, sd)
        self.faded = np.fmax(self.faded, (sd - self.first_sd) ** 2)
        return np.asarray(self.walk + (self.steepness * self.beyond_degc) ** 2 + self.faded)

    def miss(self, lag_degc: FloatArray) -> None:
        """Add what the lag behind the thermometer may have done in a gap (sd), (3,)."""
        self.walk = self.walk + (self.steepness * lag_degc) ** 2


class ThermalInput:
    """Sum of the model's increments since the start, and of the variance that they bring.

    Raises BAD_CONFIG when the model lacks a gyro.

    Parameters
    ----------
    model : BiasModel or None
        None: the bias stays where it is.
    """

    def __init__(self, model: BiasModel | None) -> None:
        self._predictor = BiasPredictor(model, GYROS) if model is not None else None
        columns = self._predictor.temperature_columns if self._predictor is not None else ["temperature"] * 3
        self._sources = [_sources(name, axis) for name, axis in zip(columns, "xyz", strict=True)]
        trust = np.zeros((3, 4))
        if model is not None:
            for row, name in zip(trust, GYROS, strict=True):
                channel = model.channels[name]
                low, high = channel.temperature_range_degc
                slopes = channel.slope(np.linspace(low, high, 101))
                row[:] = channel.residual_sd, np.sqrt(np.mean(slopes**2)), low, high
        self.variance = ThermalVariance(*trust.T)
        self._reference = np.full(3, np.nan)
        self.outside = False
        """Whether the temperature has been outside the range that the model was made for."""
        self.lacking = False
        """Whether what the model needs was missing in a block with samples."""

    @property
    def ranges_degc(self) -> FloatArray:
        """Calibrated range of each axis, (3, 2)."""
        return np.column_stack([self.variance.low_degc, self.variance.high_degc])

    def begin(self) -> None:
        """Start the sums at zero."""
        self._reference[:] = np.nan

    def temperature(self, block: SampleBlock) -> FloatArray:
        """Return the temperature of each gyro in °C, the estimated one where there is one, (n, 3)."""
        # The reading is a stopgap where the estimate has not begun; mixed with it, it would jump.
        return _first_of(block, self._sources)

    def rate_sd(self, block: SampleBlock) -> FloatArray:
        """Return what is known of the rate of each gyro's temperature (sd), °C/s, (n, 3); NaN without one."""
        return _first_of(block, [[names[0].replace("estimate", "rate_sd")] for names in self._sources])

    def process(
        self, block: SampleBlock, temperature: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the model has added to the bias since `begin` and its curve (rad/s), and its sd.

        Parameters
        ----------
        block : SampleBlock
            Of one segment.
        temperature : array (n, 3)
            As from `temperature`.

        Returns
        -------
        total, curve, sd : array (n, 3)
            The curve is zero without a model, and NaN before the first temperature; the sd is that of the
            unknown state at power-on, NaN before the first temperature.
        """
        n = len(block)
        if self._predictor is None:
            return np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        others = {name: block[name] for name in self._predictor.drivers if name in block}
        times, segment = block["device_time_ns"], block["segment"]
        predicted = self._predictor.process(times, segment, temperature, block.accel, others)
        known = np.isfinite(predicted.bias)
        sd = np.where(known, predicted.start_sd, np.nan)
        for j in np.flatnonzero(np.isnan(self._reference) & known.any(0)):
            self._reference[j] = predicted.bias[np.argmax(known[:, j]), j]
        total = np.where(known, predicted.bias - self._reference, 0.0)
        self.outside |= bool((np.isfinite(temperature) & ~predicted.inside).any())
        self.lacking |= bool(n and not known.any())
        return total, predicted.bias, sd


def _first_of(block: SampleBlock, sources: list[list[str]]) -> FloatArray:
    """Return the first column of each list that a block has, (n, lists); NaN without one."""
    none = np.full(len(block), np.nan)
    found = [next((block[name] for name in names if name in block), none) for names in sources]
    return np.column_stack(found).astype(np.float64)


def _sources(column: str, axis: str) -> list[str]:
    suffix = column.removeprefix("temperature").removeprefix("_estimate")
    suffixes = [suffix] if suffix else ["", f"_{axis}"]
    return [f"temperature{kind}{end}" for kind in ("_estimate", "") for end in suffixes]
