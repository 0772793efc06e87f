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
    runs, column = diagnosis.train, verdict.channel.temperature
    hours = [run.time_s / HOUR_S for run in runs]
    degc = [run.temperature[column] for run in runs]
    return {
        "Training over time: what the declared model leaves (dots), and the effects (line)": svg(
            lambda axes: _training(axes, runs, verdict, hours, "time since power-on, h")
        ),
        "The same over temperature: a loop here is no curve": svg(
            lambda axes: _training(axes, runs, verdict, degc, "temperature, °C")
        ),
    }


def errors_plot(diagnosis: Diagnosis, verdict: ChannelVerdict) -> str:
    """Return the picture that the page opens with: the error before and after, of a test if there is one."""
    return svg(lambda axes: _errors(axes, diagnosis, verdict), WIDE)


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


def _training(
    axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict, over: Sequence[FloatArray], label: str
) -> None:
    scale, unit = shown(verdict.channel.unit)
    ends = np.cumsum([len(run) for run in runs])[:-1]
    before, after = (np.split(model.train, ends) for model in (verdict.before, verdict.after))
    for at, run in enumerate(runs):
        colour = COLOURS[at % len(COLOURS)]
        axes.plot(over[at], before[at] * scale, ".", ms=3, color=colour, label=for_plot(run.name))
        if verdict.claims:
            axes.plot(over[at], (before[at] - after[at]) * scale, "-", lw=1, color=colour)
    axes.set(xlabel=label, ylabel=f"left of {verdict.name}, {unit}")
    axes.legend(fontsize=6)


def _errors(axes: Axes, diagnosis: Diagnosis, verdict: ChannelVerdict) -> None:
    """Draw the errors of runs one after another, and the white noise of a mean."""
    scale, unit = shown(verdict.channel.unit)
    if diagnosis.test:
        what, runs, score = "test", diagnosis.test, verdict.test_after
        before, counted = verdict.test_before.residual, np.concatenate(score.counted)
        after = score.estimated if score.left < score.rms else score.residual
    else:
        what, runs = "training", diagnosis.train
        before, after = [verdict.before.train], [verdict.after.train]
        counted = np.ones(len(after[0]), bool)
    ends = np.cumsum([0.0, *(run.time_s[-1] for run in runs)])
    time = np.concatenate([run.time_s + end for run, end in zip(runs, ends[:-1], strict=True)]) / HOUR_S
    axes.plot(time, np.concatenate(before) * scale, ".", ms=4, color=BEFORE, label="before")
    if verdict.claims:
        axes.plot(time, np.concatenate(after) * scale, ".", ms=4, color=AFTER, label="after")
    if not counted.all():
        axes.plot(time[~counted], np.zeros(int((~counted).sum())), "k|", ms=4, label="not scored")
    floor = verdict.channel.floor.sd * scale
    axes.axhspan(-floor, floor, color="0.85", zorder=0, label="white noise of a mean")
    axes.set(xlabel="time, h", ylabel=f"{what} error of {verdict.name}, {unit}")
    axes.legend(fontsize=6)
