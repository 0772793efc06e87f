"""The plots of the report, as SVG text."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imumon.blocks import FloatArray
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.harmless import for_plot
from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.verdict import ChannelVerdict

HOUR_S = 3600.0
SCALES = {"rad/s": (1.0 / DEG_PER_H, "°/h"), "m/s^2": (1.0 / MICRO_G, "µg")}
"""Factor to the unit that a person reads, and that unit; others are read as they are."""
COLOURS = ("#1f4e79", "#c0504d", "#4f7f3f", "#8064a2", "#d08a2e", "#4bacc6")
AFTER, BEFORE = COLOURS[:2]
SIZE, WIDE = (5.2, 3.0), (9.6, 3.2)


def shown(unit: str) -> tuple[float, str]:
    """Return the factor to the unit that a person reads, and that unit."""
    return SCALES.get(unit, (1.0, unit))


def figures(diagnosis: Diagnosis, verdict: ChannelVerdict) -> dict[str, str]:
    """Return the plots of a channel, caption to SVG."""
    runs = diagnosis.train
    return {
        "Training over time: what the declared model leaves (dots), and the effects (line)": svg(
            lambda axes: _training(axes, runs, verdict)
        ),
        "The same over temperature: a loop here is no curve": svg(
            lambda axes: _over_temperature(axes, runs, verdict)
        ),
    }


def errors_plot(diagnosis: Diagnosis, verdict: ChannelVerdict) -> str:
    """Return the picture that the page opens with: the error before and after, of a test if there is one."""
    draw = _test if diagnosis.test else _fitted
    return svg(lambda axes: draw(axes, diagnosis, verdict), WIDE)


def svg(draw: Callable[[Axes], None], size: tuple[float, float] = SIZE) -> str:
    """Return what is drawn as SVG text."""
    settings: Any = {"svg.fonttype": "path", "svg.hashsalt": "imumon", "font.size": 8}
    with mpl.rc_context(settings):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]


def _split(runs: Sequence[RunBlocks], values: FloatArray) -> list[FloatArray]:
    return np.split(values, np.cumsum([len(run) for run in runs])[:-1])


def _labelled(axes: Axes, verdict: ChannelVerdict, what: str, over: str) -> None:
    axes.set(xlabel=over, ylabel=f"{what} {verdict.name}, {shown(verdict.channel.unit)[1]}")
    axes.legend(fontsize=6)


def _training(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale = shown(verdict.channel.unit)[0]
    before, after = _split(runs, verdict.before.train), _split(runs, verdict.after.train)
    for at, run in enumerate(runs):
        hours, colour = run.time_s / HOUR_S, COLOURS[at % len(COLOURS)]
        axes.plot(hours, before[at] * scale, ".", ms=3, color=colour, label=for_plot(run.name))
        if verdict.claims:
            axes.plot(hours, (before[at] - after[at]) * scale, "-", lw=1, color=colour)
    _labelled(axes, verdict, "left of", "time since power-on, h")


def _over_temperature(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale = shown(verdict.channel.unit)[0]
    for at, (run, left) in enumerate(zip(runs, _split(runs, verdict.before.train), strict=True)):
        t, colour = run.temperature[verdict.channel.temperature], COLOURS[at % len(COLOURS)]
        axes.plot(t, left * scale, ".-", ms=3, lw=0.5, color=colour, label=for_plot(run.name))
    _labelled(axes, verdict, "left of", "temperature, °C")


def _fitted(axes: Axes, diagnosis: Diagnosis, verdict: ChannelVerdict) -> None:
    before, after = (_split(diagnosis.train, fit.train) for fit in (verdict.before, verdict.after))
    _both(axes, verdict, diagnosis.train, before, after)
    _labelled(axes, verdict, "training error of", "time, h")


def _test(axes: Axes, diagnosis: Diagnosis, verdict: ChannelVerdict) -> None:
    before, after = verdict.test_before, verdict.test_after
    left = after.estimated if verdict.claims and after.left < after.rms else after.residual
    ends = _both(axes, verdict, diagnosis.test, before.residual, left)
    outside = [hours[~use] for hours, use in zip(ends, after.counted, strict=True)]
    beyond = np.concatenate(outside)
    axes.plot(beyond, np.zeros(len(beyond)), "k|", ms=4, label="not scored" if len(beyond) else None)
    _labelled(axes, verdict, "test error of", "time, h")


def _both(
    axes: Axes,
    verdict: ChannelVerdict,
    runs: Sequence[RunBlocks],
    before: Sequence[FloatArray],
    after: Sequence[FloatArray],
) -> list[FloatArray]:
    """Draw the errors of runs one after another, and the white noise of a mean; return their times in h."""
    scale, ends, offset = shown(verdict.channel.unit)[0], [], 0.0
    for run in runs:
        ends.append(run.time_s / HOUR_S + offset)
        offset = float(ends[-1][-1])
    hours = np.concatenate(ends)
    axes.plot(hours, np.concatenate(before) * scale, ".", ms=4, color=BEFORE, label="before")
    if verdict.claims:
        axes.plot(hours, np.concatenate(after) * scale, ".", ms=4, color=AFTER, label="after")
    floor = verdict.channel.floor.sd * scale
    axes.axhspan(-floor, floor, color="0.85", zorder=0, label="white noise of a mean")
    return ends
