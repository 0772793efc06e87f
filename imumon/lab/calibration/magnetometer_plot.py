"""The picture of a magnetometer's calibration: readings as sent and corrected, in three planes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imumon.files import write_png
from imumon.harmless import for_plot
from imumon.lab.calibration.magnetometer import MagnetometerFit

PLANES = ((0, 1), (1, 2), (2, 0))
MOST_POINTS = 1500
"""More make the file large, and hide each other."""


def write_magnetometer_plot(path: Path, fit: MagnetometerFit, title: str) -> None:
    """Draw readings, field, and the circle that the field should lie in, to a PNG.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    model, turn = fit.model, np.linspace(0.0, 2.0 * np.pi, 200)
    every = 1 + len(fit.field) // MOST_POINTS
    readings, field = fit.readings[::every], fit.field[::every]
    figure = Figure(figsize=(13.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    for number, (i, j) in enumerate(PLANES):
        axes = figure.add_subplot(1, 3, number + 1)
        axes.plot(readings[:, i], readings[:, j], ".", ms=2, color="0.65", label="as sent")
        axes.plot(field[:, i], field[:, j], ".", ms=2, color="#3b78d8", label="corrected")
        axes.plot(model.field * np.cos(turn), model.field * np.sin(turn), color="0.2", lw=0.9)
        axes.plot(model.hard_iron[i], model.hard_iron[j], "+", ms=11, color="#d03c3c", label="hard iron")
        axes.set(xlabel=f"{'xyz'[i]} [{model.unit}]", ylabel=f"{'xyz'[j]} [{model.unit}]", aspect="equal")
        axes.grid(color="0.9", lw=0.5)
    figure.axes[0].legend(loc="upper right", fontsize=9, framealpha=0.9)
    figure.suptitle(
        f"{for_plot(title)}: strength {model.field:.4g} {model.unit}, "
        f"scatter {fit.residual_before:.2g} as sent, {model.residual_sd:.2g} corrected; "
        f"{model.coverage:.0%} of the directions",
        fontsize=11,
    )
    write_png(path, figure, 110)
