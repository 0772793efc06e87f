"""The log-log picture of a recording's Allan deviations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from imumon.allan.analysis import Result
from imumon.allan.parameters import TERMS_OF
from imumon.allan.recording import GROUPS, group_of
from imumon.files import write_png
from imumon.harmless import for_plot

COLORS = {"x": "#d03c3c", "y": "#2a9a4f", "z": "#3b78d8"}
TITLES = {"gyro": "Angular rate", "accel": "Specific force"}
STYLES = {
    "angle_random_walk": ":",
    "bias_instability": "-.",
    "rate_random_walk": (0, (12, 3)),
    "quantization": (0, (1, 3)),
    "rate_ramp": (0, (10, 2, 1, 2, 1, 2)),
    "correlated_noise": (0, (3, 2, 3, 2, 1, 2)),
}
"""Lines of the terms, in their order."""
DARK = "0.25"
"""Colour of the lines of a legend that hold for all axes."""


def write_plot(path: Path, results: Mapping[str, Result], title: str) -> None:
    """Draw the overlapping Allan deviations with their intervals, and the fit, to a PNG.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    groups = [group for group in GROUPS if any(group_of(name) == group for name in results)]
    figure = Figure(figsize=(7.0 * len(groups), 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    for number, group in enumerate(groups):
        axes = figure.add_subplot(1, len(groups), number + 1)
        _draw(axes, group, {name: result for name, result in results.items() if group_of(name) == group})
    figure.suptitle(for_plot(title), fontsize=11)
    write_png(path, figure, 130)


def _draw(axes: Any, group: str, results: Mapping[str, Result]) -> None:
    level = TERMS_OF[group]["bias_instability"]
    factor, unit = level.factor, level.shown
    drawn: set[str] = set()
    for name, result in results.items():
        axis = name[-1]
        color, tau, allan = COLORS[axis], result.tau_s, result.allan
        trusted = result.trusted
        axes.fill_between(tau, factor * allan.low, factor * allan.high, color=color, alpha=0.16, lw=0)
        axes.plot(tau[:trusted], factor * allan.values[:trusted], color=color, lw=1.8, label=axis)
        axes.plot(tau, factor * allan.values, color=color, lw=0.8)
        drawn |= _draw_fit(axes, result, factor, color)
    longest = max((result.longest_tau_s for result in results.values() if result.trusted), default=None)
    if longest is not None:
        axes.axvline(longest, color="0.6", lw=0.8)
        axes.annotate(
            "longest trusted τ", (longest, 0.99), xycoords=("data", "axes fraction"), rotation=90,
            ha="right", va="top", fontsize=8, color="0.4",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="averaging time τ [s]", ylabel=f"Allan deviation [{unit}]")
    axes.set_title(TITLES[group], fontsize=10)
    axes.grid(which="major", color="0.8", lw=0.6)
    axes.grid(which="minor", color="0.92", lw=0.4)
    fitted = any(result.fit is not None for result in results.values())
    handles = [*axes.get_legend_handles_labels()[0], *_legend_of_all_axes(group, fitted, drawn)]
    axes.legend(handles=handles, loc="lower left", fontsize=8, handlelength=3.2)


def _legend_of_all_axes(group: str, fitted: bool, drawn: set[str]) -> list[Any]:
    """Return the entries of the legend that hold for the curves of all axes: the styles that are drawn."""
    handles: list[Any] = [
        Line2D([], [], color=DARK, lw=0.8, label="beyond the longest trusted τ"),
        Patch(color=DARK, alpha=0.16, lw=0, label="68 % interval"),
    ]
    if fitted:
        handles.append(Line2D([], [], color=DARK, lw=1.0, ls="--", label="fit: sum of the terms"))
    titles = {term: TERMS_OF[group][term].title for term in STYLES if term in drawn}
    return handles + [
        Line2D([], [], color=DARK, lw=1.0, ls=STYLES[term], label=f"its part: {title}")
        for term, title in titles.items()
    ]


def _draw_fit(axes: Any, result: Result, factor: float, color: str) -> set[str]:
    """Draw the sum of the terms, and thinly each of those that the data show; return the terms drawn."""
    fit = result.fit
    drawn: set[str] = set()
    if fit is None:
        return drawn
    tau = np.geomspace(result.tau_s[fit.first], result.tau_s[fit.last], 100)
    parts = fit.shares(tau / result.series.interval_s).T
    deviation = factor * np.sqrt(np.maximum(parts.sum(axis=0), 0.0))
    axes.plot(tau, deviation, color=color, lw=1.0, ls="--")
    for (term, style), part in zip(STYLES.items(), parts, strict=True):
        if fit.terms[term] is not None and np.count_nonzero(fit.coefficients) > 1:
            line = factor * np.sqrt(np.maximum(part, 0.0))
            line[line < 0.5 * deviation.min()] = np.nan
            axes.plot(tau, line, color=color, lw=0.9, ls=style)
            drawn.add(term)
    return drawn
