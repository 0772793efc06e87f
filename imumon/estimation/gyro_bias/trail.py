"""Charts of the bias over temperature: the calibrated curve, where the bias has been, and where it is now."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.charts import AXIS_COLORS, GREY, Axis, Chart, Curve
from imumon.estimation.gyro_bias.thermal_input import GYROS
from imumon.models.model import BiasModel

TAB, RESIDUAL = "Gyro bias", "Residual"
DEG_PER_HOUR = math.degrees(3600.0)
SPACING_NS = 1_000_000_000
MOST_POINTS = 250
"""When more are kept, every second one is dropped, and from then on half as many are taken."""
CURVE_POINTS = 101


class BiasTrail:
    """Bias over temperature since the start, thinned to constant memory.

    Parameters
    ----------
    model : BiasModel or None
        Whose curves are drawn beside it.
    """

    def __init__(self, model: BiasModel | None) -> None:
        self._model = model
        self._points: list[FloatArray] = []
        self._spacing_ns = SPACING_NS
        self._next_ns: int | None = None

    def add(self, time_ns: IntArray, temperature: FloatArray, bias: FloatArray) -> None:
        """Take estimates, (n, 3) each, in °C and rad/s, at times (n,): the first of each interval."""
        for t, point in zip(time_ns.tolist(), np.hstack([temperature, bias]), strict=True):
            if self._next_ns is not None and self._next_ns - self._spacing_ns <= t < self._next_ns:
                continue
            if np.isfinite(point).all():
                self._points.append(point)
                if len(self._points) > MOST_POINTS:
                    self._points = self._points[::2]
                    self._spacing_ns *= 2
            self._next_ns = (t // self._spacing_ns + 1) * self._spacing_ns

    def charts(self) -> list[Chart]:
        """Return the chart of the bias, and with a model that of the bias less its curve; none without
        data."""
        if not self._points:
            return []
        points = np.array(self._points)
        degc, bias = points[:, :3], points[:, 3:] * DEG_PER_HOUR
        x = Axis("temperature [°C]")
        curves = self._model_curves() + _trails(degc, bias)
        charts = [Chart("gyro_bias", TAB, "Gyro bias over temperature", x, Axis("[°/h]"), tuple(curves))]
        if self._model is not None:
            predicted = [self._model.channels[name].value(degc[:, j]) for j, name in enumerate(GYROS)]
            left = bias - np.column_stack(predicted) * DEG_PER_HOUR
            charts.append(
                Chart(
                    "gyro_bias_left",
                    RESIDUAL,
                    "Gyro bias less the calibrated curve",
                    x,
                    Axis("[°/h]"),
                    tuple(_trails(degc, left)),
                )
            )
        return charts

    def _model_curves(self) -> list[Curve]:
        if self._model is None:
            return []
        curves = []
        for (axis, color), name in zip(AXIS_COLORS.items(), GYROS, strict=True):
            channel = self._model.channels[name]
            low, high = channel.temperature_range_degc
            degc = np.linspace(low, high, CURVE_POINTS)
            value = channel.value(degc) * DEG_PER_HOUR
            faint = tuple((part + 2 * grey) // 3 for part, grey in zip(color, GREY, strict=True))
            curves.append(Curve(f"curve {axis}", degc, value, (faint[0], faint[1], faint[2]), width=1.2))
        return curves


def _trails(degc: FloatArray, values: FloatArray) -> list[Curve]:
    """Return where each axis has been, and where it is now as a larger point."""
    curves = []
    for j, (axis, color) in enumerate(AXIS_COLORS.items()):
        x, y = degc[:, j], values[:, j]
        curves.append(Curve(axis, x, y, color, points=True, width=2.5))
        curves.append(Curve(f"now {axis}", x[-1:], y[-1:], color, points=True, width=9.0, listed=False))
    return curves
