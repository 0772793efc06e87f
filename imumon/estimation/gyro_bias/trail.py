"""Charts of the bias over temperature: the calibrated curve, where the bias has been, and where it is now."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.estimation.gyro_bias.thermal_input import GYROS
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel

MOST_POINTS = 250
"""When more are kept, every second one is dropped, and from then on half as many are taken."""


class BiasTrail:
    """Bias over temperature since the start, thinned to constant memory, beside the curves of a model."""

    def __init__(self, model: BiasModel | None) -> None:
        self._channels = [] if model is None else [model.channels[name] for name in GYROS]
        self._points: list[FloatArray] = []
        self._every, self._count = 1, 0

    def add(self, temperature: FloatArray, bias: FloatArray) -> None:
        """Take estimates of slots, (n, 3) each, in °C and rad/s."""
        points = np.hstack([temperature, bias])
        for point in points[np.isfinite(points).all(1)]:
            if self._count % self._every == 0:
                self._points.append(point)
            self._count += 1
            if len(self._points) > MOST_POINTS:
                self._points, self._every = self._points[::2], 2 * self._every

    def charts(self) -> list[Chart]:
        """Return the chart of the bias, and with a model that of the bias less its curve; none without
        data."""
        if not self._points:
            return []
        degc, bias = np.hsplit(np.array(self._points), 2)
        lines, expected = [], np.zeros_like(bias)
        for j, ((axis, color), channel) in enumerate(zip(AXIS_COLORS.items(), self._channels, strict=False)):
            low, high = channel.temperature_range_degc
            at = np.linspace(low, high, 101)
            lines.append(Curve(f"{axis}, model", at, channel.value(at) / DEG_PER_H, color, width=1.2))
            expected[:, j] = channel.value(degc[:, j])
        dots = "dots: estimates since the start; large: now"
        note = f"line: model; {dots}" if lines else dots
        charts = [
            _chart(
                "gyro_bias", "Gyro bias", "Gyro bias over temperature", [*lines, *_trails(degc, bias)], note
            )
        ]
        if lines:
            title = "Gyro bias less the calibrated curve"
            charts.append(_chart("gyro_bias_left", "Residual", title, _trails(degc, bias - expected), dots))
        return charts


def _chart(name: str, tab: str, title: str, curves: list[Curve], note: str) -> Chart:
    return Chart(name, tab, title, Axis("temperature [°C]"), Axis("[°/h]"), tuple(curves), notes=(note,))


def _trails(degc: FloatArray, bias: FloatArray) -> list[Curve]:
    """Return where each axis has been, and where it is now as a larger point; °C and rad/s, (n, 3)."""
    curves = []
    for j, (axis, color) in enumerate(AXIS_COLORS.items()):
        x, y = degc[:, j], bias[:, j] / DEG_PER_H
        curves.append(Curve(f"{axis}, estimate", x, y, color, points=True, width=2.5))
        curves.append(Curve(f"now {axis}", x[-1:], y[-1:], color, points=True, width=9.0, listed=False))
    return curves
