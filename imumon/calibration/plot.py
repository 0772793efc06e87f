"""The picture of a calibration: the curve of each channel, what it was fitted to, and what it leaves over."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imumon.calibration.calibration import Calibration
from imumon.files import write_png
from imumon.harmless import for_plot

SHOWN = {"rad/s": ("°/h", 206264.80624709636), "m/s^2": ("mg", 1e3 / 9.80665)}
"""What a person reads, and how many of it one of the model's units is."""


def write_calibration_plot(path: Path, result: Calibration, title: str) -> None:
    """Draw a column for each channel to a PNG: above curve and points, below the residuals with 1σ.

    Raises
    ------
    OSError
        When the file cannot be written; one that was there before is untouched.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # takes 0.3 s, and few want a picture
    from matplotlib.figure import Figure

    names = list(result.findings)
    figure = Figure(figsize=(4.2 * len(names), 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, len(names), sharex="col", squeeze=False, height_ratios=(2, 1))
    for name, (above, below) in zip(names, grid.T, strict=True):
        finding, model = result.findings[name], result.model.channels[name]
        unit, factor = SHOWN[model.unit]
        points, curve = finding.points, finding.choice.curve
        at = np.linspace(points.temperature.min(), points.temperature.max(), 400)
        above.plot(points.temperature, factor * points.value, ".", ms=2, color="0.6", label="at rest")
        above.plot(at, factor * curve.value(at), color="#d03c3c", lw=1.2, label=finding.choice.name)
        above.set(title=name, ylabel=f"[{unit}]")
        above.legend(fontsize=9)
        residual = factor * (points.value - curve.value(points.temperature))
        sd = factor * model.residual_sd
        below.plot(points.temperature, residual, ".", ms=2, color="#3b78d8")
        below.axhspan(-sd, sd, color="#d03c3c", alpha=0.15, label=f"1σ: {sd:.3g} {unit}")
        below.set(xlabel="temperature [°C]", ylabel=f"less the curve [{unit}]")
        below.legend(fontsize=9)
        for axes in (above, below):
            axes.grid(color="0.9", lw=0.5)
    figure.suptitle(f"{for_plot(title)}: bias over temperature", fontsize=11)
    write_png(path, figure, 110)
