"""Charts of the bias over temperature: the calibrated curve, where the bias has been, and where it is now."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from imumon.blocks import FloatArray, IntArray
from imumon.charts import AXIS_COLORS, GREY, Axis, Chart, Curve
from imumon.estimation.zupt.thermal_input import GYROS
from imumon.models.model import BiasModel

TAB = "Gyro bias"
DEG_PER_HOUR = math.degrees(3600.0)
SPACING_NS = 1_000_000_000
MOST_POINTS = 250
"""When more are kept, every second one is dropped, and from then on half as many are taken."""
CURVE_POINTS = 101
SPACING, COUNT, NEXT_NS = range(3)
NEVER = -1


class BiasTrail:
    """Bias over temperature since the start, thinned to constant memory.

    Parameters
    ----------
    model : BiasModel or None
        Whose curves are drawn beside it.
    """

    def __init__(self, model: BiasModel | None) -> None:
        self._model = model
        self._points = np.empty((MOST_POINTS, 6))
        self._state = np.array([SPACING_NS, 0, NEVER])

    def add(self, time_ns: IntArray, temperature: FloatArray, bias: FloatArray) -> None:
        """Take estimates, (n, 3) each, in °C and rad/s, at times (n,)."""
        _gather(time_ns, temperature, bias, self._points, self._state)

    def charts(self) -> list[Chart]:
        """Return the chart of the bias, and with a model that of the bias less its curve; none without
        data."""
        points = self._points[: self._state[COUNT]].copy()  # the view draws them later
        if not len(points):
            return []
        degc, bias = points[:, :3], points[:, 3:] * DEG_PER_HOUR
        x = Axis("temperature [°C]")
        curves = self._model_curves() + _trails(degc, bias)
        charts = [Chart("gyro_bias", TAB, "Gyro bias over temperature", x, Axis("[°/h]"), tuple(curves))]
        if self._model is not None:
            foretold = [self._model.channels[name].value(degc[:, j]) for j, name in enumerate(GYROS)]
            left = bias - np.column_stack(foretold) * DEG_PER_HOUR
            charts.append(
                Chart(
                    "gyro_bias_left",
                    TAB,
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


@njit(cache=True, nogil=True)
def _gather(
    time_ns: IntArray, temperature: FloatArray, bias: FloatArray, points: FloatArray, state: IntArray
) -> None:
    """Keep the first sample of each interval; where the points are full, every second one of them."""
    for i in range(len(time_ns)):
        t = time_ns[i]
        if state[NEXT_NS] - state[SPACING] <= t < state[NEXT_NS]:
            continue
        begun = state[NEXT_NS] != NEVER
        state[NEXT_NS] = (t // state[SPACING] + 1) * state[SPACING]
        total = temperature[i].sum() + bias[i].sum()
        if not begun or not math.isfinite(total):
            continue
        if state[COUNT] == len(points):
            half = (len(points) + 1) // 2
            for k in range(half):
                points[k] = points[2 * k]
            state[COUNT] = half
            state[SPACING] *= 2
            state[NEXT_NS] = (t // state[SPACING] + 1) * state[SPACING]
        points[state[COUNT], :3] = temperature[i]
        points[state[COUNT], 3:] = bias[i]
        state[COUNT] += 1


def _trails(degc: FloatArray, values: FloatArray) -> list[Curve]:
    """Return where each axis has been, and where it is now as a larger point."""
    curves = []
    for j, (axis, color) in enumerate(AXIS_COLORS.items()):
        x, y = degc[:, j], values[:, j]
        curves.append(Curve(axis, x, y, color, points=True, width=2.5))
        curves.append(Curve(f"now {axis}", x[-1:], y[-1:], color, points=True, width=9.0, listed=False))
    return curves
