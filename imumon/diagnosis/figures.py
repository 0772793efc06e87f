"""The plots of the report, as SVG text: what an engineer looks at."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.engine import Diagnosis
from imumon.diagnosis.verdict import ChannelVerdict
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.harmless import for_plot

HOUR_S = 3600.0
SCALES = {"rad/s": (1.0 / DEG_PER_H, "°/h"), "m/s^2": (1.0 / MICRO_G, "µg")}
"""Factor to the unit that a person reads, and that unit; others are read as they are."""
COLOURS = ("#1f4e79", "#c0504d", "#4f7f3f", "#8064a2", "#d08a2e", "#4bacc6")
SIZE = (5.2, 3.0)


def shown(unit: str) -> tuple[float, str]:
    """Return the factor to the unit that a person reads, and that unit."""
    return SCALES.get(unit, (1.0, unit))


def figures(diagnosis: Diagnosis, verdict: ChannelVerdict) -> dict[str, str]:
    """Return the plots of a channel, caption to SVG."""
    drawn: dict[str, Callable[[Axes], None]] = {}
    if verdict.test_before is not None and diagnosis.test:
        drawn["Test: residual before and after"] = lambda axes: _test(axes, diagnosis.test, verdict)
    drawn |= {
        "Training residual of the declared model (dots) and what the effects take away (line)": lambda axes: (
            _in_time(axes, diagnosis.train, verdict)
        ),
        "The same against temperature: loops": lambda axes: _loops(axes, diagnosis.train, verdict),
        "Spectrum of the training residual, before and after": lambda axes: _spectra(
            axes, diagnosis.train, verdict
        ),
    }
    for claim in verdict.claims:
        drawn[f"Residual against {claim.finding.name}, the rest of the model taken away"] = (
            lambda axes, name=claim.finding.name: _against(axes, diagnosis.train, verdict, name)  # type: ignore[misc]  # the default binds the name
        )
    return {caption: svg(draw) for caption, draw in drawn.items()}


def svg(draw: Callable[[Axes], None]) -> str:
    """Return what is drawn as SVG text."""
    settings: Any = {"svg.fonttype": "path", "svg.hashsalt": "imumon", "font.size": 8}
    with mpl.rc_context(settings):
        figure = Figure(figsize=SIZE, layout="constrained")
        draw(figure.add_subplot())
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]


def _split(runs: Sequence[RunBlocks], values: FloatArray) -> list[FloatArray]:
    bounds = np.cumsum([len(run) for run in runs])[:-1]
    return np.split(values, bounds)


def _scaled(verdict: ChannelVerdict) -> tuple[float, str]:
    return shown(verdict.channel.unit)


def _in_time(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale, unit = _scaled(verdict)
    before, after = _split(runs, verdict.before.train), _split(runs, verdict.after.train)
    for at, run in enumerate(runs):
        colour = COLOURS[at % len(COLOURS)]
        axes.plot(run.time_s / HOUR_S, before[at] * scale, ".", ms=3, color=colour, label=for_plot(run.name))
        axes.plot(run.time_s / HOUR_S, (before[at] - after[at]) * scale, "-", lw=1, color=colour)
    axes.set(xlabel="time since power-on, h", ylabel=f"{verdict.name}, {unit}")
    axes.legend(fontsize=6)


def _loops(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale, unit = _scaled(verdict)
    before = _split(runs, verdict.before.train)
    for at, run in enumerate(runs):
        axes.plot(
            run.temperature[verdict.channel.temperature],
            before[at] * scale,
            ".-",
            ms=3,
            lw=0.5,
            color=COLOURS[at % len(COLOURS)],
            label=for_plot(run.name),
        )
    axes.set(xlabel="temperature, °C", ylabel=f"{verdict.name}, {unit}")


def _spectra(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale, unit = _scaled(verdict)
    longest = max(range(len(runs)), key=lambda at: len(runs[at]))
    run = runs[longest]
    for label, model, colour in (
        ("before", verdict.before, COLOURS[1]),
        ("after", verdict.after, COLOURS[0]),
    ):
        values = _split(runs, model.train)[longest] * scale
        window = np.hanning(len(values))
        power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2
        density = 2 * power * run.block_s / (window**2).sum()
        axes.loglog(
            np.fft.rfftfreq(len(values), run.block_s)[1:], np.sqrt(density[1:]), color=colour, label=label
        )
    axes.axhline(
        verdict.channel.floor.sd * scale * np.sqrt(2 * run.block_s), ls=":", color="k", label="white floor"
    )
    axes.set(xlabel="frequency, Hz", ylabel=f"{unit}/√Hz")
    axes.legend(fontsize=6)


def _against(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict, name: str) -> None:
    scale, unit = _scaled(verdict)
    after = _split(runs, verdict.after.train)
    for at, run in enumerate(runs):
        drive = run.drives[verdict.channel.temperature]
        parts = [part for part in verdict.after.parts if part.effect.label == name]
        part = np.sum([one.added(run, drive, at) for one in parts], axis=0)
        axes.plot(
            part * scale,
            (part + after[at]) * scale,
            ".",
            ms=3,
            color=COLOURS[at % len(COLOURS)],
            label=for_plot(run.name),
        )
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], "k:", lw=1)
    axes.set(xlabel=f"{name} as fitted, {unit}", ylabel=f"{verdict.name}, {unit}")


def _test(axes: Axes, runs: Sequence[RunBlocks], verdict: ChannelVerdict) -> None:
    scale, unit = _scaled(verdict)
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    offset = 0.0
    estimated = verdict.test_after.estimated_rms != verdict.test_after.rms
    for at, run in enumerate(runs):
        hours = run.time_s / HOUR_S + offset
        before, after = verdict.test_before.residual[at], verdict.test_after.residual[at]
        label = at == 0
        axes.plot(hours, before * scale, ".", ms=3, color=COLOURS[1], label="before" if label else None)
        axes.plot(hours, after * scale, ".", ms=3, color=COLOURS[0], label="after" if label else None)
        if estimated:
            further = verdict.test_after.estimated[at]
            name = "estimated in the test" if label else None
            axes.plot(hours, further * scale, "-", lw=1, color=COLOURS[2], label=name)
        outside = ~verdict.test_after.counted[at]
        axes.plot(hours[outside], np.zeros(outside.sum()), "k|", ms=4, label="not scored" if label else None)
        offset = float(hours[-1])
    axes.set(xlabel="time, h", ylabel=f"{verdict.name}, {unit}")
    axes.legend(fontsize=6)
