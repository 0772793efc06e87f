"""The log-log picture of a recording's Allan deviations."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from imumon.files import write_png
from imumon.harmless import for_plot

from .analysis import Result
from .covariance import TERMS_OF
from .live import MEASURED
from .recording import group_of

COLORS = {"x": "#d03c3c", "y": "#2a9a4f", "z": "#3b78d8"}


def write_plot(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Draw the overlapping Allan deviations with their intervals, and the fit, to a PNG.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    groups = [group for group in TERMS_OF if group in map(group_of, results)]
    figure = Figure(figsize=(7.0 * len(groups), 5.6), layout="constrained")
    for number, group in enumerate(groups):
        axes = figure.add_subplot(1, len(groups), number + 1)
        _draw(axes, group, {name: result for name, result in results.items() if group_of(name) == group})
    figure.suptitle(for_plot(str(source)), fontsize=11)
    write_png(path, figure, 130)


def _draw(axes: Any, group: str, results: Mapping[str, Result]) -> None:
    level = TERMS_OF[group]["bias_instability"]
    factor = level.factor
    for name, result in results.items():
        trusted = slice(result.trusted)
        line = factor * result.allan.values[trusted]
        axes.plot(result.tau_s[trusted], line, color=COLORS[name[-1]], lw=1.8, label=name[-1])
    for name, result in results.items():
        color, tau, allan = COLORS[name[-1]], result.tau_s, result.allan
        axes.plot(tau, factor * allan.values, color=color, lw=0.8)
        axes.fill_between(tau, factor * allan.low, factor * allan.high, color=color, alpha=0.16, lw=0)
        if (fit := result.fit) is not None:
            fitted = np.geomspace(tau[fit.first], tau[fit.last], 100)
            line = factor * np.sqrt(np.maximum(fit.shares(fitted / tau[0]).sum(axis=-1), 0.0))
            axes.plot(fitted, line, color=color, lw=1.0, ls="--", label="fit: sum of the terms")
    longest = max((result.longest_tau_s for result in results.values() if result.trusted), default=0.0)
    if longest:
        axes.axvline(longest, color="0.6", lw=0.8)
        axes.annotate(
            "longest trusted τ", (longest, 0.99), xycoords=("data", "axes fraction"), rotation=90,
            ha="right", va="top", fontsize=8, color="0.4",
        )  # fmt: skip
    deviation = f"Allan deviation, 68 % interval [{level.shown}]"
    axes.set(xscale="log", yscale="log", xlabel="averaging time τ [s]", ylabel=deviation)
    axes.set_title(MEASURED[group].capitalize(), fontsize=10)
    axes.grid(which="major", color="0.8", lw=0.6)
    axes.grid(which="minor", color="0.92", lw=0.4)
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))  # the fit once
    axes.legend(named.values(), named.keys(), loc="lower left", fontsize=8, handlelength=3.2)
