"""Live Allan curves as a stage of the pipeline: no columns, but charts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from imumon.allan.parameters import TERMS_OF, AllanParameters
from imumon.allan.streaming import LiveCurve, StreamingAllan
from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import AXIS_COLORS, GREY, Axis, Chart, Curve
from imumon.columns import Column
from imumon.estimation.rest.parameters import retired

TAB = "Allan"
_TITLES = {
    "gyro": "Allan deviation of the angular rate, at rest; upright bars: 68 % intervals",
    "accel": "Allan deviation of the specific force, at rest; upright bars: 68 % intervals",
}
CHANNELS = tuple(f"{group}_{axis}" for group in _TITLES for axis in AXIS_COLORS)


class AllanStage:
    """Allan deviations of the gyros and accelerometers, as they come.

    With a column ``at_rest`` only samples at rest count; motion ends a run as a gap does.

    Parameters
    ----------
    parameters : AllanParameters, optional
        Its keys are not used any more; those that are given are named once.
    """

    columns: Sequence[Column] = ()
    """None: a curve over averaging time is not a quantity of each sample."""

    def __init__(self, parameters: AllanParameters | None = None) -> None:
        self._retired = [] if parameters is None else retired(parameters)
        self._channels: dict[str, StreamingAllan] = {}
        self._restarts = 0

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Take the samples of a block; needs ``device_time_ns`` and ``segment``."""
        rest = block.columns.get("at_rest")
        for name in CHANNELS:
            if name in block:
                values: FloatArray = np.asarray(block[name], np.float64)
                if rest is not None:
                    values = np.where(rest == 1, values, np.nan)
                channel = self._channels.setdefault(name, StreamingAllan())
                channel.process(block["device_time_ns"], block["segment"], values)
        return {}

    def notices(self) -> list[str]:
        """Say once which keys are not used any more, and that the rate changed and the curves began anew."""
        restarts = max((channel.restarts for channel in self._channels.values()), default=0)
        new, self._restarts = restarts > self._restarts, restarts
        keys, self._retired = self._retired, []
        texts = [f"allan: {key} is not used any more" for key in keys]
        return texts + (["the sample rate changed: the Allan curves begin anew"] if new else [])

    def charts(self) -> Sequence[Chart]:
        """Return one log-log chart per sensor; none while no averaging time can be trusted."""
        charts = []
        for group, title in _TITLES.items():
            level = TERMS_OF[group]["bias_instability"]
            channels = {axis: self._channels.get(f"{group}_{axis}") for axis in AXIS_COLORS}
            found = {axis: one.curve().trusted() for axis, one in channels.items() if one is not None}
            shown = {axis: curve for axis, curve in found.items() if len(curve.tau_s) > 1}
            if shown:
                x, y = Axis("averaging time [s]", log=True), Axis(f"[{level.shown}]", log=True)
                notes = tuple(_note(axis, curve, group) for axis, curve in found.items())
                curves = tuple(_curves(shown, level.factor))
                charts.append(Chart(f"allan_{group}", TAB, title, x, y, curves, notes=notes))
        return charts


def _curves(shown: Mapping[str, LiveCurve], factor: float) -> Iterator[Curve]:
    """Yield the curve of each axis, upright bars over their intervals, and the line of white noise."""
    for axis, curve in shown.items():
        yield Curve(axis, curve.tau_s, factor * curve.deviation, AXIS_COLORS[axis], width=2.0)
    for axis, curve in shown.items():
        gap = np.full(len(curve.tau_s), np.nan)
        x = np.column_stack([curve.tau_s, curve.tau_s, gap]).ravel()
        y = factor * np.column_stack([curve.low, curve.high, gap]).ravel()
        yield Curve(f"68 % {axis}", x, y, AXIS_COLORS[axis], width=1.0, listed=False)
    # Slope -1/2, through the longest curve where its random walk is read.
    curve = max(shown.values(), key=lambda one: len(one.tau_s))
    near = _at_1_s(curve)
    line = factor * curve.deviation[near] * np.sqrt(curve.tau_s[near] / curve.tau_s)
    yield Curve("white noise", curve.tau_s, line, GREY, width=1.2, dashed=True)


def _note(axis: str, curve: LiveCurve, group: str) -> str:
    """Return what can be read off a curve: at 1 s the random walk, with its interval, and the lowest."""
    text = least = "-"
    if len(curve.tau_s):
        level, walk = TERMS_OF[group]["bias_instability"], TERMS_OF[group]["angle_random_walk"]
        near = _at_1_s(curve)
        if 0.5 <= curve.tau_s[near] <= 2.0:
            scale = walk.factor * math.sqrt(curve.tau_s[near])
            reach = 0.5 * (curve.high[near] - curve.low[near]) * scale
            text = f"{curve.deviation[near] * scale:.3g} ± {reach:.2g} {walk.shown}"
        lowest = int(np.argmin(curve.deviation))
        so_far = " so far" if lowest == len(curve.tau_s) - 1 else ""
        least = f"{level.factor * curve.deviation[lowest]:.3g} {level.shown}{so_far}"
    return f"{axis}  random walk {text:24} lowest {least}"


def _at_1_s(curve: LiveCurve) -> int:
    """Return which point of a curve is the nearest to 1 s."""
    return int(np.argmin(np.abs(np.log(curve.tau_s))))
